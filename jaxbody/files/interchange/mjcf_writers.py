"""Models as MJCF, for MuJoCo: the same bodies, joints, springs and dampers, to compare motions from
rest or from an initial state."""

from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from jaxbody.core.arrays import is_concrete
from jaxbody.core.errors import JaxbodyError, Problem, Problems
from jaxbody.core.source_files import extension_of, writing
from jaxbody.files.interchange.mjcf_places import ORIGIN, Place
from jaxbody.geometry.points_and_orientations import matrix
from jaxbody.model.elements.bushings import Bushing
from jaxbody.model.elements.springs import Spring, SpringDamper
from jaxbody.model.elements.torsions import Torsion
from jaxbody.model.joints.combined_joints import Combined, Composite, Series
from jaxbody.model.joints.joints import Ball, Fixed, Free, Guide, Hinge, Joint
from jaxbody.model.laws.laws import Law, Linear
from jaxbody.model.laws.spring_laws import TensionOnly
from jaxbody.model.layouts import WORLD
from jaxbody.model.models import Model
from jaxbody.model.preconditions import check_potential

CLOSE = 1e-9  # tolerance for axes and rotations that must coincide
LEAST = 1e-15  # smallest principal moment of inertia of a moving body [kg m2]
KINDS = {True: "hinge", False: "slide"}
ON_JOINTS = (
    "It can be written along the axes of a joint that moves its body, about that of a hinge, or "
    "the same about all axes of a ball."
)
TENDONS = "Springs between two points with linear laws, or ropes, can be written."


def write_mjcf(model: Model, path: Any) -> None:
    """Write a model to an MJCF file, to simulate or view it in MuJoCo.

    Supports become fixed bodies. Springs become tendons between two sites; torsions, and bushings
    on bodies that only translate or are on a ball joint, become springs and dampers of joints. The
    coordinates of joints are zero in the reference pose, as in jaxbody; the angular velocities of
    free bodies and ball joints are in the axes of the body in MuJoCo, in those of the parent in
    jaxbody. Base motions are not written: MuJoCo imposes only positions, without the velocities
    that dampers need.

    Args:
        model: the model
        path: path of the file, .xml; a file of the same name is replaced

    Errors, all at once: WRONG_KIND for elements, laws and joints that MJCF does not have,
    NOT_POSITIVE for a moving body without inertia, UNKNOWN_FORMAT, BAD_SHAPE for a batch of models,
    TRACED, NOT_SAVED.

    >>> import pathlib, tempfile
    >>> path = pathlib.Path(tempfile.mkdtemp(), "car.xml")
    >>> jb.files.write_mjcf(jb.presets.quarter_car(), path)
    >>> '<spatial name="tyre" stiffness="193000.0"' in path.read_text()
    True
    """
    path = Path(path)
    extension_of(path, ".xml")
    check_potential("write_mjcf", model)
    if model.closures:
        raise JaxbodyError(
            Problem(
                "CLOSED_LOOPS",
                "write_mjcf.model",
                f"has closures ({', '.join(model.closure_names)})",
                limit="no closures",
                hint="It takes trees of joints; stiff bushings may close loops.",
            )
        )
    if not is_concrete(model):
        raise JaxbodyError(
            Problem(
                "TRACED",
                "write_mjcf",
                "cannot be called inside jit, vmap or grad",
                hint="Write the result of the program.",
            )
        )
    if model.gravity.ndim > 1:
        raise JaxbodyError(
            Problem(
                "BAD_SHAPE",
                "write_mjcf",
                f"is a batch of {len(model.gravity)} models",
                limit="one model",
                hint="Write one of them: jax.tree.map(lambda x: x[0], models).",
            )
        )
    root = MjcfWriter(model).root()
    ElementTree.indent(root)
    with writing(path):
        path.write_text(ElementTree.tostring(root, encoding="unicode") + "\n", encoding="utf-8")


