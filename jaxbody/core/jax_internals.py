"""Internal functions of JAX that jaxbody uses, with an alternative where a version lacks them;
`lanes` has rules for operations by name.

    trace_state_clean             whether a function is called outside of jit, grad and vmap;
                                  without it compile options are left out
    ClosedJaxpr, Literal          programs and constants in them, which `lanes` rewrites; without
                                  `lanes` all batches are those of jax.vmap
    Primitive, primitive_jvps, primitive_transposes, deflinear2, primitive_batchers,
    register_lowering, lower_fun, core_call_lowering
                                  operations with rules of their own; custom_jvp and custom_vmap
                                  are the alternative, but are traced more often
    Zero, instantiate_zeros       tangents that are known to be zero, in such rules
    dce_jaxpr, dce_rules          removes what results do not need; without them more is computed

Changes of JAX that matter here:
0.10  most names of jax.core move to `jax.extend.core`; the last version for Python 3.11
0.11  `jax.experimental.hijax`: "high" operations with their own rules, which are replaced by others
      before a program is compiled
0.12  jnp.searchsorted is one, and so is jnp.interp: `without_high_operations`. `ClosedJaxpr` is
      `Jaxpr`. XLA always uses fusion emitters
Expected: JAX's documents recommend high operations for custom rules; custom_jvp and custom_vjp
exist in that form but are not used yet. Programs will then have `call_hi_primitive` where `lanes`
has a rule for `custom_jvp_call`, and `without_high_operations` would drop their rules.
"""

import functools
from collections.abc import Callable, Sequence
from typing import Any

import jax
from jax.core import ShapedArray, Tracer, eval_jaxpr
from jax.extend.core import ClosedJaxpr, Literal, Primitive  # pyright: ignore[reportPrivateImportUsage]
from jax.interpreters import ad, batching, mlir, partial_eval
from jax.interpreters.ad import Zero, instantiate_zeros

__all__ = ["ClosedJaxpr", "Literal", "Tracer", "Zero", "instantiate_zeros"]  # used by other modules


# State of JAX


def outermost() -> bool:
    """Return whether no transformation of JAX (jit, grad, vmap) is tracing. False where JAX gives
    no answer: callers are then slower, but correct."""
    try:
        from jax._src import core

        return core.trace_state_clean()
    except (ImportError, AttributeError):
        return False


def chosen(x: Sequence[Any], which: Sequence[bool]) -> list[Any]:
    """Return the elements of x for which `which` is True, in order."""
    return [y for y, c in zip(x, which, strict=True) if c]


def merged(which: Sequence[bool], given: Sequence[Any], others: Sequence[Any]) -> list[Any]:
    """Return a list with the elements of `given`, in order, where `which` is True, and those of
    `others` elsewhere."""
    own = iter(given)
    return [next(own) if c else x for c, x in zip(which, others, strict=True)]


# Programs


def jaxpr_as_fun(jaxpr: ClosedJaxpr) -> Callable[..., list[Any]]:
    """Return the function that runs a program (a jaxpr)."""
    return functools.partial(eval_jaxpr, jaxpr.jaxpr, jaxpr.consts)


# whether functions with custom rules keep their derivatives in `only_what_is_needed`
REST_HAS_DERIVATIVES = jax.__version_info__ >= (0, 8)


def only_what_is_needed(jaxpr: ClosedJaxpr) -> ClosedJaxpr:
    """Return the program without operations that its results do not need, where JAX can remove
    them."""
    if not hasattr(partial_eval, "dce_jaxpr"):
        return jaxpr
    return ClosedJaxpr(
        partial_eval.dce_jaxpr(jaxpr.jaxpr, [True] * len(jaxpr.out_avals), instantiate=True)[0],
        jaxpr.consts,
    )


