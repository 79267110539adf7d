"""Power spectral densities with their units, correlated inputs, and frequency bands for integrals.

Internally, all densities are one-sided and per hertz: the variance of a signal is
int_0^inf S(f) df. A density per rad/s is multiplied by 2 pi; one per cycle/m is divided by the
speed; a two-sided one is doubled.
"""

from __future__ import annotations

import itertools
import re
from abc import abstractmethod
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxbody.core.arrays import (
    Array,
    Bool,
    Complex,
    Float,
    as_numpy,
    checked,
    device_array,
    is_concrete,
    module_of,
    scalar,
)
from jaxbody.core.errors import JaxbodyError, Problem, Problems, unknown
from jaxbody.core.units import ANGULAR_RATE, RATE, parse
from jaxbody.records.sampling_checks import even_samples

QUANTITIES = ("m", "m/s", "m/s2", "rad", "rad/s", "rad/s2", "N", "N m")
MEASURES = {
    "Hz": RATE,
    "rad/s": ANGULAR_RATE,
    "cycle/m": (-1, 0, 0, 0, 0),
    "rad/m": (-1, 0, 0, 1, 0),
}
DENSITIES = {  # dimension -> quantity, measure of frequency
    tuple(2 * a - b for a, b in zip(parse(quantity, "").dimension, measure, strict=True)): (
        quantity,
        per,
    )
    for quantity in QUANTITIES
    for per, measure in MEASURES.items()
}
CYCLES = re.compile(r"\bcycles?\b")
LAST = re.compile(r".*[^/]/\s*(\([^()]*\)|[^/()\s*.]+)\s*")  # the last divisor of a unit
ROUNDING = 1e-9  # round-off of the smallest eigenvalue of a matrix of coherences
LOWEST = -700.0  # used for the logarithm of zero


class Spectrum(eqx.Module):
    """The base class of power spectral densities: `spectrum(f)` at frequencies f [Hz] is one-sided,
    per hertz, of a signal in `quantity`.

    >>> jb.vibration.PowerLaw(2.0, unit="(m/s)2/Hz")(jnp.array([1.0, 3.0])).tolist()
    [2.0, 2.0]
    """

    quantity: eqx.AbstractVar[str]

    @abstractmethod
    def __call__(self, f: Float[Array, "nf"]) -> Float[Array, "nf"]:
        """Return the density at frequencies f [Hz]."""


class Density(Spectrum):
    """The base class of densities stated in a unit, over time or, at a speed, over distance."""

    speed: Float[Array, ""]
    quantity: str = eqx.field(static=True)
    # from the unit to the square of the quantity in SI units
    factor: float = eqx.field(static=True)
    per: str = eqx.field(static=True)
    sides: int = eqx.field(static=True)

    def stated(self, unit: Any, sides: Any, speed: Any, problems: Problems) -> None:
        """Check and set unit, sides and speed."""
        kind = type(self).__name__
        self.quantity, self.per, self.factor = _unit(unit, f"{kind}.unit", problems)
        if sides not in (1, 2):
            problems.add(
                "BAD_SIDES",
                f"{kind}.sides",
                f"is {sides!r}",
                value=sides,
                limit="1 or 2",
                hint="Give 2 for a two-sided density.",
            )
        if self.per.endswith("/m") != (speed is not None):
            problems.add(
                "NO_SPEED",
                f"{kind}.speed",
                "is missing" if speed is None else "is given, but the spectrum is over time",
                value=speed,
                limit="for cycle/m and rad/m only",
                hint="Give the speed in m/s.",
            )
        self.sides = sides
        self.speed = scalar(1.0 if speed is None else speed, f"{kind}.speed", problems)
        if is_concrete(self.speed) and self.speed <= 0:
            problems.add(
                "NO_SPEED",
                f"{kind}.speed",
                f"is {self.speed:g} m/s",
                value=float(self.speed),
                limit="> 0",
                hint="Give the speed in m/s.",
            )

    @abstractmethod
    def at(self, x: Float[Array, "nf"]) -> Float[Array, "nf"]:
        """Return the density in the unit in which it is stated, at frequencies x in the measure of
        frequency of that unit: Hz, rad/s, cycle/m or rad/m."""

    def __call__(self, f):
        rate = (2 * jnp.pi if self.per.startswith("rad") else 1.0) / (
            self.speed if self.per.endswith("/m") else 1.0
        )
        return self.factor * self.sides * rate * self.at(f * rate)


