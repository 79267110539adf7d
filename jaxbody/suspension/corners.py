"""Corners: a wheel with its suspension, ready for curves over travel and steering."""

from __future__ import annotations

from typing import Any

import equinox as eqx

from jaxbody.suspension.alignment_curves import SuspensionCurves, suspension_curves
from jaxbody.suspension.suspensions import Suspension
from jaxbody.suspension.wheels import Wheel


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
