"""Forces on rotors that feed their whirl: seals, internal damping, clearances of blades."""

import jax.numpy as jnp

from jaxbody.core.arrays import Array, Float
from jaxbody.core.errors import Problems
from jaxbody.geometry.fields import field, take
from jaxbody.geometry.points_and_orientations import direction, ends
from jaxbody.geometry.vectors import cross
from jaxbody.model.forces.force_elements import PointPair


class WhirlForce(PointPair):
    """The linear force of a seal or bearing on a rotor, with cross-coupled stiffness and damping,

        F = -K x - C x' + k n x x + c n x x'

    for the displacement x of the rotor's point across the shaft's axis n. A positive k pushes along
    the whirl in the sense of n, as a seal does by the swirl of its fluid. Damping c_i inside a
    shaft that turns at W is C = c_i, k = c_i W.

    Args:
        a: point of the rotor, (name, point)
        b: center on the stator, (name, point)
        axis: n; x, y, z or a direction, in the axes of the stator
        stiffness: K [N/m], by default 0
        damping: C [N s/m], by default 0
        cross_stiffness: k [N/m], by default 0
        cross_damping: c [N s/m], by default 0

    Errors: BAD_END, SELF_SPRING, ZERO_AXIS, BAD_SHAPE, NON_FINITE. Source: G. Genta, Dynamics of
    Rotating Systems (2005), 3.5.

    >>> seal = jb.forces.WhirlForce("rotor", "stator", axis="z", cross_stiffness=2e5)
    >>> float(seal.cross_stiffness)
    200000.0
    """

    axis: Float[Array, "3"] = field("", "direction")
    stiffness: Float[Array, ""] = field("N/m")
    damping: Float[Array, ""] = field("N s/m")
    cross_stiffness: Float[Array, ""] = field("N/m")
    cross_damping: Float[Array, ""] = field("N s/m")

    def __init__(
        self, a, b, *, axis, stiffness=0.0, damping=0.0, cross_stiffness=0.0, cross_damping=0.0
    ):
        with Problems() as problems:
            self.between, (self.a, self.b) = ends((a, b), "WhirlForce", problems)
            self.axis = direction(axis, "WhirlForce.axis", problems)
            take(
                self,
                problems,
                stiffness=stiffness,
                damping=damping,
                cross_stiffness=cross_stiffness,
                cross_damping=cross_damping,
            )

    def forces(self, now):
        n = jnp.asarray(self.axis)
        x, x_dot = (part - (part @ n) * n for part in self.relative(now))
        force = (
            -self.stiffness * x
            - self.damping * x_dot
            + self.cross_stiffness * cross(n, x)
            + self.cross_damping * cross(n, x_dot)
        )
        return self.acting(now, force)
