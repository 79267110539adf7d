"""Response spectra, the largest response of oscillators to a base acceleration as a function of
their frequency and damping ratio: the base class, and design spectra of earthquakes, given by
points or by the parameters of Eurocode 8 or ASCE 7."""

from abc import abstractmethod
from typing import Any

import jax.numpy as jnp
import numpy as np
from equinox import Module, field

from jaxbody.core import tables
from jaxbody.core.arguments import check_one_of, positive_number
from jaxbody.core.arrays import Array, Float, checked, device_array, float_array, is_concrete
from jaxbody.core.errors import Problems
from jaxbody.core.units import GRAVITY

ROUNDING = 1e-9  # relative, of frequencies at the ends of a spectrum's range


class ResponseSpectrum(tables.Printed, Module):
    """The base class of response spectra: `spectrum(frequencies, damping)` is the
    pseudo-acceleration w^2 max|x| [m/s2] at frequencies [Hz] and damping ratios, of oscillators x''
    + 2 zeta w x' + w^2 x = -a. A subclass defines `__call__` and `covers`.

    >>> class Plateau(jb.shock.ResponseSpectrum):
    ...     level: float
    ...     def __call__(self, frequencies, damping=0.05):
    ...         return self.level * jnp.sqrt(0.05 / damping) * jnp.ones(jnp.shape(frequencies))
    ...     def covers(self):
    ...         return 0.5, 20.0
    >>> print(Plateau(3.0))
    Plateau
               value
      lowest     0.5  Hz
      highest     20  Hz
    <BLANKLINE>
    """

    def _tables(self) -> list[tables.PrintedTable]:
        low, high = map(float, self.covers())
        ends = [("lowest", low, "Hz"), ("highest", high, "Hz")]
        return [tables.PrintedTable(type(self).__name__, ("", "value", ""), ends)]

    @abstractmethod
    def __call__(self, frequencies: Any, damping: Any = 0.05) -> Float[Array, "*n"]:
        """Return the pseudo-acceleration [m/s2] at frequencies [Hz] and damping ratios."""

    @abstractmethod
    def covers(self) -> tuple[Any, Any]:
        """Return the lowest and the highest frequency [Hz] at which the spectrum is known; above
        the highest its value is that of a rigid body."""

    def dampings(self) -> tuple[Any, Any]:
        """Return the smallest and the largest damping ratio for which the spectrum is known."""
        return 0.0, 1.0

    def rigid(self) -> Float[Array, ""]:
        """Return the acceleration of a rigid body [m/s2], which is the peak of the base
        acceleration: the value at the highest frequency."""
        return self(self.covers()[1], self.dampings()[0])


def check_dampings(given: Any, where: str, problems: Problems, modes: int | None = None) -> Any:
    """Check one damping ratio or a row of them, with `modes` one for each mode, and return the
    array, None if it is not one. Problems: NOT_A_FRACTION for ratios that are not from 0 to below
    1, BAD_SHAPE."""
    array = problems.gather(lambda: float_array(given, where))
    if array is not None:
        array = checked(
            array,
            ((), (max(array.size, 1) if modes is None else modes,)),
            where,
            problems,
            "Give one damping ratio, or several in one row."
            if modes is None
            else f"Give one for all modes or one for each of {modes}.",
        )
    if array is not None and is_concrete(array) and (wrong := (array < 0) | (array >= 1)).any():
        value = float(np.ravel(array)[np.flatnonzero(wrong)[0]])
        problems.add(
            "NOT_A_FRACTION",
            where,
            f"is {value:g}",
            value=value,
            limit="0 to below 1",
            hint=f"Give {value / 100:g} for {value:g} percent."
            if 1 <= value < 100
            else "It is a fraction of the critical damping.",
        )
    return array


def log_interpolated(
    x: Float[Array, "*n"], at: Float[Array, "k"], values: Float[Array, "k"]
) -> Float[Array, "*n"]:
    """Interpolate linearly between logarithms of `at` and `values`; constant outside, exact at the
    points."""
    tiny = jnp.finfo(values.dtype).tiny
    return jnp.exp(jnp.interp(jnp.log(x), jnp.log(at), jnp.log(jnp.maximum(values, tiny))))


def as_rows(given: Any) -> Float[Array, "*n"]:
    """Return frequencies [Hz], or damping ratios, as a JAX array of the current precision."""
    return device_array(float_array(given, "frequencies"))


