"""Scenes: bodies, supports, joints, centers of mass and the ground as drawn parts; and animations
from poses, of all parts of a model with names, force arrows and trails; several side by side."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from jaxbody.model.elements.contacts import Tyre
from jaxbody.model.forces.drives import CommandedForce
from jaxbody.model.joints.combined_joints import Combined, Composite, Planar
from jaxbody.model.joints.joints import Ball, Guide, Hinge
from jaxbody.model.layouts import WORLD
from jaxbody.model.storage import KindTable
from jaxbody.views.scenes.animations import Animation, DrawnPart, NameLabel, Trail, rod
from jaxbody.views.scenes.colors import COLORS, GRAY, INK, LIGHT
from jaxbody.views.scenes.element_parts import (
    hub_of,
    is_link,
    parts_of_closures,
    parts_of_elements,
    parts_of_roads,
    parts_of_wheel,
)
from jaxbody.views.scenes.poses import (
    PoseSequence,
    attaching,
    drawn_elements,
    marks,
    named_rows,
    placed_closures,
    places_of,
    size_of_sequence,
)
from jaxbody.views.scenes.shapes import (
    THICK,
    Mesh,
    Shape,
    arrow,
    axes_along,
    box,
    cylinder,
    hull,
    joined,
    ribbon,
    solid_of_body,
    sphere,
)

FLAT = 1e-6  # largest extent of a flat model, relative to its size
# radius of the ends of elements and of a center of mass, relative to the size of the model
PIN, CENTER = 0.008, 0.016


def parts_of_bodies(
    sequence: PoseSequence, size: float, shapes: Mapping[str, tuple[Shape, ...]], opacity: float
) -> tuple[list[DrawnPart], list[NameLabel]]:
    """Return the parts of each body, namely its solid, the ends of elements on it and its center of
    mass, and the labels with the names."""
    model, parts, labels = sequence.model, [], []
    own = points_of_frames(sequence)
    for i, name in enumerate(model.layout.bodies):
        body, (p, R), color = model[name], sequence.pose(name), COLORS[i % len(COLORS)]
        com = np.asarray(body.com, float)
        if name in shapes:
            parts += _shaped(("bodies", name), shapes[name], color, p, R)
        else:
            hub = hub_of(sequence, name, np.concatenate([own[name], com[None]]))
            if hub is not None:
                parts.append(DrawnPart(("bodies", name, "hub"), hub, color, p, R))
            else:
                # curves of a suspension do not depend on inertia
                inertia = np.zeros((3, 3)) if sequence.wheel else np.asarray(body.inertia, float)
                solid = solid_of_body(own[name], com, float(body.mass), inertia, size)
                parts.append(
                    DrawnPart(
                        ("bodies", name, "solid"), solid, color, p, R, opacity=opacity, edged=True
                    )
                )
        pins = [
            sphere(PIN * size, 10).placed(point)
            for table in _along_lines(sequence)
            for frame, point in places_of(table)
            if frame == name
        ]
        if pins:
            parts.append(
                DrawnPart(
                    ("bodies", name, "ends"), joined(pins), INK, p, R, over=1.5 * THICK * size
                )
            )
        solids = [part.mesh.vertices for part in parts if part.path[:2] == ("bodies", name)]
        reach = max(
            (np.linalg.norm(vertices - com, axis=1).max() for vertices in solids), default=0.0
        )
        parts += _center_of_mass(name, com, size, p, R, reach)
        labels.append(NameLabel(("bodies", name, "name"), name, sequence.points(name, com), INK))
    return parts, labels


def _center_of_mass(
    name: str, com: np.ndarray, size: float, p: np.ndarray, R: np.ndarray, reach: float
) -> list[DrawnPart]:
    """Return the usual symbol of a center of mass, a ball of eight octants, alternately black and
    white. `reach`: largest distance of a point of the body from it [m]."""
    ball = sphere(CENTER * size, 16).placed(com)
    middles = ball.vertices[ball.faces].mean(1) - com
    black = np.prod(middles, axis=1) > 0  # the octants with an even number of negative coordinates
    return [
        DrawnPart(
            ("centers of mass", name, word), Mesh(ball.vertices, faces), color, p, R, over=reach
        )
        for word, faces, color in (
            ("black", ball.faces[black], INK),
            ("white", ball.faces[~black], "#ffffff"),
        )
    ]


def parts_of_supports(
    sequence: PoseSequence, size: float, up: np.ndarray, shapes: Mapping[str, tuple[Shape, ...]]
) -> tuple[list[DrawnPart], list[NameLabel]]:
    """Return the parts and labels of supports: a slab under points in a horizontal plane, a board
    behind a flat model, and a small plate at the end of each line element."""
    model, parts, labels = sequence.model, [], []
    own = points_of_frames(sequence)
    board = _board(sequence, size, up) if len(model.layout.supports) == 1 else None
    for name in (*model.layout.supports, WORLD):
        p, R = sequence.pose(name)
        feet = [_foot(point, direction, size) for point, direction in _feet(sequence, name)]
        if feet:
            parts.append(
                DrawnPart(("supports", name, "feet"), joined(feet), GRAY, p, R, edged=True)
            )
        if name == WORLD:
            continue
        points = own[name]
        if name in shapes:
            parts += _shaped(("supports", name), shapes[name], LIGHT, p, R)
        elif len(points) and board is not None and np.ptp(points @ R[0].T @ up) > 0.02 * size:
            own_board = board.placed(-p[0]).placed(np.zeros(3), R[0].T)
            parts.append(
                DrawnPart(
                    ("supports", name, "board"), own_board, "#eef1f5", p, R, below=True, edged=True
                )
            )
        elif (
            len(points)
            and not _carries_tyre(sequence, name)
            and np.ptp(points @ R[0].T @ up) <= 0.02 * size
        ):
            lowered = points - 2.2 * THICK * size * (R[0].T @ up)
            rim = box([3 * THICK * size] * 3).vertices * [2.2, 2.2, 0.4] @ axes_along(up).T @ R[0]
            slab = hull(np.concatenate([lowered + corner for corner in rim]))
            parts.append(DrawnPart(("supports", name, "slab"), slab, LIGHT, p, R, edged=True))
        if len(points) and not _carries_tyre(sequence, name):
            lowest = points[np.argmin(points @ R[0].T @ up)]
            labels.append(
                NameLabel(
                    ("supports", name, "name"),
                    name,
                    sequence.points(name, lowest),
                    GRAY,
                    "support",
                )
            )
    return parts, labels


def parts_of_joints(sequence: PoseSequence, size: float) -> Iterator[DrawnPart]:
    """Yield the drawn parts of joints: pins of hinges with their axes, balls, and rails of guides,
    fixed to the frame of the parent."""
    model, r = sequence.model, 0.012 * size
    pin = joined([cylinder(r, -2.2 * r, 2.2 * r), cylinder(0.25 * r, -6 * r, 6 * r, sides=8)])
    rail = cylinder(0.004 * size, -0.1 * size, 0.1 * size, sides=8)
    for name, parent in zip(model.layout.bodies, model.layout.parents, strict=True):
        joint, (p, R) = model.joint(name), sequence.pose(parent)
        origin = R[0].T @ (sequence.pose(name)[0][0] - p[0])
        at = origin if joint.at is None else np.asarray(joint.at, float)
        lines: list[tuple[Mesh, Any, np.ndarray]] = []
        if isinstance(joint, Hinge):
            lines = [(pin, joint.axis, at)]
        elif isinstance(joint, Guide):
            lines = [(rail, joint.axis, origin)]
        elif isinstance(joint, Combined | Composite):
            places = (
                np.where(np.array(joint.turns)[:, None], np.asarray(joint.points), origin)
                if isinstance(joint, Composite)
                else [at] * len(joint.turns)
            )
            lines = [
                (pin if turn else rail, n, x)
                for turn, n, x in zip(joint.turns, joint.directions, places, strict=True)
            ]
        elif isinstance(joint, Ball):
            yield DrawnPart(("joints", name), sphere(1.5 * r), GRAY, p + R @ at, R)
        for i, (mesh, axis, point) in enumerate(lines):
            number = (str(i + 1),) if len(lines) > 1 else ()
            axes = axes_along(np.asarray(axis, float))
            yield DrawnPart(("joints", name, *number), mesh, GRAY, p + R @ point, R @ axes)


def up_of(model: Any) -> np.ndarray:
    """Return the direction against gravity, or z without gravity."""
    g = np.asarray(model.gravity, float)
    length = np.linalg.norm(g)
    return -g / length if length > 0 else np.array([0.0, 0, 1])


def is_flat(sequence: PoseSequence, size: float, up: np.ndarray) -> np.ndarray | None:
    """Return the horizontal normal of the plane in which all points of a flat model lie in the
    first frame, or None for other models."""
    places = marks(sequence)[0]
    _, spread, rows = np.linalg.svd(places - places.mean(0), full_matrices=True)
    spread = np.concatenate([spread, np.zeros(3)])[:3]
    if spread[2] > FLAT * size or spread[1] <= FLAT * size or abs(rows[2] @ up) > 0.1:
        return None
    return rows[2] * np.sign(rows[2] @ np.array([1e-3, -1e-3 if abs(up[2]) > 0.5 else 1e-6, 1.0]))


def points_of_frames(sequence: PoseSequence) -> dict[str, np.ndarray]:
    """Return {frame: points (n, 3) of elements, closures and joints on it}, in the axes of the
    frame, in the first frame of the sequence."""
    model = sequence.model
    places: dict[str, list[np.ndarray]] = {name: [] for name in model.layout.frames}
    for table in attaching(model):
        for frame, point in places_of(table):
            places[frame].append(point)
    for name, parent in zip(model.layout.bodies, model.layout.parents, strict=True):
        joint = model.joint(name)
        if isinstance(joint, Hinge | Ball | Combined) and not isinstance(joint, Planar):
            fixed = (name, np.zeros(3)) if joint.at is None else (parent, joint.at)
            at = sequence.points(*fixed)[0]
            for frame in (name, parent):
                p, R = sequence.pose(frame)
                places[frame].append(R[0].T @ (at - p[0]))
    return {name: np.array(rows).reshape(-1, 3) for name, rows in places.items()}


def _along_lines(sequence: PoseSequence) -> list[KindTable]:
    """Return the tables of elements along lines."""
    tables = (*sequence.model.elements, *sequence.model.forces)
    return [
        x for x in tables if hasattr(x.rows, "free_length") or isinstance(x.rows, CommandedForce)
    ]


def _feet(sequence: PoseSequence, name: str) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return (point, outward direction), in the axes of a support or of the world, of each end of a
    line element on it."""
    feet, (_, R) = [], sequence.pose(name)
    for _, element in named_rows(_along_lines(sequence)):
        A, B = (end[0] for end in sequence.ends(element))
        for frame, point, d in zip(element.between, element.points, (A - B, B - A), strict=True):
            if frame == name:
                length = np.linalg.norm(d)
                outward = d / length if length > 0 else np.array([0.0, 0, -1])
                feet.append((np.asarray(point, float), R[0].T @ outward))
    return feet