class PowerLaw(Density):
    """A power spectral density S(x) = level (x/reference)^-exponent, with the frequency x as in the
    unit (Hz, rad/s, cycle/m or rad/m): exponent 0 is white noise, 2 a road.

    Args:
        level: S at the reference frequency [unit]
        unit: such as "m2/Hz", "(m/s2)^2/Hz", "m2/s4/Hz", "g2/Hz", "m2/(rad/s)", "m3" or
            "m2/(cycle/m)": the square of a length, angle, force or moment, of their rates or
            accelerations, per Hz, rad/s, cycle/m or rad/m
        exponent: exponent; default 0, a constant density
        reference: frequency x at which S is `level`; default 1
        sides: 1 (default), or 2 where half of the power is at negative frequencies
        speed: speed of travel [m/s], for a spectrum over distance only

    Errors: BAD_UNIT, NO_SPEED, BAD_SIDES, NEGATIVE, BAD_FREQUENCY for a reference of 0 or less,
    BAD_SHAPE, NON_FINITE.

    >>> road = jb.vibration.PowerLaw(
    ...     64e-6, exponent=2.0, reference=0.1, unit="m2/(cycle/m)", speed=20.0
    ... )
    >>> round(float(road(jnp.array([2.0]))[0]) * 1e6, 9)
    3.2
    """

    level: Float[Array, ""]
    exponent: Float[Array, ""]
    reference: Float[Array, ""]

    def __init__(
        self, level, *, unit: str, exponent: Any = 0.0, reference=1.0, sides: int = 1, speed=None
    ):
        with Problems() as problems:
            self.stated(unit, sides, speed, problems)
            self.level = scalar(level, "PowerLaw.level", problems)
            self.exponent = scalar(exponent, "PowerLaw.exponent", problems)
            self.reference = scalar(reference, "PowerLaw.reference", problems)
            check_not_negative(self.level, "PowerLaw.level", problems)
            if is_concrete(self.reference) and self.reference <= 0:
                problems.add(
                    "BAD_FREQUENCY",
                    "PowerLaw.reference",
                    f"is {self.reference:g}",
                    value=float(self.reference),
                    limit="> 0",
                    hint="Give the frequency at which the density is `level`.",
                )

    def at(self, x):
        return self.level * (x / self.reference) ** -self.exponent


