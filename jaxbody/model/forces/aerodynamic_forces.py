"""Quasi-steady air loads on a wing section."""

import jax.numpy as jnp

from jaxbody.core.arrays import Array, Float
from jaxbody.core.errors import Problems
from jaxbody.geometry.fields import field, take
from jaxbody.geometry.points_and_orientations import direction, ends
from jaxbody.geometry.vectors import cross, dot, rotate
from jaxbody.model.forces.force_elements import ForceElement


class SectionAirloads(ForceElement):
    """The lift of a wing section in a steady flow, at a point of the section ahead of its axis,

        L = q S c_La (alpha - v_n/U)

    alpha is the angle of the chord to the flow, v_n the velocity of the point along the direction
    of lift. Without `speed` its effect v_n/U is left out.

    Args:
        on: (name of the section's body, point at which lift acts, the aerodynamic center)
        chord: direction from the trailing to the leading edge, in body axes
        flow: direction in which the air moves, in world axes
        lift: direction of positive lift, across the flow, in world axes
        pressure: dynamic pressure q [Pa]
        area: S [m2], per unit of span for a section of unit span
        slope: slope of lift c_La [1/rad], by default 2 pi
        speed: U [m/s], by default None

    Errors: BAD_END, ZERO_AXIS, NOT_POSITIVE, NEGATIVE, BAD_SHAPE, NON_FINITE. Source: R.
    Bisplinghoff, H. Ashley, R. Halfman, Aeroelasticity (1955), 6-6, 9-2.

    >>> air = jb.forces.SectionAirloads(
    ...     ("wing", [0.1, 0, 0]), chord="x", flow=[-1, 0, 0], lift="z", pressure=600.0, area=1.0
    ... )
    >>> round(float(air.slope), 6)
    6.283185
    """

    point: Float[Array, "3"] = field("m")
    chord: Float[Array, "3"] = field("", "direction")
    flow: Float[Array, "3"] = field("", "direction")
    lift: Float[Array, "3"] = field("", "direction")
    pressure: Float[Array, ""] = field("Pa", "nonnegative")
    area: Float[Array, ""] = field("m2", "positive")
    slope: Float[Array, ""] = field("1/rad")
    speed: Float[Array, ""] | None = field("m/s", "positive")

    def __init__(
        self, on, *, chord, flow, lift, pressure, area, slope=6.283185307179586, speed=None
    ):
        with Problems() as problems:
            self.between, (self.point,) = ends((on,), "SectionAirloads", problems)
            self.chord, self.flow, self.lift = (
                direction(x, f"SectionAirloads.{name}", problems)
                for name, x in (("chord", chord), ("flow", flow), ("lift", lift))
            )
            take(self, problems, pressure=pressure, area=area, slope=slope)
            self.speed = None
            if speed is not None:
                take(self, problems, speed=speed)

    @property
    def points(self):
        return (self.point,)

    def forces(self, now):
        (frame,) = now.frames
        chord, n = rotate(frame.R, jnp.asarray(self.chord)), jnp.asarray(self.lift)
        alpha = jnp.arctan2(dot(chord, n), -dot(chord, jnp.asarray(self.flow)))
        if self.speed is not None:
            alpha = alpha - dot(frame.velocity(self.point), n) / self.speed
        F = self.pressure * self.area * self.slope * alpha * n
        return ((F, cross(rotate(frame.R, self.point), F)),)
