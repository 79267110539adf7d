"""Batches on the last axis. `jax.vmap` puts a batch first, so that vectors of three leave most of a
processor's wide registers empty.

A function that is `in_lanes` has the same results, but in a batch its operations are rewritten one
by one so that arrays (3,) become (3, b), with at most `lanes` members at a time. Operations without
a rule here are left to jax.vmap; so is the whole function on devices other than CPUs, and where a
rule fails, as it may when JAX changes an operation. `compile_times` shows both. Custom derivatives
are kept.
"""

import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.dtypes import float0

from jaxbody.core.arrays import Array
from jaxbody.core.compilation.compilations import note_left_to_vmap
from jaxbody.core.jax_internals import (
    CALLS,
    ClosedJaxpr,  # pyright: ignore[reportPrivateImportUsage]
    Literal,
    Zero,
    call_of,
    chosen,
    fixpoint,
    jaxpr_as_fun,
    merged,
    only_what_is_needed,
    parts_of_scan,
    reach,
    reach_of,
    reach_of_while,
    same_operation,
    with_open_constants,
    without_high_operations,
)
from jaxbody.numerics.symmetric_eigenvalues import eigenvalues
from jaxbody.numerics.xla_workarounds import sum_p

LANES = 32
ELEMENTWISE = {
    "abs",
    "acos",
    "add",
    "add_any",
    "and",
    "asin",
    "atan",
    "atan2",
    "cbrt",
    "ceil",
    "clamp",
    "convert_element_type",
    "copy",
    "cos",
    "cosh",
    "div",
    "eq",
    "eq_to",
    "erf",
    "exp",
    "exp2",
    "expm1",
    "floor",
    "ge",
    "gt",
    "integer_pow",
    "is_finite",
    "le",
    "le_to",
    "log",
    "log1p",
    "logistic",
    "lt",
    "lt_to",
    "max",
    "min",
    "mul",
    "ne",
    "neg",
    "nextafter",
    "not",
    "or",
    "pow",
    "rem",
    "round",
    "rsqrt",
    "select_n",
    "sign",
    "sin",
    "sinh",
    "sqrt",
    "square",
    "sub",
    "tan",
    "tanh",
    "xor",
}
SAME_AXES = {
    "argmax",
    "argmin",
    "cummax",
    "cummin",
    "cumsum",
    "reduce_and",
    "reduce_max",
    "reduce_min",
    "reduce_or",
    "reduce_prod",
    "reduce_sum",
    "rev",
    "split",
    "squeeze",
    "sum_in_lanes",
}
# {operation: (number of its first arguments, which alone may have a last axis of n lanes, function
# of (arguments, parameters, n))}
WITH_LANES: dict[str, tuple[int, Callable[[list[Array], dict[str, Any], int], Array]]] = {
    "any_of_batch": (1, lambda x, p, n: jnp.any(x[0], -1)),
    "broadcast_in_dim": (
        1,
        lambda x, p, n: lax.broadcast_in_dim(
            x[0], (*p["shape"], n), (*p["broadcast_dimensions"], len(p["shape"]))
        ),
    ),
    "dynamic_slice": (
        1,
        lambda x, p, n: lax.dynamic_slice(
            x[0], (*x[1:], jnp.zeros_like(x[1])), (*p["slice_sizes"], n)
        ),
    ),
    "dynamic_update_slice": (
        2,
        lambda x, p, n: lax.dynamic_update_slice(x[0], x[1], (*x[2:], jnp.zeros_like(x[2]))),
    ),
    "pad": (1, lambda x, p, n: lax.pad(x[0], x[1], (*p["padding_config"], (0, 0, 0)))),
    "reshape": (1, lambda x, p, n: lax.reshape(x[0], (*p["new_sizes"], n))),
    "slice": (
        1,
        lambda x, p, n: lax.slice(
            x[0],
            (*p["start_indices"], 0),
            (*p["limit_indices"], n),
            p["strides"] and (*p["strides"], 1),
        ),
    ),
    "transpose": (1, lambda x, p, n: lax.transpose(x[0], (*p["permutation"], x[0].ndim - 1))),
}
APART = {
    "cholesky",
    "cond",
    "custom_linear_solve",
    "custom_vjp_call",
    "dot_general",
    "dynamic_slice",
    "dynamic_update_slice",
    "eigh",
    "gather",
    "householder_product",
    "lu",
    "scatter",
    "scatter-add",
    "sort",
    "stop_gradient",
    "triangular_solve",
}  # left to jax.vmap, because it is fast for them or they are rare


