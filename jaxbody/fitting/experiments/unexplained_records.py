"""Records that a fitted model does not explain: their residuals are not clearly smaller than their
variation, or the prediction begins far from the first samples.

    rms(y - p) > UNEXPLAINED rms(y - mean y)

y is the record and p the prediction of one component of a channel. Residuals that may be noise are
not reported: those as large as the stated noise, or white and not correlated with the prediction,
as in a noisy record of a small motion. Frequency responses, modes and curves vary about zero, not
about their mean. Remedies for a wrong beginning are a start at rest, or leaving out the initial
transient.
"""

from collections.abc import Iterator
from typing import Any, NamedTuple

import equinox as eqx
import numpy as np

from jaxbody.core.arrays import Float, indices
from jaxbody.core.compilation.compile_options import program_with
from jaxbody.fitting.experiments.experiments import Experiment, Integration
from jaxbody.fitting.experiments.measurements import Measurement
from jaxbody.fitting.statistics.autocorrelations import UNLIKELY, whiteness
from jaxbody.mechanics.quasi_static_states import Rest
from jaxbody.model.models import Model, options_of_motion
from jaxbody.model.states import State

# rms of residuals relative to the variation of the record; noise of 30 % of the motion leaves 0.29
UNEXPLAINED = 0.5
# smallest variation or residual that counts, relative to the largest component of the same unit
SMALL = 0.1
SHORT = 2.0  # as UNEXPLAINED, for records that are too short to tell noise from motion
STATED = 2.0  # residuals relative to the stated noise, up to which they are noise

SIGNIFICANT = 4.0  # smallest correlation of residuals and prediction, in standard errors
# residuals beyond so many standard deviations do not count where a robust loss was chosen
OUTLIERS = 5.0


class Component(NamedTuple):
    """Residuals of one component of a channel, or of real and imaginary part together.

    `r`: residuals p - y of the fit; `v`: residuals of a constant prediction, the mean of a record
    in time, else zero; `noise`: stated noise, zero if none is stated; `in_time`: True for a record
    in time."""

    name: str
    unit: str
    r: np.ndarray
    v: np.ndarray
    noise: float
    in_time: bool


def unexplained(
    experiments: dict[str, Measurement],
    residuals: dict[str, dict[str, Any]],
    robust: bool,
    least: float,
) -> Iterator[str]:
    """Yield a sentence on each record that the fitted model does not explain.

    Args:
        experiments: the measurements
        residuals: {measurement: {channel: predicted minus measured}}, in their units
        robust: True to ignore outliers
        least: rms of residuals up to which they are integration error
    """
    for run, experiment in experiments.items():
        components = [
            c
            for name in experiment.channels
            for c in _components(run, name, experiment, np.asarray(residuals[run][name]))
        ]
        for c in components:
            kept = np.abs(c.r) <= (OUTLIERS * 1.4826 * np.median(np.abs(c.r)) if robust else np.inf)
            size, variation, largest = (
                _rms(c.r[kept]),
                _rms(c.v[kept]),
                max(_rms(other.v) for other in components if other.unit == c.unit),
            )
            test = whiteness(c.r) if c.in_time else None
            limit = SHORT if c.in_time and test is None else UNEXPLAINED
            noisy = size <= STATED * c.noise or (
                test is not None and test.p > UNLIKELY and not _related(c.r, c.r - c.v)
            )
            if (
                variation > 0
                and size > max(limit * variation, SMALL * largest, least)
                and not noisy
            ):
                sizes = [f"{x:.3g} {c.unit}".rstrip() for x in (size, variation)]
                yield (
                    f"the residuals of {c.name} have a rms of {sizes[0]}, where the record itself "
                    f"varies by {sizes[1]}"
                )


