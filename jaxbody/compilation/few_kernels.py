"""Short programs in a few kernels of XLA, each of many simple operations, where every few operations would be a kernel of their own.

jaxlib 0.12 compiles a kernel in 4 ms, whatever its size, and no option avoids it. XLA itself marks short loops by an attribute and compiles
each of them as one function in an older way, which takes less time; here runs of simple operations are called with this attribute.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import jax
import jaxlib.version
import numpy as np

from jaxbody.compilation.program_parts import parts_of, programs_inside, read
from jaxbody.core.jax_internals import ClosedJaxpr, call_of, same_operation, without_high_operations

VERSIONS = ((0, 12),)  # of jaxlib, which were tried; with 0.10, where an option avoids the newer way, this takes as long
MARKS = {"xla_cpu_small_call": "true", "inlineable": "false"}
OPTIONS = {"xla_cpu_experimental_ynn_fusion_type": ""}  # products of matrices are not library calls, which a kernel cannot hold
LARGEST = 50_000  # numbers in an array; work on larger ones is shared by the cores
MOST_PRODUCTS = 100_000  # in a product of matrices; larger ones are faster in a library
ELEMENTWISE = (
    "abs acos acosh add add_any and asin asinh atan atan2 atanh cbrt ceil clamp complex conj copy cos cosh div eq erf erf_inv erfc "
    "exp exp2 expm1 floor ge gt imag integer_pow is_finite le log log1p logistic lt max min mul ne neg nextafter not or pow real rem "
    "round rsqrt select_n shift_left shift_right_arithmetic shift_right_logical sign sin sinh sqrt square stop_gradient sub tan tanh "
    "xor"
)
STRUCTURAL = (
    "argmax argmin broadcast_in_dim concatenate convert_element_type cummax cummin cumprod cumsum dot_general "
    "dynamic_slice dynamic_update_slice gather iota pad reduce reduce_and reduce_max reduce_min reduce_or reduce_prod "
    "reduce_sum reshape rev slice split squeeze stack transpose unstack"
)
OF_JAXBODY = "any_of_batch kept_in_lanes sum_in_lanes"
CALLS = ("closed_call", "core_call", "custom_jvp_call", "custom_vjp_call", "eval_jaxpr", "in_lanes", "jit", "pjit", "remat", "checkpoint")
BODIES = {"scan": "jaxpr", "while": "body_jaxpr"}  # loops, and which parameter is their body
SIMPLE = {*ELEMENTWISE.split(), *STRUCTURAL.split(), *OF_JAXBODY.split(), *CALLS, *BODIES, "cond", "custom_linear_solve"}


def jaxlib_version() -> tuple[int, int]:
    """The first two numbers of the version."""
    major, minor = jaxlib.version.__version__.split(".")[:2]
    return int(major), int(minor)


def debugging() -> bool:
    """Whether JAX runs operations one by one, or looks for NaN in the results of a program."""
    return any(getattr(jax.config, f"jax_{name}") for name in ("disable_jit", "debug_nans", "debug_infs"))


def in_few_kernels(function: Callable[..., Any]) -> Callable[..., Any]:
    """The function of trees of arrays, with runs of simple operations as kernels."""

    def run(*args):
        if debugging():
            return function(*args)
        traced, results = jax.make_jaxpr(function, return_shape=True)(*args)
        return jax.tree.unflatten(jax.tree.structure(results), evaluated(without_high_operations(traced), jax.tree.leaves(args)))

    run.__name__ = function.__name__
    return run


def evaluated(program: ClosedJaxpr, arrays: Sequence[Any]) -> list[Any]:
    """The results of a program; operations that are not simple stand alone between the kernels, or their own programs are evaluated so."""
    jaxpr = program.jaxpr
    known = dict(zip([*jaxpr.constvars, *jaxpr.invars], [*program.consts, *arrays], strict=True))
    for alone, equations, needed, kept in parts_of(jaxpr, lambda equation: not is_simple(equation)):
        if alone is not None:
            args = read(known, alone.invars)
            called = alone.primitive.name in CALLS
            out = evaluated(_called(alone), args) if called else same_operation(_with_kernels_inside(alone), args)
            known |= zip(alone.outvars, out, strict=True)
        elif kept:
            # arguments are results, too: XLA ends the process where a kernel does not use one of them
            kernel = jaxpr.replace(constvars=[], invars=needed, outvars=[*kept, *needed], eqns=equations)
            out = _kernel_p.bind(*read(known, needed), jaxpr=ClosedJaxpr(kernel, []))
            known |= zip(kept, out[: len(kept)], strict=True)
    return read(known, jaxpr.outvars)


def is_simple(equation: Any) -> bool:
    """Whether an operation and all inside it have few numbers, and XLA compiles them without other libraries."""
    return (
        equation.primitive.name in SIMPLE
        and not equation.effects
        and all(_is_small(x.aval) for x in (*equation.invars, *equation.outvars))
        and (equation.primitive.name != "dot_general" or _products(equation) <= MOST_PRODUCTS)
        and all(is_simple(inner) for program in programs_inside(equation) for inner in program.eqns)
    )


def _is_small(aval: Any) -> bool:
    return isinstance(getattr(aval, "dtype", None), np.dtype) and aval.dtype.kind in "biufc" and aval.size <= LARGEST


def _products(equation: Any) -> int:
    (contracted, _), _ = equation.params["dimension_numbers"]
    return equation.outvars[0].aval.size * int(np.prod([equation.invars[0].aval.shape[i] for i in contracted]))


def _with_kernels_inside(equation: Any) -> Any:
    """The same loop or branches, with runs of simple operations in them as kernels."""

    def divided(program):
        return jax.make_jaxpr(lambda *arrays: evaluated(program, arrays))(*program.in_avals)

    name, params = equation.primitive.name, equation.params
    if name in BODIES:
        return equation.replace(params=params | {BODIES[name]: divided(params[BODIES[name]])})
    if name == "cond":
        return equation.replace(params=params | {"branches": tuple(map(divided, params["branches"]))})
    return equation


def _called(equation: Any) -> ClosedJaxpr:
    """The program of a call."""
    return equation.params["call_jaxpr" if "call_jaxpr" in equation.params else "jaxpr"]


_kernel_p = call_of("kernel", attributes=MARKS)
