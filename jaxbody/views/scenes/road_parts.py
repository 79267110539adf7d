"""Tyres as wheels of their radius, and the roads under them."""

import numpy as np
from scipy.spatial.transform import Rotation

from jaxbody.model.elements.contacts import Tyre
from jaxbody.model.inputs.roads import Road
from jaxbody.views.scenes.animations import DrawnPart
from jaxbody.views.scenes.colors import INK, LIGHT
from jaxbody.views.scenes.poses import PoseSequence, named_rows
from jaxbody.views.scenes.shapes import Mesh, axes_along, cylinder, joined, ribbon, slab, tyre

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
