"""Checks of the sampling and the samples of a record: rate, jitter, gaps, dead and saturated
channels, likely wrong units."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from jaxbody.core import units
from jaxbody.core.arrays import check_times, checked, concrete, float_array, time_text
from jaxbody.core.errors import Problems, warn

EQUAL = 1e-6  # largest difference between equal steps, relative to them
# largest ratio of the last digit of times to their step: above one half, a missing time could not
# be detected
COARSEST = 1 / 3
IRREGULAR = 0.05  # largest ratio of jitter to step, and of missing to all samples
MANY_MISSING = 0.2
AT_THE_RAILS = 0.01  # largest share of samples at an extreme value without the warning SATURATED
RUN = 4  # consecutive equal samples that count as saturated
USUAL_RATES = (2.0, 1e7)  # Hz


@dataclass(frozen=True)
class Sampling:
    """The sampling of a record: mean step between neighboring samples [s], rms deviation of the
    steps from whole multiples of it [s], and number of missing samples."""

    step: float
    jitter: float
    missing: int

    @property
    def rate(self) -> float:
        return 1 / self.step


def counts_of(times: np.ndarray) -> np.ndarray:
    """Return the number of sampling steps between neighboring times: 1, or more where samples are
    missing."""
    steps = np.diff(times)
    return np.maximum(np.round(steps / np.median(steps)), 1)


def sampling_of(times: np.ndarray) -> Sampling:
    """Return the sampling of two or more increasing times."""
    counts = counts_of(times)
    step = float((times[-1] - times[0]) / counts.sum())
    jitter = float(np.sqrt(np.mean((np.diff(times) - counts * step) ** 2)))
    return Sampling(step, jitter, int(counts.sum()) - len(counts))


def resolutions(times: np.ndarray) -> list[float]:
    """Return the resolutions [s] of times as they are stored: their last decimal, such as 0.001 if
    all are whole milliseconds, and the distance between two floating-point numbers, also that of 32
    bits if all are such numbers."""
    largest = np.abs(times).max()
    decimals = (
        10.0**-k
        for k in range(16)
        if np.abs(times * 10.0**k - np.round(times * 10.0**k)).max() < 1e-15 * largest * 10.0**k
    )
    steps = [np.spacing(largest), next(decimals, 0.0)]
    if (times == times.astype(np.float32)).all():
        steps.append(np.spacing(np.float32(largest)))
    return [float(x) for x in steps]


def evenly_spaced(times: np.ndarray) -> bool:
    """Return whether increasing times have equal steps, or equal steps rounded to one of their
    resolutions."""
    step = (times[-1] - times[0]) / (len(times) - 1)
    far = np.abs(times - times[0] - step * np.arange(len(times))).max()
    rounded = any(
        far <= digit * (1 + EQUAL) for digit in resolutions(times) if digit <= COARSEST * step
    )
    return bool(rounded or np.ptp(np.diff(times)) <= EQUAL * step)


def even_samples(
    times: Any, values: Any, where: tuple[str, str], problems: Problems
) -> tuple[Any, Any]:
    """Return values, one for each of evenly spaced times, and the mean time step [s]. Problems are
    added if the times or values are not valid; the values are then None if they are wrong, and the
    step is 1 if the times are. Errors: those of times, NOT_UNIFORM, BAD_SHAPE, NON_FINITE."""
    t = check_times(times, problems, where[0], minimum=2, kept=True)
    known = None if t is None else concrete(t)
    if known is not None and not evenly_spaced(known):
        steps = np.diff(known)
        problems.add(
            "NOT_UNIFORM",
            where[0],
            f"has steps from {steps.min():.6g} to {steps.max():.6g} s",
            value=steps,
            limit="equal steps",
            hint="Read the record with rate= if it was sampled evenly, with fill= if samples are "
            "missing; or use jb.resample(record, rate=...).",
        )
    if t is None:
        return problems.gather(lambda: float_array(values, where[1])), 1.0
    return checked(values, (t.shape,), where[1], problems, "One value for each time."), (
        t[-1] - t[0]
    ) / (len(t) - 1)


def check_sampling(
    times: Any,
    problems: Problems,
    where: str,
    *,
    irregular: bool,
    highest: float | None,
    dropped: bool,
) -> None:
    """Check times and their sampling. Errors: those of times, JITTER, GAPS; warns
    TIME_UNIT, LOW_RATE."""
    known = check_times(times, problems, where, minimum=2, kept=True)
    if known is None:
        if problems.collected[-1].code == "DUPLICATE_TIME":
            hint = (
                "Rows with the same time differ in their values: keep the correct one."
                if dropped
                else "Give drop_duplicates=True to leave out rows that repeat the one before."
            )
            problems.collected[-1] = replace(problems.collected[-1], hint=hint)
        return
    s = sampling_of(np.asarray(known))
    message = (
        f"jitters by {100 * s.jitter / s.step:.2g} % of a step (rms), {s.missing} of "
        f"{len(known) + s.missing} samples missing"
    )
    hint = "Give rate= if it was sampled evenly, irregular=True if the times are correct."
    if not irregular and s.jitter > IRREGULAR * s.step:
        problems.add("JITTER", where, message, value=s.jitter / s.step, limit="5 %", hint=hint)
    elif not irregular and s.missing > IRREGULAR * len(known):
        problems.add("GAPS", where, message, value=s.missing, limit="5 %", hint=hint)
    if not USUAL_RATES[0] <= s.rate <= USUAL_RATES[1]:
        slow = "milliseconds or microseconds" if s.rate < 1 else "milliseconds"
        warn(
            "TIME_UNIT",
            f"{where}: {len(known)} samples from {time_text(known[0], known)} to "
            f"{time_text(known[-1], known)} s give {s.rate:.4g} Hz; are they in "
            f"{slow if s.rate < USUAL_RATES[0] else 'seconds'}?",
        )
    if highest is not None and s.rate < 10 * highest:
        bad = (
            "too few samples for a spectrum"
            if s.rate < 2.5 * highest
            else "few samples for a spline and its derivatives (10 per period)"
        )
        warn(
            "LOW_RATE",
            f"{where}: {s.rate:.4g} Hz for frequencies up to {highest:.4g} Hz gives {bad}",
        )


def check_values(
    values: np.ndarray,
    unit: units.Unit,
    times: np.ndarray,
    problems: Problems,
    where: str,
    *,
    may_lack: bool,
) -> None:
    """Check the values (n,) or (n, k) of one channel in its given unit. Errors: NON_FINITE,
    ALL_NAN, unless `may_lack`; warns MISSING, DEAD, SATURATED, UNIT."""
    if np.isinf(values).any():
        i = int(np.argwhere(np.isinf(values))[0][0])
        problems.add(
            "NON_FINITE",
            where,
            f"is {values[i]} at index {i}",
            value=i,
            limit="finite, or NaN where a sample is missing",
        )
        return
    rows = values.reshape(len(values), -1)
    for k, lacking in enumerate(np.isnan(rows).mean(0)):
        name = where + (f"[{k}]" if values.ndim == 2 else "")
        if lacking == 1 and not may_lack:
            problems.add(
                "ALL_NAN",
                name,
                "has no samples",
                value=k,
                hint='Leave it out; drop="all_nan" leaves out all such channels.',
            )
        elif MANY_MISSING < lacking < 1:
            warn("MISSING", f"{name} lacks {100 * lacking:.0f} % of its samples")
    warn_of_rails(rows, times, where, unit.text)
    _check_unit(rows, unit, where)


def warn_of_rails(rows: np.ndarray, times: np.ndarray, where: str, unit: str) -> None:
    """Issue the warning DEAD for a channel that does not change, SATURATED for one that stays at
    its largest or smallest value."""
    for k, x in enumerate(rows.T):
        name = where + (f"[{k}]" if rows.shape[1] > 1 else "")
        here = x[np.isfinite(x)]
        if len(here) > 2 and here.min() == here.max():
            warn(
                "DEAD",
                f"{name} is {here[0]:.6g} {unit} throughout, {time_text(times[0], times)} to "
                f"{time_text(times[-1], times)} s",
            )
        elif len(here):
            _warn_of_rails(x, unit, times, name)


def runs(where: np.ndarray) -> list[list[int]]:
    """Return [first, end] of each run of True, as for a slice."""
    return np.flatnonzero(np.diff(where, prepend=False, append=False)).reshape(-1, 2).tolist()


def _warn_of_rails(x: np.ndarray, unit: str, times: np.ndarray, where: str) -> None:
    for rail in (np.nanmax(x), np.nanmin(x)):
        stays = [(i, j) for i, j in runs(x == rail) if j - i >= RUN and not _turns(x, i, j)]
        if (count := sum(j - i for i, j in stays)) > AT_THE_RAILS * len(x):
            when = [
                f"{time_text(times[i], times)} to {time_text(times[j - 1], times)} s"
                for i, j in stays[:3]
            ]
            warn(
                "SATURATED",
                f"{where} stays at {rail:.6g} {unit} for {count} of {len(x)} samples: "
                f"{', '.join(when)}{', ...' if len(stays) > 3 else ''}",
            )


def _turns(x: np.ndarray, i: int, j: int) -> bool:
    """Return whether equal samples x[i:j] are the peak of a motion with rounded values: a parabola
    through two samples on either side exceeds them by no more than rounding."""
    beside = [k for k in (i - 2, i - 1, j, j + 1) if 0 <= k < len(x) and np.isfinite(x[k])]
    if len(beside) < 4:
        return False
    resolution, middle = np.diff(np.unique(x[np.isfinite(x)])).min(), (i + j - 1) / 2
    beyond = np.polyfit(np.array(beside) - middle, x[beside], 2)[2] - x[i]
    return bool(abs(beyond) < 2 * resolution)


def _check_unit(rows: np.ndarray, unit: units.Unit, where: str) -> None:
    """Issue the warning UNIT for numbers that suggest a unit other than the stated one."""
    largest = float(np.nanmax(np.abs(rows))) if np.isfinite(rows).any() else 0.0
    if unit.dimension == units.ANGLE and unit.factor == 1.0 and largest > 2 * np.pi:
        warn("UNIT", f"{where} reaches {largest:.4g} rad, more than a turn; is it in degrees?")
    if unit.dimension == units.ACCELERATION and np.isfinite(rows).any():
        steady = float(np.linalg.norm(np.nanmean(rows, 0)))
        if unit.factor == 1.0 and abs(steady - 1) < 0.05:
            warn("UNIT", f"{where} has the mean {steady:.4g} m/s2; is it in g, gravity included?")
        elif unit.factor == units.GRAVITY and abs(steady / units.GRAVITY - 1) < 0.05:
            warn("UNIT", f"{where} has the mean {steady:.4g} g; is it in m/s2, gravity included?")
