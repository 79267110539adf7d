"""Suspensions drawn by hard points: a model, and points that are one parameter wherever they are
used; corners, which are a wheel with its suspension."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any, TypeVar

import equinox as eqx
import jax

from jaxbody.core.arrays import Array, Float, device_array
from jaxbody.core.errors import Problems, unknown
from jaxbody.model.models import Model
from jaxbody.suspension.alignment_curves import SuspensionCurves, suspension_curves
from jaxbody.suspension.wheels import Wheel

S = TypeVar("S", bound="Suspension")


def _located(points: Mapping[str, Any]) -> dict[str, Any]:
    """The hard points as arrays."""
    return {name: device_array(point) for name, point in points.items()}


class Suspension(eqx.Module):
    """A model drawn by hard points, such as a `Corner` or an `Axle`.

    Args:
        model: in the design position
        hard_points: {name: place [m]} of the points that are one parameter wherever they are used;
            by default none
        build: {name: place} -> the suspension with these hard points and any other numbers, from
            which it follows what each of them moves

    `fit` and `tune` take a suspension in place of a model; its hard points are then free by their
    names, free=["lower outer"], with bounds in meters.

    A pendulum whose pin is a hard point:

    >>> def drawn(points):
    ...     model = Model(
    ...         bodies={"bar": Body(mass=1.0, inertia=[1, 1, 1])},
    ...         joints={"bar": Hinge("world", axis="y", at=points["pin"])},
    ...     )
    ...     return jb.Suspension(model, hard_points=points, build=drawn)
    >>> pendulum = drawn({"pin": [0.0, 0.0, 1.0]})
    >>> pendulum.moved({"pin": [0.0, 0.0, 2.0]}).model.joint("bar").at.tolist()
    [0.0, 0.0, 2.0]
    """

    model: Model
    hard_points: dict[str, Float[Array, "3"]] = eqx.field(
        default_factory=dict, kw_only=True, converter=_located
    )
    build: Callable[[dict[str, Any]], Suspension] | None = eqx.field(
        static=True, default=None, kw_only=True
    )

    @property
    def wheels(self) -> tuple[Wheel, ...]:
        """Its wheels."""
        return ()

    def moved(self: S, places: Mapping[str, Any]) -> S:
        """The suspension with these hard points at other places {name: place [m]}, in the model
        and the wheels: points, axes, lengths of rods. All other numbers stay as they are; a
        spring keeps its compression in the design position. Errors: UNKNOWN_NAME, BAD_SHAPE,
        NON_FINITE, WRONG_SIDE.

        >>> corner = jb.double_wishbone().moved({"tie rod inner": [0.05, 0.2, 0.255]})
        >>> corner.model["tie rod"].a.tolist()
        [0.05, 0.2, 0.255]
        """
        with Problems() as problems:
            names = tuple(self.hard_points)
            problems.collected += [
                unknown(name, "moved", names) for name in places if name not in names
            ]
        if self.build is None or not places:
            return self
        points = self.hard_points | dict(places)
        before, after = (self.build(x) for x in (self.hard_points, points))
        leaves, treedef = jax.tree.flatten(_without_points(self))
        changes = zip(
            leaves,
            *(jax.tree.leaves(_without_points(drawn)) for drawn in (before, after)),
            strict=True,
        )
        moved = jax.tree.unflatten(treedef, [now + (new - old) for now, old, new in changes])
        return dataclasses.replace(moved, hard_points=after.hard_points)


def _without_points(suspension: Suspension) -> Any:
    return dataclasses.replace(suspension, hard_points={})


class Corner(Suspension):
    """A suspension of one wheel.

    Args:
        model: in the design position; all its bodies have the axes and the origin of the car
        wheel: the wheel
        steering: the path of the coordinate that steers, such as "rack.q"
        hard_points, build: those of a `Suspension`

    >>> corner = jb.double_wishbone()
    >>> corner.steering, corner.model.layout.bodies
    ('rack.q', ('lower arm', 'upright', 'rack', 'upper arm'))
    """

    wheel: Wheel
    steering: str = eqx.field(static=True, default="rack.q")

    @property
    def wheels(self):
        return (self.wheel,)

    def curves(self, travel: Any, steering: Any = 0.0) -> SuspensionCurves:
        """Curves over travel, the rise of the center of the wheel [m], and steering [m,
        or rad of a coordinate that turns], either a number or as many as the other has;
        see `suspension_curves`.

        >>> toe = jb.double_wishbone().curves([-0.04, 0.0, 0.04])["toe"]  # doctest: +SKIP
        """
        over = {"travel": travel, "steering": steering}
        return suspension_curves(self.model, drive=self.drive, over=over, wheel=self.wheel)

    @property
    def drive(self) -> dict[str, Any]:
        """The driven readings of its curves: "travel", the rise of the center of the wheel,
        and "steering"."""
        return {"travel": self.wheel, "steering": self.steering}
