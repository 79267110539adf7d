"""Functions of arrays alone: all else that a call depends on is fixed in them, so that JAX keeps one trace for each."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import jax
import jaxlib.version
import numpy as np

Options = tuple[tuple[str, Any], ...]  # of XLA, names and values
ARRAYS = (jax.Array, np.ndarray, np.generic)
NOT_EVERYWHERE = {"xla_cpu_use_fusion_emitters": {(0, 10): True, (0, 12): False}}  # versions of jaxlib; others are tried
KEPT = 4096  # functions with different structures or static values, each with its compiled programs


@dataclass(frozen=True, eq=False)
class Remainder:
    """A part of a result that holds no array, known when the function is traced."""

    value: Any


jax.tree_util.register_pytree_node(Remainder, lambda remainder: ((), remainder.value), lambda value, _: Remainder(value))


@dataclass(frozen=True)
class ArrayFunction:
    """function(*args) as a function of the arrays in args; it returns the arrays of the result, and a Remainder with all else of it. No
    result has a weak type: batches lose it, and what takes the result would be traced again."""

    function: Callable[..., Any]
    tree: Any  # of args
    others: tuple[tuple[type, Any] | None, ...]  # leaves of args with their types (1, 1.0 and True are equal); None for arrays

    @property
    def __name__(self) -> str:
        return self.function.__name__

    def __call__(self, *arrays: Any) -> tuple[list[Any], Remainder]:
        given = iter(arrays)
        leaves = [next(given) if other is None else other[1] for other in self.others]
        results, remainder = separated(self.function(*jax.tree.unflatten(self.tree, leaves)))
        return list(map(without_weak_type, results)), remainder


def array_function(function: Callable[..., Any], args: tuple[Any, ...]) -> tuple[ArrayFunction, list[Any]]:
    """The function of arrays for these arguments, the same object for equal ones, and the arrays."""
    leaves, tree = jax.tree.flatten(args)
    arrays = [leaf for leaf in leaves if isinstance(leaf, ARRAYS)]
    return _array_function(function, tree, tuple(None if isinstance(leaf, ARRAYS) else (type(leaf), leaf) for leaf in leaves)), arrays


def without_weak_type(x: Any) -> Any:
    """x with the type that it has, where JAX would let others decide it, as of a number of Python."""
    return jax.lax.convert_element_type(x, x.dtype) if getattr(x, "weak_type", False) else x


_array_function = functools.lru_cache(KEPT)(ArrayFunction)


def separated(tree: Any) -> tuple[list[Any], Remainder]:
    """The arrays of a tree, and all else of it."""
    leaves, structure = jax.tree.flatten(tree)
    others = tuple(None if isinstance(leaf, ARRAYS) else (leaf,) for leaf in leaves)
    return [leaf for leaf in leaves if isinstance(leaf, ARRAYS)], Remainder((structure, others))


def joined(arrays: Sequence[Any], remainder: Remainder) -> Any:
    """The tree of `separated`."""
    structure, others = remainder.value
    given = iter(arrays)
    return jax.tree.unflatten(structure, [next(given) if other is None else other[0] for other in others])


@functools.lru_cache(KEPT)
def jitted(function: Callable[..., Any], options: Options | None = None) -> Callable[..., Any]:
    """The function as a program of its own with these options, or as a part of others; both share one trace."""
    return jax.jit(function) if options is None else compiled_with(options, function)


def compiled_with(options: Options, function: Callable[..., Any]) -> Callable[..., Any]:
    """The function as a program of its own, compiled with these options."""
    return jax.jit(function, compiler_options=known_to_xla(options))


@functools.cache
def known_to_xla(options: Options) -> dict[str, Any]:
    """Those of the options that this version of XLA has."""
    return {name: value for name, value in options if name not in NOT_EVERYWHERE or _is_known(name, value)}


def _is_known(name: str, value: Any) -> bool:
    major, minor = jaxlib.version.__version__.split(".")[:2]
    known = NOT_EVERYWHERE[name].get((int(major), int(minor)))
    return _compiles(name, value) if known is None else known


@functools.cache
def _compiles(name: str, value: Any) -> bool:
    try:
        jax.jit(lambda x: x, compiler_options={name: value}).lower(jax.ShapeDtypeStruct((), "float32")).compile()
    except jax.errors.JaxRuntimeError:
        return False
    return True
