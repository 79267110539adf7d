"""Laws of springs and dampers: polynomials, stops, ropes, gas; digressive dampers, friction."""

from __future__ import annotations

from typing import ClassVar

import jax.numpy as jnp
import numpy as np

from jaxbody.core.arrays import Array, Float
from jaxbody.core.errors import Problems
from jaxbody.geometry.fields import field, take
from jaxbody.model.laws.laws import Law, Number, row_of_numbers

ATMOSPHERE = 101325.0  # Pa


class Polynomial(Law):
    """A polynomial: F = c1 x + c2 x^2 + c3 x^3 + ..., U = c1 x^2/2 + c2 x^3/3 + ... `coefficients`
    c1, c2, ... [N/m], [N/m2] ... Hardening where c3 > 0.

    >>> float(jb.laws.Polynomial([100.0, 0.0, 5.0]).force(jnp.array(2.0)))
    240.0
    """

    coefficients: Float[Array, "n"] = field("powers")

    def __init__(self, coefficients):
        with Problems() as problems:
            self.coefficients = row_of_numbers(coefficients, "Polynomial.coefficients", problems)

    @property
    def powers(self) -> str:
        """The unit of each coefficient."""
        return ", ".join(
            f"force/argument^{i + 1}" for i in range((1, *self.coefficients.shape)[-1])
        )

    def _sum(self, x, divisors):
        c = self.coefficients / np.asarray(divisors, self.coefficients.dtype)
        total = c[..., -1]
        for i in range(c.shape[-1] - 2, -1, -1):
            total = total * x + c[..., i]
        return total

    def force(self, x):
        return self._sum(x, np.ones(self.coefficients.shape[-1])) * x

    def potential(self, x):
        return self._sum(x, np.arange(2, self.coefficients.shape[-1] + 2)) * x**2


class BumpStop(Law):
    """A stop behind a gap: with the penetration d = -x - gap (an `extension` stop: d = x - gap) and
    the engagement w,

        |F| = 0 for d < 0,   k d^2/(2 w) for 0 < d < w,   k (d - w/2) for d > w

    The force has no kink, and its slope at d = 0 is 0.

    Args:
        gap: travel before contact [m]
        stiffness: k [N/m]
        engagement: w, over which the stiffness builds up [m]
        extension: a stop against extension; False: against compression

    Errors: NEGATIVE for gap or stiffness, NOT_POSITIVE for the engagement.

    >>> round(
    ...     float(jb.laws.BumpStop(gap=0.06, stiffness=2e5, engagement=0.01).force(jnp.array(-0.1)))
    ... )
    -7000
    """

    words: ClassVar[dict[str, str]] = {"force": "N", "argument": "m"}
    gap: Number = field(
        "argument",
        "nonnegative",
        hint="For a stop that is compressed at x = 0, change the free length.",
    )
    stiffness: Number = field("force/argument", "nonnegative")
    engagement: Number = field(
        "argument", "positive", hint="A hundredth of the travel has little effect."
    )
    extension: bool = field(static=True)

    def __init__(self, *, gap, stiffness, engagement=1e-3, extension: bool = False):
        self.extension = bool(extension)
        take(self, gap=gap, stiffness=stiffness, engagement=engagement)

    def force(self, x):
        d, side = self._penetration(x)
        return side * self.stiffness * ramp(d, self.engagement)

    def potential(self, x):
        return self.stiffness * ramp_energy(self._penetration(x)[0], self.engagement)

    def _penetration(self, x):
        side = 1.0 if self.extension else -1.0
        return side * x - self.gap, side


def ramp(d: Float[Array, "*n"], w: Number) -> Float[Array, "*n"]:
    """Return 0 for d < 0, d^2/(2 w) up to w, then d - w/2."""
    return jnp.where(d <= 0, 0.0, jnp.where(d < w, d**2 / (2 * w), d - w / 2))


def ramp_energy(d: Float[Array, "*n"], w: Number) -> Float[Array, "*n"]:
    """Return the integral of the ramp."""
    return jnp.where(d <= 0, 0.0, jnp.where(d < w, d**3 / (6 * w), d**2 / 2 - d * w / 2 + w**2 / 6))


def ramp_slope(d: Number, w: Number) -> Number:
    """Return the derivative of the ramp."""
    return jnp.clip(d / w, 0.0, 1.0)


class TensionOnly(Law):
    """A rope: F = k x for x > 0, zero for x < 0; its slope at 0 is k/2. `stiffness` k [N/m].
    Error: NEGATIVE.

    >>> (
    ...     float(jb.laws.TensionOnly(100.0).force(jnp.array(-0.1))),
    ...     float(jb.laws.TensionOnly(100.0).force(jnp.array(0.1))),
    ... )
    (0.0, 10.0)
    """

    words: ClassVar[dict[str, str]] = {"force": "N", "argument": "m"}
    stiffness: Number = field("force/argument", "nonnegative")

    def __init__(self, stiffness):
        take(self, stiffness=stiffness)

    def force(self, x):
        return 0.5 * self.stiffness * (x + x * jnp.sign(x))  # |x|, with slope 0 at 0

    def potential(self, x):
        return 0.25 * self.stiffness * (x**2 + x**2 * jnp.sign(x))