def _components(run: str, name: str, experiment: Measurement, r: np.ndarray) -> Iterator[Component]:
    channel, measured, in_time = (
        experiment.channels[name],
        np.asarray(experiment.measured[name]),
        isinstance(experiment, Experiment),
    )
    still = np.nanmean(measured, 0) if in_time else np.zeros_like(measured)
    v = np.asarray(channel.residual(np.broadcast_to(still, measured.shape), measured))
    level = np.broadcast_to(
        channel.spread(np.asarray((experiment.noise or {}).get(name, 0.0))), r.shape
    )
    labels, units = indices(r.shape[1:]), channel.unit.split(",")
    r, v, level, present = (
        np.reshape(x, (len(measured), -1)) for x in (r, v, level, experiment.present(name))
    )
    columns: list[Any] = (
        [slice(None)] if np.iscomplexobj(measured) else [[i] for i in range(r.shape[1])]
    )
    for i, own in enumerate(columns):
        if (rows := present[:, own]).any():
            yield Component(
                f"{run}.{name}{labels[i] if len(columns) > 1 else ''}",
                units[i * len(units) // len(columns)].strip(),
                r[:, own][rows],
                v[:, own][rows],
                float(np.median(level[:, own][rows])),
                in_time,
            )


def _related(r: np.ndarray, p: np.ndarray) -> bool:
    """Return whether residuals r are more correlated with a prediction p than noise would be,
    |rho| sqrt(n) > SIGNIFICANT, with the correlation rho of n samples."""
    p = p - np.mean(p)
    return bool(abs(p @ r) > SIGNIFICANT * np.sqrt((p @ p) * (r @ r) / len(r)))


MIN_SAMPLES = 40  # of a run that is checked
FIRST = 0.05  # part of a run that counts as its beginning
# residuals of the beginning relative to those of the second half:
NOTABLE = 2.0  # from which a start at rest is tried
FAR = 4.0  # from which a remark is made
SETTLED = 2.0  # below which a run has settled
SIGNAL = 0.05  # residual, relative to the measured signal, below which no remark is made
# residual of a start at rest, relative to the present one, below which it is recommended
BETTER = 0.5


def transients(
    model: Model,
    experiments: dict[str, Any],
    predicted: dict[str, dict[str, Any]],
    noise: dict[str, Any],
    integration: Integration,
) -> Iterator[str]:
    """Yield a remark with its remedy for each run whose prediction begins far from the first
    samples."""
    for run, experiment in experiments.items():
        if not isinstance(experiment, Experiment) or len(experiment.times) < MIN_SAMPLES:
            continue
        size = _sizes(experiment, predicted[run], noise[run])
        count = max(int(FIRST * len(size)), 3)
        valid = np.flatnonzero(np.isfinite(size))
        if len(valid) < MIN_SAMPLES:
            continue
        late, first = _rms(size[valid[len(valid) // 2 :]]), _rms(size[valid[:count]])
        means = {
            name: np.broadcast_to(np.nanmean(x, 0), np.shape(x))
            for name, x in experiment.measured.items()
        }
        signal = _rms(_sizes(experiment, means, noise[run]))
        if first < max(NOTABLE * late, SIGNAL * signal):
            continue
        remark = (
            f"'{run}' begins with residuals {first / late:.2g} times as large as "
            "those of its second half"
        )
        if not isinstance(experiment.initial, Rest):
            rest = eqx.tree_at(
                lambda e: e.initial,
                experiment,
                Rest(),
                is_leaf=lambda x: x is None or isinstance(x, State),
            )
            other = _rms(
                _sizes(rest, _readings(model, rest, integration), noise[run])[valid[:count]]
            )
            if other < BETTER * first:
                yield (
                    f'{remark}, with initial="rest" only {other / late:.2g} times: start it in '
                    "equilibrium on its base"
                )
                continue
        if first < FAR * late:
            continue
        times = np.asarray(experiment.times) - float(experiment.times[0])
        blocks = [
            i
            for i in range(0, len(valid) // 2, count)
            if _rms(size[valid[i : i + count]]) > SETTLED * late
        ]
        settled = times[valid[min(blocks[-1] + count, len(valid) - 1)]]
        yield f"{remark}: leave out the initial transient with leave_out={settled:.3g}" + (
            ", or free its initial state" if isinstance(experiment.initial, State) else ""
        )


def _rms(x: np.ndarray) -> float:
    return float(np.sqrt(np.nanmean(np.square(x)))) if np.isfinite(x).any() else np.nan


def _sizes(
    experiment: Experiment, readings: dict[str, Any], noise: dict[str, Any]
) -> Float[np.ndarray, "nt"]:
    """Return the rms of residuals over noise at each time; NaN where all samples are missing."""
    squares, counts = np.zeros(len(experiment.times)), np.zeros(len(experiment.times))
    for name, channel in experiment.channels.items():
        r = experiment.residual(name, np.asarray(readings[name]))
        r = np.asarray(r) / channel.spread(np.asarray(noise[name]))
        squares += np.sum(r.reshape(len(squares), -1) ** 2, 1)
        counts += np.sum(np.asarray(experiment.present(name)).reshape(len(squares), -1), 1)
    return np.sqrt(np.where(counts > 0, squares / np.maximum(counts, 1), np.nan))


@program_with(lambda model, experiment, integration: options_of_motion(model, experiment.times))
def _readings(model: Model, experiment: Experiment, integration: Integration):
    return experiment.readings(model, integration, None)
