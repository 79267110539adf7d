"""One way to compile: a function of models and arrays as one program, compiled quickly by itself
and a part of others inside them."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np

from jaxbody.core.compilation.compilations import Compiled
from jaxbody.core.jax_internals import outermost, without_manual_axes

ARRAYS = (jax.Array, np.ndarray, np.generic)


@dataclass(frozen=True, eq=False)
class Remainder:
    """A part of a result that holds no array, known when the function is traced."""

    value: Any


jax.tree_util.register_pytree_node(
    Remainder, lambda remainder: ((), remainder.value), lambda value, _: Remainder(value)
)


@dataclass(frozen=True, eq=False)
class ArrayFunction:
    """function(*args) as a function of the arrays in args; it returns the arrays of the result, and
    a Remainder with all else of it. No result has a weak type: batches lose it, and what takes the
    result would be traced again."""

    function: Callable[..., Any]
    name: str
    compiled: Compiled | None  # of a driver: what notes its traces
    tree: Any  # of args
    # leaves of args with their types (1, 1.0 and True are equal); None for arrays
    others: tuple[tuple[type, Any] | None, ...]

    @property
    def __name__(self) -> str:
        return self.name

    def __call__(self, *arrays: Any) -> tuple[list[Any], Remainder]:
        given, shown = arrays, lambda x: x
        if self.compiled:  # independent of devices, as functions of the user may not be
            self.compiled.begin()
            given, shown = without_manual_axes(arrays)
        given = iter(given)
        leaves = [next(given) if other is None else other[1] for other in self.others]
        results, remainder = separated(self.function(*jax.tree.unflatten(self.tree, leaves)))
        return [without_weak_type(shown(x)) for x in results], remainder


def without_weak_type(x: Any) -> Any:
    """x with the type that it has, where JAX would let others decide it, as of a number
    of Python."""
    return jax.lax.convert_element_type(x, x.dtype) if getattr(x, "weak_type", False) else x


def separated(tree: Any) -> tuple[list[Any], Remainder]:
    """The arrays of a tree, and all else of it."""
    leaves, structure = jax.tree.flatten(tree)
    others = tuple(None if isinstance(leaf, ARRAYS) else (leaf,) for leaf in leaves)
    return [leaf for leaf in leaves if isinstance(leaf, ARRAYS)], Remainder((structure, others))


def joined(arrays: Sequence[Any], remainder: Remainder) -> Any:
    """The tree of `separated`."""
    structure, others = remainder.value
    given = iter(arrays)
    return jax.tree.unflatten(
        structure, [next(given) if other is None else other[0] for other in others]
    )


Options = tuple[tuple[str, Any], ...]  # of XLA, names and values
F = TypeVar("F", bound=Callable[..., Any])

# without them programs compile in two thirds of the time and run as fast
EMITTERS = "xla_cpu_use_fusion_emitters"
VERSION = tuple(map(int, version("jaxlib").split(".")[:2]))
HAS_EMITTERS = VERSION < (0, 11)  # later ones always use them
OPTIMIZED: Options = ((EMITTERS, False),) if HAS_EMITTERS else ()
WIDE: Options = ((EMITTERS, True),) if HAS_EMITTERS else ()
# in bits, 512 for all that the processor has; XLA's default is 256. Loops over a thousand numbers
# or so run in two thirds of the time
WIDE += (("xla_cpu_prefer_vector_width", 512),)
# compiles in half the time of OPTIMIZED; programs take up to three times as long
QUICK: Options = (
    *OPTIMIZED,
    ("xla_backend_optimization_level", 0),
    # parts of a program that LLVM compiles one by one, for which so little work does not pay
    ("xla_cpu_parallel_codegen_split_count", 1),
)
STRUCTURES = 4096  # of arguments that a function keeps programs for


def jit(function: F) -> F:
    """jax.jit for functions of models and arrays, with options of XLA with which they
    compile quickly.

    Arrays and Python floats, anywhere in the arguments, are arguments of the program, so that new
    values compile nothing; all else (names, functions, integers) is fixed in it. Results may hold
    anything. Put it around whatever you differentiate, batch or repeat:

        first = lambda model: jb.modes(jb.linearize(model, jb.equilibrium(model))).frequency[0]
        slopes = jb.jit(jax.grad(first))

    What is lost: such a program runs up to three times slower; take `jax.jit` for what is called
    thousands of times. Inside another `jit`, or inside a `grad`, `vmap` or `scan` that is in none,
    where JAX takes no options, it is an ordinary `jax.jit`.

    >>> import jax
    >>> import jaxbody as jb
    >>> car = jb.presets.quarter_car()
    >>> first = lambda model: jb.modes(jb.linearize(model, jb.equilibrium(model))).frequency[0]
    >>> slope = jb.jit(jax.grad(first))(car)
    >>> print(f"{slope['suspension'].stiffness:.2e} Hz per N/m")
    1.69e-05 Hz per N/m
    """
    name = getattr(function, "__name__", type(function).__name__)
    programs = _Programs(lambda args, named: function(*args, **named), name)

    @functools.wraps(function)
    def call(*args, **named):
        given = jax.tree.map(
            lambda x: jnp.asarray(x) if isinstance(x, float | complex) else x, (args, named)
        )
        return programs(given, QUICK if outermost() else ())

    return call  # pyright: ignore[reportReturnType]


def program(function: F) -> F:
    """A driver: `jit` for jaxbody's own functions that take milliseconds, whose Python numbers are
    fixed in the program."""
    return program_with(QUICK)(function)


def program_with(options: Options | Callable[..., Options]) -> Callable[[F], F]:
    """A decorator: a driver with these options, or with those that a function of its arguments
    chooses from their shapes. As a part of another program, or of a derivative or batch, it has
    none: JAX takes no options there."""

    def driver_of(function):
        compiled = Compiled(function)
        programs = _Programs(function, function.__name__, compiled)

        @functools.wraps(function)
        def driver(*args):
            if not outermost():
                return programs(args, ())
            with compiled.watched(args):
                return programs(args, options(*args) if callable(options) else options)

        return driver

    return driver_of  # pyright: ignore[reportReturnType]


class _Programs:
    """The programs of a function, one for each structure of its arguments with all in it that is
    no array."""

    def __init__(self, function: Callable[..., Any], name: str, compiled: Compiled | None = None):
        self.of_arrays = functools.lru_cache(STRUCTURES)(
            lambda x64, *fixed: ArrayFunction(function, name, compiled, *fixed)
        )
        self.jitted = functools.lru_cache(STRUCTURES)(
            lambda function, options: jax.jit(function, compiler_options=dict(options) or None)
        )

    def __call__(self, args: tuple[Any, ...], options: Options) -> Any:
        leaves, tree = jax.tree.flatten(args)
        arrays = [x for x in leaves if isinstance(x, ARRAYS)]
        # JAX keeps NumPy's constants of a function as they were in its first trace
        x64 = jax.config.read("jax_enable_x64")
        function = self.of_arrays(
            x64, tree, tuple(None if isinstance(x, ARRAYS) else (type(x), x) for x in leaves)
        )
        return joined(*self.jitted(function, options)(*arrays))