def _foot(point: np.ndarray, direction: np.ndarray, size: float) -> Mesh:
    """Return a small plate across the direction, behind the point."""
    r = 0.03 * size
    return box([2 * r, 2 * r, 0.3 * r]).placed(point + 0.15 * r * direction, axes_along(direction))


def _carries_tyre(sequence: PoseSequence, name: str) -> bool:
    return any(
        isinstance(table.rows, Tyre) and link[1] == name
        for table in sequence.model.elements
        for link in table.links
    ) or (name in sequence.roads)


def _board(sequence: PoseSequence, size: float, up: np.ndarray) -> Mesh | None:
    """Return a board behind a flat model, in world axes in the first frame, or None for other
    models."""
    normal = is_flat(sequence, size, up)
    if normal is None:
        return None
    axes = np.stack([np.cross(up, normal), up, normal], -1)
    inside = marks(sequence)[0] @ axes
    low, high = inside.min(0) - 0.08 * size, inside.max(0) + 0.08 * size
    middle = (low + high) / 2
    middle[2] = low[2] + 0.08 * size - 0.07 * size
    return box([high[0] - low[0], high[1] - low[1], 0.015 * size]).placed(axes @ middle, axes)


def _shaped(
    path: tuple[str, ...], shapes: tuple[Shape, ...], color: str, p: np.ndarray, R: np.ndarray
) -> list[DrawnPart]:
    return [
        DrawnPart(
            (*path, f"shape {i + 1}"),
            shape.mesh,
            shape.color or color,
            p,
            R,
            opacity=shape.opacity,
            edged=True,
        )
        for i, shape in enumerate(shapes)
    ]


