"""Options of XLA: faster compilation, with and without optimization, and on request fast loops on a CPU."""

from __future__ import annotations

import functools
import os
from collections.abc import Callable
from typing import Any

import jax
import jaxlib.version

from jaxbody.compilation.array_functions import KEPT, array_function, jitted, joined, known_to_xla
from jaxbody.compilation.compilations import Compiled
from jaxbody.compilation.eager_programs import NOT_OPTIMIZED, OFTEN, calls_of, run
from jaxbody.compilation.kept_programs import call, known, structs
from jaxbody.compilation.late_imports import find_lapack
from jaxbody.compilation.program_parts import programs_inside
from jaxbody.compilation.shared_settings import little_garbage
from jaxbody.core.errors import JaxbodyError, Problem, warn
from jaxbody.core.jax_internals import only_transformed, outermost, started, without_manual_axes

TESTED = (0, 7, 2), (0, 12)  # oldest and newest jaxlib; XLA ends the process on an unknown option, and before on loops over long vectors
HOLDER = "--xla_backend_extra_options="
OPTION = "xla_cpu_small_while_loop_byte_threshold"
WIDTH = "--xla_cpu_prefer_vector_width="  # in bits, 512 for all that the processor has; XLA's default is 256
NO_FUSION_EMITTERS = {"xla_cpu_use_fusion_emitters": False}  # compiles in two thirds of the time or less; programs run as fast
UNOPTIMIZED = {  # halves the remaining time to compile; programs take up to three times as long
    **dict([NOT_OPTIMIZED]),
    "xla_cpu_parallel_codegen_split_count": 1,  # parts of a program that LLVM compiles one by one, for which so little work does not pay
}
BRIEF = tuple((NO_FUSION_EMITTERS | UNOPTIMIZED).items())  # of programs that take milliseconds
MOST = 100  # steps of a loop that takes milliseconds, such as one over parameters
_brief: set[str] = set()  # names of functions that are not optimized, and of those that may be
_long: set[str] = set()
VECTORIZED = {"xla_cpu_use_fusion_emitters": True, "xla_cpu_prefer_vector_width": 512}


def fast_loops() -> bool:
    """Let XLA compile every loop on a CPU into one function; simulations of small models then run 2 to 5 times as fast.

    By default XLA does so only for loops that carry less than 1024 bytes. The widest vector instructions are enabled too. Returns whether
    the options are set. They apply to all that JAX compiles in this process and its child processes, so jaxbody sets them only when you
    call this function. Call it before the first computation; other options in `XLA_FLAGS` are kept. Results change by rounding only.

    Loops over long vectors become slower, because they then run on one core: 100 steps on a vector of 1e6 took twice the time on two cores.
    Other programs were timed too (float32, two cores, jaxlib 0.10): a thousand random steps of 32 numbers took a quarter of the time. No
    difference was measured for matrix products of 256 x 512 x 512 in a loop, a loop over vectors of 1e3, training steps of a small network,
    a recurrent network, sorting and a convolution. Loops with LAPACK calls, sorts or scatters gain nothing. Time your own program both
    ways.

    Errors: TOO_LATE where JAX has already looked for devices, unless the option is set. Warns UNTESTED_JAXLIB, and changes nothing, for a
    version of jaxlib that was not tested, because XLA ends the process on unknown options, and before 0.7.2 on loops over long vectors.

    >>> done = fast_loops()  # doctest: +SKIP
    """
    flags = os.environ.get("XLA_FLAGS", "").split()
    if any(OPTION in flag for flag in flags):
        return True
    version = tuple(int(part) for part in jaxlib.version.__version__.split(".")[:3])
    oldest, newest = TESTED
    if version < oldest or version[:2] > newest:
        known = " to ".join(".".join(map(str, bound)) for bound in TESTED)
        warn("UNTESTED_JAXLIB", f"fast_loops was tested with jaxlib {known}, not with {jaxlib.version.__version__}: nothing is changed")
        return False
    if started():
        hint = "Call jaxbody.fast_loops() before any array is made."
        raise JaxbodyError(
            Problem("TOO_LATE", "fast_loops", "JAX has already started on its devices, so the option has no effect", hint=hint)
        )
    others = [flag for flag in flags if not flag.startswith(HOLDER)]
    held = [flag.removeprefix(HOLDER) for flag in flags if flag.startswith(HOLDER)]  # XLA uses only the last of several
    width = [] if any(flag.startswith(WIDTH) for flag in flags) else [WIDTH + "512"]
    os.environ["XLA_FLAGS"] = " ".join([*others, *width, HOLDER + ",".join([*held[-1:], f"{OPTION}=100000000"])])
    return True


