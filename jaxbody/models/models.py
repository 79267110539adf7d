"""A model: bodies, supports, elements and joints by name, kept as arrays."""

from __future__ import annotations

import difflib
import unicodedata
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxbody.core import tables
from jaxbody.core.arguments import check_kind, named
from jaxbody.core.arrays import concrete, device_array, functions_as_nodes, vector
from jaxbody.core.compile_options import jit_as_it_is
from jaxbody.core.errors import JaxbodyError, Problem, Problems, warn
from jaxbody.elements.element_checks import check_laws, check_leaves
from jaxbody.elements.elements import Bushing, Element, LineElement
from jaxbody.elements.torsions import Torsion
from jaxbody.geometry import rotations
from jaxbody.geometry.frames import Pose
from jaxbody.geometry.orientations import matrix
from jaxbody.laws.laws import Law, Sum
from jaxbody.models.bodies import Body, Support, warn_of_points, warn_of_tiny
from jaxbody.models.joints import Free, Joint
from jaxbody.models.states import State
from jaxbody.models.storage import Table, tabulate, tabulate_by_structure

WORLD = "world"
LARGEST_TURN = 179.0  # degrees, of a bushing in the reference pose


@dataclass(frozen=True)
class Layout:
    """What of a model is static: the order of its frames and coordinates, as the user gave the names."""

    bodies: tuple[str, ...]
    supports: tuple[str, ...]
    kinds: tuple[type[Joint], ...]  # of each body's joint, in the order of bodies
    parents: tuple[str, ...]

    @cached_property
    def frames(self) -> tuple[str, ...]:
        """All frames, in the order of their rows: world, supports, bodies."""
        return (WORLD, *self.supports, *self.bodies)

    def frame(self, name: str) -> int:
        return self.frames.index(name)

    @cached_property
    def first_body(self) -> int:
        return 1 + len(self.supports)

    @cached_property
    def q_slices(self) -> dict[str, slice]:
        ends = np.cumsum([0] + [kind.nq for kind in self.kinds])
        return {name: slice(int(i), int(j)) for name, i, j in zip(self.bodies, ends[:-1], ends[1:], strict=True)}

    @cached_property
    def v_slices(self) -> dict[str, slice]:
        ends = np.cumsum([0] + [kind.nv for kind in self.kinds])
        return {name: slice(int(i), int(j)) for name, i, j in zip(self.bodies, ends[:-1], ends[1:], strict=True)}

    @cached_property
    def nq(self) -> int:
        return sum(kind.nq for kind in self.kinds)

    @cached_property
    def nv(self) -> int:
        return sum(kind.nv for kind in self.kinds)

    @cached_property
    def nxi(self) -> int:
        return 6 * len(self.supports)

    @cached_property
    def floating(self) -> bool:
        """True when every body is free on the world: the mass matrix is then constant in body axes."""
        return all(kind is Free for kind in self.kinds) and set(self.parents) <= {WORLD}

    @cached_property
    def depths(self) -> dict[str, int]:
        """How many joints lie between a body and the world or a support."""
        parent = dict(zip(self.bodies, self.parents, strict=True))

        def depth(name: str) -> int:
            return 0 if name not in parent else 1 + depth(parent[name])

        return {name: depth(name) for name in self.bodies}

    @cached_property
    def carries(self) -> np.ndarray:
        """(nb, nv): 1 where a speed moves a body, being of its own joint or of one before it."""
        parent = dict(zip(self.bodies, self.parents, strict=True))
        mask = np.zeros((len(self.bodies), self.nv))
        for i, name in enumerate(self.bodies):
            while name in parent:
                mask[i, self.v_slices[name]] = 1
                name = parent[name]
        return mask

    @cached_property
    def roots(self) -> np.ndarray:
        """For each body the frame row of the support (or world) at the root of its tree."""
        parent = dict(zip(self.bodies, self.parents, strict=True))

        def root(name: str) -> str:
            return root(parent[name]) if name in parent else name

        return np.array([self.frame(root(name)) for name in self.bodies], dtype=int)

    @cached_property
    def motions(self) -> tuple[tuple[str, str], ...]:
        """For each speed the body and what it does: ("plate", "turn about z")."""
        return tuple((name, motion) for name, kind in zip(self.bodies, self.kinds, strict=True) for motion in kind.motions)

    @cached_property
    def coordinates(self) -> tuple[str, ...]:
        """What each speed (and each component of Delta) does, in words."""
        return tuple(f"{name} {motion}" for name, motion in self.motions)

    @cached_property
    def base_coordinates(self) -> tuple[str, ...]:
        return tuple(f"{name} {motion}" for name in self.supports for motion in Free.motions)

    @cached_property
    def turns(self) -> np.ndarray:
        """(nv,): True for speeds in rad/s."""
        return np.array([turn for kind in self.kinds for turn in kind.turns], dtype=bool)

    @cached_property
    def angular(self) -> np.ndarray:
        """(nq,): True for angles and for the four numbers of a quaternion, which stand for three turns."""
        return np.array([turn for kind in self.kinds for turn in (*kind.turns, *[True] * (kind.nq - kind.nv))], dtype=bool)


