"""Paths: every number of a model or an experiment by name, with wildcards, to read and to
replace them.

A path is a name and a field, "AB.stiffness", "plate.mass", "AB.a"; `*`, `?` and `[...]` match as in
file names. Paths of an experiment are "run1.initial.v", "run1.base.frequency" (the motion of a
support), "run1.corner.point" (a sensor).
"""

import difflib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from dataclasses import field as attribute
from fnmatch import fnmatchcase
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxbody.core.arguments import checked_dict
from jaxbody.core.arrays import (
    Array,
    checked,
    concrete,
    device_array,
    is_concrete,
    module_of,
    of_unit_length,
    part_of,
)
from jaxbody.core.errors import JaxbodyError, Problem, Problems, unknown
from jaxbody.geometry.fields import Kind, in_domain, kind_along, kind_of, nan_outside
from jaxbody.model.bodies import check_inertia
from jaxbody.model.elements.user_energies import unwrapped
from jaxbody.model.forces.controllers import ControlLaw
from jaxbody.model.joints.joints import Joint
from jaxbody.model.laws.laws import Law
from jaxbody.model.models import Model, refuse_batch


@dataclass(frozen=True)
class Leaf:
    """The array, or a row of an array, at a path: the path, the index of the array among those of a
    tree, the row (None for the whole array), the rank of a row, and the kind of its numbers."""

    path: str
    array: int
    row: int | None
    rank: int
    kind: Kind = attribute(default=Kind(), compare=False)

    @property
    def field(self) -> str:
        """The last part of the path: "stiffness"."""
        return self.path.rsplit(".", 1)[-1]

    def axis(self, arrays: Sequence[Array]) -> int:
        """Return the axis of the rows, which follows the leading axes of a batch of models."""
        return arrays[self.array].ndim - 1 - self.rank

    def read(self, arrays: Sequence[Array]) -> Array:
        array = arrays[self.array]
        return (
            array
            if self.row is None
            else part_of(array, (..., self.row, *[slice(None)] * self.rank))
        )

    def shape(self, arrays: Sequence[Array]) -> tuple[int, ...]:
        """Return the shape of the result of `read`."""
        shape = arrays[self.array].shape
        return (
            shape
            if self.row is None
            else shape[: self.axis(arrays)] + shape[self.axis(arrays) + 1 :]
        )


def numbered(tree: Any) -> Any:
    """Return the tree with each array replaced by its index."""
    treedef = jax.tree.structure(tree)
    return jax.tree.unflatten(treedef, range(treedef.num_leaves))


def leaves_of(tree: Any, prefix: str = "") -> list[Leaf]:
    """Return every leaf of a model or an experiment, whose `named()` gives its parts by name.
    Error: WRONG_KIND."""
    numbers = numbered(tree)
    if not isinstance(tree, Model):
        if not hasattr(tree, "named"):
            raise JaxbodyError(
                Problem(
                    "WRONG_KIND",
                    "paths or replace",
                    f"got a {type(tree).__name__}",
                    tree,
                    "a model or an experiment",
                    'Numbers of a part have paths in its model, such as "engine.mass".',
                )
            )
        roots = tree.named()
        sizes = [np.size(x) for x in jax.tree.leaves(tree)]  # a state without z has none
        return [
            Leaf(f"{prefix}{name}.{path}".removesuffix("."), n, None, 0, kind)
            for name, part in numbers.named().items()
            for path, n, kind in _fields(part, roots[name])
            if sizes[n]
        ]
    leaves = []
    tables = lambda model: (  # noqa: E731
        model.bodies,
        model.supports,
        *model.joints,
        *model.elements,
        *model.forces,
        *model.closures,
    )
    for table, rows in zip(tables(numbers), [table.rows for table in tables(tree)], strict=True):
        for (path, n, kind), rank in zip(
            _fields(unwrapped(table.rows), unwrapped(rows)), table.ranks, strict=True
        ):
            leaves += [
                Leaf(f"{prefix}{name}.{path}", n, row, rank, kind)
                for row, name in enumerate(table.names)
            ]
    return [*leaves, Leaf(f"{prefix}gravity", numbers.gravity, None, 1, kind_of(tree, "gravity"))]