RIGID = 1e4  # Hz, the highest frequency of formulas that hold up to a rigid body
SOIL = {  # S, T_B, T_C, T_D of EN 1998-1:2004, tables 3.2 and 3.3, by type and ground
    1: {
        "A": (1.0, 0.15, 0.4, 2.0),
        "B": (1.2, 0.15, 0.5, 2.0),
        "C": (1.15, 0.2, 0.6, 2.0),
        "D": (1.35, 0.2, 0.8, 2.0),
        "E": (1.4, 0.15, 0.5, 2.0),
    },
    2: {
        "A": (1.0, 0.05, 0.25, 1.2),
        "B": (1.35, 0.05, 0.25, 1.2),
        "C": (1.5, 0.1, 0.25, 1.2),
        "D": (1.8, 0.1, 0.3, 1.2),
        "E": (1.6, 0.05, 0.25, 1.2),
    },
}
# a_vg/a_g, T_B, T_C, T_D, table 3.4
VERTICAL = {1: (0.9, 0.05, 0.15, 1.0), 2: (0.45, 0.05, 0.15, 1.0)}
LONGEST = 4.0  # s, the longest period of EN 1998-1, 3.2.2.2
# ASCE 7-16, table 17.5-1: B by damping
DAMPING_FACTORS = ((0.02, 0.05, 0.1, 0.2, 0.3, 0.4, 0.5), (0.8, 1.0, 1.2, 1.5, 1.7, 1.9, 2.0))


class DesignSpectrum(ResponseSpectrum):
    """A response spectrum of pseudo-acceleration through points, interpolated linearly between
    logarithms of frequency and value.

    Args:
        frequencies: increasing frequencies [Hz]
        values: pseudo-accelerations at these [m/s2]
        damping: the damping ratio of the spectrum

    Errors: BAD_FREQUENCY, NOT_POSITIVE, NOT_A_FRACTION, BAD_SHAPE, NON_FINITE.

    >>> spectrum = jb.shock.DesignSpectrum([1.0, 4.0], [2.0, 8.0])
    >>> round(float(spectrum(2.0)), 9)
    4.0
    """

    frequencies: Float[Array, "n"]
    values: Float[Array, "n"]
    damping: Float[Array, ""]

    def __init__(self, frequencies, values, *, damping=0.05):
        with Problems() as problems:
            n = max(2, np.size(frequencies))
            f = checked(
                frequencies,
                ((n,),),
                "DesignSpectrum.frequencies",
                problems,
                "Give two points or more.",
            )
            y = checked(
                values, ((n,),), "DesignSpectrum.values", problems, "One value for each frequency."
            )
            zeta = check_dampings(damping, "DesignSpectrum.damping", problems)
            if f is not None and is_concrete(f) and (np.diff(f, prepend=0.0) <= 0).any():
                problems.add(
                    "BAD_FREQUENCY",
                    "DesignSpectrum.frequencies",
                    f"is {f}",
                    value=f,
                    limit="positive, increasing",
                )
            if y is not None and is_concrete(y) and (y <= 0).any():
                problems.add(
                    "NOT_POSITIVE",
                    "DesignSpectrum.values",
                    f"has {y.min():g}",
                    value=y,
                    limit="> 0",
                )
        self.frequencies, self.values, self.damping = map(device_array, (f, y, zeta))

    def covers(self):
        return self.frequencies[0], self.frequencies[-1]

    def dampings(self):
        return self.damping, self.damping

    def __call__(self, frequencies, damping=None):
        """Return the pseudo-acceleration [m/s2] at frequencies [Hz], constant beyond the points. It
        is always that of the stated damping ratio; `damping` is ignored."""
        return log_interpolated(as_rows(frequencies), self.frequencies, self.values)

    def _tables(self):
        return [
            tables.PrintedTable(
                f"Design spectrum, damping ratio {tables.number(self.damping)}",
                ("frequency [Hz]", "pseudo-acceleration [m/s2]"),
                [*zip(self.frequencies, self.values, strict=True)],
            )
        ]