class Model(eqx.Module):
    """Rigid bodies on elements between each other, `world` and supports whose motion is imposed.

    bodies, supports, elements: by name. joints: by the name of the body that they carry; a body without one is free. gravity [m/s2].
    `model["AB"]` is the element, body or support of that name, `model.joint("arm")` a body's joint, `model.reference` the state of the
    reference pose at rest. A derivative with respect to a model is a model. All problems of an input are told at once.

    >>> model = Model(bodies={"plate": Body(mass=3.0, inertia=[0.3, 0.9, 1.2])},
    ...               elements={"AB": Spring(("plate", [0, 0, 0]), ("world", [0, 1, 0]), stiffness=100.0, free_length=0.8)})
    >>> float(model["AB"].stiffness)
    100.0
    """

    bodies: Table
    supports: Table
    joints: tuple[Table, ...]
    elements: tuple[Table, ...]
    gravity: Float[Array, "3"]
    layout: Layout = eqx.field(static=True)

    def __init__(
        self,
        *,
        bodies: dict[str, Body],
        supports: dict[str, Support] | None = None,
        elements: dict[str, Element] | None = None,
        joints: dict[str, Joint] | None = None,
        gravity=(0, 0, 0),
    ):
        problems = Problems()
        bodies, supports = (
            named(bodies, "bodies", "name: jb.Body(...)", problems),
            named(supports, "supports", "name: jb.Support(...)", problems),
        )
        elements, joints = (
            named(elements, "elements", "name: jb.Spring(...)", problems),
            named(joints, "joints", "name: jb.Hinge(...)", problems),
        )
        problems.raise_if_any()
        _check_names(problems, bodies=bodies, supports=supports, elements=elements)
        bodies, supports = _of_kind(problems, "bodies", bodies, Body), _of_kind(problems, "supports", supports, Support)
        elements, joints = _of_kind(problems, "elements", elements, Element), _of_kind(problems, "joints", joints, Joint)
        _check_links(problems, bodies, supports, elements, joints)
        gravity = vector(gravity, "gravity", problems)
        elements = {name: functions_as_nodes(element) for name, element in elements.items()}
        check_leaves(problems, elements)
        check_laws(problems, elements)
        _check_reference(problems, bodies, supports, elements)
        problems.raise_if_any()
        every_joint = {name: joints.get(name, Free()) for name in bodies}
        self.layout = Layout(
            tuple(bodies), tuple(supports), tuple(type(j) for j in every_joint.values()), tuple(j.parent for j in every_joint.values())
        )  # fmt: skip
        by_depth = {name: every_joint[name] for name in sorted(bodies, key=lambda name: self.layout.depths[name])}
        self.bodies = tabulate(bodies)
        self.supports = tabulate(supports, Support())
        self.joints = tabulate_by_structure(by_depth, lambda name: self.layout.depths[name])
        self.elements = tabulate_by_structure(elements)
        self.gravity = device_array(gravity)
        _warn_of_oddities(bodies, supports, elements)
        carrying = {joint.parent for joint in every_joint.values()}
        warn_of_points({name: body for name, body in bodies.items() if isinstance(every_joint[name], Free) and name not in carrying})

    @property
    def names(self) -> tuple[str, ...]:
        """All names of bodies, supports and elements."""
        return self.layout.bodies + self.layout.supports + self.element_names

    @property
    def element_names(self) -> tuple[str, ...]:
        return tuple(name for table in self.elements for name in table.names)

    def __getitem__(self, name: str) -> Any:
        for table in (self.bodies, self.supports, *self.elements):
            if name in table.names:
                return table.row(name)
        raise JaxbodyError(unknown(name, "model[...]", self.names))

    def joint(self, body: str) -> Joint:
        """The joint that carries a body."""
        for table in self.joints:
            if body in table.names:
                return table.row(body)
        raise JaxbodyError(unknown(body, "model.joint(...)", self.layout.bodies))

    @property
    def reference(self) -> State:
        """The state at rest in the reference pose."""
        return _reference(self)

    def __repr__(self) -> str:
        return tables.text(*self._tables())

    def __str__(self) -> str:
        return tables.printed(*self._tables())

    def _repr_html_(self) -> str:
        return tables.html(*self._tables())

    def _tables(self) -> list[tables.Table]:
        layout = self.layout
        rows = [
            (name, kind.__name__.lower(), parent, self[name].mass, self[name].position)
            for name, kind, parent in zip(layout.bodies, layout.kinds, layout.parents, strict=True)
        ]
        shown = [tables.Table("Model", ("body", "joint", "on", "mass [kg]", "position [m]"), rows)]
        for table in self.elements:
            columns = [f for f in table.rows.__dataclass_fields__ if f in SHOWN and getattr(table.rows, f) is not None]
            kind = type(table.rows).__name__.lower()
            rows = [
                (name, *link, *(_shown(getattr(table.row(name), c)) for c in columns))
                for name, link in zip(table.names, table.links, strict=True)
            ]
            heads = ("from", "to", "on")[: len(table.links[0])]
            shown.append(tables.Table("", (kind, *heads, *(c.replace("_", " ") for c in columns)), rows))
        return shown


