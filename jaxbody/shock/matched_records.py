"""Records with a given response spectrum: sums of cosines under an envelope, with amplitudes and
phases fitted by exact derivatives.

    a(t) = P envelope(t) sum_k exp(b_k) cos(2 pi f_k t + p_k)

P is a linear projection, after which velocity and displacement are zero at the end. The residuals
are log(reached/target); since they are fewer than the unknowns, each Levenberg-Marquardt step is
the smallest change of b and p that removes their linear part.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxbody.core import tables
from jaxbody.core.arguments import check_key, check_kind, positive_number
from jaxbody.core.arrays import Array, Float, Int, device_array
from jaxbody.core.errors import Problems, Status
from jaxbody.core.progress_lines import working
from jaxbody.core.results import Labeled, Result, dataset, warn_if_failed
from jaxbody.model.inputs.motions import Sampled
from jaxbody.model.inputs.samples import integrals
from jaxbody.records.records import Record
from jaxbody.shock.oscillators import influences, poles
from jaxbody.shock.response_spectra import ResponseSpectrum, check_dampings
from jaxbody.shock.shock_spectra import weights_of
from jaxbody.vibration.frequency_responses import check_frequencies

LINES = 3  # cosines for each frequency of the spectrum
# default frequencies: their number, the highest [Hz], and periods of the lowest in the record
TARGETS, HIGHEST, PERIODS = 80, 33.0, 4.0
SAMPLES = 8  # in a period of the highest frequency
RISE, FALL = 0.15, 0.55  # of the duration, where the envelope reaches 1 and begins to fall
PARTS = 4  # points in a step among which the peaks are looked for
STEPS = 60


class MatchedRecord(Labeled, Result):
    """A record whose response spectrum matches a target. `acceleration` [m/s2], `velocity` [m/s]
    and `displacement` [m] over `times` [s], at rest in the same place at both ends; the spectrum
    `reached` at `frequencies` [Hz] and its `target` [m/s2], for the damping ratio `damping`.
    `deviation` is the largest of |reached/target - 1|; `status` NOT_CONVERGED where it exceeds the
    tolerance."""

    index = "time"
    times: Float[Array, "n"]
    acceleration: Float[Array, "n"]
    velocity: Float[Array, "n"]
    displacement: Float[Array, "n"]
    frequencies: Float[Array, "nf"]
    target: Float[Array, "nf"]
    reached: Float[Array, "nf"]
    damping: Float[Array, ""]
    status: Int[Array, ""]

    @property
    def deviation(self) -> Any:
        """The largest of |reached/target - 1|."""
        return np.max(np.abs(np.asarray(self.reached) / np.asarray(self.target) - 1))

    @property
    def samples(self) -> tuple[Array, Array]:
        """Times [s] and accelerations [m/s2], as arguments of `shock_spectrum` and
        `spectrum_response`."""
        return self.times, self.acceleration

    def record(self) -> Record:
        """Return the acceleration as a record."""
        return Record(self.times, {"acceleration": (self.acceleration, "m/s2")})

    def motion(self, direction: Any) -> Sampled:
        """Return the motion of a support with this acceleration along `direction`, a vector in
        world axes."""
        along = np.asarray(direction, float)
        return Sampled.from_accelerations(
            self.times, translation=np.outer(self.acceleration, along / np.linalg.norm(along))
        )

    def explain(self) -> str:
        return (
            f"it deviates by {tables.percent(self.deviation)}; give a longer duration, "
            "or fewer frequencies"
        )

    def to_xarray(self) -> Any:
        """Return an xarray.Dataset: the motion by time, both spectra by frequency."""
        return dataset(
            {
                "acceleration": (("time",), self.acceleration, "m/s2"),
                "velocity": (("time",), self.velocity, "m/s"),
                "displacement": (("time",), self.displacement, "m"),
                "target": (("frequency",), self.target, "m/s2"),
                "reached": (("frequency",), self.reached, "m/s2"),
                "status": ((), self.status, ""),
            },
            {
                "time": ("time", np.asarray(self.times), {"units": "s"}),
                "frequency": ("frequency", np.asarray(self.frequencies), {"units": "Hz"}),
            },
            "matched record",
        )

    def _tables(self) -> list[tables.PrintedTable]:
        f = np.asarray(self.frequencies)
        title = (
            f"Record of {float(self.times[-1]):.4g} s for a spectrum from "
            f"{f[0]:.4g} to {f[-1]:.4g} Hz"
        )
        mean = float(np.mean(np.abs(np.asarray(self.reached) / np.asarray(self.target) - 1)))
        rows = [
            ("peak acceleration", float(np.abs(self.acceleration).max()), "m/s2"),
            ("peak velocity", float(np.abs(self.velocity).max()), "m/s"),
            ("peak displacement", float(np.abs(self.displacement).max()), "m"),
            ("largest deviation of the spectrum", tables.percent(self.deviation), ""),
            ("mean deviation", tables.percent(mean), ""),
        ]
        return [tables.PrintedTable(title, ("", "", ""), rows, self.failure)]


def spectrum_compatible_record(
    spectrum: ResponseSpectrum,
    *,
    duration: float,
    key: Any,
    frequencies: Any = None,
    damping: float = 0.05,
    rate: float | None = None,
    tolerance: float = 0.05,
) -> MatchedRecord:
    """Generate a record of base acceleration whose response spectrum is a given one, at rest in the
    same place when it begins and when it ends.

    The record is a sum of cosines of random phases under an envelope that rises, is constant and
    falls; amplitudes and phases are fitted with exact derivatives of the continuous peaks of
    pseudo-acceleration. Another key gives another record.

    Args:
        spectrum: the target, a ResponseSpectrum such as Eurocode8(2.0, "B").
        duration: duration of the record [s].
        key: random key of the phases, such as jax.random.key(0).
        frequencies: frequencies at which the spectra are matched [Hz]; default: 80 from 4/duration,
            or the lowest of the spectrum, to the highest of the spectrum, 33 Hz at most.
        damping: damping ratio of the spectra.
        rate: samples per second; default: eight in a period of the highest frequency.
        tolerance: the largest allowed |reached/target - 1|.

    Errors, all at once: WRONG_KIND, NO_KEY, BAD_NUMBER, BAD_FREQUENCY, NOT_COVERED, LOW_RATE for a
    rate below four in a period of the highest frequency, TOO_SHORT, NOT_A_FRACTION; warns
    NOT_CONVERGED. Source: L. Al Atik, N. Abrahamson, Earthquake Spectra 26 (2010) 601, who adjust a
    record by wavelets instead.

    >>> quake = jb.shock.spectrum_compatible_record(
    ...     jb.shock.Eurocode8(2.0, "B"),
    ...     duration=8.0,
    ...     key=jax.random.key(1),
    ...     frequencies=[0.7, 1.0, 1.5, 2.5, 4.0],
    ... )
    >>> (
    ...     bool(quake.deviation < 0.05),
    ...     abs(round(float(quake.velocity[-1]), 9)),
    ...     abs(round(float(quake.displacement[-1]), 9)),
    ... )
    (True, 0.0, 0.0)
    """
    with Problems() as problems:
        check_kind(
            spectrum,
            ResponseSpectrum,
            "spectrum_compatible_record.spectrum",
            "a ResponseSpectrum, such as Eurocode8(2.0)",
            problems,
        )
        length = positive_number(duration, "spectrum_compatible_record.duration", problems)
        check_key(key, "spectrum_compatible_record.key", problems, "Phases are random: give")
        zeta = check_dampings(damping, "spectrum_compatible_record.damping", problems)
        limit = positive_number(tolerance, "spectrum_compatible_record.tolerance", problems)
        given = (
            None
            if rate is None
            else positive_number(rate, "spectrum_compatible_record.rate", problems)
        )
        f = (
            None
            if frequencies is None
            else problems.gather(
                lambda: check_frequencies(frequencies, "spectrum_compatible_record.frequencies")
            )
        )
        problems.raise_if_any()
        f = _default_frequencies(spectrum, float(length)) if f is None else np.sort(np.asarray(f))
        per_second = float(given) if given is not None else SAMPLES * float(f[-1])
        _check_reach(spectrum, f, float(length), per_second, problems)
    n = max(int(np.ceil(float(length) * per_second)), 2 * LINES)
    times = float(length) * np.arange(n + 1) / n
    problem = _Problem(times, f, np.asarray(spectrum(f, zeta)), float(zeta))
    with working("spectrum_compatible_record") as line:
        a, reached = _fitted(problem, key, float(limit) / 2, line)
    v, x = (np.asarray(y)[:, 0] for y in integrals(times, a[:, None]))
    deviation = np.abs(reached / problem.target - 1).max()
    status = Status.OK if deviation <= float(limit) else Status.NOT_CONVERGED
    arrays = map(device_array, (times, a, v, x, f, problem.target, reached, zeta))
    return warn_if_failed(MatchedRecord(*arrays, jnp.array(status.value)))  # pyright: ignore[reportCallIssue]


def _default_frequencies(spectrum: ResponseSpectrum, duration: float) -> np.ndarray:
    low, high = map(float, spectrum.covers())
    low, high = max(low, PERIODS / duration), min(high, HIGHEST)
    return np.geomspace(min(low, high), high, TARGETS)


def _check_reach(
    spectrum: ResponseSpectrum, f: np.ndarray, duration: float, rate: float, problems: Problems
) -> None:
    """Check that the spectrum covers the frequencies `f` [Hz], and that the duration [s] and
    sampling rate [Hz] suffice for them."""
    where, (low, high) = "spectrum_compatible_record.frequencies", map(float, spectrum.covers())
    if (outside := f[(f < low * (1 - 1e-9)) | (f > high * (1 + 1e-9))]).size:
        problems.add(
            "NOT_COVERED",
            where,
            f"has {outside} Hz",
            value=outside,
            limit=f"{low:.6g} to {high:.6g} Hz",
            hint="Leave these frequencies out.",
        )
    if (slow := f[f * duration < 1]).size:
        problems.add(
            "TOO_SHORT",
            where,
            f"has {slow} Hz, whose period is longer than {duration:g} s",
            value=slow,
            limit=f">= {1 / duration:.6g} Hz",
            hint="Give a longer duration, or leave these out.",
        )
    if rate < 4 * f[-1]:
        problems.add(
            "LOW_RATE",
            "spectrum_compatible_record.rate",
            f"is {rate:g} Hz",
            value=rate,
            limit=f">= {4 * f[-1]:.6g} Hz",
            hint="Give a higher rate, or leave frequencies out.",
        )


class _Problem:
    """The least-squares problem of a matched record. Its unknowns `values` (2, k) are b_k, the
    logarithms of amplitudes, and phases p_k; its residuals are log(reached/target)."""

    def __init__(self, times: np.ndarray, f: np.ndarray, target: np.ndarray, damping: float):
        self.target, self.h, T = target, times[1], times[-1]
        h, u = self.h, times / T
        self.lines = np.geomspace(
            max(f[0] / 1.5, 1 / T), min(f[-1] * 1.3, 0.45 / h), LINES * max(len(f), 10)
        )
        self.envelope = (
            np.where(
                u < RISE,
                np.sin(np.pi / 2 * u / RISE),
                np.where(u > FALL, np.cos(np.pi / 2 * (u - FALL) / (1 - FALL)), 1),
            )
            ** 2
        )
        # velocity and displacement at the end per sample of a, linear between samples
        ends = np.stack([np.full(len(times), h), h * (T - times)])
        ends[:, 0], ends[:, -1] = (h / 2, h * T / 2 - h**2 / 6), (h / 2, h**2 / 6)
        self.ends, self.correction = ends, np.linalg.solve((ends * self.envelope) @ ends.T, ends)
        angles = 2 * np.pi * self.lines * times[:, None]
        self.cosines, self.sines = np.cos(angles), np.sin(angles)
        s = poles(jnp.asarray(f), jnp.full(len(f), damping))
        self.oscillators, self.frequencies = (s, weights_of(s, "pseudo")), f

    def start(self, key: Any) -> np.ndarray:
        """Return the initial guess: random phases, and amplitudes in proportion to the target,
        scaled to its level."""
        levels = np.interp(np.log(self.lines), np.log(self.frequencies), np.log(self.target))
        values = np.stack(
            [levels, np.asarray(jax.random.uniform(key, (len(self.lines),), maxval=2 * np.pi))]
        )
        values[0] -= np.mean(self.linear(values)[0])
        return values

    def acceleration(self, values: np.ndarray) -> np.ndarray:
        size, phase = np.exp(values[0]), values[1]
        a = self.envelope * (
            self.cosines @ (size * np.cos(phase)) - self.sines @ (size * np.sin(phase))
        )
        return a - self.envelope * ((self.ends @ a) @ self.correction)

    def linear(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the residuals log(reached/target), their Jacobian (frequencies, 2 k), and the
        reached spectrum."""
        reached, by_a = map(
            np.asarray, influences(self.acceleration(values), self.h, *self.oscillators, PARTS)
        )
        whole = by_a * self.envelope / reached[:, None]
        whole = whole - (whole @ self.correction.T) @ (self.ends * self.envelope)
        size, (c, s) = np.exp(values[0]), (np.cos(values[1]), np.sin(values[1]))
        by_cosines, by_sines = whole @ self.cosines * size, whole @ self.sines * size
        jacobian = np.concatenate(
            [by_cosines * c - by_sines * s, -by_cosines * s - by_sines * c], 1
        )
        return np.log(reached / self.target), jacobian, reached


def _fitted(problem: _Problem, key: Any, enough: float, line: Any) -> tuple[np.ndarray, np.ndarray]:
    """Return the acceleration and its spectrum after Levenberg-Marquardt steps, which end when all
    residuals are below `enough`."""
    values, damp = problem.start(key), 1e-2
    r, J, reached = problem.linear(values)
    for step in range(STEPS):
        if np.abs(r).max() < enough:
            break
        line(f"step {step + 1}, deviation {np.abs(r).max():.1%}")
        H = J @ J.T
        new = values - (
            J.T @ np.linalg.solve(H + damp * np.trace(H) / len(r) * np.eye(len(r)), r)
        ).reshape(values.shape)
        r_new, J_new, reached_new = problem.linear(new)
        if r_new @ r_new < r @ r:
            values, r, J, reached, damp = new, r_new, J_new, reached_new, max(damp / 4, 1e-6)
        else:
            damp *= 5
    return problem.acceleration(values), reached
