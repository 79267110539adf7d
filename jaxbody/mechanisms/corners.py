"""Corners: a wheel with its suspension, ready for curves over travel and steering."""

from __future__ import annotations

from typing import Any

import equinox as eqx

from jaxbody.mechanisms.alignment_curves import SuspensionCurves, suspension_curves
from jaxbody.mechanisms.wheels import Wheel
from jaxbody.models.models import Model
from jaxbody.sensors.kinematic_sensors import Position


class Corner(eqx.Module):
    """A suspension of one wheel: `model`, in the design position, whose bodies all have the axes and the origin of the car; `wheel`;
    `steering`, the path of the coordinate that steers, such as "rack.q".

    >>> corner = jb.double_wishbone()
    >>> corner.steering, corner.model.layout.bodies
    ('rack.q', ('lower arm', 'upright', 'rack', 'upper arm'))
    """

    model: Model
    wheel: Wheel
    steering: str = eqx.field(static=True, default="rack.q")

    def curves(self, travel: Any, steering: Any = 0.0) -> SuspensionCurves:
        """Curves over travel, the rise of the center of the wheel [m], and steering [m, or rad of a coordinate that turns], either a number
        or as many as the other has; see `suspension_curves`.

        >>> toe = jb.double_wishbone().curves([-0.04, 0.0, 0.04])["toe"]  # doctest: +SKIP
        """
        drive = {"travel": Position(self.wheel.on, self.wheel.center, axis="z"), "steering": self.steering}
        return suspension_curves(self.model, drive=drive, over={"travel": travel, "steering": steering}, wheel=self.wheel)
