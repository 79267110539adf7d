"""Residuals of each component of a channel as a record of its own, with noise correlated within it
and independent of others."""

from __future__ import annotations

import numpy as np

from jaxbody.core.arrays import indices
from jaxbody.fitting.experiments.measurements import Measurement
from jaxbody.fitting.statistics.noises import ResidualSeries


def records_of(experiments: dict[str, Measurement]) -> list[ResidualSeries]:
    """The records of the residuals of all measurements, in the same order; all runs share one noise
    level for each unit of a channel."""
    records, first = [], 0
    for run, experiment in sorted(experiments.items()):
        for name, channel in sorted(experiment.channels.items()):
            present = experiment.present(name)
            labels, present = indices(present.shape[1:]), present.reshape(len(present), -1)
            units = np.broadcast_to(
                channel.spread(np.arange(channel.units)), (1, present.shape[1])
            )[0]
            for i, (label, unit) in enumerate(zip(labels, units, strict=True)):
                times = np.flatnonzero(present[:, i])
                rows = first + times * present.shape[1] + i
                stated = not channel.series and name in (experiment.noise or {})
                records.append(
                    ResidualSeries(
                        f"{run}.{name}{label}",
                        f"{name} {unit}",
                        run,
                        rows,
                        times,
                        channel.series,
                        stated,
                    )
                )
            first += present.size
    return records
