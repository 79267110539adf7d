"""Laws of rubber: branches of a spring and a dashpot in series, any number of them in parallel with
a spring."""

import jax.numpy as jnp

from jaxbody.geometry.fields import field, take
from jaxbody.model.laws.laws import Number
from jaxbody.model.laws.memory_laws import Viscoelastic


class Maxwell(Viscoelastic):
    """A Maxwell branch: a spring k and a dashpot c = k tau in series. With y, the displacement of
    the dashpot:

        F = k (e - y),   y' = (e - y)/tau,   V = k (e - y)^2/2,   R = k tau y'^2/2,
        dynamic stiffness k i w tau/(1 + i w tau)

    In parallel with a spring it is the standard linear solid; several branches in parallel are a
    Prony series. tau -> 0 at constant c is a damper c, tau -> infinity at constant k a spring k.

    Args:
        stiffness: k of the branch, which it adds at high frequencies [N/m]
        relaxation_time: tau [s]

    Error: NOT_POSITIVE. Source: R. S. Lakes, Viscoelastic Materials (2009), 2.6.

    >>> mount = jb.laws.Linear(2e4) + jb.laws.Maxwell(stiffness=6e4, relaxation_time=0.01)
    >>> float(mount.terms[1].restoring_force(jnp.array(0.001), 0.0, jnp.zeros(1)))
    60.0
    """

    stiffness: Number = field(
        "force/argument", "positive", hint="A branch without stiffness has no force: leave it out."
    )
    relaxation_time: Number = field(
        "s",
        "positive",
        hint="For a damper c use damper=c, or a short time with the stiffness c/time.",
    )

    def __init__(self, *, stiffness, relaxation_time):
        take(self, stiffness=stiffness, relaxation_time=relaxation_time)

    def energy(self, e, z):
        return 0.5 * self.stiffness * (e - z[0]) ** 2

    def dissipation(self, e_dot, y_dot):
        return 0.5 * self.stiffness * self.relaxation_time * y_dot[0] ** 2

    def static_force(self, e, z):
        return self.stiffness * (e - z[0])

    def restoring_force(self, e, e_dot, z):
        return self.static_force(e, z)

    def rate(self, e, e_dot, z):
        return (e - z) / self.relaxation_time

    def relaxed(self, e):
        return jnp.reshape(e, (1,))
