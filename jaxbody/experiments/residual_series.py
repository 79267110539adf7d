"""The residuals of each channel of each run as a row of records, whose noise is correlated within and independent between."""

from __future__ import annotations

import numpy as np

from jaxbody.experiments.measurements import Measurement
from jaxbody.statistics.noises import ResidualSeries


def records_of(experiments: dict[str, Measurement]) -> list[ResidualSeries]:
    """The records that the residuals of all measurements are made of, by name as those are; one noise level for each unit of a channel, in all runs."""
    records, first = [], 0
    for run, experiment in sorted(experiments.items()):
        for name, channel in sorted(experiment.channels.items()):
            there = experiment.present(name)
            labels = [str(list(i)).replace(" ", "") if i else "" for i in np.ndindex(there.shape[1:])]
            there = there.reshape(len(there), -1)
            units = np.broadcast_to(channel.spread(np.arange(channel.units)), there.shape[1:])
            for i, (label, unit) in enumerate(zip(labels, units, strict=True)):
                times = np.flatnonzero(there[:, i])
                rows = first + times * there.shape[1] + i
                known = not channel.series and name in (experiment.noise or {})
                records.append(ResidualSeries(f"{run}.{name}{label}", f"{name} {unit}", run, rows, times, channel.series, known))
            first += there.size
    return records