SHOWN = ("spring", "damper", "stiffness", "free_length", "free_angle", "radius", "damping")  # of elements, when a model prints


def _shown(value: Any) -> Any:
    """A law by its name, and its number where it has but one."""
    if not isinstance(value, Law):
        return value
    if isinstance(value, Sum):
        return " + ".join(_shown(term) for term in value.terms)
    numbers = jax.tree.leaves(value)
    return type(value).__name__ + (f" {tables.number(numbers[0])}" if len(numbers) == 1 else "")


def unknown(name: str, where: str, known: tuple[str, ...]) -> Problem:
    """The problem of a name that is not there, with the nearest one that is."""
    known = tuple(map(str, known))
    near = difflib.get_close_matches(str(name), known, 1)
    hint = (f"Did you mean '{near[0]}'? " if near else "") + "Known: " + ", ".join(known[:12]) + (", ..." if len(known) > 12 else "") + "."
    return Problem("UNKNOWN_NAME", where, f"'{name}' is unknown.", name, hint=hint)


def _check_names(problems: Problems, **groups: dict[str, Any]) -> None:
    seen: dict[str, str] = {}
    folded: dict[str, str] = {}
    for group, things in groups.items():
        for name in things:
            where = f"{group}[{name!r}]"
            if (
                not isinstance(name, str)
                or not name
                or len(name) > 200
                or not name.isprintable()
                or set(name) & set(".*?[]")
                or name == WORLD
            ):
                problems.add(
                    "BAD_NAME",
                    where,
                    "is no name",
                    value=name,
                    limit="1 to 200 printable characters",
                    hint="Not `world`, and none of . * ? [ ].",
                )
                continue
            if name in seen:
                problems.add(
                    "DUPLICATE_NAME",
                    where,
                    f"is also the name of one of the {seen[name]}",
                    value=name,
                    limit="one name, one thing",
                    hint="Rename one of them.",
                )
            alike = unicodedata.normalize("NFKC", name).casefold()
            if folded.get(alike, name) != name:
                warn("LOOK_ALIKE", f"the names '{folded[alike]}' and '{name}' look alike")
            seen[name], folded[alike] = group, name


