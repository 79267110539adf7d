"""Columns of a Jacobian with nonzeros in different rows are evaluated together: all u of one color
share a tangent.

Parameters of different measurements change different residuals, and so do the initial states of
every other segment of a record. Source: A. Curtis, M. Powell, J. Reid, On the estimation of sparse
Jacobian matrices, J. Inst. Math. Appl. 13 (1974) 117.
"""

import jax.numpy as jnp
import numpy as np

from jaxbody.core.arrays import Array, Bool, Int
from jaxbody.fitting.experiments.measurements import Measurement
from jaxbody.fitting.parameters.spaces import Parameter, Space

PRIORS = "priors"  # in place of a measurement's name for residuals of priors


def colors_of(space: Space) -> Int[np.ndarray, "n"]:
    """The color of each u: parameters of one measurement reuse the colors of the others, shared
    parameters have colors of their own."""
    used = dict.fromkeys(space.runs, 0)
    colors = np.zeros(space.size, int)
    for parameter, part in space.parts:
        if parameter.run:
            i, row = (
                np.arange(parameter.form.size),
                parameter.form.size // _parts(parameter, space.runs[parameter.run]),
            )
            colors[part] = used[parameter.run] + i % row + row * (i // row % 2)
            used[parameter.run] = colors[part].max() + 1
    shared = np.concatenate(
        [np.zeros(0, int), *(np.r_[part] for parameter, part in space.parts if not parameter.run)]
    )
    colors[shared] = max(used.values(), default=0) + np.arange(len(shared))
    return colors


def moved_rows(space: Space, run: str, channel: str, size: int) -> Bool[Array, "{size} n"]:
    """Which residuals of a channel depend on each u."""

    def rows_of(parameter: Parameter) -> Array:
        n = parameter.form.size
        if run == PRIORS:
            return jnp.full((size, n), channel == parameter.path)
        rows = space.runs[run].moved_rows(parameter.path, channel) if parameter.run == run else None
        if rows is None:
            return jnp.full((size, n), parameter.run in ("", run))
        return jnp.repeat(jnp.repeat(rows, size // rows.shape[0], 0), n // rows.shape[1], 1)

    return jnp.concatenate([rows_of(parameter) for parameter in space.parameters], 1)


def _parts(parameter: Parameter, run: Measurement) -> int:
    """The number of parts of a parameter that change different rows, such as the initial states
    of segments."""
    masks = [run.moved_rows(parameter.path, channel) for channel in run.channels]
    return max(1 if rows is None else rows.shape[1] for rows in masks)