class MjcfWriter:
    """Writer of the XML of a model."""

    def __init__(self, model: Model):
        self.model, self.problems = model, Problems()
        layout = model.layout
        self.places = {WORLD: ORIGIN} | {
            name: Place(np.asarray(model[name].position), np.asarray(model[name].orientation))
            for name in (*layout.supports, *layout.bodies)
        }
        self.joints = {name: model.joint(name) for name in layout.bodies}
        self.parents = dict.fromkeys(layout.supports, WORLD) | {
            name: joint.parent for name, joint in self.joints.items()
        }
        self.nodes: dict[str, Any] = {}  # XML nodes of frames
        self.steps: dict[str, list[Any]] = {}  # XML nodes of the joints of each body

    def root(self) -> Any:
        root = ElementTree.Element("mujoco")
        ElementTree.SubElement(root, "compiler", angle="radian", inertiafromgeom="false")
        option = ElementTree.SubElement(
            root, "option", gravity=_row(self.model.gravity), integrator="RK4", timestep="0.0005"
        )
        ElementTree.SubElement(option, "flag", contact="disable")
        self.nodes[WORLD] = ElementTree.SubElement(root, "worldbody")
        for name in sorted(self.parents, key=lambda name: len(self.model.layout.chains[name])):
            self.frame(name)
        tendons = ElementTree.Element("tendon")
        for name in self.model.element_names:
            element = self.model[name]
            if isinstance(element, Spring | SpringDamper):
                self.tendon(tendons, name, element)
            elif isinstance(element, Bushing | Torsion):
                self.on_joint(name, element)
            else:
                self.refuse(name, f"has the type {type(element).__name__}", TENDONS)
        if len(tendons):
            root.append(tendons)
        self.problems.raise_if_any()
        return root

    def refuse(self, element: str, message: str, hint: str) -> None:
        self.problems.add(
            "WRONG_KIND",
            f"elements['{element}']",
            f"{message}, which MJCF does not have",
            limit="what MJCF has",
            hint=hint,
        )

    def frame(self, name: str) -> None:
        """Add a support or body to the node of its parent, with its joints and inertia."""
        parent, joint = self.parents[name], self.joints.get(name)
        place = self.places[parent].inverse() @ self.places[name]
        node = ElementTree.SubElement(
            self.nodes[parent], "body", name=name, pos=_row(place.p), quat=_row(place.q)
        )
        self.nodes[name], self.steps[name] = node, []
        if joint is None:
            return
        for i, (kind, axis, at) in enumerate(self.lines(name, joint, place)):
            given = {"name": f"{name} {i + 1}" if i else name, "type": kind}
            if axis is not None:
                given["axis"] = _row(axis)
            if kind != "free":
                given["pos"] = _row(at)
            self.steps[name].append(ElementTree.SubElement(node, "joint", given))
        body = self.model[name]
        moments = np.linalg.eigvalsh(body.inertia)
        if self.steps[name] and moments[0] < LEAST:
            self.problems.add(
                "NOT_POSITIVE",
                f"bodies['{name}']",
                (
                    f"has the smallest principal moment {moments[0]:.3g} kg m2, and MuJoCo needs "
                    "one of each moving body"
                ),
                value=moments[0],
                limit=f">= {LEAST}",
                hint="Give it a small inertia, also where it does not turn.",
            )
        I = np.asarray(body.inertia)
        ElementTree.SubElement(
            node,
            "inertial",
            pos=_row(body.com),
            mass=_row(body.mass),
            fullinertia=_row([*np.diag(I), I[0, 1], I[0, 2], I[1, 2]]),
        )

    def lines(self, name: str, joint: Joint, place: Place) -> list[tuple[str, Any, np.ndarray]]:
        """Return the MJCF joints that make up `joint`: kind, axis (None for a free or ball joint)
        and point of each, in the axes of the body. `place` is the pose of the body relative to its
        parent."""
        back = place.inverse()
        at = np.zeros(3) if joint.at is None else back.point(np.asarray(joint.at))
        points: Any = [at] * joint.nv
        match joint:
            case Free(parent="world"):
                return [("free", None, at)]
            case Ball():
                return [("ball", None, at)]
            case Fixed():
                return []
            case Guide() | Hinge():
                axes: Any = [joint.axis]
            case Series():
                axes = np.eye(3)[list(joint.steps)]
            case Combined():
                axes = joint.directions
            case Composite():
                axes, points = joint.directions, map(back.point, np.asarray(joint.points))
            case _:
                self.problems.add(
                    "WRONG_KIND",
                    f"joints['{name}']",
                    f"is Free on '{joint.parent}'"
                    if isinstance(joint, Free)
                    else f"is of the type {type(joint).__name__}",
                    value=joint,
                    limit="what MJCF has",
                    hint=(
                        "Free bodies are in the world there; hinges, guides and balls "
                        "may be on other bodies."
                    ),
                )
                return []
        return [
            (KINDS[turn], back.R @ axis, point)
            for turn, axis, point in zip(joint.turns, np.asarray(axes), points, strict=True)
        ]

    def tendon(self, tendons: Any, name: str, element: Spring | SpringDamper) -> None:
        """Add a spring as a tendon between two sites."""
        lengths = [float(element.free_length)]
        if isinstance(element, Spring):
            k, c = element.stiffness, element.damping
        elif isinstance(element.spring, TensionOnly):
            k, c = element.spring.stiffness, _coefficient(element.damper)
            lengths = [0.0, *lengths] if lengths[0] else lengths
        else:
            k, c = _coefficient(element.spring), _coefficient(element.damper)
        if k is None or c is None:
            self.refuse(name, "has a law that is not linear", TENDONS)
            return
        node = ElementTree.SubElement(
            tendons,
            "spatial",
            name=name,
            stiffness=_row(k),
            damping=_row(c),
            springlength=_row(lengths),
        )
        for letter, end, point in zip("ab", element.between, element.points, strict=True):
            ElementTree.SubElement(
                self.nodes[end], "site", name=f"{name} {letter}", pos=_row(point)
            )
            ElementTree.SubElement(node, "site", site=f"{name} {letter}")

    def on_joint(self, name: str, element: Bushing | Torsion) -> None:
        """Add a torsion or bushing as springs and dampers of the joint between its ends."""
        body = next(
            (end for end in element.between if self.parents.get(end) in element.between), ""
        )
        numbers = self.springs(element, body) if self.steps.get(body) else None
        if numbers is None:
            self.refuse(
                name, f"is a {type(element).__name__} that is no spring of a joint", ON_JOINTS
            )
            return
        springs = zip(self.steps[body], numbers, strict=True)
        acting = [(node, *spring) for node, spring in springs if spring[0] or spring[1]]
        for i, (node, k, c, relaxed) in enumerate(acting):
            if "stiffness" in node.attrib:
                self.refuse(name, "is a second spring of a joint", "Put both into one.")
            node.attrib.update(
                name=f"{name} {i + 1}" if i else name,
                stiffness=_row(k),
                damping=_row(c),
                springref=_row(relaxed),
            )

    def springs(
        self, element: Bushing | Torsion, body: str
    ) -> list[tuple[float, float, float]] | None:
        """Return stiffness, damping and relaxed coordinate of each joint of a body that are
        equivalent to an element between it and its parent; None if there are none."""
        place = self.places[self.parents[body]].inverse() @ self.places[body]
        ends = [place if end == body else ORIGIN for end in element.between]
        R_A, R_B = (
            end.R @ matrix(q)
            for end, q in zip(ends, (element.orientation, element.orientation_b), strict=True)
        )
        C, sign = R_A.T @ R_B, 1 if element.between[1] == body else -1
        kinds, axes, points = zip(*self.lines(body, self.joints[body], place), strict=True)
        N = (
            sign
            * R_A.T
            @ place.R
            @ np.stack([np.zeros(3) if axis is None else axis for axis in axes], -1)
        )
        if isinstance(element, Torsion):
            return _twists(element, kinds, N, C)
        a, b = (end.point(np.asarray(x)) for end, x in zip(ends, element.points, strict=True))
        if np.abs(C - np.eye(3)).max() > CLOSE:
            return None
        if set(kinds) == {"slide"}:
            return _slides(element, N, R_A.T @ (b - a))
        at_center = np.abs(np.stack([a, b]) - place.point(points[0])).max() < CLOSE
        return _ball(element) if kinds == ("ball",) and at_center else None