class PSD(Density):
    """A power spectral density through points, interpolated linearly in log-log scale, as in test
    specifications; zero outside the points.

    `PSD.from_record` estimates one from a record.

    Args:
        frequencies: increasing frequencies in the measure of the unit (Hz, rad/s, cycle/m or rad/m)
        values: densities at these [unit]
        unit: see PowerLaw
        sides: 1 (default), or 2 where half of the power is at negative frequencies
        speed: speed of travel [m/s], for a spectrum over distance only

    Errors: BAD_UNIT, NO_SPEED, BAD_SIDES, BAD_FREQUENCY, NEGATIVE, BAD_SHAPE, NON_FINITE.

    >>> psd = jb.vibration.PSD([10.0, 100.0], [0.01, 0.1], unit="g2/Hz")
    >>> round(float(psd(jnp.array([31.6227766]))[0]) / 9.80665**2, 9)
    0.031622777
    """

    frequencies: Float[Array, "n"]
    values: Float[Array, "n"]

    def __init__(self, frequencies, values, *, unit: str, sides: int = 1, speed=None):
        with Problems() as problems:
            self.stated(unit, sides, speed, problems)
            count = max(2, np.size(frequencies))
            x = checked(
                frequencies, ((count,),), "PSD.frequencies", problems, "Give two points or more."
            )
            y = checked(
                values, ((count,),), "PSD.values", problems, "One value for each frequency."
            )
            if x is not None and is_concrete(x) and (np.diff(x, prepend=0.0) <= 0).any():
                problems.add(
                    "BAD_FREQUENCY",
                    "PSD.frequencies",
                    f"is {x}",
                    value=x,
                    limit="positive, increasing",
                    hint="Leave 0 out.",
                )
            if y is not None:
                check_not_negative(y, "PSD.values", problems)
        self.frequencies, self.values = device_array(x), device_array(y)

    @classmethod
    def from_record(cls, times, values, *, unit: str, segment: int = 1024) -> PSD:
        """Estimate a density from a record by Welch's method, with scipy.signal.welch: Hann windows
        of `segment` samples that overlap by half.

        Args:
            times: evenly spaced times [s].
            values: the record [unit].
            unit: unit of the record: m, m/s, m/s2, g, rad, ...
            segment: samples in a window.

        Errors: BAD_UNIT, BAD_SHAPE, NOT_UNIFORM, NON_FINITE."""
        from scipy.signal import welch

        with Problems() as problems:
            y, step = even_samples(
                times, values, ("PSD.from_record times", "PSD.from_record values"), problems
            )
        f, S = welch(np.asarray(y), 1 / float(step), nperseg=min(segment, len(y)))
        return cls(f[1:], S[1:], unit=f"({unit})2/Hz")

    def at(self, x):
        positive = self.values > 0
        logarithms = jnp.where(positive, jnp.log(jnp.where(positive, self.values, 1.0)), LOWEST)
        interpolated = jnp.exp(jnp.interp(jnp.log(x), jnp.log(self.frequencies), logarithms))
        margin = 1e-12 * x
        known = (x >= self.frequencies[0] - margin) & (x <= self.frequencies[-1] + margin)
        return jnp.where(known, interpolated, 0.0)