def _of_kind(problems: Problems, group: str, things: dict[str, Any], kind: type) -> dict[str, Any]:
    """The things that are of their kind; those that are not go to `problems`."""
    for name, thing in things.items():
        check_kind(thing, kind, f"{group}[{name!r}]", f"a jb.{kind.__name__}", problems)
    if group == "bodies" and not things:
        problems.add("NO_BODY", "bodies", "is empty", value=things, limit="at least one body", hint="Give a body.")
    return {name: thing for name, thing in things.items() if isinstance(thing, kind)}


def _check_links(problems: Problems, bodies, supports, elements, joints) -> None:
    frames = (*bodies, *supports, WORLD)
    for name, element in elements.items():
        for end in element.between:
            if end not in frames:
                found = unknown(end, f"elements[{name!r}]", frames)
                limit = "a body, a support or world"
                problems.add("UNKNOWN_BODY", found.where, f"body or support {found.message}", value=end, limit=limit, hint=found.hint)
    for name, joint in joints.items():
        if name not in bodies:
            found = unknown(name, f"joints[{name!r}]", tuple(bodies))
            problems.add("UNKNOWN_BODY", found.where, f"body {found.message}", value=name, limit="a body", hint=found.hint)
        if joint.parent not in frames:
            found = unknown(joint.parent, f"joints[{name!r}]", frames)
            limit = "a body, a support or world"
            problems.add("UNKNOWN_BODY", found.where, f"parent {found.message}", value=joint.parent, limit=limit, hint=found.hint)
    for name in joints:
        chain = [name]
        while chain[-1] in joints and len(chain) <= len(joints) + 1:
            chain.append(joints[chain[-1]].parent)
        if chain[-1] in joints:
            problems.add(
                "LOOP",
                f"joints[{name!r}]",
                f"hangs on itself: {' on '.join(chain[: chain.index(name, 1) + 1] if name in chain[1:] else chain[:4])}",
                value=name,
                limit="a tree that ends at world or a support",
                hint="Give one of them another parent, and close the loop by a stiff Bushing in place of that joint.",
            )


def _check_reference(problems: Problems, bodies, supports, elements) -> None:
    """In the reference pose every line must have a direction and every bushing and torsion spring be short of half a turn, where its
    deformation jumps."""
    places = {WORLD: (np.zeros(3), np.array([1.0, 0, 0, 0])), **{n: (b.position, b.orientation) for n, b in {**supports, **bodies}.items()}}
    for name, element in elements.items():
        check = next((check for kind, check in CHECKS if isinstance(element, kind)), None)
        if check is None or not set(element.between) <= set(places):
            continue
        numbers = [concrete(x) for x in jax.tree.leaves((element, [places[end] for end in element.between]))]
        if all(x is not None for x in numbers):
            check(problems, f"elements[{name!r}]", element, *((p, matrix(o)) for p, o in (places[end] for end in element.between)))


