"""Animations from poses: all parts of a model, names, force arrows, trails and the ground; several
side by side."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from jaxbody.model.elements.contacts import Tyre
from jaxbody.views.scenes.animations import Animation, DrawnPart, NameLabel, Trail, rod
from jaxbody.views.scenes.body_parts import (
    ground,
    is_flat,
    parts_of_bodies,
    parts_of_joints,
    parts_of_supports,
    up_of,
)
from jaxbody.views.scenes.colors import COLORS, GRAY
from jaxbody.views.scenes.element_parts import is_link, parts_of_closures, parts_of_elements
from jaxbody.views.scenes.poses import (
    PoseSequence,
    marks,
    named_rows,
    placed_closures,
    size_of_sequence,
)
from jaxbody.views.scenes.road_parts import parts_of_roads, parts_of_wheel
from jaxbody.views.scenes.shapes import Shape, arrow

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
        sequence.amplitude,
    )


def with_ground(animation: Animation) -> Animation:
    """Return the animation with a grid at the height of its lowest point."""
    part, note = ground(animation.outline(), animation.up, animation.right, animation.size)
    return replace(animation, parts=(part, *animation.parts), notes=(*animation.notes, note))


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
        for name, element in named_rows((*model.attached, *model.forces))
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
