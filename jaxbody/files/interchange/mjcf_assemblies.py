"""Assembly of a model from an MJCF file, for both readers: frames with their joints and masses,
springs of joints and tendons."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from jaxbody.core.errors import JaxbodyError, Problem
from jaxbody.files.interchange.mjcf_documents import MjcfDocument
from jaxbody.files.interchange.mjcf_geometry import ORIGIN, Place, about, from_z_to, product
from jaxbody.model.bodies import Body, Support
from jaxbody.model.elements.bushings import Bushing
from jaxbody.model.elements.elements import Element
from jaxbody.model.elements.springs import Spring, SpringDamper
from jaxbody.model.elements.torsions import Torsion
from jaxbody.model.joints.combined_joints import Composite
from jaxbody.model.joints.joints import Ball, Fixed, Free, Guide, Hinge, Joint
from jaxbody.model.laws.spring_laws import TensionOnly
from jaxbody.model.layouts import WORLD

READ = ("compiler", "option", "default", "worldbody", "tendon")  # sections that are read

STEPS = {"slide": "move", "hinge": "turn"}
SEVERAL = "springs and dampers of several joints of one body that turns"
LARGE_TURNS = "damping of ball joints at large turns, where it is that of the rotation vector"


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

    def motion_to_relaxed(self) -> Place:
        """Return the motion of the body from its pose in the file to the pose where the spring of
        the joint exerts no force."""
        if self.kind == "slide":
            return Place(self.relaxed * self.axis, ORIGIN.q)
        turn = Place(np.zeros(3), about(self.axis, self.relaxed if self.kind == "hinge" else 0.0))
        return Place(self.at - turn.point(self.at), turn.q)


def joint_of(joints: list[JointOfBody], parent: str, on_parent: Place) -> Joint:
    """Return the joint that connects a body to its parent, in the parent's axes. Error:
    WRONG_KIND."""
    at = [on_parent.point(joint.at) for joint in joints]
    axes = [on_parent.R @ joint.axis for joint in joints]
    own_point = at[0] if joints and joints[0].at.any() else None  # None: the body's origin
    match joints:
        case []:
            return Fixed(parent)
        case [JointOfBody(kind="free")] if parent == WORLD:
            return Free()
        case [JointOfBody(kind="free") as joint]:
            raise JaxbodyError(
                Problem(
                    "WRONG_KIND",
                    joint.where,
                    f"is free on '{parent}'",
                    parent,
                    WORLD,
                    "A free body has no parent.",
                )
            )
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
                    joint.where,
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
    q = from_z_to(along)
    k, c = (np.array([0, 0, x * (along @ along)]) for x in (joint.stiffness, joint.damping))
    relaxed = parent, on_parent.point(joint.at + joint.relaxed * joint.axis)
    return Bushing(
        relaxed, at[1], stiffness=k, damping=c, orientation=product(on_parent.q, q), orientation_b=q
    )


@dataclass
class Carried:
    """A frame of the model: its parent, its place on the parent and in the world, its joints, and
    the parts that make up its mass. A frame that does not move is a support."""

    where: str
    parent: str
    on_parent: Place
    place: Place
    moves: bool
    joints: list[JointOfBody]
    parts: list[Body] = field(default_factory=list)


class FramesOfFile(ABC):
    """Base class of the two readers: collects frames, masses, joints and springs of a file, and a
    list of what is left out."""

    def __init__(self, document: MjcfDocument):
        self.document, self.problems = document, document.problems
        self.carried: dict[str, Carried] = {}
        self.elements: dict[str, Element] = {}
        self.left_out: dict[str, tuple[str, int]] = {}

    def leave_out(self, what: str, where: str, times: int = 1) -> None:
        first, count = self.left_out.get(what, (where, 0))
        self.left_out[what] = first, count + times

    def gather(self, where: str, make: Callable[[], Any]) -> Any:
        """Return the result of `make`; if it fails, add its problems at the line `where` and return
        None."""
        return self.problems.gather(make, lambda x: replace(x, where=f"{where} {x.where}"))

    def leave_out_sections(self) -> None:
        """List as left out what the file states besides bodies, joints and tendons."""
        for node in self.document.root.children if self.document.root.tag == "mujoco" else []:
            for child in node.children if node.tag not in READ else []:
                self.leave_out(f"{node.tag} {child.tag}", child.where)
        for option in self.document.root.all("option"):
            for name in ("density", "viscosity", "wind", "magnetic"):
                if set(option.attributes.get(name, "0").split()) != {"0"}:
                    self.leave_out(f"{name} of the medium", option.where)
            for flag in option.all("flag"):
                for name in ("passive", "spring", "damper"):
                    if flag.attributes.get(name) == "disable":
                        self.leave_out(f"flag that disables {name}", flag.where)

    def carry(
        self,
        where: str,
        name: str,
        owner: str,
        place: Place,
        joints: list[JointOfBody],
        own: Body | None,
    ) -> tuple[str, Place]:
        """Add a body of the file at the pose `place` on the frame `owner`. Return the frame of the
        model that it becomes, or is a part of, and its place on that frame."""
        carrier = self.carried.get(owner)
        if joints or carrier is None or not carrier.moves or (own and carrier.parts):
            in_world = carrier.place @ place if carrier else place
            name = self.name_of(name, f"body {len(self.carried) + 1}", self.carried, where)
            moves = bool(joints) or (carrier is not None and carrier.moves)
            self.carried[name] = carrier = Carried(where, owner, place, in_world, moves, joints)
            owner, place = name, ORIGIN
        if own:
            moved = self.gather(
                where, lambda: Body.of_parts([own], position=place.p, orientation=place.q)
            )
            carrier.parts += [moved] if moved else []
        return owner, place

    def name_of(self, name: str, default: str, taken: Any, where: str) -> str:
        """Return a name that a model accepts and that is not `taken`; if it differs from the name
        in the file, the latter is listed as left out."""
        allowed = "".join("_" if letter in ".*?[]" else letter for letter in name or default)
        while allowed in taken or allowed == WORLD:
            allowed += "_" if name else " 2"
        if name not in (allowed, ""):
            self.leave_out(f"the name '{name}', here '{allowed}'", where)
        return allowed

    def parts(self, scale: float, gravity: np.ndarray) -> dict[str, Any]:
        """Return the arguments of Model, with all masses and inertias multiplied by `scale`."""
        moving = {name: each for name, each in self.carried.items() if each.moves}
        parts: dict[str, Any] = {"gravity": gravity, "elements": self.elements}
        parts["bodies"] = {
            name: self.gather(each.where, lambda each=each: _body(each, scale))
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
            if not each.moves
        }
        self.springs(moving)
        self.tendons()
        return parts

    @abstractmethod
    def tendons(self) -> None:
        """Add the springs of tendons to the elements."""

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

    def add(self, spring: Element | str | None, name: str, default: str, where: str) -> None:
        """Add an element to the model, or list the reason why there is none."""
        if isinstance(spring, Element):
            name = self.name_of(name, default, {**self.carried, **self.elements}, where)
            self.elements[name] = spring
        elif spring:
            self.leave_out(spring, where)


def tendon(
    ends: list[tuple[str, np.ndarray]], k: float, c: float, low: float, high: float
) -> Element | str:
    """Return the spring of a tendon between two points on frames, without force at lengths from
    `low` to `high` [m], or the reason why there is none; `k`, `c`: stiffness [N/m] and damping [N
    s/m]."""
    if not (k or c):
        return "tendons without stiffness and damping"
    if low == high:
        return Spring(*ends, stiffness=k, damping=c, free_length=high)
    if low > 0:
        return "tendons with a dead band above zero"
    return SpringDamper(*ends, spring=TensionOnly(k), damper=c or None, free_length=high)


def _body(each: Carried, scale: float) -> Body:
    """Return the body of a frame, made of its parts."""
    if not each.parts:
        raise JaxbodyError(
            Problem(
                "BAD_MASS",
                "body",
                "has joints and no mass",
                limit="> 0",
                hint="Give it a geom or an inertial element.",
            )
        )
    whole = Body.of_parts(each.parts)
    return Body(
        scale * whole.mass,
        scale * whole.inertia,
        com=whole.com,
        position=each.place.p,
        orientation=each.place.q,
    )