def _twists(
    element: Torsion, kinds: tuple[str, ...], N: np.ndarray, C: np.ndarray
) -> list[tuple[float, float, float]] | None:
    """Return the joint springs equivalent to a torsion on a joint with a single rotation about its
    axis, whose deformation is e = +-q + c - e0; None for other joints."""
    turns, n, (k, c) = (
        [i for i, kind in enumerate(kinds) if kind != "slide"],
        np.asarray(element.axis),
        map(_coefficient, (element.spring, element.damper)),
    )
    if (
        len(turns) != 1
        or kinds[turns[0]] != "hinge"
        or k is None
        or c is None
        or np.abs(C @ n - n).max() > CLOSE
    ):
        return None
    along = float(n @ N[:, turns[0]])
    if abs(abs(along) - 1) > CLOSE:
        return None
    w = np.array([C[2, 1] - C[1, 2], C[0, 2] - C[2, 0], C[1, 0] - C[0, 1]])
    relaxed = np.sign(along) * (float(element.free_angle) - 2 * np.arctan2(n @ w, 1 + np.trace(C)))
    return [
        (float(k), float(c), relaxed) if i in turns else (0.0, 0.0, 0.0) for i in range(len(kinds))
    ]


def _slides(
    element: Bushing, N: np.ndarray, p: np.ndarray
) -> list[tuple[float, float, float]] | None:
    """Return the joint springs equivalent to a bushing on a joint of slides only, with N the axes
    of the slides and the energy 1/2 (p + N q)' K (p + N q); None if this couples the coordinates
    q."""
    K, C = (
        np.diag(x) if x.ndim == 1 else x[:3, :3]
        for x in map(np.asarray, (element.stiffness, element.damping))
    )
    (k, coupled), (c, also) = (
        (np.diag(A), A - np.diag(np.diag(A))) for A in (N.T @ K @ N, N.T @ C @ N)
    )
    if (
        np.abs(coupled).max() > CLOSE * np.abs(k).max()
        or np.abs(also).max() > CLOSE * np.abs(c).max()
    ):
        return None
    return [
        (float(x), float(y), float(-f / x) if x else 0.0)
        for x, y, f in zip(k, c, N.T @ K @ p, strict=True)
    ]


def _ball(element: Bushing) -> list[tuple[float, float, float]] | None:
    """Return the joint spring equivalent to a bushing on a ball joint, whose stiffness must be the
    same about all axes; None for others, and with damping, which differs at large rotations."""
    if element.stiffness.shape == (3,):
        return None
    K = np.asarray(element.stiffness)[3:, 3:]
    return (
        None
        if np.asarray(element.damping)[3:, 3:].any() or np.abs(K - K[0, 0] * np.eye(3)).max()
        else [(float(K[0, 0]), 0.0, 0.0)]
    )


def _row(numbers: Any) -> str:
    """Return numbers as text with all their digits."""
    return " ".join(repr(float(x)) for x in np.ravel(numbers))


def _coefficient(law: Law | None) -> Any:
    """Return the coefficient of a linear law, 0 without a law, None for other laws."""
    return 0.0 if law is None else law.coefficient if isinstance(law, Linear) else None