def _no_lanes() -> str:
    """Return the reason why lanes cannot be used; "" if they can."""
    platform = jax.default_backend()
    return "" if platform == "cpu" else f"lanes are for a CPU, this is a {platform}"


def in_lanes(
    function: Callable, *, reversible: bool = False, lanes: int = LANES, name: str = ""
) -> Callable[..., Any]:
    """Return the function in a form whose batches are computed in chunks, with the members of a
    chunk on the last axis.

    Args:
        function: a function from arrays to arrays
        reversible: keep the derivatives of the function itself, for reverse mode; False: the
            forward derivative is in lanes too
        lanes: members of the batch in a chunk
        name: its name in `compile_times`; "": module and name of the function
    """
    name = name or f"{function.__module__.rpartition('.')[2]}.{function.__name__}"

    def wrapped(*args):
        args = jax.tree.map(jnp.asarray, args)
        traced, out = jax.make_jaxpr(function, return_shape=True)(*args)
        traced = only_what_is_needed(traced)
        results = _lanes_p.bind(
            *traced.consts,
            *jax.tree.leaves(args),
            jaxpr=with_open_constants(traced),
            reversible=reversible,
            lanes=lanes,
            name=name,
        )
        return jax.tree.unflatten(jax.tree.structure(out), results)

    return wrapped


def vmap_last(function: Callable) -> Callable[[Array], Any]:
    """Map a function of one array over its last axis; results have that axis last."""

    def over(x: Array):
        if _no_lanes():
            return jax.vmap(function, in_axes=-1, out_axes=-1)(x)
        traced, out = jax.make_jaxpr(function, return_shape=True)(x[..., 0])
        traced = without_high_operations(traced)
        results = Lanes(x.shape[-1]).run(traced, [True], [x], [True] * len(traced.out_avals))
        return jax.tree.unflatten(jax.tree.structure(out), results)

    return over


def _jvp(primals, tangents, *, jaxpr, reversible, lanes, name):
    moved = [not isinstance(t, Zero) for t in tangents]
    smooth = [jnp.issubdtype(aval.dtype, jnp.inexact) for aval in jaxpr.out_avals]
    if not any(smooth):
        out = _lanes_p.bind(*primals, jaxpr=jaxpr, reversible=reversible, lanes=lanes, name=name)
        return out, [Zero(aval.to_tangent_aval()) for aval in jaxpr.out_avals]

    push = _pushed(jaxpr_as_fun(jaxpr), moved, smooth)
    push = push if reversible else in_lanes(push, lanes=lanes, name=name)
    out, dy = push(list(primals), [t for t in tangents if not isinstance(t, Zero)])
    return out, merged(smooth, dy, [Zero(aval.to_tangent_aval()) for aval in jaxpr.out_avals])


def _pushed(
    function: Callable, moved: list[bool], smooth: list[bool]
) -> Callable[[list, list], tuple[list, list]]:
    """Return a function of (arguments, tangents of the arguments that are `moved`) that returns
    (results, tangents of the results that are `smooth`, of a floating type)."""

    def pushed(primals, tangents):
        def of_moved(*x):
            out = function(*merged(moved, x, primals))
            return chosen(out, smooth), out

        _, dy, out = jax.jvp(of_moved, chosen(primals, moved), tangents, has_aux=True)
        return out, dy

    return pushed


