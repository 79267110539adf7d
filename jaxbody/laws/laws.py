"""Force laws F(x) of one number: of springs over the elongation x [m], F and its energy U; of dampers over the rate of it x [m/s], F and
its dissipation potential U.

    F(x) = dU/dx,   U(0) = 0

A law states one of the two; the other is its derivative, or its integral by Gauss-Legendre quadrature. Tension is positive, so a spring
that is pressed has x < 0 and F < 0. Everything in a law is an array and can be free in a fit. Laws add. Torsion elements take the same
laws in rad and N m.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxbody.core.arrays import checked, concrete, functions_as_nodes, scalar
from jaxbody.core.errors import JaxbodyError, Problem, Problems
from jaxbody.laws.curve_files import read_columns

__all__ = [
    "AirSpring",
    "Digressive",
    "Friction",
    "Function",
    "Law",
    "Linear",
    "Polynomial",
    "Stop",
    "Sum",
    "Table",
    "TensionOnly",
    "TwoSided",
]


def __dir__():
    return __all__


Number = Float[Array, ""]
NODES, WEIGHTS = np.polynomial.legendre.leggauss(20)
ATMOSPHERE = 101325.0  # Pa


class Law(eqx.Module):
    """The base of all laws: a law of one's own derives from it and states `force` or `potential`.

    >>> class Cubic(Law):
    ...     coefficient: jax.Array
    ...     def force(self, x):
    ...         return self.coefficient * x**3
    >>> round(float(Cubic(jnp.array(8.0)).potential(jnp.array(0.5))), 12)
    0.125
    """

    def __check_init__(self):
        kind = type(self)
        if kind.force is Law.force and kind.potential is Law.potential:
            hint = "Give one of them: def force(self, x): ..."
            raise JaxbodyError(Problem("NO_FORCE", kind.__name__, "states neither force nor potential", limit="one of them", hint=hint))

    def potential(self, x: Number) -> Number:
        """U(x), the integral of the force from 0."""
        return _integral(functions_as_nodes(self), x)

    def force(self, x: Number) -> Number:
        """F(x) = dU/dx."""
        return jax.grad(self.potential)(x)

    def slope(self, x: Number) -> Number:
        """dF/dx, the stiffness or damping there."""
        return jax.jvp(self.force, (x,), (jnp.ones_like(x),))[1]

    def beyond(self, x: Number) -> Bool[Array, ""]:
        """True where the law is continued beyond what it is known for."""
        return jnp.zeros(jnp.shape(x), bool)

    def __add__(self, other: Any) -> Sum:
        return Sum(self, other)


def as_law(value: Any, where: str, problems: Problems) -> Law | None:
    """A law stays one; a number is the coefficient of a linear one; a Python function x -> F becomes one; None is no law."""
    if value is None or isinstance(value, Law):
        return value
    if callable(value):
        return Function(value)
    number = checked(value, ((),), where, problems, "Give a law, a number or a function x -> F.")
    if number is None:
        return None
    not_negative(number, where, "", problems, "If it is meant, say Polynomial([...]).")
    return _made(Linear, coefficient=number)


class Linear(Law):
    """F = k x,  U = k x^2/2. `coefficient` k, stiffness [N/m] or damping [N s/m]. Error: NEGATIVE.

    >>> float(Linear(200.0).force(jnp.array(0.1)))
    20.0
    """

    coefficient: Number

    def __init__(self, coefficient):
        problems = Problems()
        self.coefficient = scalar(coefficient, "Linear.coefficient", problems)
        not_negative(self.coefficient, "Linear.coefficient", "", problems, "If it is meant, say Polynomial([...]).")
        problems.raise_if_any()

    def force(self, x):
        return self.coefficient * x

    def potential(self, x):
        return 0.5 * self.coefficient * x**2


class Polynomial(Law):
    """F = c1 x + c2 x^2 + c3 x^3 + ...,  U = c1 x^2/2 + c2 x^3/3 + ... `coefficients` c1, c2, ... [N/m], [N/m2] ... Hardening where c3 > 0.

    >>> float(Polynomial([100.0, 0.0, 5.0]).force(jnp.array(2.0)))
    240.0
    """

    coefficients: Float[Array, "n"]

    def __init__(self, coefficients):
        problems = Problems()
        self.coefficients = _row(coefficients, "Polynomial.coefficients", problems, least=1)
        problems.raise_if_any()

    def _sum(self, x, divisors):
        c = self.coefficients / np.asarray(divisors)
        total = c[..., -1]
        for i in range(c.shape[-1] - 2, -1, -1):
            total = total * x + c[..., i]
        return total

    def force(self, x):
        return self._sum(x, np.ones(self.coefficients.shape[-1])) * x

    def potential(self, x):
        return self._sum(x, np.arange(2, self.coefficients.shape[-1] + 2)) * x**2


class Table(Law):
    """Through measured points by monotone cubics (Fritsch, Carlson, SIAM J. Numer. Anal. 17 (1980) 238, slopes of Fritsch and Butland):
    between x_i and x_{i+1}, h apart, with u = (x - x_i)/h,

        F = (1 + 2u)(1 - u)^2 F_i + u^2 (3 - 2u) F_{i+1} + h u (1 - u)^2 m_i - h u^2 (1 - u) m_{i+1}

    U is its exact integral. Beyond the points F goes on straight with the end slope, and results say TABLE_RANGE. `x` [m or m/s]
    increasing, `forces` [N] not falling, at least four. `Table.read` takes them from a file with units. Errors, all at once: TABLE_SHORT,
    TABLE_UNSORTED, TABLE_DUPLICATE, TABLE_FALLS, BAD_SHAPE, NON_FINITE.

    >>> float(Table([-1, 0, 1, 2], [-10, 0, 10, 40]).force(jnp.array(3.0))) > 70
    True
    """

    x: Float[Array, "n"]
    forces: Float[Array, "n"]

    def __init__(self, x, forces):
        problems = Problems()
        self.x, self.forces = (_row(v, f"Table.{name}", problems, least=1) for name, v in (("x", x), ("forces", forces)))
        _check_table(self.x, self.forces, problems)
        problems.raise_if_any()

    @classmethod
    def read(
        cls,
        path,
        *,
        separator: str | None = None,
        decimal: str = ".",
        encoding: str = "utf-8",
        skip: int = 0,
        footer: int = 0,
        largest: float = 1e8,
    ) -> Table:
        """From a file of two columns with their names and units above them, `elongation [mm], force [kN]`; lines that start with # are comments.

        Units of length or angle or their rates, then of force or moment. `separator`, as the first line of numbers has it unless stated; `decimal`, "," of
        decimal commas; `encoding`, `skip` and `footer`, lines left out at the start and at the end; `largest`, of the file [bytes]: as of `read_record`.
        Errors: those of a table of text in `read_record`, NO_UNIT, UNKNOWN_UNIT, WRONG_DIMENSION, BAD_SHAPE of other than two columns, and those of the table.
        """
        text = {"separator": separator, "decimal": decimal, "encoding": encoding, "skip": skip, "footer": footer}
        return cls(*read_columns(Path(path), largest=largest, **text))

    def force(self, x):
        u, h, (F0, F1, m0, m1), before, after = self._cell(x)
        inside = (1 + 2 * u) * (1 - u) ** 2 * F0 + u**2 * (3 - 2 * u) * F1 + h * u * (1 - u) ** 2 * m0 - h * u**2 * (1 - u) * m1
        slopes = self._slopes()
        return inside + slopes[0] * before + slopes[-1] * after

    def potential(self, x):
        return self._from_start(x) - self._from_start(jnp.zeros_like(x))

    def beyond(self, x):
        return (x < self.x[0]) | (x > self.x[-1])

    def _from_start(self, x):
        """The integral of F from the first point."""
        u, h, (F0, F1, m0, m1), before, after = self._cell(x)
        inside = h * (
            (u - u**3 + u**4 / 2) * F0
            + (u**3 - u**4 / 2) * F1
            + h * (u**2 / 2 - 2 * u**3 / 3 + u**4 / 4) * m0
            - h * (u**3 / 3 - u**4 / 4) * m1
        )
        steps, m = jnp.diff(self.x), self._slopes()
        cells = steps * (self.forces[1:] + self.forces[:-1]) / 2 + steps**2 * (m[:-1] - m[1:]) / 12
        whole = jnp.sum(jnp.where(jnp.arange(len(cells)) < self._index(x), cells, 0.0))
        F_first, F_last = self.forces[0], self.forces[-1]
        return whole + inside + F_first * before + m[0] * before**2 / 2 + F_last * after + m[-1] * after**2 / 2

    def _index(self, x):
        return jnp.clip(jnp.sum(self.x <= jax.lax.stop_gradient(x)) - 1, 0, self.x.shape[0] - 2)

    def _cell(self, x):
        """Place u within its cell, width, forces and slopes at both ends; and how far x lies before the first, after the last point."""
        i, m = self._index(x), self._slopes()
        inside = jnp.where(x < self.x[0], self.x[0], jnp.where(x > self.x[-1], self.x[-1], x))
        x_of, F_of = jnp.asarray(self.x), jnp.asarray(self.forces)
        h = x_of[i + 1] - x_of[i]
        before, after = jnp.where(x < self.x[0], x - self.x[0], 0.0), jnp.where(x > self.x[-1], x - self.x[-1], 0.0)
        return (inside - x_of[i]) / h, h, (F_of[i], F_of[i + 1], m[i], m[i + 1]), before, after

    def _slopes(self) -> Float[Array, "n"]:
        """Inside, the weighted harmonic mean of the chords' slopes beside a point; at the ends, of the parabola through three points, kept
        within the bounds that make the curve monotone."""
        h, d = jnp.diff(self.x), jnp.diff(self.forces) / jnp.diff(self.x)
        rising = d[:-1] * d[1:] > 0
        left, right = jnp.where(rising, d[:-1], 1.0), jnp.where(rising, d[1:], 1.0)
        w1, w2 = 2 * h[1:] + h[:-1], h[1:] + 2 * h[:-1]
        inner = jnp.where(rising, (w1 + w2) / (w1 / left + w2 / right), 0.0)
        first = _end_slope(h[0], h[1], d[0], d[1])
        last = _end_slope(h[-1], h[-2], d[-1], d[-2])
        return jnp.concatenate([first[None], inner, last[None]])


def _end_slope(h0, h1, d0, d1):
    m = ((2 * h0 + h1) * d0 - h0 * d1) / (h0 + h1)
    bounded = jnp.where((jnp.sign(d0) != jnp.sign(d1)) & (jnp.abs(m) > 3 * jnp.abs(d0)), 3 * d0, m)
    return jnp.where(jnp.sign(m) != jnp.sign(d0), 0.0, bounded)


class TwoSided(Law):
    """One law on either side: F = bump(x) for x < 0, rebound(x) for x > 0; its slope at 0 is the mean of the two.

    `bump` (a shortening spring or damper) and `rebound` (a lengthening one): laws or numbers; with numbers, as a damper, the bilinear
    damper.

    >>> damper = TwoSided(bump=800.0, rebound=2400.0)
    >>> float(damper.force(jnp.array(-0.5))), float(damper.force(jnp.array(0.5))), float(damper.slope(jnp.array(0.0)))
    (-400.0, 1200.0, 1600.0)
    """

    bump: Law
    rebound: Law

    def __init__(self, *, bump, rebound):
        problems = Problems()
        self.bump, self.rebound = (_law(law, f"TwoSided.{name}", problems) for name, law in (("bump", bump), ("rebound", rebound)))
        problems.raise_if_any()

    def potential(self, x):
        return self._each(x, lambda law, x: law.potential(x))

    def force(self, x):
        return self._each(x, lambda law, x: law.force(x))

    def beyond(self, x):
        return jnp.where(x < 0, self.bump.beyond(x), self.rebound.beyond(x))

    def _each(self, x, value):
        below, above = value(self.bump, jnp.where(x <= 0, x, 0.0)), value(self.rebound, jnp.where(x >= 0, x, 0.0))
        side = jnp.sign(x)  # 0 at 0, where the derivatives are then those of the mean
        return (1 - side) / 2 * below + (1 + side) / 2 * above


class Digressive(Law):
    """F = c1 x + (c0 - c1) x/sqrt(1 + (x/x0)^2): slope c0 at rest, c1 at large x, the knee at x0.

    `slow` c0 and `fast` c1 [N s/m], `knee` x0 [m/s]. Errors: NEGATIVE, NOT_POSITIVE of the knee.

    >>> float(Digressive(slow=3000.0, fast=0.0, knee=0.3).force(jnp.array(0.4)))
    720.0
    """

    slow: Number
    fast: Number
    knee: Number

    def __init__(self, *, slow, fast, knee):
        problems = Problems()
        self.slow, self.fast, self.knee = (
            scalar(v, f"Digressive.{name}", problems) for name, v in (("slow", slow), ("fast", fast), ("knee", knee))
        )
        not_negative(self.slow, "Digressive.slow", "N s/m", problems)
        not_negative(self.fast, "Digressive.fast", "N s/m", problems)
        positive(self.knee, "Digressive.knee", "m/s", problems)
        problems.raise_if_any()

    def force(self, x):
        return self.fast * x + (self.slow - self.fast) * x / jnp.sqrt(1 + (x / self.knee) ** 2)

    def potential(self, x):
        return 0.5 * self.fast * x**2 + (self.slow - self.fast) * x**2 / (1 + jnp.sqrt(1 + (x / self.knee) ** 2))


class Friction(Law):
    """Dry friction, regularized: F = F0 x/sqrt(x^2 + v0^2), 71 % of F0 at the velocity v0, 99.5 % at 10 v0. It creeps where it should stick.

    `level` F0 [N], `velocity` v0 [m/s]. Errors: NEGATIVE, NOT_POSITIVE of the velocity.

    >>> round(float(Friction(level=50.0, velocity=1e-3).force(jnp.array(0.1))), 2)
    50.0
    """

    level: Number
    velocity: Number

    def __init__(self, *, level, velocity):
        problems = Problems()
        self.level = scalar(level, "Friction.level", problems)
        self.velocity = scalar(velocity, "Friction.velocity", problems)
        not_negative(self.level, "Friction.level", "N", problems)
        positive(self.velocity, "Friction.velocity", "m/s", problems, "Say how fast it slides before the full force is there.")
        problems.raise_if_any()

    def force(self, x):
        return self.level * x / jnp.sqrt(x**2 + self.velocity**2)

    def potential(self, x):
        return self.level * x**2 / (jnp.sqrt(x**2 + self.velocity**2) + self.velocity)


class Stop(Law):
    """A stop that is met after a gap: with the penetration d = -x - gap (an `extension` stop: d = x - gap), w the engagement,

        |F| = 0 for d < 0,   k d^2/(2 w) for 0 < d < w,   k (d - w/2) for d > w

    `stiffness` k [N/m], `gap` [m], `engagement` w [m] over which the stiffness comes in: the force has no kink, and its slope at d = 0 is 0.
    Errors: NEGATIVE of gap or stiffness, NOT_POSITIVE of the engagement.

    >>> round(float(Stop(gap=0.06, stiffness=2e5, engagement=0.01).force(jnp.array(-0.1))))
    -7000
    """

    gap: Number
    stiffness: Number
    engagement: Number
    extension: bool = eqx.field(static=True)

    def __init__(self, *, gap, stiffness, engagement=1e-3, extension: bool = False):
        problems = Problems()
        self.gap, self.stiffness, self.engagement = (
            scalar(v, f"Stop.{name}", problems) for name, v in (("gap", gap), ("stiffness", stiffness), ("engagement", engagement))
        )
        self.extension = bool(extension)
        not_negative(self.gap, "Stop.gap", "m", problems, "A stop that is pressed at x = 0 is preload: change the free length.")
        not_negative(self.stiffness, "Stop.stiffness", "N/m", problems)
        positive(self.engagement, "Stop.engagement", "m", problems, "A hundredth of the travel does little harm.")
        problems.raise_if_any()

    def force(self, x):
        d, side = self._penetration(x)
        return side * self.stiffness * ramp(d, self.engagement)

    def potential(self, x):
        return self.stiffness * ramp_energy(self._penetration(x)[0], self.engagement)

    def _penetration(self, x):
        side = 1.0 if self.extension else -1.0
        return side * x - self.gap, side


def ramp(d: Number, w: Number) -> Number:
    """0 for d < 0, d^2/(2 w) up to w, then d - w/2."""
    return jnp.where(d <= 0, 0.0, jnp.where(d < w, d**2 / (2 * w), d - w / 2))


def ramp_energy(d: Number, w: Number) -> Number:
    """The integral of the ramp."""
    return jnp.where(d <= 0, 0.0, jnp.where(d < w, d**3 / (6 * w), d**2 / 2 - d * w / 2 + w**2 / 6))


def ramp_slope(d: Number, w: Number) -> Number:
    """The derivative of the ramp."""
    return jnp.clip(d / w, 0.0, 1.0)


class TensionOnly(Law):
    """A rope: F = k x for x > 0, nothing for x < 0; its slope at 0 is k/2. `stiffness` k [N/m]. Error: NEGATIVE.

    >>> float(TensionOnly(100.0).force(jnp.array(-0.1))), float(TensionOnly(100.0).force(jnp.array(0.1)))
    (0.0, 10.0)
    """

    stiffness: Number

    def __init__(self, stiffness):
        problems = Problems()
        self.stiffness = scalar(stiffness, "TensionOnly.stiffness", problems)
        not_negative(self.stiffness, "TensionOnly.stiffness", "N/m", problems)
        problems.raise_if_any()

    def force(self, x):
        return 0.5 * self.stiffness * (x + x * jnp.sign(x))  # |x|, with slope 0 at 0

    def potential(self, x):
        return 0.25 * self.stiffness * (x**2 + x**2 * jnp.sign(x))


class AirSpring(Law):
    """A gas in a cylinder, polytropic: F = A (p_a - p0 (1 + x/h)^-n).

    `pressure` p0 [Pa, absolute] and `height` h of the column of gas [m] at x = 0, `area` A [m2], `exponent` n (1 isothermal, 1.4 adiabatic),
    `ambient` p_a. Stiffness at x = 0: n p0 A/h. There is no force for x <= -h: NaN, which results report. Error: NOT_POSITIVE.
    `AirSpring.carrying(load, ...)` is one that bears a load at x = 0.

    >>> spring = AirSpring.carrying(2000.0, area=0.02, height=0.15)
    >>> round(float(spring.force(jnp.array(0.0))), 6), round(float(spring.slope(jnp.array(0.0))))
    (-2000.0, 37581)
    """

    pressure: Number
    area: Number
    height: Number
    exponent: Number
    ambient: Number

    def __init__(self, *, pressure, area, height, exponent=1.4, ambient=ATMOSPHERE):
        problems = Problems()
        given = {"pressure": pressure, "area": area, "height": height, "exponent": exponent, "ambient": ambient}
        for (name, v), unit in zip(given.items(), ("Pa", "m2", "m", "", "Pa"), strict=True):
            setattr(self, name, scalar(v, f"AirSpring.{name}", problems))
            if name == "ambient":
                not_negative(getattr(self, name), "AirSpring.ambient", unit, problems)
            else:
                positive(getattr(self, name), f"AirSpring.{name}", unit, problems)
        problems.raise_if_any()

    @classmethod
    def carrying(cls, load, *, area, height, exponent=1.4, ambient=ATMOSPHERE) -> AirSpring:
        """p0 = p_a + load/A: the spring that pushes with `load` [N] at x = 0."""
        return cls(pressure=ambient + load / area, area=area, height=height, exponent=exponent, ambient=ambient)

    def force(self, x):
        return self.area * (self.ambient - self.pressure * jnp.exp(-self.exponent * jnp.log1p(x / self.height)))

    def potential(self, x):
        """A (p_a x - p0 h (1 - (1 + x/h)^(1-n))/(n - 1)), the logarithm at n = 1."""
        y = jnp.log1p(x / self.height)
        return self.area * (self.ambient * x - self.pressure * self.height * y * _expm1_over((1 - self.exponent) * y))


def _expm1_over(z):
    """(exp(z) - 1)/z, by its series near z = 0."""
    small = jnp.abs(z) < 0.5
    near, far = jnp.where(small, z, 0.0), jnp.where(small, 1.0, z)
    series = jnp.ones_like(near)
    for n in range(18, 1, -1):
        series = 1 + near / n * series
    return jnp.where(small, series, jnp.expm1(far) / far)


class Function(Law):
    """Any JAX function x -> F of the user; one that is made anew is compiled anew (make it a Law with array leaves to avoid that). Its energy
    is a quadrature with twenty nodes, exact where F is smooth.

    >>> round(float(Function(lambda x: jnp.sinh(x)).potential(jnp.array(1.0))), 12)
    0.543080634815
    """

    function: Callable[[Array], Array] = eqx.field(static=True)

    def force(self, x):
        return self.function(x)


class Sum(Law):
    """F = the sum of the forces of its laws: a spring and its bump stop.

    >>> float((Linear(100.0) + Stop(gap=0.1, stiffness=1000.0, engagement=0.01)).force(jnp.array(-0.2)))
    -115.0
    """

    terms: tuple[Law, ...]

    def __init__(self, *terms):
        problems = Problems()
        laws = [_law(term, f"Sum.terms[{i}]", problems) for i, term in enumerate(terms)]
        problems.raise_if_any()
        self.terms = tuple(part for law in laws for part in (law.terms if isinstance(law, Sum) else (law,)))

    def force(self, x):
        return sum((law.force(x) for law in self.terms[1:]), self.terms[0].force(x))

    def potential(self, x):
        return sum((law.potential(x) for law in self.terms[1:]), self.terms[0].potential(x))

    def beyond(self, x):
        return jnp.any(jnp.stack([law.beyond(x) for law in self.terms]), 0)


@jax.custom_jvp
def _integral(law: Law, x: Number) -> Number:
    """U(x) = x/2 sum w_i F(x (1 + t_i)/2), whose derivative in x is F(x) itself and not that of the quadrature."""
    return _quadrature(law, x)


@_integral.defjvp
def _integral_jvp(primals, tangents):
    (law, x), (law_dot, x_dot) = primals, tangents
    U, U_dot = jax.jvp(lambda law: _quadrature(law, x), (law,), (law_dot,))
    return U, U_dot + law.force(x) * x_dot


def _quadrature(law: Law, x: Number) -> Number:
    points = x * (1 + jnp.asarray(NODES, x.dtype)) / 2
    return x / 2 * jnp.sum(jnp.asarray(WEIGHTS, x.dtype) * jax.vmap(law.force)(points))


def potential(law: Law | None, x: Number) -> Number:
    """U(x), 0 without a law."""
    return jnp.zeros_like(x) if law is None else law.potential(x)


def force(law: Law | None, x: Number) -> Number:
    """F(x), 0 without a law."""
    return jnp.zeros_like(x) if law is None else law.force(x)


def slope(law: Law | None, x: Number) -> Number:
    """dF/dx, 0 without a law."""
    return jnp.zeros_like(x) if law is None else law.slope(x)


def beyond(law: Law | None, x: Number) -> Bool[Array, ""]:
    """Whether a law is continued beyond what it is known for."""
    return jnp.zeros(jnp.shape(x), bool) if law is None else law.beyond(x)


def parts(law: Law) -> list[Any]:
    """The laws that a law is made of."""
    return jax.tree.leaves(law, is_leaf=lambda part: isinstance(part, Law) and not isinstance(part, Sum | TwoSided))


def has_range(tree: Any) -> bool:
    """True when a law in the tree is known for a range only."""
    return any(isinstance(leaf, Table) for leaf in jax.tree.leaves(tree, is_leaf=lambda x: isinstance(x, Table)))


# Checks


def _made(kind: type, **fields) -> Any:
    """A law of fields that are known to be good."""
    law = object.__new__(kind)
    for name, value in fields.items():
        object.__setattr__(law, name, value)
    return law


def _law(value: Any, where: str, problems: Problems) -> Law:
    law = as_law(value, where, problems)
    if law is None and not problems.found:
        problems.add("WRONG_KIND", where, "is None", limit="a law or a number", hint="Give 0 for no force.")
    return _made(Linear, coefficient=np.zeros(())) if law is None else law


def _row(value: Any, where: str, problems: Problems, least: int) -> Any:
    """Finite numbers in a row."""
    n = max(np.size(value), 1) if not hasattr(value, "aval") else value.shape[0]
    array = checked(value, ((n,),), where, problems, f"Give a row of at least {least} numbers.")
    return np.zeros(0) if array is None else array


def not_negative(value: Any, where: str, unit: str, problems: Problems, hint: str = "") -> None:
    """Error: NEGATIVE."""
    known = concrete(value)
    if known is not None and (known < 0).any():
        problems.add("NEGATIVE", where, f"is {known.min():g} {unit}".rstrip(), value=float(known.min()), limit=">= 0", hint=hint)


def positive(value: Any, where: str, unit: str, problems: Problems, hint: str = "") -> None:
    """Error: NOT_POSITIVE."""
    known = concrete(value)
    if known is not None and not any(p.where == where for p in problems.found) and (known <= 0).any():
        problems.add("NOT_POSITIVE", where, f"is {known.min():g} {unit}".rstrip(), value=float(known.min()), limit="> 0", hint=hint)


def _check_table(x: Any, forces: Any, problems: Problems) -> None:
    x, F = concrete(x), concrete(forces)
    if problems.found or x is None or F is None:
        return
    if len(x) != len(F):
        problems.add("BAD_SHAPE", "Table.forces", f"has {len(F)} numbers for {len(x)} of x", value=len(F), limit=f"{len(x)}")
        return
    if len(x) < 4:
        problems.add("TABLE_SHORT", "Table.x", f"has {len(x)} points", value=len(x), limit="at least 4", hint="Measure more points.")
    steps, rises = np.diff(x), np.diff(F)
    for code, bad, told, hint in (
        ("TABLE_DUPLICATE", steps == 0, "repeats", "Keep one force for each x, their mean perhaps."),
        ("TABLE_UNSORTED", steps < 0, "goes back", "Sort the points by x."),
    ):
        if bad.any():
            i = int(np.flatnonzero(bad)[0])
            problems.add(
                code, "Table.x", f"{told} at index {i + 1}: {x[i]:g}, then {x[i + 1]:g}", value=i + 1, limit="increasing", hint=hint
            )
    if (steps > 0).all() and (rises < 0).any():
        i = int(np.flatnonzero(rises < 0)[0])
        told = f"falls from {F[i]:g} to {F[i + 1]:g} N between x = {x[i]:g} and {x[i + 1]:g}"
        hint = "Is the sign that of tension? Smooth a noisy record; a law that is meant to fall is a Polynomial or a function."
        problems.add("TABLE_FALLS", "Table.forces", told, value=i + 1, limit="not falling", hint=hint)
