"""Columns of a Jacobian with nonzeros in different rows are evaluated together: all u of one color share a tangent.

Parameters of different measurements change different residuals, and so do the initial states of every other segment of a record.
Source: A. Curtis, M. Powell, J. Reid, On the estimation of sparse Jacobian matrices, J. Inst. Math. Appl. 13 (1974) 117.
"""

import jax.numpy as jnp
import numpy as np

from jaxbody.core.arrays import Array, Bool, Int
from jaxbody.experiments.measurements import Measurement
from jaxbody.identification.fit_parameters import FreeParameter

PRIORS = "priors"  # in place of a measurement's name for residuals of priors


def colors_of(free: tuple[FreeParameter, ...], experiments: dict[str, Measurement]) -> Int[np.ndarray, "n"]:
    """The color of each u: parameters of one measurement reuse the colors of the others, shared parameters have colors of their own."""
    used = dict.fromkeys(experiments, 0)
    colors: dict[str, np.ndarray] = {}
    for f in (f for f in free if f.run):
        row = f.form.size // _parts(f, experiments)
        i = np.arange(f.form.size)
        colors[f.path] = used[f.run] + i % row + row * (i // row % 2)
        used[f.run] = colors[f.path].max() + 1
    shared = max(used.values(), default=0)
    for f in (f for f in free if not f.run):
        colors[f.path] = shared + np.arange(f.form.size)
        shared += f.form.size
    return np.concatenate([np.zeros(0, int), *(colors[f.path] for f in free)])


def moved_rows(
    free: tuple[FreeParameter, ...], experiments: dict[str, Measurement], run: str, channel: str, size: int
) -> Bool[Array, "{size} n"]:
    """Which residuals of a channel depend on each u."""

    def rows_of(f: FreeParameter) -> Array:
        n = f.form.size
        if run == PRIORS:
            return jnp.full((size, n), channel == f.path)
        rows = experiments[run].moved_rows(f.path, channel) if f.run == run else None
        if rows is None:
            return jnp.full((size, n), f.run in ("", run))
        return jnp.repeat(jnp.repeat(rows, size // rows.shape[0], 0), n // rows.shape[1], 1)

    return jnp.concatenate([rows_of(f) for f in free], 1)


def _parts(f: FreeParameter, experiments: dict[str, Measurement]) -> int:
    """The number of parts of a parameter that change different rows, such as the initial states of segments."""
    experiment = experiments[f.run]
    masks = [experiment.moved_rows(f.path, channel) for channel in experiment.channels]
    return max(1 if rows is None else rows.shape[1] for rows in masks)
