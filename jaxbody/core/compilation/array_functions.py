"""Functions of arrays alone: all else that a call depends on is fixed in them, so that JAX keeps
one trace for each."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import jax
import numpy as np

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
    tree: Any  # of args
    # leaves of args with their types (1, 1.0 and True are equal); None for arrays
    others: tuple[tuple[type, Any] | None, ...]

    @property
    def __name__(self) -> str:
        return self.name

    def __call__(self, *arrays: Any) -> tuple[list[Any], Remainder]:
        given = iter(arrays)
        leaves = [next(given) if other is None else other[1] for other in self.others]
        results, remainder = separated(self.function(*jax.tree.unflatten(self.tree, leaves)))
        return list(map(without_weak_type, results)), remainder


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
