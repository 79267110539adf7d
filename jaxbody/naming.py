"""Paths: every number of a model or an experiment by name, with wildcards, and back again.

A path is a name and a field, "AB.stiffness", "plate.mass", "AB.a"; `*`, `?` and `[...]` match as in file names. Of an experiment
"run1.initial.v", "run1.base.frequency" (the motion of a support), "run1.corner.point" (a sensor).
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from dataclasses import dataclass
from fnmatch import fnmatchcase
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from jaxbody.arrays import concrete, device_array, float_array
from jaxbody.errors import Problems
from jaxbody.models import Model


@dataclass(frozen=True)
class Leaf:
    """Where a path leads: the path, the number of the array among a tree's arrays, and the row in it (None for the whole)."""

    path: str
    array: int
    row: int | None
    rank: int

    @property
    def field(self) -> str:
        """The last part of the path: "stiffness"."""
        return self.path.rsplit(".", 1)[-1]

    def read(self, arrays: list[Array]) -> Array:
        array = arrays[self.array]
        return array if self.row is None else array[(..., self.row, *[slice(None)] * self.rank)]


def numbered(tree: Any) -> Any:
    """The same tree with the numbers of its arrays in their places."""
    treedef = jax.tree.structure(tree)
    return jax.tree.unflatten(treedef, range(treedef.num_leaves))


def leaves_of(tree: Any, prefix: str = "") -> list[Leaf]:
    """Every leaf of a model; or of an experiment, which says by `named()` what is called how."""
    numbers = numbered(tree)
    if not isinstance(tree, Model):
        return [Leaf(f"{prefix}{name}.{field}", n, None, 0) for name, part in numbers.named().items() for field, n in _fields(part)]
    found = []
    for table in (numbers.bodies, numbers.supports, *numbers.joints, *numbers.elements):
        for (field, n), rank in zip(_fields(table.rows), table.ranks, strict=True):
            found += [Leaf(f"{prefix}{name}.{field}", n, row, rank) for row, name in enumerate(table.names)]
    return [*found, Leaf(f"{prefix}gravity", numbers.gravity, None, 1)]


def _fields(tree: Any) -> list[tuple[str, int]]:
    def name(key: Any) -> str:
        return str(getattr(key, "name", getattr(key, "key", getattr(key, "idx", key))))

    return [(".".join(name(key) for key in keys), leaf) for keys, leaf in jax.tree_util.tree_leaves_with_path(tree)]


def matching(leaves: list[Leaf], patterns: Iterable[str], where: str) -> dict[str, list[Leaf]]:
    """The leaves that each pattern means; a pattern that means nothing is an error with the nearest path."""
    problems, found = Problems(), {}
    for pattern in patterns:
        found[pattern] = [leaf for leaf in leaves if fnmatchcase(leaf.path, pattern)]
        if not found[pattern]:
            paths = [leaf.path for leaf in leaves]
            near = difflib.get_close_matches(str(pattern), paths, 3, 0.5) or paths[:3]
            problems.add("UNKNOWN_PATH", where, f"'{pattern}' matches nothing.", value=pattern, hint=f"Did you mean {' or '.join(near)}?")
    problems.raise_if_any()
    return found


def write(tree: Any, values: dict[Leaf, Any]) -> Any:
    """The tree with new values at leaves."""
    arrays, treedef = jax.tree.flatten(tree)
    by_array: dict[int, dict[int | None, Any]] = {}
    for leaf, value in values.items():
        by_array.setdefault(leaf.array, {})[leaf.row] = value
    for n, rows in by_array.items():
        if None in rows:
            arrays[n] = rows[None]
        elif len(rows) == arrays[n].shape[0]:
            arrays[n] = jnp.stack([rows[i] for i in range(len(rows))])
        else:
            arrays[n] = arrays[n].at[jnp.array(list(rows))].set(jnp.stack(list(rows.values())))
    return jax.tree.unflatten(treedef, arrays)


def paths(tree: Any, pattern: str = "*") -> dict[str, Array]:
    """{path: value} of everything that a pattern means, in a model or an experiment.

    >>> model = Model(bodies={"mass": Body(mass=2.0, inertia=[1, 1, 1])}, gravity=[0, 0, -9.81])
    >>> list(paths(model, "mass.m*")), float(paths(model, "mass.mass")["mass.mass"])
    (['mass.mass'], 2.0)
    """
    arrays = jax.tree.leaves(tree)
    return {leaf.path: leaf.read(arrays) for leaf in leaves_of(tree) if fnmatchcase(leaf.path, pattern)}


def replace(tree: Any, values: dict[str, Any]) -> Any:
    """The model or experiment with other values: {path or pattern: value}.

    A value has the shape of one leaf, and then serves every match, or one more leading axis with a value for each match, in the order
    of `paths`. Errors: UNKNOWN_PATH, BAD_SHAPE, NON_FINITE, LISTED_TWICE, all at once.

    >>> model = Model(bodies={"mass": Body(mass=2.0, inertia=[1, 1, 1])})
    >>> float(replace(model, {"*.mass": 3.0})["mass"].mass)
    3.0
    """
    arrays = jax.tree.leaves(tree)
    problems, new = Problems(), {}
    for pattern, leaves in matching(leaves_of(tree), values, "replace").items():
        value = float_array(values[pattern], f"replace['{pattern}']")
        shapes = {leaf.read(arrays).shape for leaf in leaves}
        one, each = shapes == {value.shape}, all(value.shape == (len(leaves), *shape) for shape in shapes)
        known = concrete(value)
        if not (one or each or value.ndim == 0):
            told = " or ".join(str(shape) for shape in sorted(shapes))
            problems.add("BAD_SHAPE", f"replace['{pattern}']", f"has shape {value.shape}", value=value.shape, limit=f"{told}, or with a leading {len(leaves)}", hint=f"It means {', '.join(leaf.path for leaf in leaves[:6])}.")  # fmt: skip
            continue
        if known is not None and not np.isfinite(known).all():
            problems.add("NON_FINITE", f"replace['{pattern}']", f"is {known}", value=known, limit="finite")
        value = device_array(value)
        for i, leaf in enumerate(leaves):
            if leaf in new:
                problems.add("LISTED_TWICE", f"replace['{pattern}']", f"means {leaf.path}, which another pattern means too", value=pattern)
            new[leaf] = value[i] if each and not one else jnp.broadcast_to(value, leaf.read(arrays).shape)
    problems.raise_if_any()
    return write(tree, new)


def by_name(names: tuple[tuple[str, ...], ...], tables: tuple[Array, ...], axis: int = 0) -> dict[str, Array]:
    """{name: row}, for tables of rows along `axis` and the names of their rows."""
    lead = (slice(None),) * axis
    return {name: table[(*lead, i)] for group, table in zip(names, tables, strict=True) for i, name in enumerate(group)}
