"""The inerter: a force proportional to the relative acceleration of two points, an element with
kinetic energy."""

from __future__ import annotations

import jax.numpy as jnp

from jaxbody.core.arrays import Array, Float
from jaxbody.core.errors import Problems
from jaxbody.geometry.fields import field, take
from jaxbody.geometry.places import ends
from jaxbody.model.elements.elements import Element, length_and_direction


class Inerter(Element):
    """An inerter between the point a of one body and the point b of another: a flywheel on a rack
    or a ball screw, or fluid in a tube.

        T = 1/2 b (d|AB|/dt)^2,   force = b d2|AB|/dt2, positive where it pulls the points together

    It has no mass of its own, exerts no force at rest and stands beside springs and dampers. It
    adds to T, M, M~ and M_bb. In a model with one the mass matrix depends on the configuration, so
    that free bodies too are integrated as bodies on joints.

    Args:
        a, b: (name of a body, a support or `world`, point in its frame [m]), apart from each other
        inertance: b [kg]

    Errors: NEGATIVE, SELF_SPRING, ZERO_LENGTH in the reference pose, BAD_SHAPE, NON_FINITE.
    Source: M. C. Smith, Synthesis of mechanical networks: the inerter, IEEE Transactions on
    Automatic Control 47 (2002) 1648.

    A mass of 2 kg on a spring of 50 N/m beside an inerter of 6 kg has the natural frequency
    sqrt(k/(m + b)) = 2.5 rad/s:

    >>> places = ("mass", [0, 0, 0]), ("world", [0, 1, 0])
    >>> model = Model(
    ...     bodies={"mass": Body(mass=2.0, inertia=[1, 1, 1])},
    ...     joints={"mass": Guide("world", axis=[0, 1, 0])},
    ...     elements={
    ...         "s": Spring(*places, stiffness=50.0, free_length=1.0),
    ...         "i": Inerter(*places, inertance=6.0),
    ...     },
    ... )
    >>> round(float(2 * jnp.pi * modes(linearize(model, equilibrium(model))).frequency[0]), 9)
    2.5
    """

    inertance: Float[Array, ""] = field("kg", "nonnegative")

    def __init__(self, a, b, *, inertance):
        with Problems() as problems:
            self.between, (self.a, self.b) = ends((a, b), "Inerter", problems)
            take(self, problems, inertance=inertance)

    def deformation(self, A, B):  # pyright: ignore[reportIncompatibleMethodOverride]  its own frames
        """The length |AB|."""
        return length_and_direction(B.point(self.b) - A.point(self.a))[0]

    def energy(self, e):
        return jnp.zeros_like(e)

    def dissipation(self, e, e_dot):
        return jnp.zeros_like(e)

    def kinetic_energy(self, e, e_dot):
        return 0.5 * self.inertance * e_dot**2