def without_high_operations(jaxpr: ClosedJaxpr) -> ClosedJaxpr:
    """Return the same program in operations with batching and lowering rules.

    Since version 0.12 a program may have "high" operations, such as searchsorted, which JAX
    replaces by others just before it compiles."""
    if not getattr(jaxpr, "is_high", False):
        return jaxpr
    opened = with_open_constants(jaxpr)
    low = jax.jit(jaxpr_as_fun(opened)).trace(*opened.in_avals).lojax.jaxpr  # pyright: ignore
    n, inner = len(jaxpr.consts), low.jaxpr
    closed = inner.replace(
        constvars=[*inner.invars[:n], *inner.constvars], invars=[*inner.invars[n:]]
    )
    return ClosedJaxpr(closed, [*jaxpr.consts, *low.consts])


def with_open_constants(jaxpr: ClosedJaxpr) -> ClosedJaxpr:
    """Return the program with its constants as its first arguments."""
    inner = jaxpr.jaxpr
    return ClosedJaxpr(inner.replace(constvars=[], invars=[*inner.constvars, *inner.invars]), [])


def same_operation(equation: Any, args: Sequence[Any]) -> list[Any]:
    """Return the results of the operation of one equation of a program, with other arguments."""
    params = equation.primitive.get_bind_params(equation.params)
    functions, params = params if isinstance(params, tuple) else ((), params)
    out = equation.primitive.bind(*functions, *args, **params)
    return list(out) if equation.primitive.multiple_results else [out]


# Which results of a program depend on some of its arguments

CALLS = {
    "in_lanes": "jaxpr",
    "jit": "jaxpr",
    "pjit": "jaxpr",
    "closed_call": "call_jaxpr",
}


def reach(jaxpr: ClosedJaxpr, on: list[bool]) -> list[bool]:
    """Return which results of a program depend on those arguments for which `on` is True."""
    known = dict(zip(jaxpr.jaxpr.invars, on, strict=True))
    for eqn in jaxpr.jaxpr.eqns:
        given = [not isinstance(x, Literal) and known.get(x, False) for x in eqn.invars]
        known |= dict(zip(eqn.outvars, reach_of(eqn, given), strict=True))
    return [not isinstance(x, Literal) and known.get(x, False) for x in jaxpr.jaxpr.outvars]


def reach_of(eqn, on: list[bool]) -> list[bool]:
    """Return which results of one operation depend on those of its arguments for which `on` is
    True."""
    name, p = eqn.primitive.name, eqn.params
    if name in CALLS:
        return reach(p[CALLS[name]], on)
    if name == "while" and any(on):
        ends_apart, carry = reach_of_while(p, on)
        return [True] * len(carry) if ends_apart else carry
    if name == "scan":
        consts, end = parts_of_scan(eqn)
        carry = fixpoint(p["jaxpr"], on[:consts], on[consts:end], on[end:])
        return carry + reach(p["jaxpr"], on[:consts] + carry + on[end:])[len(carry) :]
    if name == "cond" and not on[0]:
        return [
            any(of) for of in zip(*(reach(branch, on[1:]) for branch in p["branches"]), strict=True)
        ]
    return [any(on) and name != "any_of_batch"] * len(eqn.outvars)


def reach_of_while(p, on: list[bool]) -> tuple[bool, list[bool]]:
    """Return whether the condition of a while loop depends on those arguments for which `on` is
    True, and which of its carried values do."""
    a, b = p["cond_nconsts"], p["cond_nconsts"] + p["body_nconsts"]
    carry = fixpoint(p["body_jaxpr"], on[a:b], on[b:], [])
    return reach(p["cond_jaxpr"], on[:a] + carry)[0], carry


def parts_of_scan(eqn) -> tuple[int, int]:
    """Return where the carry begins and ends among the arguments of a scan.

    Carried values have the same shape in its body; mapped ones do not."""

    def alike(outer, inner):
        return sum(a.aval.shape == b.aval.shape for a, b in zip(outer, inner, strict=True))

    body = eqn.params["jaxpr"].jaxpr
    carried, end = alike(eqn.outvars, body.outvars), alike(eqn.invars, body.invars)
    return end - carried, end


def fixpoint(
    body: ClosedJaxpr, consts: list[bool], carry: list[bool], xs: list[bool]
) -> list[bool]:
    """Return which carried values of a loop depend, after any number of steps, on the values that
    are `on` (True in `consts`, `carry` and `xs`)."""
    while True:
        after = [a or b for a, b in zip(carry, reach(body, consts + carry + xs), strict=False)]
        if after == carry:
            return carry
        carry = after