class AirSpring(Law):
    """An air spring with a polytropic gas: F = A (p_a - p0 (1 + x/h)^-n).

    The stiffness at x = 0 is n p0 A/h. For x <= -h the force is NaN, and results report it.
    `AirSpring.carrying(load, ...)` returns a spring that carries a load at x = 0.

    Args:
        pressure: absolute, p0 at x = 0 [Pa]
        area: A [m2]
        height: h of the column of gas at x = 0 [m]
        exponent: n, 1 isothermal, 1.4 adiabatic
        ambient: pressure p_a [Pa]

    Error: NOT_POSITIVE.

    >>> spring = jb.laws.AirSpring.carrying(2000.0, area=0.02, height=0.15)
    >>> round(float(spring.force(jnp.array(0.0))), 6), round(float(spring.slope(jnp.array(0.0))))
    (-2000.0, 37581)
    """

    pressure: Number = field("Pa", "positive")
    area: Number = field("m2", "positive")
    height: Number = field("m", "positive")
    exponent: Number = field("", "positive")
    ambient: Number = field("Pa", "nonnegative")

    def __init__(self, *, pressure, area, height, exponent=1.4, ambient=ATMOSPHERE):
        take(self, pressure=pressure, area=area, height=height, exponent=exponent, ambient=ambient)

    @classmethod
    def carrying(cls, load, *, area, height, exponent=1.4, ambient=ATMOSPHERE) -> AirSpring:
        """Return the spring that pushes with a force at x = 0: p0 = p_a + load/A.

        Args:
            load: force at x = 0 [N]
            area: A [m2]
            height: height of the column of gas at x = 0 [m]
            exponent: polytropic exponent, 1 for isothermal, 1.4 for adiabatic
            ambient: pressure p_a [Pa]
        """
        return cls(
            pressure=ambient + load / area,
            area=area,
            height=height,
            exponent=exponent,
            ambient=ambient,
        )

    def force(self, x):
        return self.area * (
            self.ambient - self.pressure * jnp.exp(-self.exponent * jnp.log1p(x / self.height))
        )

    def potential(self, x):
        """Return A (p_a x - p0 h (1 - (1 + x/h)^(1-n))/(n - 1)) [J]; at n = 1 its limit, with
        log(1 + x/h)."""
        y = jnp.log1p(x / self.height)
        return self.area * (
            self.ambient * x
            - self.pressure * self.height * y * _expm1_over((1 - self.exponent) * y)
        )


def _expm1_over(z):
    """Return (exp(z) - 1)/z, by its series near z = 0."""
    small = jnp.abs(z) < 0.5
    near, far = jnp.where(small, z, 0.0), jnp.where(small, 1.0, z)
    series = jnp.ones_like(near)
    for n in range(18, 1, -1):
        series = 1 + near / n * series
    return jnp.where(small, series, jnp.expm1(far) / far)


class Digressive(Law):
    """A digressive damper: F = c1 x + (c0 - c1) x/sqrt(1 + (x/x0)^2), with the slope c0 at rest, c1
    at large x, and the knee at x0.

    Args:
        slow: c0 [N s/m]
        fast: c1 [N s/m]
        knee: x0, the velocity about which the slope changes [m/s]

    Errors: NEGATIVE, NOT_POSITIVE for the knee.

    >>> float(jb.laws.Digressive(slow=3000.0, fast=0.0, knee=0.3).force(jnp.array(0.4)))
    720.0
    """

    words: ClassVar[dict[str, str]] = {"force": "N", "argument": "m/s"}
    slow: Number = field("force/argument", "nonnegative")
    fast: Number = field("force/argument", "nonnegative")
    knee: Number = field("argument", "positive")

    def __init__(self, *, slow, fast, knee):
        take(self, slow=slow, fast=fast, knee=knee)

    def force(self, x):
        return self.fast * x + (self.slow - self.fast) * x / jnp.sqrt(1 + (x / self.knee) ** 2)

    def potential(self, x):
        return 0.5 * self.fast * x**2 + (self.slow - self.fast) * x**2 / (
            1 + jnp.sqrt(1 + (x / self.knee) ** 2)
        )


class Friction(Law):
    """Dry friction, regularized: F = F0 x/sqrt(x^2 + v0^2), which is 71 % of F0 at the velocity
    v0, 99.5 % at 10 v0. Under a load below F0 it creeps instead of sticking.

    `level` F0 [N], `velocity` v0 [m/s]. Errors: NEGATIVE, NOT_POSITIVE for the velocity.

    >>> round(float(jb.laws.Friction(level=50.0, velocity=1e-3).force(jnp.array(0.1))), 2)
    50.0
    """

    words: ClassVar[dict[str, str]] = {"force": "N", "argument": "m/s"}
    level: Number = field("force", "nonnegative")
    velocity: Number = field(
        "argument", "positive", hint="Give the velocity at which it slides with 71 % of the force."
    )

    def __init__(self, *, level, velocity):
        take(self, level=level, velocity=velocity)

    def force(self, x):
        return self.level * x / jnp.sqrt(x**2 + self.velocity**2)

    def potential(self, x):
        return self.level * x**2 / (jnp.sqrt(x**2 + self.velocity**2) + self.velocity)
