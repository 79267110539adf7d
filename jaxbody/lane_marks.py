"""What a function tells a batch in lanes: what to ask of all members, what to work out once, sums and maxima that XLA compiles well."""

from __future__ import annotations

from collections.abc import Callable

import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.core import ShapedArray
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir
from jaxtyping import Array, Bool

# Whether it is so for any member of a batch, the same for all: a loop that asks this needs no masks over what it carries.
_any_p = Primitive("any_of_batch")
any_of_batch: Callable[[Bool[Array, "*n"]], Bool[Array, "*n"]] = _any_p.bind
_any_p.def_impl(lambda x: x)
_any_p.def_abstract_eval(lambda x: x)
mlir.register_lowering(_any_p, lambda context, x: [x])
batching.primitive_batchers[_any_p] = lambda args, axes: (_any_p.bind(jnp.any(args[0], axes[0])), None)

# The same numbers, which a batch in lanes works out once; else XLA works them out again in each fusion, and for each element, that uses them.
_kept_p = Primitive("kept_in_lanes")
kept: Callable[[Array], Array] = _kept_p.bind
_kept_p.def_impl(lambda x: x)
_kept_p.def_abstract_eval(lambda x: x)
mlir.register_lowering(_kept_p, lambda context, x: [x])
ad.deflinear2(_kept_p, lambda cotangent, x: [cotangent])
batching.defvectorized(_kept_p)


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


sum_p = Primitive("sum_in_lanes")
sum_p.def_impl(plain_sum)
sum_p.def_abstract_eval(lambda x, axes: ShapedArray(tuple(n for i, n in enumerate(x.shape) if i not in axes), x.dtype))
mlir.register_lowering(sum_p, mlir.lower_fun(plain_sum, multiple_results=False))
batching.primitive_batchers[sum_p] = _batched_sum
ad.deflinear2(sum_p, _spread_back)
