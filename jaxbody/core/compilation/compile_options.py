"""Drivers: functions of models and arrays, each compiled as one program with options of XLA; inside
another program they are a part of it."""

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np

from jaxbody.core.jax_internals import outermost

ARRAYS = (jax.Array, np.ndarray, np.generic)


@jax.tree_util.register_static
@dataclass(frozen=True, eq=False)
class Remainder:
    """A part of a result that holds no array, known when the function is traced."""

    value: Any


def separated(tree: Any) -> tuple[list[Any], Any, tuple[tuple[type, Any] | None, ...]]:
    """Return the arrays of a tree, its structure and its other leaves.

    Other leaves are listed with their types, because 1, 1.0 and True are equal, with None in place
    of each array."""
    leaves, structure = jax.tree.flatten(tree)
    others = tuple(None if isinstance(leaf, ARRAYS) else (type(leaf), leaf) for leaf in leaves)
    return [leaf for leaf in leaves if isinstance(leaf, ARRAYS)], structure, others


def joined(arrays: Sequence[Any], structure: Any, others: Sequence[Any]) -> Any:
    """Return the tree that `separated` has split."""
    given = iter(arrays)
    return jax.tree.unflatten(
        structure, [next(given) if other is None else other[1] for other in others]
    )


def without_weak_type(x: Any) -> Any:
    """Return x with a fixed type: the (weak) type of a Python number would depend on the array with
    which x is combined."""
    return jax.lax.convert_element_type(x, x.dtype) if getattr(x, "weak_type", False) else x


Options = tuple[tuple[str, Any], ...]  # of XLA, names and values
F = TypeVar("F", bound=Callable[..., Any])

# without XLA's fusion emitters programs compile in two thirds of the time and run as fast; later
# versions of jaxlib always use them
EMITTERS = "xla_cpu_use_fusion_emitters"
HAS_EMITTERS = tuple(map(int, version("jaxlib").split(".")[:2])) < (0, 11)
OPTIMIZED: Options = ((EMITTERS, False),) if HAS_EMITTERS else ()
WIDE: Options = (
    *(((EMITTERS, True),) if HAS_EMITTERS else ()),
    # width of vector instructions [bits]: 512 uses the full width of the processor, XLA's default
    # is 256. Loops over about a thousand numbers run in two thirds of the time
    ("xla_cpu_prefer_vector_width", 512),
)
# compiles in half the time of OPTIMIZED; programs take up to three times as long
QUICK: Options = (
    *OPTIMIZED,
    ("xla_backend_optimization_level", 0),
    # number of parts that LLVM compiles in parallel: one, because the work is too little for more
    ("xla_cpu_parallel_codegen_split_count", 1),
)
STRUCTURES = 4096  # most structures of arguments for which a function keeps programs


def jit(function: F) -> F:
    """Compile a function of models and arrays as jax.jit does, with options of XLA with which it
    compiles quickly.

    Arrays and Python floats, anywhere in the arguments, are arguments of the program, so that new
    values compile nothing; all else (names, functions, integers) is fixed in it. Results may hold
    anything. Apply it to the outermost function, after jax.grad or jax.vmap:

        first = lambda model: jb.modes(jb.linearize(model, jb.equilibrium(model))).frequency[0]
        slopes = jb.jit(jax.grad(first))

    The price: such a program runs up to three times slower; use `jax.jit` for a function that is
    called thousands of times. Inside another `jit`, and inside a `grad`, `vmap` or `scan` that is
    not compiled, JAX takes no options, and it is an ordinary `jax.jit`.

    >>> import jax
    >>> import jaxbody as jb
    >>> car = jb.presets.quarter_car()
    >>> first = lambda model: jb.modes(jb.linearize(model, jb.equilibrium(model))).frequency[0]
    >>> slope = jb.jit(jax.grad(first))(car)
    >>> print(f"{slope['suspension'].stiffness:.2e} Hz per N/m")
    1.69e-05 Hz per N/m
    """
    compiled = _compiled(function, QUICK)

    @functools.wraps(function)
    def call(*args, **named):
        args, named = jax.tree.map(
            lambda x: jnp.asarray(x) if isinstance(x, float | complex) else x, (args, named)
        )
        return compiled(*args, **named)

    return call  # pyright: ignore[reportReturnType]


def program(function: F) -> F:
    """Compile a driver: one of jaxbody's own functions, which takes milliseconds, and whose Python
    numbers are fixed in its program."""
    return program_with(QUICK)(function)


def program_with(options: Options | Callable[..., Options]) -> Callable[[F], F]:
    """Return a decorator that compiles a driver with these options of XLA.

    They may be a function of the driver's arguments, which chooses options from their shapes.
    Inside another program, a derivative or a batch they are not used, because JAX takes no options
    there."""

    return lambda function: _compiled(function, options)


def _compiled(function: Any, options: Options | Callable[..., Options]) -> Any:
    """Return the function, compiled once for each structure of its arguments and each set of
    values in them that are not arrays.

    jax.jit accepts arrays only: what is compiled is a function of the arrays in the arguments that
    returns the arrays in the result. The other parts of a result are known when it is traced.

    Args:
        function: the function, whose results may hold anything.
        options: options of XLA, for calls outside of other programs; or a function of the arguments
            that returns them.
    """

    @functools.lru_cache(STRUCTURES)
    def of_arrays(structure, others, x64):  # JAX keeps NumPy constants as first traced
        def traced(*arrays):
            args, named = joined(arrays, structure, others)
            results, *rest = separated(function(*args, **named))
            # batches lose weak types, and functions of the result would be traced again
            return [without_weak_type(x) for x in results], Remainder(rest)

        traced.__name__ = getattr(function, "__name__", type(function).__name__)
        return traced

    @functools.lru_cache(STRUCTURES)
    def program_of(traced, options):
        return jax.jit(traced, compiler_options=dict(options) or None)

    @functools.wraps(function)
    def call(*args, **named):
        arrays, structure, others = separated((args, named))
        traced = of_arrays(structure, others, jax.config.read("jax_enable_x64"))
        chosen: Options = ()  # JAX takes no options inside another program
        if outermost():
            chosen = options(*args) if callable(options) else options
        results, remainder = program_of(traced, chosen)(*arrays)
        return joined(results, *remainder.value)

    return call
