"""Elements, closures, tyres and roads as drawn parts: springs as coils that stretch, dampers and
drives as cylinders with rods, inerters, bushings, torsion springs, anti-roll bars, contacts,
forces; rods between their balls, balls, pins of hinges, rails and welds; tyres as wheels of their
radius, and the roads under them. Couplings have no position in space."""

from collections.abc import Iterable, Iterator
from functools import singledispatch
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from jaxbody.geometry.closures import AlongAxis, Ball, Closure, Hinge, Inline, Weld
from jaxbody.geometry.points_and_orientations import matrix
from jaxbody.model.elements.bushings import FramePair
from jaxbody.model.elements.contacts import Contact, Tyre
from jaxbody.model.elements.elements import LineElement
from jaxbody.model.elements.springs import Inerter, Spring, SpringDamper
from jaxbody.model.elements.torsions import AntiRollBar, Torsion
from jaxbody.model.forces.drives import CommandedForce, ControlledDamper
from jaxbody.model.forces.force_elements import ForceElement
from jaxbody.model.inputs.roads import Road
from jaxbody.views.scenes.animations import DrawnPart, rod
from jaxbody.views.scenes.colors import COLORS, GRAY, INK, LIGHT
from jaxbody.views.scenes.poses import (
    BUSHING,
    PoseSequence,
    drawn_elements,
    named_rows,
    placed_closures,
)
from jaxbody.views.scenes.shapes import (
    Mesh,
    across,
    axes_along,
    axes_along_lines,
    box,
    coil,
    cylinder,
    joined,
    ribbon,
    ring,
    slab,
    sphere,
    spiral,
    tyre,
)

STEEL, RUBBER, DAMPER, BAR = "#4a525e", "#3a3f47", "#d9a441", COLORS[3]
# radius of a coil over its length, and its limits relative to the size of the model
SLENDER, THIN, WIDE = 0.11, 0.010, 0.024
PITCH = 1.15  # distance of the turns of a coil over its radius
TUBE = 0.55  # length of a damper's tube over that of the damper in the first frame


def parts_of_elements(sequence: PoseSequence, size: float, up: np.ndarray) -> list[DrawnPart]:
    """Return the parts of all elements but tyres."""
    return [
        part
        for name, element in drawn_elements(sequence.model)
        if not isinstance(element, Tyre)
        for part in _parts(element, name, sequence.ends(element), sequence, size, up)
    ]


@singledispatch
def _parts(
    element: Any,
    name: str,
    ends: list[np.ndarray],
    sequence: PoseSequence,
    size: float,
    up: np.ndarray,
) -> Iterable[DrawnPart]:
    """Return the parts of an element: a rod, unless a function below is registered for its class.

    Args:
        element: the element.
        name: its name.
        ends: world positions (n, 3) of each end.
        sequence: the poses.
        size: size of the model [m].
        up: the direction against gravity.
    """
    return [rod(("elements", name), cylinder(0.004 * size, sides=8), GRAY, ends[0], ends[1])]


@_parts.register
def _force(element: ForceElement, name, ends, sequence, size, up) -> Iterator[DrawnPart]:
    """Yield a knot at each point, seen through bodies, and thin rods between them."""
    knot, mesh = sphere(0.012 * size, 12), cylinder(0.004 * size, sides=8)
    for i, at in enumerate(ends):
        yield DrawnPart(("elements", name, f"end {i + 1}"), knot, COLORS[4], at, over=size)
    for i, (a, b) in enumerate(pairwise(ends)):
        yield rod(("elements", name, f"line {i + 1}"), mesh, COLORS[4], a, b)


@_parts.register
def _contact(element: Contact, name, ends, sequence, size, up) -> list[DrawnPart]:
    ball = sphere(float(element.free_length) / 2)
    return [
        DrawnPart(("elements", name, side), ball, COLORS[5], at, opacity=0.6)
        for side, at in zip("ab", ends, strict=True)
    ]


def springs_and_dampers(element: LineElement) -> tuple[bool, bool]:
    """Return whether an element along a line has a spring, and whether it has a damper."""
    if isinstance(element, Spring):
        return bool(element.stiffness != 0) or not element.damping, bool(element.damping != 0)
    if isinstance(element, SpringDamper):
        return element.spring is not None or element.damper is None, element.damper is not None
    return True, False


