"""Springs, dampers and inerters along a line; elements with laws `spring` and `damper`."""

from typing import Any

import equinox as eqx
import jax.numpy as jnp

from jaxbody.core.arrays import Array, Float
from jaxbody.core.errors import Problems
from jaxbody.geometry.fields import field, take
from jaxbody.geometry.points_and_orientations import ends
from jaxbody.geometry.vectors import length_and_direction
from jaxbody.model.elements.elements import (
    MEANT,
    Element,
    LineElement,
    check_signs,
)
from jaxbody.model.laws import law_states, laws


class LawForces(Element):
    """The base class of elements whose forces follow laws, in the fields `spring` and `damper` of
    each class.

    >>> issubclass(jb.SpringDamper, LawForces) and issubclass(jb.Torsion, LawForces)
    True
    """

    def energy(self: Any, e):
        return laws.potential(self.spring, e)

    def dissipation(self: Any, e, e_dot):
        return law_states.dissipation(self.spring, self.damper, e, e_dot)

    def beyond(self: Any, e, e_dot):
        return laws.beyond(self.spring, e) | laws.beyond(self.damper, e_dot)

    def damping_force(self: Any, e, e_dot):
        return law_states.rate_force(self.spring, self.damper, e, e_dot)

    def lost_power(self: Any, *frames):
        return law_states.lost_power(self.spring, self.damper, *self.rates(*frames))

    def static_force(self: Any, e):
        return laws.force(self.spring, e)

    def tangent(self: Any, e):
        return law_states.tangent(self.spring, self.energy, e)

    def _each(self: Any, function, *e) -> list[Any]:
        """Return function(law, ...) for each law and its deformation."""
        return [function(self.spring, *e)]

    def state_rates(self, e, e_dot):
        return _joined(self._each(law_states.state_rates, e, e_dot))

    def rest_states(self, e):
        return _joined(self._each(law_states.rest_states, e))

    def sensitivities(self, e):
        """Return dz/de at rest."""
        return _joined(self._each(law_states.sensitivities, e))

    def inner(self: Any, e, e_dot):
        return law_states.inner(self.spring, e, e_dot)


def _joined(parts: list[list[Array]]) -> Float[Array, "nz"]:
    return jnp.concatenate([one for part in parts for one in part])


class Spring(LineElement):
    """A line spring with viscous damping between the point a of one body and the point b
    of another.

        V = 1/2 k (|AB| - l0)^2,   R = 1/2 c (d|AB|/dt)^2,   tension = k (|AB| - l0) + c d|AB|/dt

    With l0 = 0 the spring is exact down to zero length, where its damper has no direction and
    exerts no force.

    Args:
        a, b: (name of a body, a support or `world`, point in its frame [m])
        stiffness: k [N/m]
        free_length: l0 [m]
        damping: c [N s/m]
        allow_negative: warn of negative coefficients instead of refusing them

    Errors: NEGATIVE_STIFFNESS, NEGATIVE_DAMPING (warnings with `allow_negative`), NEGATIVE_LENGTH,
    SELF_SPRING, BAD_SHAPE, NON_FINITE. Source: (20)-(28) of the paper.

    >>> spring = jb.Spring(
    ...     ("plate", [0, 0, 0]), ("world", [0, 1, 0]), stiffness=100.0, free_length=0.8
    ... )
    """

    stiffness: Float[Array, ""] = field(
        "N/m", "nonnegative unless allow_negative", code="NEGATIVE_STIFFNESS", hint=MEANT
    )
    damping: Float[Array, ""] = field(
        "N s/m", "nonnegative unless allow_negative", code="NEGATIVE_DAMPING", hint=MEANT
    )
    allow_negative: bool = eqx.field(default=False, static=True)

    def __init__(
        self,
        a,
        b,
        *,
        stiffness,
        free_length: Any = 0.0,
        damping: Any = 0.0,
        allow_negative: bool = False,
    ):
        with Problems() as problems:
            self.between, (self.a, self.b) = ends((a, b), "Spring", problems)
            self.allow_negative = True
            take(self, problems, stiffness=stiffness, free_length=free_length, damping=damping)
            check_signs(self, allow_negative, problems)

    def energy(self, e):
        return 0.5 * self.stiffness * e**2

    def dissipation(self, e, e_dot):
        return 0.5 * self.damping * e_dot**2

    def split(self, L):
        return self.stiffness, -self.stiffness * self.free_length, jnp.zeros_like(L)

    def damper_tension(self, e, e_dot):
        return self.damping * e_dot

    def has_no_direction(self):
        return bool(self.damping == 0)


