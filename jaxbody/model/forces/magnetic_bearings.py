"""Active magnetic bearings: an attraction that grows with displacement and current, and the circuit
of the coil with a controller of the position."""

import jax.numpy as jnp

from jaxbody.core.arrays import Array, Float
from jaxbody.core.errors import Problems
from jaxbody.geometry.fields import field, take
from jaxbody.geometry.points_and_orientations import direction, ends
from jaxbody.model.forces.force_elements import PointPair


class MagneticBearing(PointPair):
    """A magnetic bearing between a point of a rotor and a point of a stator, along one axis, with
    the current of its coil as a state:

        F = k_i i + k_x x,   L i' + R i = u - k_v x',   u = -P x - D x'

    x is the displacement of the rotor's point along the axis, seen from the stator, F the force on
    the rotor. The displacement stiffness k_x is that of an attraction: it pushes the rotor away. A
    radial bearing is two of them.

    Args:
        a: point of the rotor, (name, point)
        b: center of the bearing on the stator, (name, point)
        axis: x, y, z or a direction, in the axes of the stator
        current_stiffness: k_i [N/A]
        displacement_stiffness: k_x [N/m]
        inductance: L [V s/A]
        resistance: R [V/A]
        proportional: P [V/m]
        derivative: D [V s/m]
        back_emf: k_v [V s/m], by default 0

    Errors: BAD_END, SELF_SPRING, ZERO_AXIS, NOT_POSITIVE, BAD_SHAPE, NON_FINITE. Source: G.
    Schweitzer, E. Maslen, Magnetic Bearings (2009), 2.2, 4.4.

    >>> bearing = jb.forces.MagneticBearing(
    ...     "rotor", "stator", axis="z", current_stiffness=40.0, displacement_stiffness=2e4,
    ...     inductance=0.01, resistance=2.0, proportional=5e3, derivative=20.0,
    ... )
    >>> bearing.states
    ('current',)
    """

    axis: Float[Array, "3"] = field("", "direction")
    current_stiffness: Float[Array, ""] = field("N/A")
    displacement_stiffness: Float[Array, ""] = field("N/m")
    inductance: Float[Array, ""] = field("V s/A", "positive")
    resistance: Float[Array, ""] = field("V/A", "positive")
    proportional: Float[Array, ""] = field("V/m")
    derivative: Float[Array, ""] = field("V s/m")
    back_emf: Float[Array, ""] = field("V s/m")
    states, state_units = ("current",), ("A",)

    def __init__(
        self,
        a,
        b,
        *,
        axis,
        current_stiffness,
        displacement_stiffness,
        inductance,
        resistance,
        proportional,
        derivative,
        back_emf=0.0,
    ):
        with Problems() as problems:
            self.between, (self.a, self.b) = ends((a, b), "MagneticBearing", problems)
            self.axis = direction(axis, "MagneticBearing.axis", problems)
            take(
                self,
                problems,
                current_stiffness=current_stiffness,
                displacement_stiffness=displacement_stiffness,
                inductance=inductance,
                resistance=resistance,
                proportional=proportional,
                derivative=derivative,
                back_emf=back_emf,
            )

    def forces(self, now):
        x, _ = self.relative(now)
        along = self.displacement_stiffness * (x @ self.axis) + self.current_stiffness * now.z[0]
        return self.acting(now, along * jnp.asarray(self.axis))

    def rates(self, now):
        x, x_dot = (part @ self.axis for part in self.relative(now))
        u = -self.proportional * x - self.derivative * x_dot
        return (u - self.back_emf * x_dot - self.resistance * now.z) / self.inductance
