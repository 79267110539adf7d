"""What a function tells a batch in lanes: what to ask of all members, what to work out once, sums and maxima that XLA compiles well."""

from __future__ import annotations

from collections.abc import Callable

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool

from jaxbody.core.jax_internals import new_operation, same_numbers, shaped

# Whether it is so for any member of a batch, the same for all: a loop that asks this needs no masks over what it carries.
_any_p = same_numbers("any_of_batch", batch=lambda args, axes: (_any_p.bind(jnp.any(args[0], axes[0])), None))
any_of_batch: Callable[[Bool[Array, "*n"]], Bool[Array, "*n"]] = _any_p.bind

# The same numbers, which a batch in lanes works out once; else XLA works them out again in each fusion, and for each element, that uses them.
_kept_p = same_numbers(
    "kept_in_lanes", batch=lambda args, axes: (_kept_p.bind(args[0]), axes[0]), transpose=lambda cotangent, x: [cotangent]
)
kept: Callable[[Array], Array] = _kept_p.bind


def as_kept(x: Array) -> Array:
    """x / 1, as XLA fuses no division into several users; it must not know that it is 1."""
    return x / jnp.where(x == x, 1.0, jnp.nan)


# Reducers that XLA does not recognize: else it gives large reductions to a library, whose calls keep a loop from being compiled
# whole. They must be sums and maxima all the same, as XLA merges sums of sums.
def plain_sum(x: Array, axes: tuple[int, ...]) -> Array:
    """The sum over axes, never by a library."""
    return lax.reduce(x, np.zeros((), x.dtype), lambda a, b: -(-a - b), axes)


def plain_max(x: Array, axes: tuple[int, ...]) -> Array:
    """The largest over axes, never by a library."""
    return lax.reduce(x, np.array(-np.inf, x.dtype), lambda a, b: -lax.min(-a, -b), axes)


def _spread_back(cotangent, x, axes):
    return [lax.broadcast_in_dim(cotangent, x.aval.shape, [i for i in range(x.aval.ndim) if i not in axes])]


def _batched_sum(args, batched, axes):
    return sum_p.bind(jnp.moveaxis(args[0], batched[0], -1), axes=axes), args[0].ndim - 1 - len(axes)


def _summed(x, axes):
    return shaped(tuple(n for i, n in enumerate(x.shape) if i not in axes), x.dtype)


sum_p = new_operation("sum_in_lanes", plain_sum, typed=_summed, batch=_batched_sum, transpose=_spread_back)