@_parts.register
def _line_element(element: LineElement, name, ends, sequence, size, up) -> Iterator[DrawnPart]:
    (A, B), (sprung, damped) = ends, springs_and_dampers(element)
    length = max(float(np.linalg.norm(B[0] - A[0])), 0.02 * size)
    radius = float(np.clip(SLENDER * length, THIN * size, WIDE * size))
    turns = int(np.clip(round(0.84 * length / (PITCH * radius)), 4, 16))
    thickness = radius * (0.15 if damped else 0.18)
    if sprung:
        yield rod(("elements", name, "coil"), coil(radius, thickness, length, turns), STEEL, A, B)
    if damped:
        inner = 0.62 * radius if sprung else 0.8 * radius
        yield from _cylinder_and_rod(("elements", name, "damper"), inner, length, DAMPER, A, B)


def _cylinder_and_rod(
    path: tuple[str, ...], inner: float, length: float, color: str, A: np.ndarray, B: np.ndarray
) -> Iterator[DrawnPart]:
    """Yield a rod from one point (n, 3), and a cylinder of this radius and color at the other."""
    R, lengths = axes_along_lines(B - A)
    least, most = 0.95 * float(lengths.min()), float(lengths.max())
    tube, stem = (
        min(TUBE * length, least),
        min(max(most - 0.7 * TUBE * length, 0.4 * length), least),
    )
    piston = (*path[:-1], "piston")
    if tube + stem > most:  # rigid parts overlap; else the rod is stretched
        yield DrawnPart(piston, cylinder(0.4 * inner, 0.0, stem, sides=12), GRAY, A, R)
    else:
        yield rod(piston, cylinder(0.4 * inner, sides=12), GRAY, A, B)
    yield DrawnPart(path, cylinder(inner, -max(tube, 0.02 * length), 0.0, sides=18), color, B, R)


@_parts.register
def _drive(element: CommandedForce, name, ends, sequence, size, up) -> Iterator[DrawnPart]:
    """Yield the cylinder and rod of an actuator, or of a damper with its valve."""
    A, B = ends
    length = max(float(np.linalg.norm(B[0] - A[0])), 0.02 * size)
    radius = float(np.clip(SLENDER * length, THIN * size, WIDE * size))
    valve = isinstance(element, ControlledDamper)
    path, color = ("elements", name, "cylinder"), DAMPER if valve else COLORS[4]
    yield from _cylinder_and_rod(path, 0.8 * radius, length, color, A, B)
    if valve:
        band, R = (
            ring(0.8 * radius, 1.1 * radius, -0.3 * length, -0.2 * length),
            axes_along_lines(B - A)[0],
        )
        yield DrawnPart((*path[:-1], "valve"), band, COLORS[4], B, R)


@_parts.register
def _inerter(element: Inerter, name, ends, sequence, size, up) -> list[DrawnPart]:
    """Return a flywheel in the middle of a rod."""
    A, B = ends
    R, lengths = axes_along_lines(B - A)
    radius = float(np.clip(0.12 * lengths[0], 0.008 * size, 0.03 * size))
    wheel = cylinder(radius, -0.3 * radius, 0.3 * radius)
    return [
        rod(("elements", name, "rod"), cylinder(0.2 * radius, sides=10), GRAY, A, B),
        DrawnPart(("elements", name, "flywheel"), wheel, DAMPER, (A + B) / 2, R),
    ]


@_parts.register(FramePair)
def _bushing(element: Any, name, ends, sequence, size, up) -> Iterator[DrawnPart]:
    """Yield a rubber ring on the frame of the second end about a pin on the frame of the first; the
    axis of the ring is the bushing axis that is nearest to vertical in the first frame."""
    R_a, R_b = (
        sequence.pose(frame)[1] @ np.asarray(matrix(q))
        for frame, q in zip(
            element.between, (element.orientation, element.orientation_b), strict=True
        )
    )
    # rotation of z of the mesh to that axis
    turn = np.roll(np.eye(3), int(np.argmax(np.abs(R_b[0].T @ up))) - 2, axis=0)
    r = BUSHING * size
    rubber = ring(0.4 * r, r, -0.62 * r, 0.62 * r)
    pin = joined(
        [
            cylinder(0.4 * r, -1.25 * r, 1.25 * r),
            *(cylinder(0.7 * r, *z) for z in ((-1.25 * r, -1.0 * r), (1.0 * r, 1.25 * r))),
        ]
    )
    yield DrawnPart(("elements", name, "rubber"), rubber, RUBBER, ends[1], R_b @ turn)
    yield DrawnPart(("elements", name, "pin"), pin, GRAY, ends[0], R_a @ turn)
    if np.linalg.norm(ends[1][0] - ends[0][0]) > 2 * r:
        yield rod(("elements", name, "link"), cylinder(0.2 * r, sides=8), GRAY, ends[0], ends[1])


