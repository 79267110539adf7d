"""Checks of a model: names that exist, joints that lead to the world, lines with a direction in the
reference pose."""

import unicodedata
from dataclasses import replace
from typing import Any

import numpy as np

from jaxbody.core.arguments import check_kind
from jaxbody.core.arrays import concrete, is_concrete
from jaxbody.core.errors import Problems, unknown, warn
from jaxbody.geometry.closures import Closure, Coupling, Rod
from jaxbody.geometry.points_and_orientations import matrix
from jaxbody.model.bodies import warn_of_tiny
from jaxbody.model.elements.bushings import FramePair
from jaxbody.model.elements.element_checks import unknown_frame
from jaxbody.model.elements.elements import LineElement
from jaxbody.model.elements.springs import Inerter
from jaxbody.model.elements.torsions import Torsion
from jaxbody.model.elements.user_energies import DrawnAt
from jaxbody.model.forces.drives import CommandedForce
from jaxbody.model.layouts import WORLD, Layout
from jaxbody.model.storage import KindTable

LARGEST_TURN = 179.0  # degrees, of a bushing in the reference pose


def check_names(problems: Problems, groups: dict[str, dict[str, Any]]) -> None:
    """Check that every name belongs to one object. Errors: BAD_NAME, DUPLICATE_NAME;
    warns LOOK_ALIKE."""
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
                    "is not a valid name",
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
                    limit="a different name for each object",
                    hint="Rename one of them.",
                )
            alike = unicodedata.normalize("NFKC", name).casefold()
            if folded.get(alike, name) != name:
                warn("LOOK_ALIKE", f"the names '{folded[alike]}' and '{name}' look alike")
            seen[name], folded[alike] = group, name


def of_kind(problems: Problems, group: str, things: dict[str, Any], kind: Any) -> dict[str, Any]:
    """Return the objects of the right kind; a problem is added for each of the others."""
    for name, thing in things.items():
        word = getattr(kind, "__name__", "Element")
        check_kind(thing, kind, f"{group}[{name!r}]", f"a jb.{word}", problems)
    if group == "bodies" and not things:
        problems.add(
            "NO_BODY",
            "bodies",
            "is empty",
            value=things,
            limit="at least one body",
            hint="Give a body.",
        )
    return {name: thing for name, thing in things.items() if isinstance(thing, kind)}


def check_links(problems: Problems, bodies, supports, elements, joints, closures) -> None:
    """Check that elements, closures and joints end on existing parts, and every chain of joints on
    the world or a support."""
    frames = (*bodies, *supports, WORLD)

    for group, parts in (("elements", elements), ("closures", closures)):
        problems.collected += [
            unknown_frame(end, f"{group}[{name!r}]", frames, "body or support")
            for name, part in parts.items()
            for end in part.between
            if end not in frames
        ]
    for name, joint in joints.items():
        where = f"joints[{name!r}]"
        if name not in bodies:
            problems.collected.append(unknown_frame(name, where, tuple(bodies), "body"))
        if joint.parent not in frames:
            problems.collected.append(unknown_frame(joint.parent, where, frames, "parent"))
        chain = [name]
        while chain[-1] in joints and len(chain) <= len(joints) + 1:
            chain.append(joints[chain[-1]].parent)
        if chain[-1] in joints:
            circle = chain[: chain.index(name, 1) + 1] if name in chain[1:] else chain[:4]
            problems.add(
                "LOOP",
                where,
                f"is its own parent: {' on '.join(circle)}",
                value=name,
                limit="a tree that ends at world or a support",
                hint=(
                    "Give one of them another parent, and close the loop by a closure "
                    "(jb.closures) or a stiff Bushing in its place."
                ),
            )


def counted(problems: Problems, name: str, closure: Closure, layout: Layout) -> Closure:
    """Return the closure; if it is a coupling, a copy that knows the unit of its first coordinate.
    Error: UNKNOWN_NAME."""
    if not isinstance(closure, Coupling):
        return closure
    known = layout.coordinate_places
    wrong = [path for path in (closure.of, closure.by) if path not in known]
    problems.collected += [
        replace(unknown(path, f"closures[{name!r}]", tuple(known)), limit="a coordinate of a joint")
        for path in wrong
    ]
    return closure if wrong else closure.counted_in(layout.q_units[known[closure.of][0]])


