"""Checks of the sampling and the samples of a record: rate, jitter, gaps, dead and saturated channels, likely wrong units."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from jaxbody.core import units
from jaxbody.core.arrays import check_times
from jaxbody.core.errors import Problems, warn

MISMATCH = 1e-3  # largest relative difference between a stated rate and that of the times
IRREGULAR = 0.05  # largest ratio of jitter to step, and of missing to all samples
MANY_MISSING = 0.2
AT_THE_RAILS = 0.01  # ratio of samples at the largest or smallest number to all
RUN = 4  # equal samples in a row that count as at a rail
USUAL_RATES = (2.0, 1e7)  # Hz


@dataclass(frozen=True)
class Sampling:
    """Mean step between neighbors [s], rms deviation of the steps from whole multiples of it [s], and number of missing samples."""

    step: float
    jitter: float
    missing: int

    @property
    def rate(self) -> float:
        return 1 / self.step


def counts_of(times: np.ndarray) -> np.ndarray:
    """The number of sampling steps between neighbors: 1, or more where samples are missing."""
    steps = np.diff(times)
    return np.maximum(np.round(steps / np.median(steps)), 1)


def sampling_of(times: np.ndarray) -> Sampling:
    """The sampling of two or more increasing times."""
    counts = counts_of(times)
    step = float((times[-1] - times[0]) / counts.sum())
    jitter = float(np.sqrt(np.mean((np.diff(times) - counts * step) ** 2)))
    return Sampling(step, jitter, int(counts.sum()) - len(counts))


def check_sampling(
    times: Any, problems: Problems, where: str, *, rate: float | None, irregular: bool, highest: float | None, dropped: bool
) -> Sampling | None:
    """Check times and their sampling. Errors: those of times, RATE_MISMATCH, JITTER, GAPS; warns TIME_UNIT, LOW_RATE."""
    known = check_times(times, problems, where, minimum=2)
    if known is None:
        if problems.collected[-1].code == "DUPLICATE_TIME":
            hint = (
                "Rows with the same time differ in their values: keep the correct one."
                if dropped
                else "Give drop_duplicates=True to leave out rows that repeat the one before."
            )
            problems.collected[-1] = replace(problems.collected[-1], hint=hint)
        return None
    s = sampling_of(np.asarray(known))
    message = f"jitters by {100 * s.jitter / s.step:.2g} % of a step (rms), {s.missing} of {len(known) + s.missing} samples missing"
    if rate is not None and abs(rate * s.step - 1) > MISMATCH:
        hint = "Leave out rate= to use the times, or leave out the times to use the rate."
        problems.add("RATE_MISMATCH", where, f"has {s.rate:.6g} Hz, not the stated {rate:.6g} Hz", value=s.rate, limit="0.1 %", hint=hint)
    hint = "Give irregular=True if the times are correct."
    if not irregular and s.jitter > IRREGULAR * s.step:
        problems.add("JITTER", where, message, value=s.jitter / s.step, limit="5 %", hint=hint)
    elif not irregular and s.missing > IRREGULAR * len(known):
        problems.add("GAPS", where, message, value=s.missing, limit="5 %", hint=hint)
    if not USUAL_RATES[0] <= s.rate <= USUAL_RATES[1]:
        unit = "milliseconds or microseconds" if s.rate < 1 else "milliseconds"
        unit = unit if s.rate < USUAL_RATES[0] else "seconds"
        warn(
            "TIME_UNIT", f"{where}: {len(known)} samples from {known[0]:.6g} to {known[-1]:.6g} s give {s.rate:.4g} Hz; are they in {unit}?"
        )
    if highest is not None and s.rate < 10 * highest:
        bad = "too few samples for a spectrum" if s.rate < 2.5 * highest else "few samples for a spline and its derivatives (10 per period)"
        warn("LOW_RATE", f"{where}: {s.rate:.4g} Hz for frequencies up to {highest:.4g} Hz gives {bad}")
    return s


def check_values(values: np.ndarray, unit: units.Unit, times: np.ndarray, problems: Problems, where: str, *, may_lack: bool) -> None:
    """Check the values (n,) or (n, k) of one channel in its own unit. Errors: NON_FINITE, ALL_NAN; warns MISSING, DEAD, SATURATED, UNIT."""
    if np.isinf(values).any():
        i = int(np.argwhere(np.isinf(values))[0][0])
        problems.add("NON_FINITE", where, f"is {values[i]} at index {i}", value=i, limit="finite, or NaN where a sample is missing")
        return
    rows = values.reshape(len(values), -1)
    for k, lacking in enumerate(np.isnan(rows).mean(0)):
        name = where + (f"[{k}]" if values.ndim == 2 else "")
        if lacking == 1 and not may_lack:
            problems.add("ALL_NAN", name, "has no samples", value=k, hint='Leave it out; drop="all_nan" leaves out all such channels.')
        elif MANY_MISSING < lacking < 1:
            warn("MISSING", f"{name} lacks {100 * lacking:.0f} % of its samples")
    warn_of_rails(rows, times, where, unit.text)
    _check_unit(rows, unit, where)


def warn_of_rails(rows: np.ndarray, times: np.ndarray, where: str, unit: str) -> None:
    """Warn DEAD for a channel that does not change, SATURATED for one that stays at its largest or smallest number."""
    for k, x in enumerate(rows.T):
        name = where + (f"[{k}]" if rows.shape[1] > 1 else "")
        here = x[np.isfinite(x)]
        if len(here) > 2 and here.min() == here.max():
            warn("DEAD", f"{name} is {here[0]:.6g} {unit} throughout, {times[0]:.6g} to {times[-1]:.6g} s")
        elif len(here):
            _warn_of_rails(x, unit, times, name)


def _warn_of_rails(x: np.ndarray, unit: str, times: np.ndarray, where: str) -> None:
    for rail in (np.nanmax(x), np.nanmin(x)):
        edges = np.flatnonzero(np.diff(np.concatenate([[0], (x == rail).astype(int), [0]]))).reshape(-1, 2)
        runs = [(i, j) for i, j in edges.tolist() if j - i >= RUN and not _turns(x, i, j)]
        if (count := sum(j - i for i, j in runs)) > AT_THE_RAILS * len(x):
            when = ", ".join(f"{times[i]:.6g} to {times[j - 1]:.6g} s" for i, j in runs[:3]) + (", ..." if len(runs) > 3 else "")
            warn("SATURATED", f"{where} stays at {rail:.6g} {unit} for {count} of {len(x)} samples: {when}")


def _turns(x: np.ndarray, i: int, j: int) -> bool:
    """Whether equal samples x[i:j] are the peak of a motion with rounded values: a parabola through two samples on either side exceeds them
    by no more than rounding."""
    beside = [k for k in (i - 2, i - 1, j, j + 1) if 0 <= k < len(x) and np.isfinite(x[k])]
    if len(beside) < 4:
        return False
    resolution, middle = np.diff(np.unique(x[np.isfinite(x)])).min(), (i + j - 1) / 2
    beyond = np.polyfit(np.array(beside) - middle, x[beside], 2)[2] - x[i]
    return bool(abs(beyond) < 2 * resolution)


def _check_unit(rows: np.ndarray, unit: units.Unit, where: str) -> None:
    """Warn UNIT for numbers that suggest a unit other than the stated one."""
    largest = float(np.nanmax(np.abs(rows))) if np.isfinite(rows).any() else 0.0
    if unit.dimension == units.ANGLE and unit.factor == 1.0 and largest > 2 * np.pi:
        warn("UNIT", f"{where} reaches {largest:.4g} rad, more than a turn; is it in degrees?")
    if unit.dimension == units.ACCELERATION and np.isfinite(rows).any():
        steady = float(np.linalg.norm(np.nanmean(rows, 0)))
        if unit.factor == 1.0 and abs(steady - 1) < 0.05:
            warn("UNIT", f"{where} has the mean {steady:.4g} m/s2; is it in g, gravity included?")
        elif unit.factor == units.GRAVITY and abs(steady / units.GRAVITY - 1) < 0.05:
            warn("UNIT", f"{where} has the mean {steady:.4g} g; is it in m/s2, gravity included?")