def _fields(numbers: Any, root: Any) -> list[tuple[str, int, Kind]]:
    """Return path, index and kind of each array below a root."""
    return [
        (jax.tree_util.keystr(keys, simple=True, separator="."), leaf, kind_along(root, keys))
        for keys, leaf in jax.tree_util.tree_leaves_with_path(numbers)
    ]


def matching(
    leaves: list[Leaf],
    patterns: Iterable[str],
    where: str,
    problems: Problems | None = None,
    absent: dict[str, str] | None = None,
) -> dict[str, list[Leaf]]:
    """Return {pattern: the leaves that match it}. For a pattern without a match, a problem is added
    to `problems`, or raised if that is None; its hint is the nearest path, or that in `absent`
    {path: hint}."""
    collect, matches = problems is not None, {}
    problems = Problems() if problems is None else problems
    by_path = {leaf.path: leaf for leaf in leaves}
    for pattern in patterns:
        exact = by_path.get(pattern)
        matches[pattern] = (
            [leaf for leaf in leaves if fnmatchcase(leaf.path, str(pattern))]
            if exact is None
            else [exact]
        )
        if not matches[pattern]:
            paths = [leaf.path for leaf in leaves]
            near = difflib.get_close_matches(str(pattern), paths, 3, 0.5) or paths[:3]
            problems.add(
                "UNKNOWN_PATH",
                where,
                f"'{pattern}' matches nothing.",
                value=pattern,
                hint=next(
                    (
                        how
                        for path, how in (absent or {}).items()
                        if fnmatchcase(path, str(pattern))
                    ),
                    f"Did you mean {' or '.join(near)}?",
                ),
            )
    if not collect:
        problems.raise_if_any()
    return matches


def write(tree: Any, values: dict[Leaf, Any]) -> Any:
    """Return the tree with new values of some leaves."""
    arrays, treedef = jax.tree.flatten(tree)
    for leaves in by_array(values).values():
        block = (
            values[leaves[0]]
            if leaves[0].row is None
            else jnp.stack([values[leaf] for leaf in leaves], leaves[0].axis(arrays))
        )
        arrays[leaves[0].array] = _put(arrays[leaves[0].array], leaves, block)
    return jax.tree.unflatten(treedef, arrays)


def by_array(leaves: Iterable[Leaf]) -> dict[int, list[Leaf]]:
    """Return {index of an array: the leaves whose numbers it holds}."""
    groups: dict[int, list[Leaf]] = {}
    for leaf in leaves:
        groups.setdefault(leaf.array, []).append(leaf)
    return groups


def _put(array: Array, leaves: Sequence[Leaf], block: Array) -> Array:
    """Return the array with the rows of these leaves replaced by a block."""
    axis, rows = array.ndim - 1 - leaves[0].rank, [leaf.row for leaf in leaves]
    if leaves[0].row is None or rows == list(range(array.shape[axis])):
        return block
    if not is_concrete((array, block)):
        return jnp.asarray(array).at[(*[slice(None)] * axis, np.array(rows))].set(block)
    changed = np.array(array)
    changed[(*[slice(None)] * axis, np.array(rows))] = block
    return device_array(changed)


def parameter_paths(tree: Any, pattern: str = "*") -> dict[str, Array]:
    """Return {path: value} of all numbers of a model or an experiment whose paths match a pattern.
    Error: WRONG_KIND.

    >>> model = jb.Model(
    ...     bodies={"mass": jb.Body(mass=2.0, inertia=[1, 1, 1])}, gravity=[0, 0, -9.81]
    ... )
    >>> (
    ...     list(jb.parameter_paths(model, "mass.m*")),
    ...     float(jb.parameter_paths(model, "mass.mass")["mass.mass"]),
    ... )
    (['mass.mass'], 2.0)
    """
    arrays = jax.tree.leaves(tree)
    return {
        leaf.path: leaf.read(arrays) for leaf in leaves_of(tree) if fnmatchcase(leaf.path, pattern)
    }


