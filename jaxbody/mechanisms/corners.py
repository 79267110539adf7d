"""Corners: a wheel with its suspension, ready for curves over travel and steering, and its hard points, which move in all that has them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import equinox as eqx
import jax

from jaxbody.core.arrays import Array, Float
from jaxbody.core.errors import Problems, unknown
from jaxbody.mechanisms.alignment_curves import SuspensionCurves, suspension_curves
from jaxbody.mechanisms.wheels import Wheel
from jaxbody.models.models import Model


class Corner(eqx.Module):
    """A suspension of one wheel.

    Args:
        model: in the design position; all its bodies have the axes and the origin of the car
        wheel: the wheel
        steering: the path of the coordinate that steers, such as "rack.q"
        hard_points: {name: place [m]} of the points that are one parameter wherever they are used; by default none
        build: {name: place} -> the corner with these hard points and any other numbers, from which it follows what each of them moves

    `fit` and `tune` take a corner in place of a model; its hard points are then free by their names, free=["lower outer"], with bounds in
    meters.

    >>> corner = jb.double_wishbone()
    >>> corner.steering, corner.model.layout.bodies
    ('rack.q', ('lower arm', 'upright', 'rack', 'upper arm'))
    """

    model: Model
    wheel: Wheel
    steering: str = eqx.field(static=True, default="rack.q")
    hard_points: dict[str, Float[Array, "3"]] = eqx.field(default_factory=dict)
    build: Callable[[dict[str, Any]], Corner] | None = eqx.field(static=True, default=None)

    def moved(self, places: Mapping[str, Any]) -> Corner:
        """The corner with these hard points at other places {name: place [m]}, in the model and the wheel: points, axes, lengths of rods.
        All other numbers stay as they are; a spring keeps its compression in the design position. Errors: UNKNOWN_NAME, BAD_SHAPE,
        NON_FINITE, WRONG_SIDE.

        >>> corner = jb.double_wishbone().moved({"tie rod inner": [0.05, 0.2, 0.255]})
        >>> corner.model["tie rod"].a.tolist()
        [0.05, 0.2, 0.255]
        """
        with Problems() as problems:
            names = tuple(self.hard_points)
            problems.collected += [unknown(name, "moved", names) for name in places if name not in names]
        if self.build is None or not places:
            return self
        points = self.hard_points | dict(places)
        before, after = (self.build(x) for x in (self.hard_points, points))
        leaves, treedef = jax.tree.flatten((self.model, self.wheel))
        changes = zip(leaves, *(jax.tree.leaves((corner.model, corner.wheel)) for corner in (before, after)), strict=True)
        model, wheel = jax.tree.unflatten(treedef, [now + (new - old) for now, old, new in changes])
        return Corner(model, wheel, self.steering, after.hard_points, self.build)

    def curves(self, travel: Any, steering: Any = 0.0) -> SuspensionCurves:
        """Curves over travel, the rise of the center of the wheel [m], and steering [m, or rad of a coordinate that turns], either a number
        or as many as the other has; see `suspension_curves`.

        >>> toe = jb.double_wishbone().curves([-0.04, 0.0, 0.04])["toe"]  # doctest: +SKIP
        """
        over = {"travel": travel, "steering": steering}
        return suspension_curves(self.model, drive=self.drive, over=over, wheel=self.wheel)

    @property
    def drive(self) -> dict[str, Any]:
        """The driven readings of its curves: "travel", the rise of the center of the wheel, and "steering"."""
        return {"travel": self.wheel, "steering": self.steering}