class SpringDamper(LawForces, LineElement):
    """A line element whose spring and damper follow laws: a strut with its bump stop, a rope, an
    air spring.

        V = U_s(|AB| - l0),   R = U_d(d|AB|/dt),   tension = F_s(|AB| - l0) + F_d(d|AB|/dt)

    Args:
        a, b: (name, point in its frame [m])
        spring: a law (jb.laws), with or without memory, the stiffness of a linear one [N/m] or a
            JAX function x -> F; None: no spring
        damper: a law without memory, as a function of the rate; a number is a damping [N s/m]
        free_length: l0, the length at which the spring's law has x = 0 [m]

    Errors: NEGATIVE, NEGATIVE_LENGTH, SELF_SPRING, BAD_SHAPE, NON_FINITE, MEMORY, those of
    the laws.

    >>> strut = jb.SpringDamper(
    ...     ("car", [1.4, 0.7, 0]),
    ...     ("wheel", [0, 0, 0]),
    ...     free_length=0.5,
    ...     spring=jb.laws.Linear(2e4) + jb.laws.BumpStop(gap=0.08, stiffness=1e5, engagement=0.01),
    ...     damper=jb.laws.TwoSided(bump=900.0, rebound=2100.0),
    ... )
    >>> float(strut.spring.force(jnp.array(-0.1)))
    -3500.0
    """

    spring: laws.Law | None = field(words={"force": "N", "argument": "m"})
    damper: laws.Law | None = field(words={"force": "N", "argument": "m/s"})

    def __init__(self, a, b, *, spring=None, damper=None, free_length=0.0):
        with Problems() as problems:
            self.between, (self.a, self.b) = ends((a, b), "SpringDamper", problems)
            take(self, problems, free_length=free_length)
            self.spring = laws.as_law(spring, "SpringDamper.spring", problems)
            self.damper = law_states.as_damper(damper, "SpringDamper.damper", problems)

    def split(self, L):
        e = L - self.free_length
        k0 = jnp.where(self.free_length == 0, laws.slope(self.spring, jnp.zeros_like(L)), 0.0)
        return k0, laws.force(self.spring, e) - k0 * L, laws.slope(self.spring, e) - k0

    def damper_tension(self, e, e_dot):
        return law_states.rate_force(self.spring, self.damper, e, e_dot)

    def has_no_direction(self):
        return (
            self.damper is None
            and not law_states.memories(self.spring)
            and bool(laws.force(self.spring, jnp.zeros(())) == 0)
        )


class Inerter(Element):
    """An inerter between the point a of one body and the point b of another: a flywheel on a rack
    or a ball screw, or fluid in a tube.

        T = 1/2 b (d|AB|/dt)^2,   force = b d2|AB|/dt2, positive where it pulls the points together

    It has no mass, exerts no force at rest and is used in parallel with springs and dampers. It
    adds to the kinetic energy and to the mass matrices M, M~ and M_bb of `linearize`. It makes the
    mass matrix depend on the configuration, so that free bodies too are integrated as bodies on
    joints.

    Args:
        a, b: (name of a body, a support or `world`, point in its frame [m]), at different places
        inertance: b [kg]

    Errors: NEGATIVE, SELF_SPRING, ZERO_LENGTH in the reference pose, BAD_SHAPE, NON_FINITE.
    Source: M. C. Smith, Synthesis of mechanical networks: the inerter, IEEE Transactions on
    Automatic Control 47 (2002) 1648.

    A mass of 2 kg on a spring of 50 N/m beside an inerter of 6 kg has the natural frequency
    sqrt(k/(m + b)) = 2.5 rad/s:

    >>> places = ("mass", [0, 0, 0]), ("world", [0, 1, 0])
    >>> model = jb.Model(
    ...     bodies={"mass": jb.Body(mass=2.0, inertia=[1, 1, 1])},
    ...     joints={"mass": jb.Guide("world", axis=[0, 1, 0])},
    ...     elements={
    ...         "s": jb.Spring(*places, stiffness=50.0, free_length=1.0),
    ...         "i": jb.Inerter(*places, inertance=6.0),
    ...     },
    ... )
    >>> round(
    ...     float(2 * jnp.pi * jb.modes(jb.linearize(model, jb.equilibrium(model))).frequency[0]), 9
    ... )
    2.5
    """

    inertance: Float[Array, ""] = field("kg", "nonnegative")

    def __init__(self, a, b, *, inertance):
        with Problems() as problems:
            self.between, (self.a, self.b) = ends((a, b), "Inerter", problems)
            take(self, problems, inertance=inertance)

    def deformation(self, A, B):  # pyright: ignore[reportIncompatibleMethodOverride]  its own frames
        """Return the length |AB|."""
        return length_and_direction(B.point(self.b) - A.point(self.a))[0]

    def energy(self, e):
        return jnp.zeros_like(e)

    def dissipation(self, e, e_dot):
        return jnp.zeros_like(e)

    def kinetic_energy(self, e, e_dot):
        return 0.5 * self.inertance * e_dot**2
