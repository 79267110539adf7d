"""Runs whose predictions begin far from their first samples: remedies are a start at rest, or
leaving out the initial transient."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import numpy as np

from jaxbody.core.arrays import Float
from jaxbody.core.compilation.compile_options import OPTIMIZED, QUICK, program_with
from jaxbody.fitting.experiments.experiments import Experiment, Integration
from jaxbody.mechanics.quasi_static_states import Rest
from jaxbody.model.models import Model
from jaxbody.model.sizes import take_long
from jaxbody.model.states import State

MIN_SAMPLES = 40  # of a run that is checked
FIRST = 0.05  # part of a run that counts as its beginning
# residual of the beginning, relative to that of the second half, from which a start at rest
# is tried
NOTABLE = 2.0
# residual of the beginning, relative to that of the second half, from which a remark is made
FAR = 4.0
SIGNAL = 0.05  # residual relative to the measured signal below which no remark is made
SETTLED = 2.0  # residual relative to that of the second half below which a run has settled
# residual of a start at rest, relative to the present one, below which it is recommended
BETTER = 0.5


def transients(
    model: Model,
    experiments: dict[str, Any],
    predicted: dict[str, dict[str, Any]],
    noise: dict[str, Any],
    integration: Integration,
) -> list[str]:
    """A remark with the remedy for each such run."""
    words = []
    for run, experiment in experiments.items():
        if not isinstance(experiment, Experiment) or len(experiment.times) < MIN_SAMPLES:
            continue
        size = _sizes(experiment, predicted[run], noise[run])
        count = max(int(FIRST * len(size)), 3)
        valid = np.flatnonzero(np.isfinite(size))
        if len(valid) < MIN_SAMPLES:
            continue
        late, first = _rms(size[valid[len(valid) // 2 :]]), _rms(size[valid[:count]])
        signal = _rms(_sizes(experiment, _means(experiment), noise[run]))
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
                words.append(
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
        free = ", or free its initial state" if isinstance(experiment.initial, State) else ""
        words.append(
            f"{remark}: leave out the initial transient with leave_out={settled:.3g}{free}"
        )
    return words


def _rms(x: np.ndarray) -> float:
    return float(np.sqrt(np.nanmean(np.square(x)))) if np.isfinite(x).any() else np.nan


def _means(experiment: Experiment) -> dict[str, Any]:
    """Predictions that are the mean of each record at all times."""
    return {
        name: np.broadcast_to(np.nanmean(x, 0), np.shape(x))
        for name, x in experiment.measured.items()
    }


def _sizes(
    experiment: Experiment, readings: dict[str, Any], noise: dict[str, Any]
) -> Float[np.ndarray, "nt"]:
    """The rms of residuals over noise at each time; NaN where all samples are missing."""
    squares, counts = np.zeros(len(experiment.times)), np.zeros(len(experiment.times))
    for name, channel in experiment.channels.items():
        r = np.asarray(experiment.residual(name, np.asarray(readings[name]))) / channel.spread(
            np.asarray(noise[name])
        )
        r = r.reshape(len(squares), -1)
        squares += np.sum(r**2, 1)
        counts += np.sum(np.asarray(experiment.present(name)).reshape(len(squares), -1), 1)
    return np.sqrt(np.where(counts > 0, squares / np.maximum(counts, 1), np.nan))


@program_with(
    lambda model, experiment, integration: (
        OPTIMIZED if take_long(model, experiment.times) else QUICK
    )
)
def _readings(model: Model, experiment: Experiment, integration: Integration):
    return experiment.readings(model, integration, None)