def replace(tree: Any, values: dict[str, Any]) -> Any:
    """Return a copy of the model or experiment with other values, {path or pattern: value}; of a
    model also with other parts, {name: element, joint, body, closure or energy}, or other laws,
    {"left.damper": law}.

    A value has the shape of one leaf, and is then used for every match, or one more leading axis
    with a value for each match, in the order of `parameter_paths`. As when a model is built, an
    axis may have any length, masses must be positive and quaternions of unit length. Errors, all at
    once: WRONG_KIND, UNKNOWN_PATH, BAD_SHAPE, NON_FINITE, NOT_A_NUMBER, COMPLEX, LISTED_TWICE,
    BAD_MASS, ZERO_AXIS, BAD_QUATERNION.

    >>> model = jb.Model(bodies={"mass": jb.Body(mass=2.0, inertia=[1, 1, 1])})
    >>> float(jb.replace(model, {"*.mass": 3.0})["mass"].mass)
    3.0
    >>> on_guide = jb.replace(model, {"mass": jb.Guide("world", axis=[0, 0, 1])})
    >>> type(on_guide.joint("mass")).__name__, float(on_guide["mass"].mass)
    ('Guide', 2.0)
    """
    listed = set()
    with Problems() as problems:
        values = checked_dict(values, "replace.values", "path: value", problems)
    whole = {
        path: x
        for path, x in values.items()
        if (isinstance(x, eqx.Module) or callable(x)) and not hasattr(x, "__array__")
    }
    if whole and isinstance(tree, Model):
        tree, values = (
            _with_parts(tree, whole),
            {path: value for path, value in values.items() if path not in whole},
        )
    arrays, treedef = jax.tree.flatten(tree)
    new: dict[int, list[tuple[list[Leaf], Any, tuple[Any, ...] | None]]] = {}
    for pattern, leaves in matching(leaves_of(tree), values, "replace").items():
        where = f"replace['{pattern}']"
        for leaf in leaves:
            if leaf in listed:
                problems.add(
                    "LISTED_TWICE",
                    where,
                    f"matches {leaf.path}, which another pattern matches too",
                    value=pattern,
                )
        listed |= set(leaves)
        shapes = sorted({leaf.shape(arrays) for leaf in leaves})
        one = (shapes[0],) if len(shapes) == 1 else ()
        many = tuple((len(leaves), *shape) for shape in one)
        names = ", ".join(leaf.path for leaf in leaves[:6]) + (", ..." if len(leaves) > 6 else "")
        hint = f"It matches {names}, of shape {' or '.join(map(str, shapes))}." + (
            "" if one else " Use one pattern for each shape."
        )
        value = checked(values[pattern], one + many, where, problems, hint)
        if value is None:
            continue
        each = value.shape not in one
        for rows in by_array(leaves).values():
            which, first = (
                tuple(leaves.index(leaf) for leaf in rows) if each else len(rows),
                rows[0],
            )
            axis, known = None if first.row is None else first.axis(arrays), concrete(value)
            made = (
                value
                if known is None
                else _made(first, np.asarray(_block(known, which, axis)), where, problems)
            )
            new.setdefault(first.array, []).append(
                (rows, made, (which, axis, first.kind.domain) if known is None else None)
            )
    problems.raise_if_any()
    for array, parts in new.items():
        leaves, blocks, places = (
            [leaf for rows, *_ in parts for leaf in rows],
            [part[1] for part in parts],
            [part[2] for part in parts],
        )
        if any(places):
            arrays[array] = _with_traced(arrays[array], blocks, tuple(leaves), tuple(places))
        else:
            arrays[array] = _put(
                arrays[array],
                leaves,
                device_array(
                    blocks[0]
                    if len(blocks) == 1
                    else np.concatenate(blocks, leaves[0].axis(arrays))
                ),
            )
    return jax.tree.unflatten(treedef, arrays)


@partial(jax.jit, static_argnums=(2, 3), inline=True)
def _with_traced(
    array: Any,
    blocks: list[Any],
    leaves: tuple[Leaf, ...],
    places: tuple[tuple[Any, ...] | None, ...],
) -> Any:
    """Return the array with its rows at `leaves` replaced by blocks, some of which are traced
    values with their rows and axis in `places`. Outside of a `jit` this is compiled as one
    program."""
    first = leaves[0]
    made = [
        x if place is None else _traced_rows(x, first.rank, *place)
        for x, place in zip(blocks, places, strict=True)
    ]
    return _put(
        array,
        leaves,
        made[0] if len(made) == 1 else jnp.concatenate(made, array.ndim - 1 - first.rank),
    )