def jit_optimized(function: Callable[..., Any]) -> Callable[..., Any]:
    """filter_jit for functions that run long: optimized. Unless part of another program, they, their derivatives and their batches compile
    in two thirds of the time on a CPU."""
    return _jit_by_itself(function, {})


def jit_unoptimized(function: Callable[..., Any]) -> Callable[..., Any]:
    """filter_jit for functions that take milliseconds: not optimized. Unless part of another program, they, their derivatives and their
    batches compile in a third of the time."""
    return _jit_by_itself(function, UNOPTIMIZED)


def jit_optimized_where(long: Callable[..., bool]) -> Callable[..., Any]:
    """A decorator: jit_optimized where long(*args), in batches of many and after a hundred calls, otherwise jit_unoptimized. The first
    results of short motions then take half the time."""
    return lambda function: _jit_by_itself(function, {}, lambda program, arrays, args: not long(*args))


def jit_optimized_with_loops(long: Callable[..., bool]) -> Callable[..., Any]:
    """A decorator: jit_optimized where long(*args), where there are other loops than those of functions that are not optimized, such as
    motions in a function of a user, and after a hundred calls; otherwise jit_unoptimized."""

    def brief(program, arrays, args):
        return not (long(*args) or _has_loops(program, tuple(map(jax.typeof, arrays))))

    return lambda function: _jit_by_itself(function, {}, brief)


def jit_vectorized(function: Callable[..., Any]) -> Callable[..., Any]:
    """filter_jit for loops over a thousand numbers or so: with the widest vectors of the processor, where XLA's default is 256 bits, and
    the fusion of whole steps. Unless part of another program, they run in two thirds of the time."""
    return _jit_by_itself(function, VECTORIZED)


def _jit_by_itself(
    function: Callable[..., Any], options: dict[str, Any], brief: Callable[..., bool] = lambda program, arrays, args: False
) -> Callable[..., Any]:
    """A function that is compiled with these options where it is not part of another program; with UNOPTIMIZED where it is `brief`."""
    compiled = Compiled(function)
    inner = without_manual_axes(function)
    own_options = tuple((NO_FUSION_EMITTERS | options).items())
    (_brief if options is UNOPTIMIZED else _long).add(function.__name__)

    @functools.wraps(function)
    def noted(*args):
        compiled.begin()
        return inner(*args)

    def options_of(program, arrays, args):
        return BRIEF if brief(program, arrays, args) and next(calls_of(program)) < OFTEN else own_options

    @functools.wraps(function)
    def driver(*args):
        find_lapack()
        program, arrays = array_function(noted, args)
        if outermost():
            with compiled.watched(args):
                return joined(*call(program, options_of(program, arrays, args), arrays))
        if only_transformed():
            return joined(*run(program, (options_of(program, arrays, args), own_options), arrays))
        return joined(*jitted(program)(*arrays))

    return driver


@functools.lru_cache(KEPT)
def _has_loops(program: Callable[..., Any], types: tuple[Any, ...]) -> bool:
    with little_garbage():
        return known(program, types, "loops", lambda: _loops(jax.make_jaxpr(jitted(program))(*structs(types)).jaxpr))


def _loops(jaxpr: Any) -> bool:
    """Whether a program has a loop of unknown length or of more than MOST steps, but for those of functions that take milliseconds."""
    for equation in jaxpr.eqns:
        name, params = equation.primitive.name, equation.params
        if name == "while" or (name == "scan" and params["length"] > MOST):
            return True
        if params.get("name") in _brief - _long:
            continue
        if any(map(_loops, programs_inside(equation))):
            return True
    return False


def quick_options() -> dict[str, Any]:
    """Options for `jax.jit` with which your own programs compile in two thirds of the time or less on a CPU.

    jaxbody's own functions already use them. Simulations and frequencies run just as fast; a training step of a neural network took 1.4
    times as long. The options are empty where XLA does not have them: jaxlib 0.10 does, 0.12 does not.

    >>> import jax
    >>> free_fall = jax.jit(lambda t: 9.81 * t**2 / 2, compiler_options=quick_options())
    >>> float(free_fall(2.0))
    19.62
    """
    return known_to_xla(tuple(NO_FUSION_EMITTERS.items()))
