"""Models from MJCF, the file format of MuJoCo, and URDF, by MuJoCo's compiler: bodies, inertias,
joints, springs of joints and tendons, and a list of what was left out."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np

from jaxbody.core import tables
from jaxbody.core.errors import JaxbodyError, Problem, Problems, import_extra
from jaxbody.files.documents import LARGEST
from jaxbody.files.interchange.mjcf_documents import Node, compiled, read_nodes
from jaxbody.files.interchange.mjcf_places import ORIGIN, Place
from jaxbody.geometry.points_and_orientations import product
from jaxbody.model.bodies import Body, Support
from jaxbody.model.elements.bushings import Bushing
from jaxbody.model.elements.elements import Element
from jaxbody.model.elements.springs import Spring, SpringDamper
from jaxbody.model.elements.torsions import Torsion
from jaxbody.model.joints.combined_joints import Composite
from jaxbody.model.joints.joints import Ball, Fixed, Free, Guide, Hinge, Joint
from jaxbody.model.laws.spring_laws import TensionOnly
from jaxbody.model.layouts import WORLD
from jaxbody.model.models import Model

READ = ("compiler", "option", "default", "worldbody", "tendon")  # sections that are read
KINDS = ("free", "ball", "slide", "hinge")  # in the order of MuJoCo's numbers
STEPS = {"slide": "move", "hinge": "turn"}
# kinds of elements whose tag has another name
KIND = {"freejoint": "joint", "spatial": "tendon", "fixed": "tendon", "link": "body"}
SITE = 3  # MuJoCo's number for a site in the path of a tendon
SEVERAL = "springs and dampers of several joints of one body that turns"
LARGE_TURNS = "damping of ball joints at large turns, where it is that of the rotation vector"


class LeftOut(NamedTuple):
    """A feature of an MJCF file that is not in the model: `where` it occurs first, what it is, and
    how many times it occurs."""

    where: str
    what: str
    times: int


@dataclass(frozen=True, repr=False)
class MjcfModel(tables.Printed):
    """A model from an MJCF file, and the list of what the file states and the model leaves out."""

    model: Model
    left_out: tuple[LeftOut, ...]

    def _tables(self) -> list[tables.PrintedTable]:
        rows = [(each.what, each.times, each.where) for each in self.left_out] or [
            ("nothing", 0, "")
        ]
        return [
            *self.model._tables(),
            tables.PrintedTable("Left out", ("what", "times", "first in"), rows),
        ]


def read_mjcf(path: Any, *, largest: float = LARGEST) -> MjcfModel:
    """Read the model in an MJCF or URDF file; the result lists what was left out of it.

    It needs the package mujoco (`jaxbody[mujoco]`): MuJoCo compiles the file in a separate process,
    which also computes the masses of shapes and meshes; it reads no file outside the folder of this
    one. The shapes of a URDF are not read, as they have no mass.

    A body with joints becomes a body: one joint becomes a Free, Ball, Hinge or Guide, several
    become a Composite. A body without joints becomes a support if it is attached to the world;
    otherwise it is Fixed to its parent, or a part of it if one of the two has no mass. Springs and
    dampers of joints become torsions and bushings, those of tendons between two sites springs.
    Coordinates are zero in the pose of the file.

    Args:
        path: path of the file, .xml or .urdf; files that it names must be in its folder
        largest: largest size of each file [bytes]

    Errors: MISSING_EXTRA without mujoco; with their lines SYNTAX, WRONG_FORMAT, WRONG_KIND,
    TOO_LARGE, OUTSIDE_FOLDER and, all at once, those of bodies, joints and elements; UNREADABLE
    with MuJoCo's message; those of files.

    >>> import pathlib, tempfile
    >>> path = pathlib.Path(tempfile.mkdtemp(), "pendulum.xml")
    >>> _ = path.write_text('''<mujoco><worldbody><body name="bob" pos="0 0 1">
    ...   <joint name="pivot" axis="0 1 0" damping="0.1" armature="0.01"/>
    ...   <geom type="sphere" size="0.1" mass="2" pos="0 0 -0.5"/>
    ... </body></worldbody></mujoco>''')
    >>> read = jb.files.read_mjcf(path)
    >>> read.model["bob"].com.tolist(), sorted(each.what for each in read.left_out)
    ([0.0, 0.0, -0.5], ['armature of joints', 'contact of geoms'])
    """
    path = Path(path)
    import_extra("mujoco", path.name)
    nodes = read_nodes(path, largest)
    reader = MjcfReader(path.name, nodes, compiled(path, nodes[0].tag))
    with reader.problems:
        parts = reader.parts()
    return MjcfModel(
        Model(**parts),
        tuple(LeftOut(where, what, count) for what, (where, count) in reader.left_out.items()),
    )


@dataclass(frozen=True, eq=False)
class JointOfBody:
    """A joint as the file states it: its kind (slide, hinge, ball or free), its point [m] and axis
    in the axes of its body, its stiffness and damping (SI); `relaxed`: displacement [m] or angle
    [rad] from the pose in the file at which its spring exerts no force."""

    name: str
    where: str
    kind: str
    at: np.ndarray
    axis: np.ndarray
    stiffness: float
    damping: float
    relaxed: float


def joint_of(joints: list[JointOfBody], parent: str, on_parent: Place) -> Joint:
    """Return the joint that connects a body to its parent, in the parent's axes. Error:
    WRONG_KIND."""
    at = [on_parent.point(joint.at) for joint in joints]
    axes = [on_parent.R @ joint.axis for joint in joints]
    own_point = at[0] if joints and joints[0].at.any() else None  # None: the body's origin
    match joints:
        case []:
            return Fixed(parent)
        case [JointOfBody(kind="free")]:
            return Free()
        case [JointOfBody(kind="ball")]:
            return Ball(parent, at=own_point)
        case [JointOfBody(kind="slide")]:
            return Guide(parent, axis=axes[0])
        case [JointOfBody(kind="hinge")]:
            return Hinge(parent, axis=axes[0], at=own_point)
    for joint in joints:
        if joint.kind not in STEPS:
            raise JaxbodyError(
                Problem(
                    "WRONG_KIND",
                    "joint",
                    f"is a {joint.kind} joint, one of several of its body",
                    joint.kind,
                    ", ".join(STEPS),
                    "Put a body with a small mass between them.",
                )
            )
    return Composite(parent, [STEPS[joint.kind] for joint in joints], directions=axes, points=at)


def spring_of(
    joint: JointOfBody, joints: list[JointOfBody], body: str, parent: str, on_parent: Place
) -> Element | str:
    """Return the spring and damper of one of a body's joints, or the reason why there is none.

    The angle of a hinge follows from the poses only if no other joint of the body allows rotation,
    the coordinate of a slide only if no joint does: q_i = n*_i . d, with d the displacement
    relative to the parent, and n*_i . n_j = 1 for i = j, else 0.
    """
    at = (parent, on_parent.point(joint.at)), (body, joint.at)
    others_turn = any(other.kind != "slide" and other is not joint for other in joints)
    if joint.kind == "free":
        return "springs and dampers of free joints"
    if joint.kind == "ball":
        k, c = (np.diag([0, 0, 0, x, x, x]) for x in (joint.stiffness, joint.damping))
        return Bushing(*at, stiffness=k, damping=c, orientation=on_parent.q)
    if others_turn:
        return SEVERAL
    if joint.kind == "hinge":
        return Torsion(
            *at,
            axis=joint.axis,
            spring=joint.stiffness or None,
            damper=joint.damping or None,
            free_angle=joint.relaxed,
            orientation=on_parent.q,
        )
    along = np.linalg.pinv(np.stack([other.axis for other in joints]))[:, joints.index(joint)]
    q = _from_z_to(along)
    k, c = (np.array([0, 0, x * (along @ along)]) for x in (joint.stiffness, joint.damping))
    relaxed = parent, on_parent.point(joint.at + joint.relaxed * joint.axis)
    return Bushing(
        relaxed, at[1], stiffness=k, damping=c, orientation=product(on_parent.q, q), orientation_b=q
    )


def _from_z_to(direction: np.ndarray) -> np.ndarray:
    """Return the quaternion of the smallest rotation from the z axis to a direction of any
    length."""
    x, y, z = direction
    across = np.hypot(x, y)
    half = np.arctan2(across, z) / 2
    n = np.array([-y, x, 0.0]) / across if across else np.array([1.0, 0, 0])
    return np.array([np.cos(half), *(np.sin(half) * n)])


@dataclass
class Carried:
    """A frame of the model: its parent, its place on the parent and in the world, its joints, and
    the bodies of MuJoCo that make up its mass, by number, with the places of their principal axes
    on it. A frame that does not move is a support."""

    where: str
    parent: str
    on_parent: Place
    place: Place
    moves: bool
    joints: list[JointOfBody]
    parts: list[tuple[int, Place]] = field(default_factory=list)


class MjcfReader:
    """Reader of a model from MuJoCo's arrays, and of what is left out from them and the elements of
    the file."""

    def __init__(self, file: str, nodes: list[Node], arrays: dict[str, np.ndarray]):
        self.file, self.nodes, self.m = file, nodes, SimpleNamespace(**arrays)
        self.problems = Problems()
        self.lines = {
            (KIND.get(each.tag, each.tag), each.attributes.get("name")): each.where
            for each in nodes
        }
        # for each body of MuJoCo, the frame of the model and the place of the body on it
        self.places: list[tuple[str, Place]] = [(WORLD, ORIGIN)]
        self.carried = {WORLD: Carried(file, WORLD, ORIGIN, ORIGIN, False, [])}
        self.elements: dict[str, Element] = {}
        self.left_out: dict[str, tuple[str, int]] = {}

    def parts(self) -> dict[str, Any]:
        """Return the arguments of Model."""
        self.leave_out_sections()
        self.leave_out_effects()
        for i in range(1, len(self.m.body_parentid)):
            self.body(i)
        moving = {name: each for name, each in self.carried.items() if each.moves}
        parts: dict[str, Any] = {"gravity": self.m.gravity, "elements": self.elements}
        parts["bodies"] = {
            name: self.gather(each.where, lambda each=each: self.solid(each))
            for name, each in moving.items()
        }
        parts["joints"] = {
            name: self.gather(
                each.where,
                lambda each=each: joint_of(each.joints, each.parent, each.on_parent),
            )
            for name, each in moving.items()
        }
        parts["supports"] = {
            name: Support(each.place.p, each.place.q)
            for name, each in self.carried.items()
            if not each.moves and name != WORLD
        }
        self.springs(moving)
        self.tendons()
        return parts

    def gather(self, where: str, make: Callable[[], Any]) -> Any:
        """Return the result of `make`; if it fails, add its problems at the line `where` and return
        None."""
        return self.problems.gather(make, lambda x: replace(x, where=f"{where} {x.where}"))

    def leave_out(self, what: str, where: str, times: int = 1) -> None:
        first, count = self.left_out.get(what, (where, 0))
        self.left_out[what] = first, count + times

    def leave_out_sections(self) -> None:
        """List as left out what the file states besides bodies, joints and tendons."""
        for tag, around, attributes, where in self.nodes:
            match (*around, tag):
                case ("mujoco", "option"):
                    for name in ("density", "viscosity", "wind", "magnetic"):
                        if set(attributes.get(name, "0").split()) != {"0"}:
                            self.leave_out(f"{name} of the medium", where)
                case ("mujoco", "option", "flag"):
                    for name in ("passive", "spring", "damper"):
                        if attributes.get(name) == "disable":
                            self.leave_out(f"flag that disables {name}", where)
                case ("mujoco", section, _) if section not in READ:
                    self.leave_out(f"{section} {tag}", where)
                case ("robot", *_, "collision"):
                    self.leave_out("contact of geoms", where)

    def leave_out_effects(self) -> None:
        """List, as left out, properties that have an effect in MuJoCo but none in the model."""
        m = self.m
        effects = {
            "contact of geoms": (m.geom_contype != 0) | (m.geom_conaffinity != 0),
            "fluidshape of geoms": m.geom_fluid.any(-1),
            "gravcomp of bodies": m.body_gravcomp,
            "camera": np.ones(m.ncam),
            "light": np.ones(m.nlight),
            "flex": np.ones(m.nflex),
            "armature of joints": m.dof_armature,
            "frictionloss of joints": m.dof_frictionloss,
            "limits of joints": m.jnt_limited,
            "armature of tendons": m.tendon_armature,
            "frictionloss of tendons": m.tendon_frictionloss,
            "limits of tendons": m.tendon_limited,
            "higher powers of stiffness of joints": m.jnt_stiffnesspoly.any(-1),
            "higher powers of damping of joints": m.dof_dampingpoly.any(-1),
            "higher powers of stiffness of tendons": m.tendon_stiffnesspoly.any(-1),
            "higher powers of damping of tendons": m.tendon_dampingpoly.any(-1),
        }
        for what, numbers in effects.items():
            if times := int(np.count_nonzero(numbers)):
                self.leave_out(what, self.file, times)

    def where(self, kind: str, name: Any) -> str:
        """Return the place of a body, joint or tendon in the file; without a name there, the name
        of the file."""
        return self.lines.get((kind, str(name)), self.file)

    def name_of(self, name: str, default: str, taken: Any, where: str) -> str:
        """Return a name that a model accepts and that is not `taken`; if it differs from the name
        in the file, the latter is listed as left out."""
        allowed = "".join("_" if letter in ".*?[]" else letter for letter in name or default)
        while allowed in taken:
            allowed += "_" if name else " 2"
        if name not in (allowed, ""):
            self.leave_out(f"the name '{name}', here '{allowed}'", where)
        return allowed

    def body(self, i: int) -> None:
        """Add a body of MuJoCo as a frame of the model, or as a part of the one that carries it."""
        m, name = self.m, str(self.m.body_names[i])
        where, first = self.where("body", name), m.body_jntadr[i]
        owner, at = self.places[m.body_parentid[i]]
        place = at @ Place(m.body_pos[i], m.body_quat[i])
        joints = [self.joint(j) for j in range(first, first + m.body_jntnum[i])]
        carrier = self.carried[owner]
        if joints or not carrier.moves or (m.body_mass[i] and carrier.parts):
            name = self.name_of(name, f"body {len(self.carried)}", self.carried, where)
            carrier = self.carried[name] = Carried(
                where, owner, place, carrier.place @ place, bool(joints) or carrier.moves, joints
            )
            owner, place = name, ORIGIN
        if m.body_mass[i]:
            carrier.parts.append((i, place @ Place(m.body_ipos[i], m.body_iquat[i])))
        self.places.append((owner, place))

    def joint(self, j: int) -> JointOfBody:
        m, name = self.m, str(self.m.joint_names[j])
        kind, q = KINDS[m.jnt_type[j]], m.jnt_qposadr[j]
        return JointOfBody(
            name,
            self.where("joint", name),
            kind,
            m.jnt_pos[j],
            m.jnt_axis[j],
            stiffness=float(m.jnt_stiffness[j]),
            damping=float(m.dof_damping[m.jnt_dofadr[j]]),
            relaxed=float(m.qpos_spring[q] - m.qpos0[q]) if kind in STEPS else 0.0,
        )

    def solid(self, each: Carried) -> Body:
        """Return the body of a frame that moves, made of its parts."""
        parts = [
            Body(self.m.body_mass[i], self.m.body_inertia[i], position=at.p, orientation=at.q)
            for i, at in each.parts
        ]
        return Body.of_parts(parts, position=each.place.p, orientation=each.place.q)

    def springs(self, moving: dict[str, Carried]) -> None:
        """Add the springs and dampers of joints to the elements."""
        for body, each in moving.items():
            for joint in each.joints:
                if joint.stiffness or joint.damping:
                    spring = self.gather(
                        joint.where,
                        lambda: spring_of(joint, each.joints, body, each.parent, each.on_parent),  # noqa: B023
                    )
                    name = f"{joint.name} spring" if joint.name in self.carried else joint.name
                    self.add(spring, name, f"{body} spring", joint.where)
                if joint.kind == "ball" and joint.damping:
                    self.leave_out(LARGE_TURNS, joint.where)

    def tendons(self) -> None:
        """Add the springs and dampers of tendons to the elements."""
        for i, name in enumerate(map(str, self.m.tendon_names)):
            where = self.where("tendon", name)
            self.add(self.gather(where, lambda: self.tendon(i)), name, "tendon", where)  # noqa: B023

    def tendon(self, i: int) -> Element | str:
        """Return the spring of a tendon between two sites, or the reason why there is none."""
        m, first = self.m, self.m.tendon_adr[i]
        wraps = slice(first, first + m.tendon_num[i])
        if m.tendon_num[i] != 2 or (m.wrap_type[wraps] != SITE).any():
            return "tendons other than between two sites"
        k, c = float(m.tendon_stiffness[i]), float(m.tendon_damping[i])
        if not (k or c):
            return "tendons without stiffness and damping"
        ends = []
        for site in m.wrap_objid[wraps]:
            owner, place = self.places[m.site_bodyid[site]]
            ends.append((owner, place.point(m.site_pos[site])))
        low, high = map(float, m.tendon_lengthspring[i])  # between them it exerts no force
        if low == high:
            return Spring(*ends, stiffness=k, damping=c, free_length=high)
        if low > 0:
            return "tendons with a dead band above zero"
        return SpringDamper(*ends, spring=TensionOnly(k), damper=c or None, free_length=high)

    def add(self, spring: Element | str | None, name: str, default: str, where: str) -> None:
        """Add an element to the model, or list the reason why there is none."""
        if isinstance(spring, Element):
            name = self.name_of(name, default, {**self.carried, **self.elements}, where)
            self.elements[name] = spring
        elif spring:
            self.leave_out(spring, where)