def _batch(args, axes, *, jaxpr, reversible, lanes, name):
    """Compute a batch in lanes, or by jax.vmap if lanes do not apply or fail with this version of
    JAX. Return results and the axis of the batch in each."""
    why = _no_lanes()
    try:
        if not why:
            return _in_chunks(args, axes, without_high_operations(jaxpr), lanes, name)
    except Exception as error:  # of any kind, depending on the change in JAX
        why = f"{type(error).__name__}: {error}".partition("\n")[0]
    note_left_to_vmap(name, why)
    reached = reach(without_high_operations(jaxpr), [axis is not None for axis in axes])
    out_axes = [0 if r else None for r in reached]
    return jax.vmap(jaxpr_as_fun(jaxpr), in_axes=tuple(axes), out_axes=out_axes)(*args), out_axes


def _in_chunks(args, axes, jaxpr: ClosedJaxpr, lanes: int, name: str):
    """Compute a batch in chunks, so that memory does not grow with it."""
    on = [axis is not None for axis in axes]
    args = [
        jnp.moveaxis(x, axis, -1) if o else x for x, axis, o in zip(args, axes, on, strict=True)
    ]
    n = next(x.shape[-1] for x, o in zip(args, on, strict=True) if o)
    reached = reach(jaxpr, on)
    if n <= lanes:
        out = Lanes(n, name).run(jaxpr, on, args)
        return out, [x.ndim - 1 if o else None for x, o in zip(out, reached, strict=True)]

    def chunk(i, joined):
        """Compute one chunk.

        The last chunk is moved back to be complete: some members are then computed twice, and no
        array is padded."""
        begin = jnp.minimum(i * lanes, n - lanes)
        given = [
            lax.dynamic_slice_in_dim(x, begin, lanes, -1) if o else x
            for x, o in zip(args, on, strict=True)
        ]
        out = Lanes(lanes, name).run(jaxpr, on, given)
        return [
            lax.dynamic_update_slice_in_dim(whole, part, begin, -1) if o else part
            for whole, part, o in zip(joined, out, reached, strict=True)
        ]

    types: list[Any] = list(jaxpr.out_avals)
    empty = [
        jnp.zeros((*a.shape, n) if o else a.shape, a.dtype)
        for a, o in zip(types, reached, strict=True)
    ]
    joined = lax.fori_loop(0, -(-n // lanes), chunk, empty)
    return joined, [x.ndim - 1 if o else None for x, o in zip(joined, reached, strict=True)]


_lanes_p = call_of("in_lanes", batch=_batch, jvp=_jvp)


@functools.lru_cache(4096)
def _function(
    jaxpr: ClosedJaxpr, on: tuple[bool, ...], n: int, name: str
) -> Callable[..., list[Any]]:
    """Return the body of a call for n members at once, jitted: JAX keeps its trace for all calls of
    one jitted function."""
    return jax.jit(lambda *x: Lanes(n, name).run(jaxpr, list(on), list(x)))


class Lanes:
    """Evaluates jaxprs for n members at once."""

    def __init__(self, n: int, name: str = "vmap_last"):
        self.n, self.name = n, name

    def run(
        self, jaxpr: ClosedJaxpr, on: list[bool], args: list[Any], wanted: list[bool] | None = None
    ) -> list[Any]:
        """Return the results of a jaxpr.

        Args:
            jaxpr: the jaxpr to be evaluated
            on: True for arguments with a last axis of lanes
            args: its arguments
            wanted: True for results that must have that axis; None: only those that depend on the
                lane have it
        """
        # {variable: (its value, True with a last axis of lanes)}
        known: dict[Any, tuple[Any, bool]] = {
            x: (value, False) for x, value in zip(jaxpr.jaxpr.constvars, jaxpr.consts, strict=True)
        }
        known |= dict(zip(jaxpr.jaxpr.invars, zip(args, on, strict=True), strict=True))

        def look(x):
            return (x.val, False) if isinstance(x, Literal) else known[x]

        for eqn in jaxpr.jaxpr.eqns:
            given, of_lanes = zip(*map(look, eqn.invars), strict=True) if eqn.invars else ((), ())
            reached = reach_of(eqn, list(of_lanes))
            out = (
                self._apply(eqn, list(of_lanes), list(given))
                if any(of_lanes)
                else same_operation(eqn, given)
            )
            known |= dict(zip(eqn.outvars, zip(out, reached, strict=True), strict=True))
        outvars: list[Any] = jaxpr.jaxpr.outvars
        results = [look(x) for x in outvars]
        wanted = [o for _, o in results] if wanted is None else wanted
        return [
            self._spread(x, o, v.aval.shape) if w else x
            for (x, o), v, w in zip(results, outvars, wanted, strict=True)
        ]

    def _spread(self, x, on: bool, shape) -> Array:
        """Return x with the given shape and lanes; a scalar, or one scalar for each lane, is
        repeated."""
        x = jnp.asarray(x)
        axes = tuple(range(len(shape))) if x.ndim - on == len(shape) else ()
        return (
            x
            if x.shape == (*shape, self.n)
            else lax.broadcast_in_dim(x, (*shape, self.n), (*axes, len(shape)) if on else axes)
        )

    def _apply(self, eqn, on: list[bool], x: list[Any]) -> list[Any]:
        name, p, n = eqn.primitive.name, dict(eqn.params), self.n
        if name in CALLS:
            return _function(p[CALLS[name]], tuple(on), n, self.name)(*x)
        if name in ELEMENTWISE:
            shape = eqn.outvars[0].aval.shape
            return [
                eqn.primitive.bind(
                    *(self._spread(a, o, shape) for a, o in zip(x, on, strict=True)), **p
                )
            ]
        if name == "reduce_sum" and jnp.issubdtype(x[0].dtype, jnp.floating):
            return [sum_p.bind(x[0], axes=tuple(p["axes"]))]
        if name in SAME_AXES:
            return same_operation(eqn, x)
        if name in ("concatenate", "stack"):
            parts = [
                self._spread(a, o, v.aval.shape) for a, o, v in zip(x, on, eqn.invars, strict=True)
            ]
            return [eqn.primitive.bind(*parts, **p)]
        arrays, rule = WITH_LANES.get(name, (0, None))
        if rule is not None and not any(on[arrays:]):
            spread = [
                self._spread(a, o, v.aval.shape)
                for a, o, v in zip(x[:arrays], on, eqn.invars, strict=False)
            ]
            return [rule([*spread, *x[arrays:]], p, n)]
        if name == "gather" and not on[1]:
            axes = p["dimension_numbers"]
            axes = axes._replace(offset_dims=(*axes.offset_dims, eqn.outvars[0].aval.ndim))
            return [
                lax.gather_p.bind(
                    *x, **p | {"dimension_numbers": axes, "slice_sizes": (*p["slice_sizes"], n)}
                )
            ]
        # eigenvectors by LAPACK; XLA drops them where they are not used
        if name == "eigh" and x[0].ndim == 3 and jnp.issubdtype(x[0].dtype, jnp.floating):
            traced = jax.make_jaxpr(eigenvalues)(jax.ShapeDtypeStruct(x[0].shape[:-1], x[0].dtype))
            return [self._by_vmap(eqn, on, x)[0], *self.run(traced, on, x)]
        if name == "custom_jvp_call":
            return self._with_own_rule(eqn, on, x)
        if name == "while":
            return self._while(p, on, x)
        if name == "cond" and on[0] and len(p["branches"]) == 2:
            return self._cond(eqn, on, x)
        if name == "scan":
            return self._scan(eqn, on, x)
        if name not in APART:
            note_left_to_vmap(
                self.name, f"no rule for {name}; only this operation is left to jax.vmap"
            )
        return self._by_vmap(eqn, on, x)

    def _by_vmap(self, eqn, on: list[bool], x: list[Any]) -> list[Any]:
        axes = [-1 if o else None for o in on]
        out = jax.vmap(
            lambda *x: same_operation(eqn, x), in_axes=axes, out_axes=-1, axis_size=self.n
        )(*x)
        return [a if r else a[..., 0] for a, r in zip(out, reach_of(eqn, on), strict=True)]

    def _with_own_rule(self, eqn, on: list[bool], x: list[Any]) -> list[Any]:
        """Evaluate an operation with a rule of its own for the derivative; if the batch is
        differentiated, that rule is applied, in lanes."""
        outs = [v.aval for v in eqn.outvars]
        moved, smooth = (
            [jnp.issubdtype(aval.dtype, jnp.inexact) for aval in avals]
            for avals in ([v.aval for v in eqn.invars], outs)
        )

        @jax.custom_jvp
        def call(*x):
            return self.run(eqn.params["call_jaxpr"], on, list(x), [True] * len(outs))

        @call.defjvp
        def _(primals, tangents):
            axes = [-1 if o else None for o in on]
            push = in_lanes(
                _pushed(lambda *x: same_operation(eqn, x), moved, smooth),
                reversible=True,
                lanes=self.n,
                name=self.name,
            )
            along = axes, chosen(axes, moved)
            out, dy = jax.vmap(push, in_axes=along, out_axes=-1, axis_size=self.n)(
                list(primals), chosen(tangents, moved)
            )
            return out, merged(smooth, dy, [np.zeros(y.shape, float0) for y in out])

        return call(*x)

    def _cond(self, eqn, on, x):
        """Evaluate both branches; that of True only if at least one lane takes it."""

        def result(branch):
            return self.run(branch, on[1:], x[1:], [True] * len(eqn.outvars))

        of_false, of_true = eqn.params["branches"]
        takes, otherwise = x[0].astype(bool), result(of_false)
        taken = lax.cond(jnp.any(takes), lambda: result(of_true), lambda: otherwise)
        return [jnp.where(takes, a, b) for a, b in zip(taken, otherwise, strict=True)]

    def _while(self, p, on, x):
        """Run a loop whose lanes may end at different steps until the last one has ended; lanes
        that have ended keep their values."""
        a, b = p["cond_nconsts"], p["cond_nconsts"] + p["body_nconsts"]
        apart, carry = reach_of_while(p, on)
        carry = [True] * len(carry) if apart else carry

        def goes_on(c):
            return self.run(p["cond_jaxpr"], on[:a] + carry, [*x[:a], *c])[0]

        def step(c):
            after = self.run(p["body_jaxpr"], on[a:b] + carry, [*x[a:b], *c], carry)
            if not apart:
                return after
            active = goes_on(c)
            return [jnp.where(active, new, old) for new, old in zip(after, c, strict=True)]

        start = [
            self._spread(v, o, av.shape) if c else v
            for v, o, c, av in zip(
                x[b:], on[b:], carry, p["body_jaxpr"].in_avals[b - a :], strict=True
            )
        ]
        return lax.while_loop(lambda c: jnp.any(goes_on(c)), step, start)

    def _scan(self, eqn, on, x):
        a, b = parts_of_scan(eqn)
        p, body = eqn.params, eqn.params["jaxpr"]
        carry = fixpoint(body, on[:a], on[a:b], on[b:])
        start = [
            self._spread(v, o, av.shape) if c else v
            for v, o, c, av in zip(x[a:b], on[a:b], carry, body.in_avals[a:b], strict=True)
        ]
        inputs = on[:a] + carry + on[b:]
        wanted = carry + reach(body, inputs)[len(carry) :]

        def step(c, xs):
            out = self.run(body, inputs, [*x[:a], *c, *xs], wanted)
            return out[: len(carry)], out[len(carry) :]

        end, ys = lax.scan(
            step, start, x[b:], length=p["length"], reverse=p["reverse"], unroll=p["unroll"]
        )
        return [*end, *ys]