def _check_length(problems: Problems, where: str, line: LineElement, A, B) -> None:
    """Zero length is for springs of zero free length that have no damper and pull with no force there."""
    ends = [p + R @ point for (p, R), point in zip((A, B), (line.a, line.b), strict=True)]
    length, size = np.linalg.norm(ends[1] - ends[0]), np.abs(ends).max() or 1.0
    if length <= 1e-12 * size and not (line.free_length == 0 and line.has_no_direction()):
        problems.add(
            "ZERO_LENGTH",
            where,
            f"has length {length:.3g} m in the reference pose, so no direction",
            value=length,
            limit="> 0",
            hint=f"Use a Bushing, a free length and damping of 0, or move a point by more than {1e-6 * size:.1g} m.",
        )


def _check_turn(problems: Problems, where: str, element: Bushing | Torsion, A, B) -> None:
    R_A, R_B = A[1] @ matrix(element.orientation), B[1] @ matrix(element.orientation_b)
    angle = np.rad2deg(np.arccos(np.clip((np.sum(R_A * R_B) - 1) / 2, -1, 1)))
    if angle > LARGEST_TURN:
        problems.add(
            "HALF_TURN",
            where,
            f"is turned by {angle:.4g} degrees in the reference pose",
            value=angle,
            limit=f"{LARGEST_TURN:g} degrees",
            hint="It is relaxed where the axes at its ends coincide: turn `orientation` or `orientation_b`.",
        )


CHECKS = ((LineElement, _check_length), (Bushing, _check_turn), (Torsion, _check_turn))


def _warn_of_oddities(bodies, supports, elements) -> None:
    masses, inertias = ([concrete(getattr(body, name)) for body in bodies.values()] for name in ("mass", "inertia"))
    if all(x is not None for x in masses + inertias):
        warn_of_tiny(tuple(bodies), np.array(masses))
        warn_of_tiny(tuple(bodies), np.trace(np.array(inertias), axis1=1, axis2=2), "inertia", "kg m2")
    for name, element in elements.items():
        if not set(element.between) & set(bodies):
            warn("USELESS_SPRING", f"elements['{name}'] joins {' and '.join(element.between)}: no body feels it")


def _places(names: tuple[str, ...], order: tuple[str, ...]) -> np.ndarray:
    return np.array([order.index(name) for name in names], dtype=int)


def rest_poses(model: Model, supports: Pose, bodies: Pose) -> Pose:
    """Pose of each body on its parent in the reference pose, rows in the order of the bodies, from those in the world."""
    world = Pose(jnp.zeros((1, 3), bodies.p.dtype), np.eye(3, dtype=bodies.R.dtype)[None])
    p, R = (jnp.concatenate([getattr(x, name) for x in (world, supports, bodies)]) for name in ("p", "R"))
    rows = _places(model.layout.parents, model.layout.frames)
    return Pose(p[rows], R[rows]).inverse() @ bodies


@jit_as_it_is
def _reference(model: Model) -> State:
    return at_rest_in(model, rest_poses(model, support_poses(model), body_poses(model)))


def at_rest_in(model: Model, rest: Pose) -> State:
    """The state in which bodies are at rest in these poses on their parents."""
    parts: dict[str, Array] = {}
    for table in model.joints:
        rows = _places(table.names, model.layout.bodies)
        q = jax.vmap(lambda joint, pose: joint.rest(pose))(table.rows, Pose(rest.p[rows], rest.R[rows]))
        parts |= {name: q[i] for i, name in enumerate(table.names)}
    q = jnp.concatenate([parts[name] for name in model.layout.bodies])
    return State(q, jnp.zeros(model.layout.nv, q.dtype))


def support_poses(model: Model) -> Pose:
    """Poses of the supports in the reference pose."""
    supports = model.supports.rows
    return Pose(supports.position, rotations.matrix(supports.orientation))


def body_poses(model: Model) -> Pose:
    """Poses of the bodies in the reference pose."""
    bodies = model.bodies.rows
    return Pose(bodies.position, rotations.matrix(bodies.orientation))
