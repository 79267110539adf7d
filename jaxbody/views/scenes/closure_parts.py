"""Closures as drawn parts: rods between their balls, balls, pins of hinges with their axes, rails
and welds; couplings have no position in space."""

from typing import Any

import numpy as np

from jaxbody.geometry.closures import AlongAxis, Ball, Closure, Hinge, Inline, Weld
from jaxbody.views.scenes.animations import DrawnPart, rod
from jaxbody.views.scenes.colors import COLORS, GRAY, INK
from jaxbody.views.scenes.meshes import box, cylinder, joined, sphere
from jaxbody.views.scenes.poses import PoseSequence, placed_closures
from jaxbody.views.scenes.shapes import axes_along

ROD = COLORS[3]
ROUND = 0.006  # radius of a rod, relative to the size of the model


def parts_of_closures(sequence: PoseSequence, size: float) -> list[DrawnPart]:
    """Return the parts of all closures; a closure at a single point is drawn on the first of its
    two frames."""
    return [
        part
        for name, closure in placed_closures(sequence.model)
        for part in _parts(name, closure, sequence, size)
    ]


def is_link(closure: Closure) -> bool:
    """Return whether a closure has two points at a distance from each other."""
    return not isinstance(closure, Ball | Weld | AlongAxis)


def _parts(name: str, closure: Any, sequence: PoseSequence, size: float) -> list[DrawnPart]:
    (A, B), (_, R) = sequence.ends(closure), sequence.pose(closure.between[0])
    r = 0.012 * size
    if is_link(closure):
        ends = [
            DrawnPart(("closures", name, end), sphere(1.3 * r), INK, at, R)
            for end, at in (("a", A), ("b", B))
        ]
        return [rod(("closures", name, "rod"), cylinder(ROUND * size, sides=12), ROD, A, B), *ends]
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