@_parts.register
def _torsion(element: Torsion, name, ends, sequence, size, up) -> list[DrawnPart]:
    """Return a flat spiral about the axis, fixed to the frame of the first end, and an arm at its
    outer end, fixed to the frame of the second."""
    R_a, R_b = (sequence.pose(frame)[1] for frame in element.between)
    axes = np.asarray(matrix(element.orientation)) @ axes_along(np.asarray(element.axis, float))
    in_b = R_b[0].T @ R_a[0] @ axes
    r = 0.035 * size
    arm = box([1.0 * r, 0.16 * r, 0.16 * r]).placed(np.array([0.7 * r, 0, 0]))
    return [
        DrawnPart(
            ("elements", name, "spiral"), spiral(0.2 * r, r, 0.07 * r), STEEL, ends[0], R_a @ axes
        ),
        DrawnPart(("elements", name, "arm"), arm, GRAY, ends[0], R_b @ in_b),
    ]


@_parts.register
def _anti_roll_bar(element: AntiRollBar, name, ends, sequence, size, up) -> Iterator[DrawnPart]:
    """Yield a bar on the body, parallel to the line between the two wheels in the first frame, with
    a lever to each wheel."""
    left, right, _ = ends
    line, (p, R) = left[0] - right[0], sequence.pose(element.between[2])
    normal = R[0] @ np.asarray(element.axis, float)
    aside = np.cross(normal, line)
    length = np.linalg.norm(aside)
    aside = 0.16 * (aside if length > 0 else across(normal) * np.linalg.norm(line))
    inward = 0.12 * line

    def on_body(at: np.ndarray) -> np.ndarray:
        """Return world positions in all frames of a point of the body given in the first frame."""
        return p + R @ (R[0].T @ (at - p[0]))

    corners = [on_body(left[0] - inward + aside), on_body(right[0] + inward + aside)]
    mesh = cylinder(0.0055 * size, sides=10)
    knot = sphere(0.0085 * size, 10)
    yield rod(("elements", name, "bar"), mesh, BAR, corners[0], corners[1])
    for side, at, corner in zip(("left", "right"), (left, right), corners, strict=True):
        yield rod(("elements", name, f"{side} lever"), mesh, BAR, corner, at)
        yield DrawnPart(("elements", name, f"{side} corner"), knot, BAR, corner)


ROUND = 0.006  # radius of a rod, relative to the size of the model


def parts_of_closures(sequence: PoseSequence, size: float) -> list[DrawnPart]:
    """Return the parts of all closures; a closure at a single point is drawn on the first of its
    two frames."""
    return [
        part
        for name, closure in placed_closures(sequence.model)
        for part in _parts_of_closure(name, closure, sequence, size)
    ]


def is_link(closure: Closure) -> bool:
    """Return whether a closure has two points at a distance from each other."""
    return not isinstance(closure, Ball | Weld | AlongAxis)


def _parts_of_closure(
    name: str, closure: Any, sequence: PoseSequence, size: float
) -> list[DrawnPart]:
    (A, B), (_, R) = sequence.ends(closure), sequence.pose(closure.between[0])
    r = 0.012 * size
    if is_link(closure):
        ends = [
            DrawnPart(("closures", name, end), sphere(1.3 * r), INK, at, R)
            for end, at in (("a", A), ("b", B))
        ]
        return [rod(("closures", name, "rod"), cylinder(ROUND * size, sides=12), BAR, A, B), *ends]
    if isinstance(closure, Ball):
        return [DrawnPart(("closures", name), sphere(1.5 * r), INK, A, R)]
    if isinstance(closure, Weld):
        return [DrawnPart(("closures", name), box([2.4 * r] * 3), INK, A, R, edged=True)]
    along = R @ axes_along(np.asarray(closure.axis, float))
    if isinstance(closure, Hinge):
        pin = joined([cylinder(r, -2.2 * r, 2.2 * r), cylinder(0.25 * r, -6 * r, 6 * r, sides=8)])
        return [DrawnPart(("closures", name), pin, INK, A, along)]
    # the rail spans all positions of the second point
    passed = np.sum((B - A) * along[..., 2], axis=1)
    first, last = min(passed.min(), 0.0) - 0.06 * size, max(passed.max(), 0.0) + 0.06 * size
    rail, slides = cylinder(0.004 * size, first, last, sides=8), isinstance(closure, Inline)
    on_rail = sphere(1.3 * r) if slides else box([2.0 * r] * 3)
    return [
        DrawnPart(("closures", name, "rail"), rail, GRAY, A, along),
        DrawnPart(("closures", name, "b"), on_rail, INK, B, along, edged=not slides),
    ]