SOLID = 0.82  # opacity of a body
LONGEST = 0.22  # length of the longest arrow, relative to the size of the model
FORCE = COLORS[4]
# directions to the camera as in `Animation.seen_from`; the first angle for several in a row
SEEN_FROM, FLAT_SEEN_FROM, IN_A_ROW = (32.0, 24.0), (14.0, 9.0), 16.0
GAP = 0.35  # between two models side by side, relative to the width of one


def animation_of(
    sequence: PoseSequence,
    *,
    speed: float = 1.0,
    shapes: Mapping[str, tuple[Shape, ...]] | None = None,
    trails: Sequence[tuple[str, str, np.ndarray]] = (),
    longest_force: float = 1.0,
) -> Animation:
    """Return the animation of a sequence of poses.

    Args:
        sequence: the poses; forces that it contains are drawn as arrows.
        speed: seconds of the sequence per second of playing.
        shapes: {body or support: its shapes} in place of the default ones.
        trails: (name, frame, point in its axes) of points whose paths are drawn.
        longest_force: the force [N] of the longest arrow.
    """
    size, up, shapes = size_of_sequence(sequence), up_of(sequence.model), shapes or {}
    bodies, names = parts_of_bodies(sequence, size, shapes, SOLID)
    supports, more_names = parts_of_supports(sequence, size, up, shapes)
    parts = [
        *supports,
        *parts_of_roads(sequence, size),
        *bodies,
        *parts_of_joints(sequence, size),
        *parts_of_elements(sequence, size, up),
        *parts_of_closures(sequence, size),
        *parts_of_wheel(sequence),
    ]
    notes = list(sequence.notes)
    if sequence.forces:
        scale = LONGEST * size / longest_force
        parts += _arrows(sequence, size, scale)
        notes.append(f"arrows: {LONGEST * size / scale:.3g} N are {LONGEST * size:.3g} m long")
    names += more_names + _names_at_middles(sequence)
    paths = [
        Trail(("trails", name), sequence.points(frame, point), COLORS[1])
        for name, frame, point in trails
    ]
    seen_from = SEEN_FROM if is_flat(sequence, size, up) is None else FLAT_SEEN_FROM
    return Animation(
        (sequence.times - sequence.times[0]) / speed,
        sequence.clock,
        tuple(parts),
        tuple(names),
        tuple(paths),
        up,
        _right(sequence, size, up),
        size,
        seen_from,
        sequence.title,
        tuple(notes),
    )


