"""Runs that begin far off their own first samples: whether rest on the base would do better, or how much of the beginning to leave out."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import numpy as np
from jaxtyping import Float

from jaxbody.core.compile_options import jit_optimized
from jaxbody.experiments.experiments import Experiment, Integration
from jaxbody.models.models import Model
from jaxbody.models.states import State
from jaxbody.statics.rest_states import Rest

FEWEST = 40  # samples of a run that is looked at
FIRST = 0.05  # part of a run that is its beginning
NOTABLE = 2.0  # times the residual of the second half, from which on rest is tried
FAR = 4.0  # times it, from which on a beginning is far off whatever rest does
SIGNAL = 0.05  # part of what a channel measures, below which nothing is far off
SETTLED = 2.0  # times the residual of the second half, from where on a run has settled
BETTER = 0.5  # part of it that is left, with which a beginning is better


def far_off(
    model: Model, experiments: dict[str, Any], predicted: dict[str, dict[str, Any]], noise: dict[str, Any], integration: Integration
) -> list[str]:
    """What may help each run that does, in words."""
    words = []
    for run, experiment in experiments.items():
        if not isinstance(experiment, Experiment) or len(experiment.times) < FEWEST:
            continue
        size = _sizes(experiment, predicted[run], noise[run])
        count = max(int(FIRST * len(size)), 3)
        here = np.flatnonzero(np.isfinite(size))
        if len(here) < FEWEST:
            continue
        late, first = _rms(size[here[len(here) // 2 :]]), _rms(size[here[:count]])
        signal = _rms(_sizes(experiment, _means(experiment), noise[run]))
        if first < max(NOTABLE * late, SIGNAL * signal):
            continue
        off = f"'{run}' begins {first / late:.2g} times as far off as it ends"
        if not isinstance(experiment.initial, Rest):
            rest = eqx.tree_at(lambda e: e.initial, experiment, Rest(), is_leaf=lambda x: x is None or isinstance(x, State))
            other = _rms(_sizes(rest, _readings(model, rest, integration), noise[run])[here[:count]])
            if other < BETTER * first:
                words.append(f'{off}: initial="rest", in equilibrium on its base, would be {other / late:.2g} times; begin it so')
                continue
        if first < FAR * late:
            continue
        times = np.asarray(experiment.times) - float(experiment.times[0])
        blocks = [i for i in range(0, len(here) // 2, count) if _rms(size[here[i : i + count]]) > SETTLED * late]
        settled = times[here[min(blocks[-1] + count, len(here) - 1)]]
        free = " or let its initial state be free" if isinstance(experiment.initial, State) else ""
        words.append(f"{off}: leave_out={settled:.3g} leaves out what has died away by then{free}")
    return words


def _rms(x: np.ndarray) -> float:
    return float(np.sqrt(np.nanmean(np.square(x)))) if np.isfinite(x).any() else np.nan


def _means(experiment: Experiment) -> dict[str, Any]:
    """What would read the mean of each record at all times."""
    return {name: np.broadcast_to(np.nanmean(x, 0), np.shape(x)) for name, x in experiment.measured.items()}


def _sizes(experiment: Experiment, readings: dict[str, Any], noise: dict[str, Any]) -> Float[np.ndarray, "nt"]:
    """At each time the rms over all components of residuals over noise; NaN where all samples are missing."""
    squares, counts = np.zeros(len(experiment.times)), np.zeros(len(experiment.times))
    for name, channel in experiment.channels.items():
        r = np.asarray(experiment.residual(name, readings[name]) / channel.spread(noise[name])).reshape(len(squares), -1)
        squares += np.sum(r**2, 1)
        counts += np.sum(np.asarray(experiment.present(name)).reshape(len(squares), -1), 1)
    return np.sqrt(np.where(counts > 0, squares / np.maximum(counts, 1), np.nan))


@jit_optimized
def _readings(model: Model, experiment: Experiment, integration: Integration):
    return experiment.readings(model, integration)