WIDTH, RIM = 0.62, 0.66  # width of a tyre, and radius of its rim, over the radius of the tyre
HOLES = 5
ASPHALT, MARK = "#b9bec7", "#ffffff"
# length of road on both sides, relative to the size of the model; length of a dash over the
# tyre's radius
AHEAD, DASH = 1.5, 0.4
HUB = 0.28  # radius of the hub of a wheel, over that of the tyre
MOST_POINTS = 4000  # largest number of points of a profile


def parts_of_roads(sequence: PoseSequence, size: float) -> list[DrawnPart]:
    """Return wheels for all tyres, a strip of road under each, and the profile under each other
    support that is moved by a Road. Wheels one behind the other share a strip."""
    tyres = _tyres(sequence)
    places = [
        (
            name,
            element.between[1],
            np.asarray(element.b, float),
            np.asarray(element.axis, float),
            1.5 * WIDTH * float(element.radius),
        )
        for name, element in tyres
    ]
    under_tyres = {support for _, support, *_ in places}
    places += [
        (support, support, np.zeros(3), np.array([0.0, 0, 1]), 0.1 * size)
        for support in sequence.roads
        if support not in under_tyres
    ]
    strips: dict[tuple[float, ...], list[DrawnPart]] = {}
    for name, support, point, normal, width in places:
        strip = _strip(name, support, point, normal, width, sequence, size)
        place = (strip[0].p[0] @ _axes_of_road(normal))[1:]
        key = (*np.round(place, 6), *np.round(strip[0].mesh.vertices.ravel(), 6))
        strips.setdefault(key, strip)
    wheels = [part for name, element in tyres for part in _wheel(name, element, sequence)]
    return wheels + [part for strip in strips.values() for part in strip]


def _tyres(sequence: PoseSequence) -> list[tuple[str, Tyre]]:
    """Return the tyres that have a radius, with their names."""
    return [
        (name, element)
        for name, element in named_rows(sequence.model.elements)
        if isinstance(element, Tyre) and float(element.radius) > 0
    ]


def hub_of(sequence: PoseSequence, body: str, points: np.ndarray) -> Mesh | None:
    """Return the hub of a body that represents a wheel, in the axes of the body, or None for a body
    without a tyre or with points outside the tyre."""
    for _, element in _tyres(sequence):
        on, road = element.between
        if on == body:
            r, R = float(element.radius), sequence.pose(body)[1][0].T @ sequence.pose(road)[1][0]
            R = R @ _axes_of_wheel(element)
            center, w = np.asarray(element.a, float), WIDTH * r
            inside = (points - center) @ R
            if (np.linalg.norm(inside[:, :2], axis=1) < r).all() and (
                np.abs(inside[:, 2]) < w
            ).all():
                return cylinder(HUB * r, -0.45 * w, 0.45 * w).placed(center, R)
    return None


def _axes_of_road(normal: np.ndarray) -> np.ndarray:
    """Return a matrix whose columns are the directions forward (x, as for cars), left and up, in
    the axes of a road."""
    forward = np.array([1.0, 0, 0]) if abs(normal[0]) < 0.9 else np.array([0.0, 1, 0])
    forward = forward - (forward @ normal) * normal
    forward /= np.linalg.norm(forward)
    return np.stack([forward, np.cross(normal, forward), normal], -1)


def _axes_of_wheel(element: Tyre) -> np.ndarray:
    """Return axes in the frame of the road, the third along the axle."""
    forward, left, up = _axes_of_road(np.asarray(element.axis, float)).T
    return np.stack([forward, -up, left], -1)