def check_movable(problems: Problems, closures: dict[str, Any], layout: Layout) -> None:
    """Check that the ends of each closure can move relative to each other. Error: RIGID."""

    def carrier(frame: str) -> str:
        """Return the frame to which this one is fixed by joints without freedom."""
        return next(
            name
            for name in layout.chains[frame]
            if name not in layout.bodies or layout.block(name).nv
        )

    for name, closure in closures.items():
        if isinstance(closure, Coupling):
            continue
        A, B = closure.between
        on = {carrier(A), carrier(B)}
        if len(on) == 1 or not on & set(layout.bodies):
            why = (
                "which are joined rigidly already"
                if len(on) == 1
                else "neither of which moves but by imposed motion"
            )
            problems.add(
                "RIGID",
                f"closures[{name!r}]",
                f"joins '{A}' and '{B}', {why}",
                value=name,
                limit="frames that move relative to each other",
                hint="Leave it out, or give one of the bodies between them a joint that moves.",
            )


def check_slopes(closures: tuple[KindTable, ...], finite: np.ndarray) -> None:
    """Check that the slopes of the conditions of closures are finite in the reference pose, row by
    row. Error: NON_FINITE."""
    of_rows = [name for table in closures for name in table.names for _ in table.rows.rows]
    bad = dict.fromkeys(name for name, good in zip(of_rows, finite, strict=True) if not good)
    with Problems() as problems:
        for name in bad:
            problems.add(
                "NON_FINITE",
                f"closures[{name!r}]",
                "has slopes that are not finite in the reference pose",
                value=name,
                limit="finite slopes",
                hint="Draw it where its condition is smooth, or square a distance.",
            )


def check_reference(
    problems: Problems, places: dict[str, DrawnAt], groups: dict[str, dict[str, Any]]
) -> None:
    """Check that in the reference pose every line and every rod drawn to its length has a
    direction, and that every bushing and torsion spring is turned by less than half a turn, where
    its deformation jumps."""
    for group, parts in groups.items():
        for name, part in parts.items():
            check = next((check for kind, check in CHECKS.items() if isinstance(part, kind)), None)
            if check is None or not set(part.between) <= set(places):
                continue
            ends = [places[end] for end in part.between]
            if is_concrete(part, ends):
                frames = ((position, matrix(orientation)) for position, orientation in ends)
                check(problems, f"{group}[{name!r}]", part, *frames)


def _check_length(problems: Problems, where: str, line, A, B) -> None:
    """Check the length of a line or rod. That of a spring may be zero if its free length is zero,
    it has no damper and its force there is zero."""
    ends = [p + R @ point for (p, R), point in zip((A, B), (line.a, line.b), strict=True)]
    length, size = np.linalg.norm(ends[1] - ends[0]), np.abs(ends).max() or 1.0
    without = isinstance(line, LineElement) and line.free_length == 0 and line.has_no_direction()
    if length <= 1e-12 * size and not (
        without or (isinstance(line, Rod) and line.length is not None)
    ):
        remedy = (
            "Use a Bushing, a free length and damping of 0, or"
            if isinstance(line, LineElement)
            else "To give it one,"
        )
        problems.add(
            "ZERO_LENGTH",
            where,
            f"has length {length:.3g} m in the reference pose, which gives it no direction",
            value=length,
            limit="> 0",
            hint=f"{remedy} move a point by more than {1e-6 * size:.1g} m.",
        )


def _check_turn(problems: Problems, where: str, element, A, B) -> None:
    R_A, R_B = A[1] @ matrix(element.orientation), B[1] @ matrix(element.orientation_b)
    angle = np.rad2deg(np.arccos(np.clip((np.sum(R_A * R_B) - 1) / 2, -1, 1)))
    if angle > LARGEST_TURN:
        problems.add(
            "HALF_TURN",
            where,
            f"is turned by {angle:.4g} degrees in the reference pose",
            value=angle,
            limit=f"{LARGEST_TURN:g} degrees",
            hint=(
                "It is relaxed where the axes at its ends coincide: turn "
                "`orientation` or `orientation_b`."
            ),
        )


def warn_of_oddities(bodies, elements) -> None:
    """Warn of values that are allowed but rarely intended."""
    masses, inertias = (
        [concrete(body.mass) for body in bodies.values()],
        [concrete(body.inertia) for body in bodies.values()],
    )
    if all(x is not None for x in masses + inertias):
        warn_of_tiny(tuple(bodies), np.array(masses))
        warn_of_tiny(
            tuple(bodies), np.trace(np.array(inertias), axis1=1, axis2=2), "inertia", "kg m2"
        )
    for name, element in elements.items():
        if not set(element.between) & set(bodies):
            warn(
                "USELESS_SPRING",
                f"elements['{name}'] joins {' and '.join(element.between)}: it acts on no body",
            )


CHECKS = {
    LineElement | Inerter | CommandedForce | Rod: _check_length,
    FramePair | Torsion: _check_turn,
}