def with_ground(animation: Animation) -> Animation:
    """Return the animation with a grid at the height of its lowest point."""
    size, right, up = animation.size, animation.right, animation.up
    cell = 10.0 ** np.floor(np.log10(size / 4))
    cell *= max(k for k in (1, 2, 5) if k * cell <= size / 4)
    axes = np.stack([right, np.cross(up, right), up], -1)
    inside = animation.outline() @ axes
    level, wide = inside[:, 2].min() - 0.002 * size, 0.0035 * size
    first, last = (
        (np.floor(inside.min(0) / cell) - 1) * cell,
        (np.ceil(inside.max(0) / cell) + 1) * cell,
    )
    lines = []
    for axis, turn in enumerate((np.eye(3), np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]))):
        other = 1 - axis
        line = ribbon(np.array([first[axis], last[axis]]), np.zeros(2), wide)
        lines += [
            line.placed(np.eye(3)[other] * k + np.array([0, 0, level]), turn)
            for k in np.arange(first[other], last[other] + 0.5 * cell, cell)
        ]
    part = DrawnPart(
        ("ground",),
        joined(lines),
        "#d5dae1",
        np.zeros((1, 3)),
        axes[None],
        below=True,
        framed=False,
    )
    notes = (*animation.notes, f"cells of the grid {cell:g} m")
    return replace(animation, parts=(part, *animation.parts), notes=notes)