class CrossPSD(eqx.Module):
    """Spectral densities of correlated inputs, S_ij = coherence_ij sqrt(S_i S_j) exp(-i 2 pi f
    (d_i - d_j)), by the names of the inputs.

    Args:
        spectra: {input: Spectrum}
        delays: {input: d [s]}, such as that of a rear wheel behind a front wheel; default 0
        coherence: {(input, input): a number from 0 to 1, or a function of the frequencies [Hz]},
            the ratio |S_ij|/sqrt(S_i S_j), which is the square root of the usual coherence
            estimate; other pairs are not correlated

    The matrix S must be positive semidefinite. Errors: UNKNOWN_NAME, WRONG_KIND, BAD_PAIR for an
    input with itself or a pair given twice, NOT_POSITIVE, BAD_SHAPE, NON_FINITE.

    >>> road = jb.vibration.PowerLaw(1e-6, unit="m2/Hz", exponent=2.0)
    >>> axles = jb.vibration.CrossPSD(
    ...     {"front": road, "rear": road},
    ...     delays={"rear": 0.125},
    ...     coherence={("front", "rear"): 1.0},
    ... )
    >>> correlation = axles.correlation(jnp.array([2.0]))[:, :, 0]
    >>> [round(float(abs(x)), 9) for x in correlation[0]], round(float(correlation[1, 0].imag), 9)
    ([1.0, 1.0], -1.0)
    """

    spectra: dict[str, Spectrum]
    delays: dict[str, Array]
    levels: tuple[Array, ...]
    # indices of two inputs, and their coherence: a function, or the index in `levels`
    pairs: tuple[tuple[int, int, Any], ...] = eqx.field(static=True)
    names: tuple[str, ...] = eqx.field(static=True)

    def __init__(
        self,
        spectra: dict[str, Spectrum],
        *,
        delays: dict[str, Any] | None = None,
        coherence: dict[Any, Any] | None = None,
    ):
        with Problems() as problems:
            self.names = tuple(spectra)
            self.spectra = check_spectra(spectra, "CrossPSD.spectra", problems)
            given, of_pairs = delays or {}, coherence or {}
            problems.collected += [
                unknown(name, "CrossPSD", self.names)
                for name in {*given, *itertools.chain(*of_pairs)} - {*self.names}
            ]
            self.delays = {
                name: device_array(
                    scalar(given.get(name, 0.0), f"CrossPSD.delays[{name!r}]", problems)
                )
                for name in self.names
            }
        levels, pairs, seen = [], [], set()
        for (one, other), value in of_pairs.items():
            where = f"CrossPSD.coherence[{(one, other)}]"
            if one == other or (other, one) in seen:
                problems.add(
                    "BAD_PAIR",
                    where,
                    "is of an input with itself, which is 1"
                    if one == other
                    else "is given in both orders",
                    value=(one, other),
                    limit="two inputs, each pair once",
                    hint="Leave it out.",
                )
            seen.add((one, other))
            index = value if callable(value) else len(levels)
            if not callable(value):
                levels.append(device_array(scalar(value, where, problems)))
            pairs.append((self.names.index(one), self.names.index(other), index))
        self.levels, self.pairs = tuple(levels), tuple(pairs)
        problems.raise_if_any()
        if self._is_constant and is_concrete(levels):
            smallest = np.linalg.eigvalsh(np.asarray(self._coherences(jnp.ones(1)))[:, :, 0]).min()
            if smallest < -ROUNDING:
                raise JaxbodyError(
                    Problem(
                        "NOT_POSITIVE",
                        "CrossPSD.coherence",
                        f"give a matrix with eigenvalue {smallest:.3g}",
                        float(smallest),
                        ">= 0",
                        "If one input has coherence 1 with two others, these two are coherent too.",
                    )
                )

    @property
    def _is_constant(self) -> bool:
        """Whether no coherence is a function of frequency."""
        return all(isinstance(index, int) for *_, index in self.pairs)

    def _coherences(self, f: Float[Array, "nf"]) -> Float[Array, "nu nu nf"]:
        rows = [
            [jnp.full(f.shape, float(i == j)) for j in range(len(self.names))]
            for i in range(len(self.names))
        ]
        for i, j, index in self.pairs:
            value = self.levels[index] if isinstance(index, int) else index(f)
            rows[i][j] = rows[j][i] = jnp.broadcast_to(value, f.shape)
        return jnp.stack([jnp.stack(row) for row in rows])

    def correlation(self, f: Float[Array, "nf"]) -> Complex[Array, "nu nu nf"]:
        """Return S_ij/sqrt(S_i S_j) at frequencies f [Hz]."""
        d = jnp.stack([self.delays[name] for name in self.names])
        phase = -2 * jnp.pi * f[None, None] * (d[:, None] - d[None])[:, :, None]
        turned = jnp.exp(jax.lax.complex(jnp.zeros_like(phase), phase))
        return self._coherences(f).astype(turned.dtype) * turned

    def positive(self, f: Float[Array, "nf"]) -> Bool[Array, ""]:
        """Return whether the matrix is positive semidefinite at all frequencies."""
        if self._is_constant:
            f = f[:1]
        return jnp.linalg.eigvalsh(jnp.moveaxis(self._coherences(f), -1, 0)).min() >= -ROUNDING