class Eurocode8(ResponseSpectrum):
    """The elastic response spectrum of Eurocode 8, with eta = max(sqrt(10/(5 + 100 zeta)), 0.55)
    and T = 1/frequency:

        a_g S (1 + T/T_B (2.5 eta - 1))    T <= T_B
        a_g S 2.5 eta                      T_B <= T <= T_C
        a_g S 2.5 eta T_C/T                T_C <= T <= T_D
        a_g S 2.5 eta T_C T_D/T^2          T_D <= T <= 4 s

    and vertically with 3 in place of 2.5, S = 1, and a_vg in place of a_g.

    Args:
        acceleration: a_g, the design ground acceleration on ground A, importance factor
            included [m/s2]
        ground: ground type, "A" (default) to "E"
        type: 1 (default), or 2 where earthquakes have a magnitude of 5.5 at most
        vertical: True for the vertical spectrum

    Errors: BAD_OPTION, BAD_NUMBER. Source: EN 1998-1:2004, 3.2.2.2 and 3.2.2.3; national annexes
    may have other numbers.

    >>> spectrum = jb.shock.Eurocode8(2.0, ground="B")
    >>> [round(float(x), 9) for x in (spectrum(3.0), spectrum(1.0), spectrum.rigid())]
    [6.0, 3.0, 2.4]
    """

    acceleration: Float[Array, ""]
    ground: str = field(static=True)
    type: int = field(static=True)
    vertical: bool = field(static=True)

    def __init__(self, acceleration, ground="A", *, type=1, vertical=False):
        with Problems() as problems:
            level = positive_number(acceleration, "Eurocode8.acceleration", problems)
            check_one_of(ground, SOIL[1], "BAD_OPTION", "Eurocode8.ground", problems)
            if type not in SOIL:
                problems.add(
                    "BAD_OPTION", "Eurocode8.type", f"is {type!r}", value=type, limit="1 or 2"
                )
        self.acceleration, self.ground = device_array(level), ground
        self.type, self.vertical = int(type), bool(vertical)

    @property
    def parameters(self) -> tuple[float, float, float, float]:
        """S, or a_vg/a_g of a vertical spectrum, and T_B, T_C and T_D [s]."""
        return VERTICAL[self.type] if self.vertical else SOIL[self.type][self.ground]

    def covers(self):
        return 1 / LONGEST, RIGID

    def rigid(self):
        """Return the peak ground acceleration a_g S [m/s2]."""
        return self.acceleration * self.parameters[0]

    def __call__(self, frequencies, damping=0.05):
        _, TB, TC, TD = self.parameters
        T, zeta = jnp.broadcast_arrays(1 / as_rows(frequencies), as_rows(damping))
        top = (3.0 if self.vertical else 2.5) * jnp.maximum(jnp.sqrt(10 / (5 + 100 * zeta)), 0.55)
        falls = jnp.where(T <= TC, top, jnp.where(T <= TD, top * TC / T, top * TC * TD / T**2))
        return self.rigid() * jnp.where(T <= TB, 1 + T / TB * (top - 1), falls)

    def _tables(self):
        factor, TB, TC, TD = self.parameters
        title = f"Eurocode 8, type {self.type}, ground {self.ground}"
        rows = [
            ("a_g [m/s2]", self.acceleration),
            ("a_vg/a_g" if self.vertical else "S", factor),
            ("T_B [s]", TB),
            ("T_C [s]", TC),
            ("T_D [s]", TD),
        ]
        return [tables.PrintedTable(title + ", vertical" * self.vertical, ("", ""), rows)]


class ASCE7(ResponseSpectrum):
    """The design response spectrum of ASCE 7, with T = 1/frequency, T_0 = 0.2 S_D1/S_DS,
    T_S = S_D1/S_DS and a factor B that depends on the damping ratio:

        S_DS (0.4 + 0.6 T/T_0)    T < T_0
        S_DS                      T_0 <= T <= T_S
        S_D1/T                    T_S < T <= T_L
        S_D1 T_L/T^2              T > T_L

    Here S_DS and S_D1 are divided by B, except in the value at T = 0, which is that for 5 %.

    Args:
        short: S_DS, acceleration at short periods [g]
        one_second: S_D1, acceleration at 1 s [g]
        long_period: T_L [s]

    Errors: BAD_NUMBER. Source: ASCE 7-16, 11.4.6; B by its table 17.5-1, interpolated linearly
    between its rows.

    >>> spectrum = jb.shock.ASCE7(short=1.0, one_second=0.6)
    >>> [round(float(x) / 9.80665, 9) for x in (spectrum(4.0), spectrum(0.5), spectrum.rigid())]
    [1.0, 0.3, 0.4]
    """

    short: Float[Array, ""]
    one_second: Float[Array, ""]
    long_period: Float[Array, ""]

    def __init__(self, short, one_second, *, long_period=8.0):
        with Problems() as problems:
            given = {"short": short, "one_second": one_second, "long_period": long_period}
            numbers = [
                positive_number(value, f"ASCE7.{name}", problems) for name, value in given.items()
            ]
        self.short, self.one_second, self.long_period = map(device_array, numbers)

    def covers(self):
        return 1 / (10 * self.long_period), RIGID

    def dampings(self):
        return DAMPING_FACTORS[0][0], 1.0

    def rigid(self):
        """Return 0.4 S_DS [m/s2]."""
        return 0.4 * self.short * GRAVITY

    def __call__(self, frequencies, damping=0.05):
        T, zeta = jnp.broadcast_arrays(1 / as_rows(frequencies), as_rows(damping))
        B = jnp.interp(zeta, *map(jnp.asarray, DAMPING_FACTORS))
        TS = self.one_second / self.short
        top, rise = self.short / B, T / (0.2 * TS)
        falls = jnp.where(T <= TS, top, top * TS / T * jnp.minimum(1.0, self.long_period / T))
        return GRAVITY * jnp.where(
            rise < 1, 0.4 * self.short + (top - 0.4 * self.short) * rise, falls
        )

    def _tables(self):
        return [
            tables.PrintedTable(
                "ASCE 7",
                ("", ""),
                [
                    ("S_DS [g]", self.short),
                    ("S_D1 [g]", self.one_second),
                    ("T_L [s]", self.long_period),
                ],
            )
        ]
