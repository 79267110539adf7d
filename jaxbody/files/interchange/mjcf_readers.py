"""Models from MJCF, the file format of MuJoCo: bodies, inertias, joints, springs of joints and
tendons, and a list of what was left out."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from jaxbody.core import tables
from jaxbody.core.errors import JaxbodyError, Problem, unknown
from jaxbody.files.documents import LARGEST
from jaxbody.files.interchange.mjcf_assemblies import FramesOfFile, JointOfBody, tendon
from jaxbody.files.interchange.mjcf_compiled import CompiledReader, compiled
from jaxbody.files.interchange.mjcf_documents import (
    MAIN,
    Attributes,
    MjcfDocument,
    Node,
    read_document,
)
from jaxbody.files.interchange.mjcf_geometry import ORIGIN, Place, place_of, solid
from jaxbody.model.bodies import Body
from jaxbody.model.elements.elements import Element
from jaxbody.model.layouts import WORLD
from jaxbody.model.models import Model

OF_JOINTS = (
    "name",
    "class",
    "type",
    "pos",
    "axis",
    "stiffness",
    "damping",
    "springref",
    "ref",
    "group",
    "user",
)
OF_TENDONS = (
    "name",
    "class",
    "stiffness",
    "damping",
    "springlength",
    "group",
    "user",
    "width",
    "rgba",
    "material",
)
OF_LIMITS = (
    "limited",
    "margin",
    "solreflimit",
    "solimplimit",
    "solreffriction",
    "solimpfriction",
    "actuatorfrcrange",
    "actuatorfrclimited",
)
WITHOUT_EFFECT = ("0", "0 0", "false", "none", "auto")

BY_MUJOCO = "MuJoCo's own compiler reads it: pip install 'jaxbody[mujoco]'."


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

    If the package mujoco is installed (`jaxbody[mujoco]`), the file is compiled by MuJoCo in a
    separate process, which also computes the masses of meshes; it reads no file outside the folder
    of this one. Without mujoco, and for a file that MuJoCo rejects (for example, because meshes are
    missing), jaxbody reads MJCF itself, and rejects unknown elements in bodies.

    A body with joints becomes a body: one joint becomes a Free, Ball, Hinge or Guide, several
    become a Composite. A body without joints becomes a support if it is attached to the world;
    otherwise it is Fixed to its parent, or a part of it if one of the two has no mass. Springs and
    dampers of joints become torsions and bushings, those of tendons between two sites springs.
    Coordinates are zero in the pose of the file.

    Args:
        path: path of the file, .xml or .urdf; files that it includes must be in its folder
        largest: largest size of each file [bytes]

    Errors, all at once with their lines: those of files, SYNTAX, ENCODING, WRONG_FORMAT,
    WRONG_KIND, OUTSIDE_FOLDER, LOOP, UNKNOWN_NAME, NOT_A_NUMBER, MISSING_ENTRY for an inertia that
    depends on a mesh, MISSING_EXTRA for a URDF without mujoco, and those of bodies, joints
    and elements.

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
    document = read_document(path, largest)
    arrays, refusal = compiled(path, document)
    reader: Any = MjcfReader(document) if arrays is None else CompiledReader(path, document, arrays)
    if document.root.tag == "robot" and arrays is None:
        code, message, hint = (
            ("MISSING_EXTRA", "is a URDF", BY_MUJOCO)
            if refusal is None
            else (
                "WRONG_FORMAT",
                f"is a URDF that MuJoCo refuses: {refusal}",
                "It is read by MuJoCo's compiler alone.",
            )
        )
        raise JaxbodyError(Problem(code, path.name, message, limit="a file of MuJoCo", hint=hint))
    try:
        with reader.problems:
            reader.world()
        with reader.problems:
            parts = reader.made()
    except JaxbodyError as error:
        if refusal is None:
            raise
        message = f"is not read by MuJoCo's compiler either: {refusal}"
        raise JaxbodyError(*error.problems, Problem("UNREADABLE", path.name, message)) from None
    return MjcfModel(
        Model(**parts),
        tuple(LeftOut(where, what, count) for what, (where, count) in reader.left_out.items()),
    )


class MjcfReader(FramesOfFile):
    """Reader of an MJCF document without MuJoCo."""

    def __init__(self, document: MjcfDocument):
        super().__init__(document)
        self.compiler, self.option = map(document.settings, ("compiler", "option"))
        self.degrees = self.compiler.text("angle", "degree") != "radian"
        self.sequence = self.compiler.text("eulerseq", "xyz")
        self.sites: dict[str, tuple[str, np.ndarray]] = {}  # name: (frame, point in its axes)
        self.total = 0.0  # mass of all bodies [kg]

    def place(self, a: Attributes) -> Place:
        return place_of(a, self.degrees, self.sequence)

    def world(self) -> None:
        """Read the bodies of the file: collect all frames, with their joints and masses."""
        if len(self.sequence) != 3 or set(self.sequence.lower()) - set("xyz"):
            raise JaxbodyError(
                Problem(
                    "BAD_SEQUENCE",
                    f"{self.compiler.where} eulerseq",
                    f"is '{self.sequence}'",
                    self.sequence,
                    "three of x y z X Y Z",
                )
            )
        if self.compiler.text("coordinate", "local") != "local":
            self.problems.add(
                "WRONG_KIND",
                self.compiler.where,
                "has global coordinates",
                limit="coordinate='local'",
                hint="Let an older MuJoCo save it with local ones.",
            )
        self.leave_out_sections()
        for node in self.document.root.all("worldbody"):
            for child, place, kind in self.contents(
                node, ORIGIN, node.attributes.get("childclass", MAIN)
            ):
                self.thing(child, WORLD, place, kind)
        if self.compiler.flag("balanceinertia"):
            self.leave_out("balanceinertia", self.compiler.where)

    def contents(self, node: Node, place: Place, kind: str) -> Iterator[tuple[Node, Place, str]]:
        """Yield the elements in a body, each with the place of the frame around it and the default
        class for elements that state none."""
        for child in node.children:
            if child.tag == "frame":
                a = Attributes(child.attributes, f"{child.where} frame", self.problems)
                yield from self.contents(child, place @ self.place(a), a.text("childclass", kind))
            else:
                yield child, place, kind

    def thing(self, node: Node, owner: str, around: Place, kind: str) -> None:
        """Read an element in the world or in a body; `around`: place, on the frame `owner`, of the
        frame in which the element is stated."""
        match node.tag:
            case "body":
                self.body(node, owner, around, node.attributes.get("childclass", kind))
            case "site":
                a = self.document.attributes(node, kind)
                self.sites[a.text("name")] = owner, (around @ self.place(a)).p
            case "geom":
                a = self.document.attributes(node, kind)
                if a.text("contype", "1") != "0" or a.text("conaffinity", "1") != "0":
                    self.leave_out("contact of geoms", node.where)
                if a.text("fluidshape", "none") != "none":
                    self.leave_out("fluidshape of geoms", node.where)
            case "camera" | "light":
                self.leave_out(node.tag, node.where)
            case "inertial" | "joint" | "freejoint":
                pass
            case _:
                self.problems.add(
                    "UNKNOWN_NAME",
                    node.where,
                    f"is an element '{node.tag:.60}', which may have mass",
                    value=node.tag,
                    limit="body, frame, inertial, joint, freejoint, geom, site, camera, light",
                    hint=BY_MUJOCO,
                )

    def body(self, node: Node, owner: str, around: Place, kind: str) -> None:
        a = Attributes(node.attributes, f"{node.where} body", self.problems)
        place = around @ self.place(a)
        inside = list(self.contents(node, ORIGIN, kind))
        joints = [
            self.joint(child, frame, of)
            for child, frame, of in inside
            if child.tag in ("joint", "freejoint")
        ]
        if a.text("gravcomp", "0") not in WITHOUT_EFFECT:
            self.leave_out("gravcomp of bodies", node.where)
        mass = self.solid(node, inside)
        owner, place = self.carry(node.where, a.text("name"), owner, place, joints, mass)
        for child, frame, of in inside:
            self.thing(child, owner, place @ frame, of)

    def solid(self, node: Node, inside: list[tuple[Node, Place, str]]) -> Body | None:
        """Return the mass and inertia of a body of the file, in its frame; None without mass."""
        source = self.compiler.text("inertiafromgeom", "auto")
        inertial = next(node.all("inertial"), None)
        parts = []
        if inertial and source != "true":
            parts = [self.gather(inertial.where, lambda: self.stated(inertial))]
        elif source != "false":
            low, high = self.compiler.row("inertiagrouprange", [0, 5], (2,))
            geoms = [
                (self.document.attributes(child, kind), frame)
                for child, frame, kind in inside
                if child.tag == "geom"
            ]
            parts = [
                self.gather(a.where, lambda a=a, frame=frame: solid(a, frame @ self.place(a)))
                for a, frame in geoms
                if low <= a.number("group") <= high
            ]
        parts = [part for part in parts if part is not None]
        if not parts:
            return None
        whole = self.gather(node.where, lambda: self.bounded(Body.of_parts(parts)))
        self.total += float(whole.mass) if whole else 0.0
        return whole

    def stated(self, node: Node) -> Body | None:
        a = Attributes(node.attributes, f"{node.where} inertial", self.problems)
        place, mass = self.place(a), a.number("mass")
        full = "fullinertia" in a
        inertia = a.row("fullinertia", np.zeros(6), (6,)) if full else a.vector("diaginertia")
        return Body(mass, inertia, position=place.p, orientation=place.q) if mass else None

    def bounded(self, body: Body) -> Body:
        """Return a body with at least the mass and the principal moments that the compiler's
        settings require."""
        mass = max(float(body.mass), self.compiler.number("boundmass"))
        least = self.compiler.number("boundinertia")
        if mass == float(body.mass) and not least:
            return body
        moments, axes = np.linalg.eigh(body.inertia)
        return Body(mass, axes @ np.diag(np.maximum(moments, least)) @ axes.T, com=body.com)

    def joint(self, node: Node, frame: Place, kind: str) -> JointOfBody:
        a = self.document.attributes(node, kind)
        sort = "free" if node.tag == "freejoint" else a.text("type", "hinge")
        if sort not in ("free", "ball", "slide", "hinge"):
            self.problems.add(
                "WRONG_KIND",
                a.where,
                f"has the type '{sort:.60}'",
                value=sort,
                limit="free, ball, slide, hinge",
            )
        self.leave_out_attributes(a, node.where, OF_JOINTS, "joints")
        axis = a.vector("axis", (0, 0, 1))
        if not axis.any():
            self.problems.add(
                "ZERO_AXIS",
                f"{a.where} axis",
                "has length zero",
                value=axis,
                limit="> 0",
                hint="Give a direction.",
            )
            axis = np.array([0, 0, 1.0])
        unit = np.pi / 180 if self.degrees and sort == "hinge" else 1.0
        return JointOfBody(
            a.text("name"),
            node.where,
            sort,
            at=frame.point(a.vector("pos")),
            axis=frame.R @ (axis / np.linalg.norm(axis)),
            stiffness=self.coefficient(a, "stiffness", "joints"),
            damping=self.coefficient(a, "damping", "joints"),
            relaxed=unit * (a.number("springref") - a.number("ref")),
        )

    def coefficient(self, a: Attributes, name: str, owners: str) -> float:
        """Return the linear coefficient of an attribute; higher powers of a polynomial are listed
        as left out."""
        row = a.row(name, [0.0])
        if row[1:].any():
            self.leave_out(f"higher powers of {name} of {owners}", a.where.partition(" ")[0])
        return float(row[0]) if len(row) else 0.0

    def leave_out_attributes(
        self, a: Attributes, where: str, known: tuple[str, ...], owners: str
    ) -> None:
        """List, as left out, attributes that have an effect in MuJoCo but none in the model."""
        for name, value in a.values.items():
            if (
                name == "range"
                and value not in WITHOUT_EFFECT
                and a.text("limited", "auto") != "false"
            ):
                self.leave_out(f"limits of {owners}", where)
            elif name not in (*known, *OF_LIMITS, "range") and value not in WITHOUT_EFFECT:
                self.leave_out(f"{name} of {owners}", where)

    def made(self) -> dict[str, Any]:
        """Return the arguments of Model."""
        stated = self.compiler.number("settotalmass")
        weightless = any(
            flag.attributes.get("gravity") == "disable"
            for option in self.document.root.all("option")
            for flag in option.all("flag")
        )
        gravity = np.zeros(3) if weightless else self.option.vector("gravity", (0, 0, -9.81))
        return self.parts(stated / self.total if stated > 0 and self.total > 0 else 1.0, gravity)

    def tendons(self) -> None:
        """Add the springs and dampers of tendons to the elements."""
        for node in (x for section in self.document.root.all("tendon") for x in section.children):
            a = self.document.attributes(node, MAIN)
            spring = self.gather(node.where, lambda: self.tendon(node, a))  # noqa: B023
            if isinstance(spring, Element):
                self.leave_out_attributes(a, node.where, OF_TENDONS, "tendons")
            self.add(spring, a.text("name"), "tendon", node.where)

    def relaxed(self, name: str) -> Place:
        """Return the place of a frame in the world where the springs of all joints exert no force:
        free lengths of tendons are measured there."""
        if name == WORLD:
            return ORIGIN
        each = self.carried[name]
        place = self.relaxed(each.parent) @ each.on_parent
        for joint in each.joints:
            place = place @ joint.motion_to_relaxed()
        return place

    def tendon(self, node: Node, a: Attributes) -> Element | str:
        """Return the spring of a tendon between two sites, or the reason why there is none."""
        sites = [child.attributes.get("site") for child in node.children]
        if node.tag != "spatial" or len(sites) != 2 or None in sites:
            return "tendons other than between two sites"
        for site in sites:
            if site not in self.sites:
                raise JaxbodyError(unknown(str(site), "site", tuple(self.sites)))
        ends = [self.sites[str(site)] for site in sites]
        there, here = (self.relaxed(name).point(p) for name, p in ends)
        stated = a.row("springlength", [-1.0], (1, 2))
        low, high = np.where(stated < 0, np.linalg.norm(there - here), stated)[[0, -1]]
        k, c = (self.coefficient(a, name, "tendons") for name in ("stiffness", "damping"))
        return tendon(ends, k, c, low, high)
