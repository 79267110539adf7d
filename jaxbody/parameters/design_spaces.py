"""Design spaces: free parameters by path, some of them tied, between bounds, as numbers u of the order of one."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxbody.core.arrays import Array, Float
from jaxbody.core.errors import Problem, Problems
from jaxbody.models.leaf_paths import Leaf, leaves_of, matching, write
from jaxbody.models.models import Model
from jaxbody.models.sizes import size_of
from jaxbody.parameters.ties import ALIKE, Factor, Tie, bounds_of_first, check_alike, equation, ties, times
from jaxbody.parameters.transforms import (
    Elementwise,
    Fraction,
    Parametrization,
    Positive,
    Rotated,
    Shifted,
    pair_of,
    parametrize,
    parts_of,
    sound_bounds,
)

SPREAD = 0.3  # standard deviation of u for random starts of directions, matrices and rows in order, which have no bounds


class Group(eqx.Module):
    """Leaves tied by factors to the value of the first, and its parametrization."""

    leaves: tuple[Leaf, ...] = eqx.field(static=True)
    factors: tuple[Factor, ...] = eqx.field(static=True)
    form: Parametrization

    @property
    def path(self) -> str:
        return self.leaves[0].path

    @property
    def label(self) -> str:
        return equation([leaf.path for leaf in self.leaves[:2]], self.factors) + (" = ..." if len(self.leaves) > 2 else "")


class Space(eqx.Module):
    """A model as a function of u, which is zero at the start: `place(u)`."""

    model: Model
    groups: tuple[Group, ...]

    @property
    def size(self) -> int:
        return sum(group.form.size for group in self.groups)

    @property
    def ends(self) -> list[slice]:
        """The part of u of each group."""
        return parts_of(self.groups)

    def values(self, u: Float[Array, "n"]) -> dict[str, Array]:
        """{path of each group's first leaf: value}."""
        return {group.path: group.form.value(u[at]) for group, at in zip(self.groups, self.ends, strict=True)}

    def place(self, u: Float[Array, "n"]) -> Model:
        values = self.values(u)
        tied = [(group, *pair) for group in self.groups for pair in zip(group.leaves, group.factors, strict=True)]
        return write(self.model, {leaf: times(values[group.path], factor) for group, leaf, factor in tied})

    def labels(self) -> list[str]:
        """The name of each u: "AB.stiffness", "mount 1.a[0]"."""
        return [group.path + suffix for group in self.groups for suffix in group.form.labels()]

    def numbers(self, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The number that each u determines and its derivative with respect to u; for orientations and matrices, u itself and 1."""
        pairs = (group.form.numbers(u[at]) for group, at in zip(self.groups, self.ends, strict=True))
        x, slopes = map(np.concatenate, zip(*pairs, strict=True))
        return x, slopes


def space_of(model: Model, free: str | Iterable[str], bounds: dict[str, Any], where: str) -> tuple[Space, np.ndarray, np.ndarray]:
    """The space of the free parameters, and the bounds of u."""
    groups = _grouped(model, [free] if isinstance(free, str) else list(free), bounds, where)
    return _bounded(Space(model, groups), bounds, f"{where}.bounds")


def _grouped(model: Model, free: list[str], bounds: dict[str, Any], where: str) -> tuple[Group, ...]:
    with Problems() as problems:
        arrays, size = jax.tree.leaves(model), size_of(model)
        selected = ties(leaves_of(model), free, f"{where}.free", problems)
        by_pattern = matching([leaf for tie in selected for leaf in tie], bounds, f"{where}.bounds")
        given = {leaf: bounds[pattern] for pattern, leaves in by_pattern.items() for leaf in leaves}
        groups = [_group(tie, arrays, model, size, given, problems) for tie in selected]
    return tuple(group for group in groups if group is not None)


def _group(tie: Tie, arrays, model: Model, size, given: dict[Leaf, Any], problems: Problems) -> Group | None:
    """The group for a tie. With a lower bound of zero its value is linear in u, because a logarithm never reaches zero."""
    starts, first = [leaf.read(arrays) for leaf in tie], next(iter(tie))
    form = parametrize(first, starts[0], model, size)
    ends = pair_of(next((given[leaf] for leaf in tie if leaf in given), None), starts[0].shape)
    if ends is not None and (ends[0] == 0).all():
        on_bound = isinstance(form, Problem) and first.kind.domain == "nonnegative"
        if on_bound or (isinstance(form, Positive) and np.isfinite(ends[1]).all()):
            form = Shifted(starts[0], size)
    if isinstance(form, Problem):
        problems.collected.append(form)
        return None
    check_alike(tie, starts, form, problems)
    return Group(tuple(tie), tuple(tie.values()), form)


def _bounded(space: Space, bounds: dict[str, Any], where: str) -> tuple[Space, np.ndarray, np.ndarray]:
    with Problems() as problems:
        owner = {
            leaf: (i, factor) for i, group in enumerate(space.groups) for leaf, factor in zip(group.leaves, group.factors, strict=True)
        }
        low, high = np.full(space.size, -np.inf), np.full(space.size, np.inf)
        forms = [group.form for group in space.groups]
        bounded: dict[int, list[tuple[str, Factor]]] = {}
        for pattern, leaves in matching(list(owner), bounds, where).items():
            for i, factor in (owner[leaf] for leaf in leaves):
                bounded.setdefault(i, []).append((pattern, factor))
        for i, patterns in bounded.items():
            path, form, at, given = space.groups[i].path, forms[i], space.ends[i], bounds[patterns[0][0]]
            ends = _within([(pair_of(bounds[pattern], form.start.shape), factor) for pattern, factor in patterns])
            largest = max(float(np.where(np.isfinite(end), np.abs(end), 0.0).max()) for end in ends or [np.asarray(form.start)])
            slack = ALIKE * largest  # a tuned model may lie outside by round-off
            if sound_bounds(form, ends, given, f"{where}['{path}']", problems, slack):
                lower, upper = ends  # pyright: ignore
                if isinstance(form, Shifted) and np.isfinite(upper - lower).all():
                    forms[i] = form = Shifted(form.start, jnp.asarray((upper - lower).max() / 2))
                low[at], high[at] = form.inverse(lower), form.inverse(upper)  # pyright: ignore
    return Space(space.model, tuple(Group(g.leaves, g.factors, form) for g, form in zip(space.groups, forms, strict=True))), low, high


def _within(pairs: list[tuple[list[Any] | None, Factor]]) -> list[Any] | None:
    """The bounds of tied leaves as bounds of the first."""
    if any(pair is None for pair, _ in pairs):
        return None
    lower, upper = zip(*(bounds_of_first(pair, factor) for pair, factor in pairs if pair is not None), strict=True)
    return [np.maximum.reduce(lower), np.minimum.reduce(upper)]


def at_value(space: Space, group: int, x: Any) -> np.ndarray:
    """The u of a group for a value of its first leaf."""
    form: Any = space.groups[group].form
    return form.inverse(np.broadcast_to(x, form.start.shape))


def drawn(space: Space, low: np.ndarray, high: np.ndarray, count: int, key: Any, where: str) -> np.ndarray:
    """Starts (count, n): the model, and random ones, uniform between the bounds of u. Orientations are uniform over all rotations,
    fractions uniform between their bounds or in their domain."""
    with Problems() as problems:
        rng = np.random.default_rng(np.asarray(jax.random.key_data(key)).ravel())
        u = np.zeros((count, space.size))
        for group, at in zip(space.groups, space.ends, strict=True):
            if isinstance(group.form, Rotated):
                q = rng.normal(size=(count, 4))
                q = q / np.linalg.norm(q, axis=1, keepdims=True)
                angle = 2 * np.arctan2(np.linalg.norm(q[:, 1:], axis=1), q[:, 0])
                u[:, at] = (
                    q[:, 1:] / np.linalg.norm(q[:, 1:], axis=1, keepdims=True) * np.where(angle > np.pi, angle - 2 * np.pi, angle)[:, None]
                )
            elif isinstance(group.form, Fraction):  # bounded by its domain
                ends = [np.asarray(group.form.value(end)) for end in (low[at], high[at])]
                u[:, at] = [group.form.inverse(rng.uniform(*ends)) for _ in range(count)]
            elif not isinstance(group.form, Elementwise):
                u[:, at] = SPREAD * rng.normal(size=(count, group.form.size))
            elif count > 1 and not np.isfinite(high[at] - low[at]).all():
                limit, hint = "both finite", "Random starts need bounds."
                problems.add("NO_BOUNDS", f"{where}['{group.path}']", "is missing", limit=limit, hint=hint)
            elif count > 1:
                u[:, at] = rng.uniform(low[at], high[at], (count, group.form.size))
    u[0] = 0.0
    return u