def side_by_side(animations: Mapping[str, Animation]) -> Animation:
    """Return several animations in a row to the right, each with its name, at the same times;
    shorter ones stop at their last frame."""
    first, placed, offset = next(iter(animations.values())), [], 0.0
    longest = max(
        animations.values(), key=lambda animation: (animation.seconds[-1], len(animation.seconds))
    )
    for name, animation in animations.items():
        points = animation.outline()
        along = points @ first.right
        shift = (offset - along.min()) * first.right
        offset += np.ptp(along) * (1 + GAP)
        moved = animation.shown_at(longest.seconds).moved(shift, name)
        # columns: right, up, away from the camera
        axes = np.stack([first.right, first.up, -np.cross(first.right, first.up)], -1)
        low, high = (points @ axes).min(0), (points @ axes).max(0)
        at = shift + axes @ np.array([(low[0] + high[0]) / 2, high[1] + 0.06 * first.size, high[2]])
        title = NameLabel((name, "title"), animation.title or name, at[None], GRAY, "title")
        placed.append(
            replace(
                moved, labels=(title, *(label for label in moved.labels if label.kind == "body"))
            )
        )
    return replace(
        first,
        seconds=longest.seconds,
        clock=longest.clock,
        parts=tuple(part for animation in placed for part in animation.parts),
        labels=tuple(label for animation in placed for label in animation.labels),
        trails=tuple(trail for animation in placed for trail in animation.trails),
        size=max(animation.size for animation in animations.values()),
        seen_from=(IN_A_ROW, first.seen_from[1]),
        title="",
        notes=tuple(
            dict.fromkeys(note for animation in animations.values() for note in animation.notes)
        ),
    )


def _arrows(sequence: PoseSequence, size: float, scale: float) -> Iterator[DrawnPart]:
    """Yield arrows of the forces that elements exert on the bodies at their ends."""
    mesh = arrow(0.012 * size, 0.3)
    for name, force in sequence.forces.items():
        element = sequence.model[name]
        for i, (frame, at) in enumerate(zip(element.between, sequence.ends(element), strict=True)):
            if frame in sequence.model.layout.bodies:
                path, tip = ("forces", name, f"on {frame}"), at + scale * force[:, i]
                yield replace(rod(path, mesh, FORCE, at, tip), over=0.05 * size)


def _names_at_middles(sequence: PoseSequence) -> list[NameLabel]:
    """Return the labels of elements and of rods at their middles; other closures have none, as they
    are near the names of bodies."""
    model = sequence.model
    named = [
        ("tyres" if isinstance(element, Tyre) and element.radius > 0 else "elements", name, element)
        for name, element in drawn_elements(model)
    ]
    named += [
        ("closures", name, closure) for name, closure in placed_closures(model) if is_link(closure)
    ]
    return [
        NameLabel(
            (group, name, "name"), name, np.mean(sequence.ends(thing)[:2], 0), GRAY, "element"
        )
        for group, name, thing in named
    ]


def _right(sequence: PoseSequence, size: float, up: np.ndarray) -> np.ndarray:
    """Return the horizontal direction that points right: in the plane of a flat model, else x, or y
    for a model that is longer along it."""
    normal = is_flat(sequence, size, up)
    if normal is not None:
        return np.cross(up, normal)
    spread = np.ptp(marks(sequence)[0], axis=0)
    x, y = (i for i in range(3) if i != int(np.argmax(np.abs(up))))
    axis = np.eye(3)[x if spread[x] >= 0.5 * spread[y] else y]
    rest = axis - (axis @ up) * up
    return rest / np.linalg.norm(rest)
