"""Unilateral contacts: the tyre on its road, and a stop between two points.

With the penetration delta = -e, the elastic force P and a damper that builds up over the
engagement w,

    P = k r(delta),  V = int P d delta,   damping: max(c_e delta_dot, -P),
    c_e = c delta/w, at least 0, at most c

where r(delta) is 0 for delta < 0, delta^2/(2 w) up to w and then delta - w/2. The total force
P + max(c_e delta_dot, -P) never pulls and has no jumps.
"""

import jax.numpy as jnp

from jaxbody.core.arrays import Array, Float, scalar
from jaxbody.core.errors import Problems
from jaxbody.geometry.fields import field, in_domain, kind_of, take
from jaxbody.geometry.points_and_orientations import direction, ends
from jaxbody.geometry.vectors import dot, rotate
from jaxbody.model.elements.elements import Element, LineElement
from jaxbody.model.laws.spring_laws import ramp, ramp_energy, ramp_slope


class Touching(Element):
    """The base class of unilateral contacts: `stiffness` k [N/m], `damping` c [N s/m], `engagement`
    w [m].

    >>> issubclass(jb.Tyre, Touching) and issubclass(jb.Contact, Touching)
    True
    """

    stiffness: Float[Array, ""] = field("N/m", "nonnegative")
    damping: Float[Array, ""] = field("N s/m", "nonnegative")
    engagement: Float[Array, ""] = field(
        "m", "positive", hint="A hundredth of the travel has little effect."
    )

    def energy(self, e):
        return self.stiffness * ramp_energy(-e, self.engagement)

    def dissipation(self, e, e_dot):
        """Return R = 1/2 c_e e_dot^2 - 1/2 q^2/c_e, with q the part of the damper's tension that
        would exceed the contact's push P, so that the contact never pulls."""
        c, q = self._damper(e, e_dot)
        return 0.5 * c * e_dot**2 - 0.5 * jnp.where(c > 0, q**2 / jnp.where(c > 0, c, 1.0), 0.0)

    def damping_force(self, e, e_dot):
        c, q = self._damper(e, e_dot)
        return c * e_dot - q

    def force(self, *frames):
        e, e_dot = self.rates(*frames)
        return -self._push(e) + self.damping_force(e, e_dot)

    def _push(self, e):
        return self.stiffness * ramp(-e, self.engagement)

    def _damper(self, e, e_dot):
        c = self.damping * jnp.clip(-e / self.engagement, 0.0, 1.0)
        excess = c * e_dot - self._push(e)
        return c, jnp.where((c > 0) & (excess > 0), excess, 0.0)


class Tyre(Touching):
    """The vertical force of a tyre: it pushes the hub a up from the road b while the hub is lower
    than the radius; the tyre may lift off.

        e = n . (A - B) - radius,   n the road's normal, `axis` in the road's frame; the penetration
                                    is -e

    The road is a support that follows the profile under the wheel (jb.inputs.Road, which averages
    it over the footprint), or the world.

    Args:
        hub: name of the wheel, or (name, point)
        road: name of the support, or (name, point)
        stiffness: [N/m]
        damping: [N s/m]
        radius: unloaded [m]
        engagement: penetration over which stiffness and damping build up [m]
        axis: the road's normal, x, y, z or a direction, in the road's frame

    Errors: NEGATIVE, NOT_POSITIVE, ZERO_AXIS, SELF_SPRING, BAD_SHAPE, NON_FINITE.

    >>> tyre = jb.Tyre(
    ...     ("wheel", [0, 0, 0]), ("road", [0, 0, 0]), stiffness=2e5, damping=50.0, radius=0.31
    ... )
    >>> tyre.between
    ('wheel', 'road')
    """

    radius: Float[Array, ""] = field("m", "nonnegative")
    axis: Float[Array, "3"] = field("", "direction")

    def __init__(
        self, hub, road, *, stiffness, damping=0.0, radius, engagement=1e-3, axis=(0, 0, 1)
    ):
        with Problems() as problems:
            self.between, (self.a, self.b) = ends((hub, road), "Tyre", problems)
            take(
                self,
                problems,
                stiffness=stiffness,
                damping=damping,
                engagement=engagement,
                radius=radius,
            )
            self.axis = direction(axis, "Tyre.axis", problems)

    def deformation(self, hub, road):  # pyright: ignore[reportIncompatibleMethodOverride]  its own frames
        return dot(rotate(road.R, self.axis), hub.point(self.a) - road.point(self.b)) - self.radius


class Contact(Touching, LineElement):
    """A stop between two points, or two spheres: it pushes them apart while they are nearer than a
    distance, e = |AB| - distance.

    Args:
        a, b: (name, point in its frame [m])
        distance: distance at which they touch [m]
        stiffness: [N/m]
        damping: [N s/m]
        engagement: penetration over which stiffness and damping build up [m]

    Errors: NEGATIVE, NOT_POSITIVE, SELF_SPRING, ZERO_LENGTH, BAD_SHAPE, NON_FINITE.

    >>> stop = jb.Contact(
    ...     ("arm", [0.5, 0, 0]),
    ...     ("base", [0.5, 0, -0.3]),
    ...     distance=0.05,
    ...     stiffness=1e6,
    ...     damping=100.0,
    ... )
    >>> float(stop.energy(jnp.array(0.01)))
    0.0
    """

    free_length: Float[Array, ""] = field(
        "m", "positive", hint="Give the distance of the points at which they touch."
    )

    def __init__(self, a, b, *, distance, stiffness, damping=0.0, engagement=1e-3):
        with Problems() as problems:
            self.between, (self.a, self.b) = ends((a, b), "Contact", problems)
            take(self, problems, stiffness=stiffness, damping=damping, engagement=engagement)
            self.free_length = in_domain(
                scalar(distance, "Contact.distance", problems),
                kind_of(self, "free_length"),
                "Contact.distance",
                problems,
            )

    def split(self, L):
        d = self.free_length - L
        return (
            jnp.zeros_like(L),
            -self.stiffness * ramp(d, self.engagement),
            self.stiffness * ramp_slope(d, self.engagement),
        )

    def damper_tension(self, e, e_dot):
        return self.damping_force(e, e_dot)
