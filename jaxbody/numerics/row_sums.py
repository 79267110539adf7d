"""Rows of tables taken and summed by slices, which a compiled loop can fuse where gather and scatter break it."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

FEW_RUNS = 64  # slices that a sum may take; more would cost more to compile than a gather costs to run


def sums(x: Float[Array, "m k"], groups: list[list[int]]) -> Float[Array, "n k"]:
    """The sum of the rows of each group: over slices where groups are a few runs of consecutive rows, else by a padded gather."""
    runs = [np.split(rows, np.flatnonzero(np.diff(rows) != 1) + 1) if rows else [] for rows in groups]
    if sum(map(len, runs)) <= FEW_RUNS:
        zero = jnp.zeros(x.shape[1], x.dtype)
        return jnp.stack([sum((jnp.sum(x[run[0] : run[-1] + 1], 0) for run in group), zero) for group in runs])
    most = max(len(rows) for rows in groups)
    padded = np.array([rows + [len(x)] * (most - len(rows)) for rows in groups])
    return jnp.sum(jnp.concatenate([x, jnp.zeros((1, x.shape[1]), x.dtype)])[padded], 1)


def take(x: Array, rows: np.ndarray) -> Array:
    """x[rows] for rows known beforehand; slices where they follow one another or are all the same, which a compiled loop can fuse."""
    if len(rows) and (np.diff(rows) == 1).all():
        if len(rows) == len(x):
            return x
        return x[int(rows[0]) : int(rows[-1]) + 1]
    if len(rows) and (rows == rows[0]).all():
        return jnp.broadcast_to(x[int(rows[0]) : int(rows[0]) + 1], (len(rows), *x.shape[1:]))
    return x[rows]
