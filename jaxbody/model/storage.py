"""Tables: objects of one kind as one struct of arrays with a static tuple of names; each object is
a row.

(Compiling the gradient of a model of 200 springs takes 14 s with separate objects, 2 s
with arrays.)
"""

import inspect
from collections.abc import Iterator
from typing import Any

import equinox as eqx
import jax
import numpy as np

from jaxbody.core import arrays
from jaxbody.core.errors import JaxbodyError, Problem


class KindTable(eqx.Module):
    """Rows of one kind: `rows` is one module whose leaves have a leading axis; `links` holds the
    names that each row is attached to: `between` of an element, `parent` of a joint."""

    names: tuple[str, ...] = eqx.field(static=True)
    links: tuple[Any, ...] = eqx.field(static=True)
    # of each leaf of one row, so that batches of models have rows too
    ranks: tuple[int, ...] = eqx.field(static=True)
    rows: Any

    def __len__(self) -> int:
        return len(self.names)

    def __iter__(self) -> Iterator[str]:
        return iter(self.names)

    def row(self, name: str) -> Any:
        """Return one row by name, with its leading batch axes."""
        i = self.names.index(name)
        leaves, treedef = jax.tree.flatten(self.rows)
        if not all(leaf is None or hasattr(leaf, "__getitem__") for leaf in leaves):
            raise JaxbodyError(self._no_node(name))
        if any(
            np.ndim(leaf) <= rank
            for leaf, rank in zip(leaves, self.ranks, strict=True)
            if leaf is not None
        ):
            raise JaxbodyError(
                Problem(
                    "BAD_SHAPE",
                    f"model['{name}']",
                    "has leaves without rows",
                    limit="a row for each name",
                    hint=(
                        "A function of whole arrays, such as a norm, was applied to its tree; "
                        "apply it to the values of jb.parameter_paths(model)."
                    ),
                )
            )
        picked = [
            leaf if leaf is None else arrays.part_of(leaf, (..., i, *[slice(None)] * rank))
            for leaf, rank in zip(leaves, self.ranks, strict=True)
        ]
        return with_link(jax.tree.unflatten(treedef, picked), self.links[i])

    def _no_node(self, name: str) -> Problem:
        """Return the problem of an attempt to replace a row by equinox.tree_at, which can replace
        whole arrays only."""
        paths = [
            jax.tree_util.keystr(keys, simple=True, separator=".")
            for keys, _ in jax.tree_util.tree_leaves_with_path(self.rows)
        ]
        path = next(
            (path for path in paths if path in inspect.get_annotations(type(self.rows))), paths[-1]
        )
        return Problem(
            "NO_NODE",
            f"model['{name}']",
            "is a row of arrays and not a node of the tree, so equinox.tree_at cannot replace it",
            name,
            f"whole arrays, such as model.elements[0].rows.{path}",
            (
                f'Use jb.replace(model, {{"{name}.{path}": value}}); it has '
                f"{', '.join(paths[:8])}{', ...' if len(paths) > 8 else ''}."
            ),
        )


def tabulate(things: dict[str, Any], template: Any = None) -> KindTable:
    """Return one table of objects of equal structure; `template` gives the structure if there are
    no objects."""
    modules = list(things.values())
    bare = [with_link(module, None) for module in modules]
    leaves = [jax.tree.leaves(module) for module in bare]
    first, treedef = jax.tree.flatten(bare[0] if bare else with_link(template, None))
    columns = [arrays.stack(list(column)) for column in zip(*leaves, strict=True)] if bare else [
        arrays.device_array(np.zeros((0, *np.shape(leaf)))) for leaf in first
    ]  # fmt: skip
    return KindTable(
        tuple(things),
        tuple(getattr(m, "between", getattr(m, "parent", None)) for m in modules),
        tuple(np.ndim(leaf) for leaf in first),
        jax.tree.unflatten(treedef, columns),
    )


def tabulate_by_structure(things: dict[str, Any], key=lambda name: None) -> tuple[KindTable, ...]:
    """Return one table for each structure (class, static fields, shapes of leaves) and value of
    `key`, in order of first appearance."""
    kinds: dict[Any, dict[str, Any]] = {}
    for name, thing in things.items():
        leaves, treedef = jax.tree.flatten(with_link(thing, None))
        kinds.setdefault((key(name), treedef, tuple(np.shape(leaf) for leaf in leaves)), {})[
            name
        ] = thing
    return tuple(tabulate(group) for group in kinds.values())


def with_link(module: Any, link: Any) -> Any:
    """Return a copy with another link, which is static, so that `eqx.tree_at` cannot replace it."""
    return with_attributes(module, {x: link for x in ("between", "parent") if x in vars(module)})


def with_attributes(module: Any, changed: dict[str, Any]) -> Any:
    """Return a copy with these attributes, without a call of its constructor."""
    copy = object.__new__(type(module))
    # only attributes of the object: copies of class attributes would change the tree structure
    for name, value in (vars(module) | changed).items():
        object.__setattr__(copy, name, value)
    return copy
