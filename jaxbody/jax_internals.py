"""What jaxbody takes from the inside of JAX, which no version promises: one function for each use, with a test and a way back."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jax.core import ShapedArray
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
        x = jax.lax.pcast(x, missing, to="varying") if hasattr(jax.lax, "pcast") else jax.lax.pvary(x, missing)  # pyright: ignore
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


# A linear function with a transpose of its own. `jax.linear_transpose` takes no loop of unknown length; `jax.custom_vjp` allows no forward
# mode; `jax.custom_derivatives.linear_call` has no derivative in what it is given.


def linear_with_transpose(
    forward: Callable[[Any, Any], Any], transpose: Callable[[Any, Any], Any], known: Any, moved: Any, like: Any
) -> Any:
    """forward(known, moved), linear in moved, arrays `like` these; its transpose by transpose(known, cotangents). The one of the two that is not
    needed is not traced. Neither may hold arrays of its own. Both are differentiable in whatever way they are by themselves."""
    given, tree = jax.tree.flatten((known, moved))
    n = len(jax.tree.leaves(known))
    known_tree = jax.tree.structure(known)

    def along(*x):
        return jax.tree.leaves(forward(*jax.tree.unflatten(tree, x)))

    def back(*x):
        return jax.tree.leaves(transpose(jax.tree.unflatten(known_tree, x[:n]), jax.tree.unflatten(jax.tree.structure(like), x[n:])))

    shapes = tuple((x.shape, x.dtype) for x in jax.tree.leaves(like))
    out = _linear_p.bind(*given, along=along, back=back, n=n, shapes=shapes)
    return jax.tree.unflatten(jax.tree.structure(like), out)


def _linear_jvp(primals, tangents, *, along, **params):
    moved = [not isinstance(t, ad.Zero) for t in tangents]

    def of_moved(*x):
        given = iter(x)
        return along(*(next(given) if m else p for m, p in zip(moved, primals, strict=True)))

    if any(moved[: params["n"]]):
        at = [p for p, m in zip(primals, moved, strict=True) if m]
        return jax.jvp(of_moved, at, [t for t, m in zip(tangents, moved, strict=True) if m])
    given = [ad.instantiate_zeros(t) for t in tangents[params["n"] :]]
    return _linear_p.bind(*primals, along=along, **params), _linear_p.bind(*primals[: params["n"]], *given, along=along, **params)


def _linear_transpose(cotangents, *args, back, n, **_):
    out = iter(back(*args[:n], *(ad.instantiate_zeros(c) for c in cotangents)))
    return [None] * n + [next(out) for _ in args[n:]]


def _linear_batch(args, axes, *, along, back, n, shapes):
    size = next(x.shape[axis] for x, axis in zip(args, axes, strict=True) if axis is not None)

    def back_over(*x):
        out = jax.vmap(back, in_axes=(*axes[:n], *(0 for _ in shapes)), axis_size=size)(*x)
        return [jnp.sum(c, 0) if axis is None else jnp.moveaxis(c, 0, axis) for c, axis in zip(out, axes[n:], strict=True)]

    along_over = jax.vmap(along, in_axes=tuple(axes), axis_size=size)
    shapes = tuple(((size, *shape), dtype) for shape, dtype in shapes)
    return _linear_p.bind(*args, along=along_over, back=back_over, n=n, shapes=shapes), [0] * len(shapes)


_linear_p = Primitive("linear_with_transpose")
_linear_p.multiple_results = True
_linear_p.def_impl(lambda *args, along, **_: along(*args))
_linear_p.def_abstract_eval(lambda *_, shapes, **__: [ShapedArray(*x) for x in shapes])
mlir.register_lowering(_linear_p, mlir.lower_fun(lambda *args, along, **_: along(*args), multiple_results=True))
ad.primitive_jvps[_linear_p] = _linear_jvp
ad.primitive_transposes[_linear_p] = _linear_transpose
batching.primitive_batchers[_linear_p] = _linear_batch