def _wheel(name: str, element: Tyre, sequence: PoseSequence) -> list[DrawnPart]:
    """Return a tyre and its rim, which turn with the speed of the road."""
    r, road = float(element.radius), sequence.roads.get(element.between[1])
    hub = sequence.points(element.between[0], element.a)
    axes = _axes_of_wheel(element)
    angle = (
        np.zeros(len(sequence.times)) if road is None else float(road.speed) * sequence.times / r
    )
    spin = Rotation.from_euler("z", angle[:, None]).as_matrix()
    R = sequence.pose(element.between[1])[1] @ axes @ spin
    w = WIDTH * r
    rim = cylinder(RIM * r, -0.38 * w, 0.38 * w)
    turn = 2 * np.pi * np.arange(HOLES) / HOLES
    holes = [
        cylinder(0.12 * r, *z, sides=12).placed(at)
        for at in 0.40 * r * np.stack([np.cos(turn), np.sin(turn), 0 * turn], -1)
        for z in ((-0.39 * w, -0.38 * w), (0.38 * w, 0.39 * w))
    ]
    return [
        DrawnPart(("tyres", name, "tyre"), tyre(r, w), INK, hub, R),
        DrawnPart(("tyres", name, "rim"), rim, LIGHT, hub, R),
        DrawnPart(("tyres", name, "holes"), joined(holes), INK, hub, R),
    ]


def parts_of_wheel(sequence: PoseSequence) -> list[DrawnPart]:
    """Return the wheel of a suspension, or nothing without one."""
    wheel = sequence.wheel
    if wheel is None:
        return []
    r, R = (
        float(wheel.radius),
        sequence.pose(wheel.on)[1] @ axes_along(np.asarray(wheel.axis, float)),
    )
    return [
        DrawnPart(
            ("wheels", wheel.on),
            tyre(r, WIDTH * r),
            INK,
            sequence.points(wheel.on, wheel.center),
            R,
            opacity=0.35,
        )
    ]


def _strip(
    name: str,
    support: str,
    point: np.ndarray,
    normal: np.ndarray,
    width: float,
    sequence: PoseSequence,
    size: float,
) -> list[DrawnPart]:
    """Return a strip of road through a point of a support at rest; a road with a speed moves
    backwards."""
    road, reach = sequence.roads.get(support), AHEAD * size
    axes, thick = _axes_of_road(normal), 0.01 * size
    if road is None:
        flat, at = (
            slab(np.array([-reach, reach]), np.zeros(2), width, thick),
            sequence.points(support, point),
        )
        return [
            DrawnPart(
                ("roads", name, "surface"),
                flat,
                ASPHALT,
                at,
                sequence.pose(support)[1] @ axes,
                framed=False,
            )
        ]
    travel = float(road.speed) * sequence.times
    x, z = _profile(road, min(travel) - reach, max(travel) + reach)
    dashes = np.arange(np.floor(x[0] / width), np.ceil(x[-1] / width)) * width
    marks = [
        _dash(s, DASH * width, x, z, 0.10 * width) for s in dashes[:: max(1, len(dashes) // 500)]
    ]
    origin = (
        np.asarray(sequence.model[support].position, float)
        + point
        - float(road.position) * axes[:, 0]
    )
    p, R = origin - np.outer(travel, axes[:, 0]), axes[None]
    return [
        DrawnPart(
            ("roads", name, "surface"), slab(x, z, width, thick), ASPHALT, p, R, framed=False
        ),
        DrawnPart(("roads", name, "marks"), joined(marks), MARK, p, R, framed=False),
    ]


def _profile(road: Road, first: float, last: float) -> tuple[np.ndarray, np.ndarray]:
    """Return distances and heights [m] of a road between two distances, level beyond its ends; a
    profile of many points is resampled in equal steps."""
    s, z = np.asarray(road.distances, float), np.asarray(road.heights, float)
    inside = s[(s > first) & (s < last)]
    x = np.concatenate([[first], inside, [last]])
    if len(x) > MOST_POINTS:
        x = np.linspace(first, last, MOST_POINTS)
    return x, np.interp(x, s, z)


def _dash(start: float, length: float, x: np.ndarray, z: np.ndarray, width: float) -> Mesh:
    at = np.linspace(start, start + length, 4)
    return ribbon(at, np.interp(at, x, z) + 0.02 * width, width)