def _with_parts(model: Model, values: dict[str, Any]) -> Model:
    """Return the model with other bodies, joints, elements, closures or energies, {name: part}, or
    other laws, {"name.spring": law, "ride.law": law}."""
    refuse_batch(model, "replace")
    parts, problems = model.parts(), Problems()
    for path, value in values.items():
        name, _, field = path.partition(".")
        group = next(
            (
                group
                for group, each in parts.items()
                if group not in ("joints", "gravity") and name in each
            ),
            "bodies",
        )
        group = "joints" if isinstance(value, Joint) else group
        if name not in parts[group]:
            problems.collected.append(unknown(name, f"replace[{path!r}]", model.names))
        elif not field:
            parts[group][name] = value
        elif not isinstance(value, Law | ControlLaw) or not isinstance(
            getattr(parts[group][name], field, 0), Law | ControlLaw | None
        ):
            problems.add(
                "UNKNOWN_PATH",
                f"replace[{path!r}]",
                "is no law of an element",
                value=path,
                hint="Replace the element.",
            )
        else:
            parts[group][name] = eqx.tree_at(
                lambda part, at=field: getattr(part, at),
                parts[group][name],
                value,
                is_leaf=lambda x: x is None,
            )
    problems.raise_if_any()
    return Model(**parts)


def _block(value: Any, rows: tuple[int, ...] | int, axis: int | None) -> Any:
    """Return the numbers to write into an array, with its rows along `axis`: the rows of `value`
    with the indices `rows`, or, if `rows` is a number, `value` repeated in that many rows. If
    `axis` is None the array has no rows, and the numbers are those of one leaf."""
    xp = module_of(value)
    if axis is None:
        return value if isinstance(rows, int) else value[rows[0]]
    if isinstance(rows, int):
        repeated = xp.broadcast_to(value, (rows, *value.shape))
        return xp.moveaxis(repeated, 0, axis) if axis else repeated
    return xp.moveaxis(value[np.array(rows)], 0, axis)


def _traced_rows(
    value: Any, rank: int, rows: tuple[int, ...] | int, axis: int | None, domain: str
) -> Any:
    """Return the numbers of a traced value to write, as `_block` does, normalized or NaN outside of
    their domain, as their values cannot be checked."""
    block = _block(value, rows, axis)
    if domain in ("direction", "rotation"):
        return block / jnp.linalg.norm(block, axis=-1, keepdims=True)
    return nan_outside(block, domain, rank)


def _made(leaf: Leaf, known: np.ndarray, where: str, problems: Problems) -> Any:
    """Check and normalize a value as the constructors of bodies, joints and elements do."""
    domain = leaf.kind.domain
    if domain not in ("direction", "rotation"):
        rows = [known]
        if domain in ("definite", "symmetric", "inertia"):
            rows = known.reshape(-1, *known.shape[known.ndim - leaf.rank :])
        for row in rows:
            if domain == "inertia":
                check_inertia(row, 1e-9 * abs(np.trace(row)), where, problems)
            else:
                in_domain(row, leaf.kind, where, problems)
        return known
    length = np.linalg.norm(known, axis=-1, keepdims=True)
    if domain == "direction" and not length.all():
        problems.add(
            "ZERO_AXIS",
            where,
            "has length zero",
            value=known,
            limit="> 0",
            hint="Give a direction.",
        )
    elif domain == "rotation" and (np.abs(length - 1) > 1e-3).any():
        problems.add(
            "BAD_QUATERNION",
            where,
            f"has length {length.ravel()[np.argmax(np.abs(length - 1))]:.6g}",
            value=known,
            limit="1 within 1e-3",
            hint="Divide it by its length; the order is w, x, y, z.",
        )
    else:
        return of_unit_length(known)
    return known


def by_name(
    names: Sequence[tuple[str, ...]], tables: Sequence[Array], axis: int = 0
) -> dict[str, Any]:
    """Return {name: row} of tables whose rows, along `axis`, have these names."""
    return {
        name: part_of(table, (*[slice(None)] * axis, i, ...))
        for group, table in zip(names, tables, strict=True)
        for i, name in enumerate(group)
    }


def of_elements(model: Any, values: Sequence[Array], axis: int = 0) -> dict[str, Any]:
    """Return {element: row} of the values of each table of elements, whose rows are along `axis`,
    without the energies written by the user."""
    names = [table.names for table in model.attached]
    return by_name(names, values[: len(names)], axis)


def springs_of(model: Any) -> list[str]:
    """Return the names of the elements whose deformation is one number."""
    return [name for table in model.elements if table.rows.size == 1 for name in table.names]
