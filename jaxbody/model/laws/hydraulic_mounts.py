"""Hydraulic engine mounts: rubber beside a column of fluid whose inertia resonates between
two chambers."""

from __future__ import annotations

from typing import ClassVar

import jax.numpy as jnp

from jaxbody.core.arrays import scalar
from jaxbody.core.errors import Problems
from jaxbody.geometry.fields import Kind, field, in_domain, take
from jaxbody.model.laws.laws import Number
from jaxbody.model.laws.memory_laws import Inertial


class Hydraulic(Inertial):
    """A hydraulic mount: rubber kr, cr in parallel with a fluid column of mass m between the upper
    chamber k1 and the lower chamber k2. y is the displacement of the fluid, reduced to that of the
    mount, and x is e - y less the free play of the decoupler, |e - y| <= gap:

        F = kr e + cr e' + k1 x,   m y'' + c y' + q |y'| y' + k2 y = k1 x,
        x = e - y - clip(e - y, -gap, gap)
        small amplitude, no gap:   K(s) = kr + cr s + k1 (m s^2 + c s + k2)/(m s^2 + c s + k1 + k2)

    It is soft at low frequencies, kr + k1 k2/(k1 + k2), has its largest loss angle near the
    resonance of the fluid, and is stiff above it, kr + k1. The quadratic loss makes the resonance
    weaker with amplitude. At amplitudes within the gap only the rubber acts; there only k2 acts on
    the fluid, and without k2 a linearization has a mode of zero frequency.

    Args:
        stiffness: kr of the rubber [N/m]
        damping: cr of the rubber [N s/m]
        upper_stiffness: k1, volumetric stiffness of the upper chamber, reduced to the mount [N/m]
        lower_stiffness: k2 of the lower chamber [N/m]; 0 for a soft bellows
        fluid_mass: m of the column, reduced to the mount: much more than its real mass [kg]
        fluid_damping: c, linear loss of the column [N s/m]
        quadratic_damping: q, turbulent loss [N s2/m2]
        gap: free play of the decoupler to each side [m]

    Errors: NEGATIVE; NOT_POSITIVE for upper_stiffness and fluid_mass. Source: R. Singh, G. Kim,
    P. V. Ravindra, Linear analysis of automotive hydro-mechanical mount, Journal of Sound and
    Vibration 158 (1992) 219; with a decoupler G. Kim, R. Singh, ibid. 179 (1995) 427.

    >>> law = jb.laws.Hydraulic(
    ...     stiffness=512950.0,
    ...     damping=198.0,
    ...     upper_stiffness=436950.0,
    ...     fluid_mass=62.8,
    ...     fluid_damping=2666.0,
    ... )
    >>> K = jb.vibration.dynamic_stiffness(law, [10.0])
    >>> round(float(K.magnitude[0]), 4), round(float(jnp.rad2deg(K.loss_angle[0])), 6)
    (641526.9444, 53.216419)
    """

    states: ClassVar[tuple[str, ...]] = ("fluid", "rate of fluid")
    state_units: ClassVar[tuple[str, ...]] = ("argument", "argument/s")
    stiffness: Number = field("force/argument", "nonnegative")
    damping: Number = field("force s/argument", "nonnegative")
    upper_stiffness: Number = field(
        "force/argument",
        "positive",
        hint="Without an upper chamber no force moves the fluid: use Linear.",
    )
    lower_stiffness: Number = field("force/argument", "nonnegative")
    fluid_mass: Number = field(
        "force s2/argument", "positive", hint="For a column without inertia use Maxwell."
    )
    fluid_damping: Number = field("force s/argument", "nonnegative")
    quadratic_damping: Number = field("force s2/argument^2", "nonnegative")
    gap: Number = field("argument", "nonnegative", hint="It is the free play to each side.")

    def __init__(
        self,
        *,
        stiffness,
        upper_stiffness,
        fluid_mass,
        fluid_damping=0.0,
        quadratic_damping=0.0,
        lower_stiffness=0.0,
        damping=0.0,
        gap=0.0,
    ):
        take(
            self,
            stiffness=stiffness,
            damping=damping,
            upper_stiffness=upper_stiffness,
            lower_stiffness=lower_stiffness,
            fluid_mass=fluid_mass,
            fluid_damping=fluid_damping,
            quadratic_damping=quadratic_damping,
            gap=gap,
        )

    @classmethod
    def from_fluid(
        cls,
        *,
        stiffness,
        pumping_area,
        inertance,
        upper_compliance,
        lower_compliance=None,
        resistance=0.0,
        quadratic_resistance=0.0,
        damping=0.0,
        free_volume=0.0,
    ) -> Hydraulic:
        """Return the mount for hydraulic parameters. With the pressures p1, p2 of the chambers and
        the flow Q through the track:

            F = kr e + cr e' + A p1,   C1 p1' = A e' - Q,   C2 p2' = Q,
            I Q' + R Q + R2 |Q| Q = p1 - p2
            k1 = A^2/C1,   k2 = A^2/C2,   m = A^2 I,   c = A^2 R,   q = A^3 R2

        Args:
            stiffness, damping: kr [N/m] and cr [N s/m] of the rubber
            pumping_area: A [m2]
            inertance: I, density times length over cross section of the track [kg/m4]
            resistance, quadratic_resistance: R [N s/m5] and R2 [N s2/m8] of the track
            upper_compliance: C1 [m5/N]
            lower_compliance: C2 [m5/N]; None: a bellows without stiffness
            free_volume: volume that the decoupler lets pass to each side [m3]

        Errors: NOT_POSITIVE, NEGATIVE, those of the mechanical parameters.

        >>> law = jb.laws.Hydraulic.from_fluid(
        ...     stiffness=2e5,
        ...     pumping_area=5e-3,
        ...     inertance=2e6,
        ...     upper_compliance=2.5e-11,
        ...     resistance=2e7,
        ... )
        >>> float(law.upper_stiffness), float(law.fluid_mass), float(law.fluid_damping)
        (1000000.0, 50.0, 500.0)
        """
        bellows = lower_compliance is None
        given = {
            "pumping_area": (pumping_area, "m2", "positive"),
            "inertance": (inertance, "kg/m4", "positive"),
            "upper_compliance": (upper_compliance, "m5/N", "positive"),
            "lower_compliance": (1.0 if bellows else lower_compliance, "m5/N", "positive"),
            "resistance": (resistance, "N s/m5", "nonnegative"),
            "quadratic_resistance": (quadratic_resistance, "N s2/m8", "nonnegative"),
            "free_volume": (free_volume, "m3", "nonnegative"),
        }
        numbers = []
        with Problems() as problems:
            for name, (value, unit, domain) in given.items():
                where = f"Hydraulic.from_fluid.{name}"
                x = scalar(value, where, problems)
                numbers.append(in_domain(x, Kind(unit, domain), where, problems))
        A, I, C1, C2, R, R2, V = numbers
        return cls(
            stiffness=stiffness,
            damping=damping,
            upper_stiffness=A**2 / C1,
            lower_stiffness=0.0 if bellows else A**2 / C2,
            fluid_mass=A**2 * I,
            fluid_damping=A**2 * R,
            quadratic_damping=A**3 * R2,
            gap=V / A,
        )

    def _pushed(self, x: Number) -> Number:
        """Return x less the free play; the slope at x = 0 is 1 if there is no free play."""
        return jnp.where(jnp.abs(x) < self.gap, 0.0, x - jnp.sign(x) * self.gap)

    def energy(self, e, z):
        return 0.5 * (
            self.stiffness * e**2
            + self.upper_stiffness * self._pushed(e - z[0]) ** 2
            + self.lower_stiffness * z[0] ** 2
        )

    def dissipation(self, e_dot, y_dot):
        u = y_dot[0]
        return (
            0.5 * (self.damping * e_dot**2 + self.fluid_damping * u**2)
            + self.quadratic_damping * jnp.abs(u) * u**2 / 3
        )

    def kinetic_energy(self, y_dot):
        return 0.5 * self.fluid_mass * y_dot[0] ** 2

    def static_force(self, e, z):
        return self.stiffness * e + self.upper_stiffness * self._pushed(e - z[0])

    def restoring_force(self, e, e_dot, z):
        return self.static_force(e, z[:1]) + self.damping * e_dot

    def rate(self, e, e_dot, z):
        y, u = z
        force = self.upper_stiffness * self._pushed(e - y) - self.lower_stiffness * y
        return jnp.stack(
            [
                u,
                (force - (self.fluid_damping + self.quadratic_damping * jnp.abs(u)) * u)
                / self.fluid_mass,
            ]
        )

    def relaxed(self, e):
        return jnp.reshape(
            self.upper_stiffness * self._pushed(e) / (self.upper_stiffness + self.lower_stiffness),
            (1,),
        )
