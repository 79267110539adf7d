"""How XLA compiles: with optimization or without, both in less time than by default; and, if the user asks for it, fast loops on a CPU."""

from __future__ import annotations

import functools
import os
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jaxlib.version

from jaxbody.core.compilations import Compiled
from jaxbody.core.errors import JaxbodyError, Problem, warn
from jaxbody.core.jax_internals import outermost, started, without_manual_axes

TESTED = tuple((0, minor) for minor in range(7, 13))  # of jaxlib: XLA ends the process on an option that it does not know
HOLDER = "--xla_backend_extra_options="
OPTION = "xla_cpu_small_while_loop_byte_threshold"
WIDTH = "--xla_cpu_prefer_vector_width="  # in bits: all that the processor has; XLA's own choice is half of 512
NO_FUSION_EMITTERS = {"xla_cpu_use_fusion_emitters": False}  # two thirds of the time of compiling or less, and programs run as fast
UNOPTIMIZED = {"xla_backend_optimization_level": 0}  # half of what then remains, and programs take up to three times as long


def fast_loops() -> bool:
    """Have XLA compile every loop on a CPU into one function, whatever the size of the state that it carries (without this, below 1024
    bytes), and use vector instructions as wide as there are: simulations of small models then take 2 to 5 times less. Whether that could
    be done.

    It holds for the whole process and for everything that JAX compiles in it, so it is never done by itself. It must come before the first
    computation; `XLA_FLAGS` keeps what it has, and child processes inherit it. Only loops are compiled otherwise, no result changes but by
    rounding. A loop over long vectors loses, as it then runs on one core: 100 steps on a vector of 1e6 took twice the time on two cores, and would lose more on
    more. Of other programs, timed with and without (float32, two cores, jaxlib 0.10), a thousand random steps of 32 numbers took a quarter of the time; matrix products of 256 x 512 x 512
    in a loop, a loop over vectors of 1e3, a training step of a small network, a hundred in a loop, a recurrent network, sorting, a convolution
    stayed within the scatter. A loop body that holds LAPACK calls, sorts or scatters gains nothing. To be sure of yours, time it both ways.

    Errors: TOO_LATE where JAX has already looked for devices, unless the option is set. Warns UNTESTED_JAXLIB, and changes nothing, for a
    version of jaxlib with which it was not tried: XLA ends the process on options that it does not know.

    >>> done = fast_loops()  # doctest: +SKIP
    """
    flags = os.environ.get("XLA_FLAGS", "").split()
    if any(OPTION in flag for flag in flags):
        return True
    version = tuple(int(part) for part in jaxlib.version.__version__.split(".")[:2])
    if version not in TESTED:
        known = ", ".join(f"{major}.{minor}" for major, minor in TESTED)
        warn("UNTESTED_JAXLIB", f"fast_loops was tried with jaxlib {known}, not with {jaxlib.version.__version__}: nothing is changed")
        return False
    if started():
        hint = "Call jaxbody.fast_loops() first, before any array is made."
        raise JaxbodyError(
            Problem("TOO_LATE", "fast_loops", "JAX has already started on its devices, so the option has no effect", hint=hint)
        )
    others = [flag for flag in flags if not flag.startswith(HOLDER)]
    held = [flag.removeprefix(HOLDER) for flag in flags if flag.startswith(HOLDER)]  # XLA heeds the last of several only
    width = [] if any(flag.startswith(WIDTH) for flag in flags) else [WIDTH + "512"]
    os.environ["XLA_FLAGS"] = " ".join([*others, *width, HOLDER + ",".join([*held[-1:], f"{OPTION}=100000000"])])
    return True


def jit_optimized(function: Callable[..., Any]) -> Callable[..., Any]:
    """filter_jit for what runs long: optimized. Where it is not part of another program it compiles in two thirds of the time on a CPU."""
    return _jit_by_itself(function, {})


def jit_unoptimized(function: Callable[..., Any]) -> Callable[..., Any]:
    """filter_jit for what runs in milliseconds: not optimized. Where it is not part of another program it compiles in a third of the time."""
    return _jit_by_itself(function, UNOPTIMIZED)


def _jit_by_itself(function: Callable[..., Any], options: dict[str, Any]) -> Callable[..., Any]:
    part = eqx.filter_jit(without_manual_axes(function))
    compiled = Compiled(function)

    @functools.wraps(function)
    def noted(*args):
        compiled.begin()
        return function(*args)

    @functools.cache
    def whole():
        return eqx.filter_jit(noted, compiler_options=quick_options() | options)  # pyright: ignore  # goes on to jax.jit

    @functools.wraps(function)
    def call(*args):
        if not outermost():
            return part(*args)
        result = whole()(*args)
        if compiled.begun:
            compiled.end(args)
        return result

    return call


@functools.cache
def quick_options() -> dict[str, Any]:
    """Options for `jax.jit` with which a program of your own, a fit or a sweep, compiles in two thirds of the time or less on a CPU; what
    jaxbody compiles by itself already does.

    Simulations and frequencies run as fast; a training step of a neural network took 1.4 times as long. Nothing where XLA does not know
    them: jaxlib 0.10 does, 0.12 does not.

    >>> import jax
    >>> free_fall = jax.jit(lambda t: 9.81 * t**2 / 2, compiler_options=quick_options())
    >>> float(free_fall(2.0))
    19.62
    """
    try:
        jax.jit(lambda x: x, compiler_options=NO_FUSION_EMITTERS).lower(jax.ShapeDtypeStruct((), "float32")).compile()
    except jax.errors.JaxRuntimeError:
        return {}
    return NO_FUSION_EMITTERS