class Band(eqx.Module):
    """A band from `low` to `high` [Hz], with `points` at equal steps of the logarithm and weights
    for integrals, whose error for a smooth function decreases with the fourth power of the step;
    where a density jumps, the error is up to half a step times the jump: divide the band there.
    Errors: EMPTY_BAND, BAD_FREQUENCY, BAD_SHAPE, NON_FINITE.

    >>> band = jb.vibration.Band(1.0, 100.0)
    >>> round(float(jnp.sum(band.weights / band.frequencies**2)), 9)
    0.99
    """

    frequencies: Float[Array, "n"]
    weights: Float[Array, "n"]
    coarse: Float[Array, "n"]  # weights of every other point, zero between them

    def __init__(self, low, high, *, points: int = 1001):
        with Problems() as problems:
            low, high = scalar(low, "Band.low", problems), scalar(high, "Band.high", problems)
            if is_concrete(low, high) and not problems.collected:
                if low <= 0:
                    problems.add(
                        "BAD_FREQUENCY",
                        "Band.low",
                        f"is {low:g} Hz",
                        value=float(low),
                        limit="> 0",
                        hint="Take a small one.",
                    )
                elif low >= high:
                    problems.add(
                        "EMPTY_BAND",
                        "Band",
                        f"goes from {low:g} to {high:g} Hz",
                        value=(float(low), float(high)),
                        limit="low < high",
                        hint="Give the lower end first.",
                    )
            if points < 17:
                problems.add(
                    "EMPTY_BAND",
                    "Band.points",
                    f"is {points}",
                    value=points,
                    limit=">= 17",
                    hint="Give more points.",
                )
        n, low, high = points | 1, as_numpy(low), as_numpy(high)
        xp = module_of(low, high)
        step = xp.log(high / low) / (n - 1)
        frequencies = low * xp.exp(step * np.arange(n, dtype=float))
        ends = np.array([3 / 8, 7 / 6, 23 / 24])  # Gregory's rule of the third order

        def weights(count):
            w = np.ones(count)
            w[:3], w[-3:] = ends, ends[::-1]
            return w

        skipping = np.zeros(n)
        skipping[::2] = 2 * weights(n // 2 + 1)
        self.frequencies = device_array(frequencies)
        self.weights, self.coarse = (
            device_array(step * frequencies * w) for w in (weights(n), skipping)
        )


def trapezoids(f: Float[Array, "n"]) -> tuple[Float[Array, "n"], Float[Array, "n"]]:
    """Return the weights of the trapezoidal rule, and those of the rule with every other point and
    the last."""
    kept = np.append(np.arange(0, len(f) - 1, 2), len(f) - 1)

    def weights(f):
        half = jnp.diff(f) / 2
        return jnp.pad(half, (0, 1)) + jnp.pad(half, (1, 0))

    return weights(f), jnp.zeros_like(f).at[kept].set(weights(f[kept]))


def check_spectra(given: Any, where: str, problems: Problems) -> dict[str, Spectrum]:
    """Return the spectra of a dict; problems are added for other values."""
    for name, spectrum in given.items():
        if not isinstance(spectrum, Spectrum):
            problems.add(
                "WRONG_KIND",
                f"{where}[{name!r}]",
                f"is a {type(spectrum).__name__}",
                value=spectrum,
                limit="Spectrum",
                hint="Give a PSD, a PowerLaw or a Spectrum of your own, which have units.",
            )
    return {name: spectrum for name, spectrum in given.items() if isinstance(spectrum, Spectrum)}


def _unit(unit: Any, where: str, problems: Problems) -> tuple[str, str, float]:
    """Return the quantity, the measure of frequency, and the factor from this unit to the squared
    quantity in SI units per unit of that measure."""
    try:
        text = CYCLES.sub("1", str(unit))
        whole, last = parse(text, where), LAST.fullmatch(text)
        measure = whole if last is None else parse(last[1], where)
        if (
            whole.dimension in DENSITIES
            and (measure if measure.dimension in MEASURES.values() else whole).factor == 1
        ):
            return *DENSITIES[whole.dimension], whole.factor
        limit = f"the square of {', '.join(QUANTITIES)} over {', '.join(MEASURES)}"
        hint = (
            'Such as "(m/s2)2/Hz", "m2/s4/Hz", "g2/Hz" or "m2/(cycle/m)"; square a density '
            "per square root of Hz."
        )
    except JaxbodyError as error:
        limit, hint = error.limit, error.hint
    problems.add("BAD_UNIT", where, f"is {unit!r}", value=unit, limit=limit, hint=hint)
    return "", "Hz", 1.0


def check_not_negative(value: Any, where: str, problems: Problems) -> None:
    """Check that densities are not negative, if they are not traced. Problem: NEGATIVE."""
    if is_concrete(value) and (value < 0).any():
        problems.add(
            "NEGATIVE",
            where,
            f"is {value.min():g}",
            value=float(value.min()),
            limit=">= 0",
            hint="A density is not negative.",
        )
