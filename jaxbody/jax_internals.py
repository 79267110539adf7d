"""What jaxbody takes from the inside of JAX, which no version promises: one function for each use, with a test and a way back."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import jax
from jax.extend.core import ClosedJaxpr, Primitive, jaxpr_as_fun
from jax.interpreters import ad, batching, mlir, partial_eval
from jaxtyping import Array


def without_high_operations(jaxpr: ClosedJaxpr) -> ClosedJaxpr:
    """The same program in operations that batches and compilers know. Since version 0.12 a program may hold "high" ones, such as
    searchsorted, each of which JAX replaces by others just before it compiles."""
    if not getattr(jaxpr, "is_high", False):
        return jaxpr
    if hasattr(partial_eval, "lower_jaxpr2"):
        return partial_eval.lower_jaxpr2(jaxpr)  # pyright: ignore
    return jax.jit(jaxpr_as_fun(jaxpr)).trace(*jaxpr.in_avals).lojax.jaxpr  # pyright: ignore  # the same by another door


# Within `jax.shard_map` the type of an array says over which axes of the mesh its values vary, and a loop may not begin with a constant,
# which does not vary, and go on with what does. A function that knows nothing of devices is therefore traced without these types.


def without_manual_axes(function: Callable[..., Any]) -> Callable[..., Any]:
    """The function of arrays, which may lie within any trees; inside it, none varies over the axes of a mesh."""

    @functools.wraps(function)
    def call(*args):
        axes = frozenset().union(*(_varying(jax.typeof(x)) for x in jax.tree.leaves(args) if isinstance(x, jax.Array)))
        if not axes:
            return function(*args)
        return _each_array(lambda x: _shown_p.bind(x, axes=axes), function(*_each_array(lambda x: _hidden(x, axes), args)))

    return call


def _each_array(function: Callable[[Array], Array], tree: Any) -> Any:
    return jax.tree.map(lambda x: function(x) if isinstance(x, jax.Array) else x, tree)


def _hidden(x: Array, axes: frozenset) -> Array:
    """x, made to vary over all axes first: derivatives in what does not vary are then sums over devices, as they must be."""
    missing = tuple(axes - _varying(jax.typeof(x)))
    if missing:
        x = jax.lax.pcast(x, missing, to="varying") if hasattr(jax.lax, "pcast") else jax.lax.pvary(x, missing)
    return _hidden_p.bind(x, axes=axes)


def _varying(aval: Any) -> frozenset:
    return aval.manual_axis_type.varying if hasattr(aval, "manual_axis_type") else getattr(aval, "vma", frozenset())


def _with_varying(aval: Any, axes: frozenset) -> Any:
    if hasattr(aval, "manual_axis_type"):
        sharding = aval.sharding.update(mesh=jax.sharding.get_abstract_mesh())
        return aval.update(sharding=sharding, manual_axis_type=aval.manual_axis_type.update(varying=axes))
    return aval.update(vma=axes)


def _type_only(name: str, varying: Callable[[frozenset], frozenset]) -> Primitive:
    """The same numbers, of another type."""
    primitive = Primitive(name)
    primitive.def_impl(lambda x, axes: x)
    primitive.def_abstract_eval(lambda x, axes: _with_varying(x, varying(axes)))
    mlir.register_lowering(primitive, lambda context, x, axes: [x])
    batching.defvectorized(primitive)
    return primitive


_hidden_p = _type_only("manual_axes_hidden", lambda axes: frozenset())
_shown_p = _type_only("manual_axes_shown", lambda axes: axes)
ad.deflinear2(_hidden_p, lambda cotangent, x, axes: [_shown_p.bind(cotangent, axes=axes)])
ad.deflinear2(_shown_p, lambda cotangent, x, axes: [_hidden_p.bind(cotangent, axes=axes)])