# New operations


def new_operation(
    name: str,
    compute: Callable[..., Any],
    *,
    batch: Callable[..., Any] | None = None,
    typed: Callable[..., Any] | None = None,
    several: bool = False,
    lowered: Callable[..., Any] | None = None,
    jvp: Callable[..., Any] | None = None,
    transpose: Callable[..., Any] | None = None,
) -> Primitive:
    """Make an operation of JAX that computes a function of (*arrays, **parameters).

    Args:
        name: its name in programs.
        compute: the function; it returns one array, or several.
        batch: its rule for jax.vmap.
        typed: the types of results; by default those of `compute`.
        several: whether it returns several arrays.
        lowered: its rule of lowering; by default that of `compute`.
        jvp: its rule for forward mode; without it, but with a transpose, the operation is linear.
        transpose: its rule for reverse mode.
    """
    primitive = Primitive(name)
    primitive.multiple_results = several
    primitive.def_impl(compute)
    primitive.def_abstract_eval(typed or functools.partial(_type_of, compute))
    mlir.register_lowering(primitive, lowered or mlir.lower_fun(compute, multiple_results=several))
    if batch is not None:
        batching.primitive_batchers[primitive] = batch
    if jvp is not None:
        ad.primitive_jvps[primitive] = jvp
    if transpose is not None and jvp is not None:
        ad.primitive_transposes[primitive] = transpose
    elif transpose is not None:
        ad.deflinear2(primitive, transpose)
    return primitive


def with_tangent(change: Callable[..., Any]) -> Callable[..., Any]:
    """Make the function (x, *known) -> x whose tangent is change(tangent of x, x, *known)."""

    @jax.custom_jvp
    def same(x, *known):
        return x

    @same.defjvp
    def _(primals, tangents):
        return same(*primals), change(tangents[0], *primals)

    return same


def call_of(name: str, **rules: Any) -> Primitive:
    """Make an operation that runs its parameter `jaxpr`."""
    primitive = new_operation(
        name,
        lambda *args, jaxpr, **_: jaxpr_as_fun(jaxpr)(*args),
        typed=lambda *args, jaxpr, **_: jaxpr.out_avals,
        several=True,
        lowered=lambda context, *args, jaxpr, **_: mlir.core_call_lowering(
            context, *args, name=name, call_jaxpr=jaxpr
        ),
        **rules,
    )

    def only_needed(used, *given):  # where JAX removes operations
        if not any(used):
            return [False] * len(given[-1].invars), None
        eqn = given[-1]
        part, needed = partial_eval.dce_jaxpr((whole := eqn.params["jaxpr"]).jaxpr, used)
        variables = {"invars": chosen(eqn.invars, needed), "outvars": chosen(eqn.outvars, used)}
        return needed, eqn.replace(
            **variables, params=eqn.params | {"jaxpr": ClosedJaxpr(part, whole.consts)}
        )

    getattr(partial_eval, "dce_rules", {})[primitive] = only_needed
    primitive.is_high = lambda *_, jaxpr, **__: getattr(jaxpr, "is_high", False)  # pyright: ignore
    primitive.to_lojax = lambda *args, jaxpr, **params: primitive.bind(
        *args, jaxpr=without_high_operations(jaxpr), **params
    )
    return primitive


def _type_of(compute: Callable[..., Any], *avals: Any, **parameters: Any) -> ShapedArray:
    out = jax.eval_shape(
        functools.partial(compute, **parameters),
        *(jax.ShapeDtypeStruct(a.shape, a.dtype) for a in avals),
    )
    return shaped(out.shape, out.dtype)


def shaped(shape: tuple[int, ...], dtype: Any) -> ShapedArray:
    """Return the type of an array, on the current mesh of devices."""
    mesh = jax.sharding.get_abstract_mesh()
    if mesh.empty:
        return ShapedArray(shape, dtype)
    return ShapedArray(
        shape,
        dtype,
        sharding=jax.sharding.NamedSharding(
            mesh, jax.sharding.PartitionSpec(*(None for _ in shape))
        ),
    )
