"""Bounds and priors of a free parameter: those of all its leaves as those of the first, checked
against its start.

A leaf is x f in the value x of the first leaf: bounds a <= x f <= b are a/f <= x <= b/f, and change
sides for f < 0.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from jaxbody.core.arrays import Array, device_array
from jaxbody.core.errors import Problem, Problems
from jaxbody.fitting.parameters.ties import ALIKE, Factor
from jaxbody.fitting.parameters.transforms import Elementwise, Ordered, Parametrization
from jaxbody.model.leaf_paths import Leaf

# leaves of a parameter, their factors, and what is given for them
Given = Iterable[tuple[Leaf, Factor, Any]]

Limits = tuple[np.ndarray, np.ndarray]


def pair_of(given: Any, shape: tuple[int, ...]) -> list[np.ndarray] | None:
    """A pair (lower, upper) or (mean, deviation) as arrays of this shape; None if it is not a pair
    of numbers."""
    try:
        lower, upper = given
        return [np.broadcast_to(np.asarray(end, float), shape) for end in (lower, upper)]
    except (TypeError, ValueError):
        return None


def limits_of(
    form: Parametrization | Problem, start: Array, bounds: Given, where: str, problems: Problems
) -> tuple[np.ndarray, np.ndarray]:
    """The largest lower and the smallest upper bound of the first leaf, -inf and inf
    without bounds.

    Args:
        form: the parametrization, or the problem of a start at a limit of the domain.
        start: the value of the first leaf.
        bounds: pairs (lower, upper) of the leaves.
        where: name of the argument, for messages.
        problems: collects BAD_BOUNDS and START_OUTSIDE.
    """
    low, high = np.full(start.shape, -np.inf), np.full(start.shape, np.inf)
    for leaf, factor, given in bounds:
        at, pair = f"{where}['{leaf.path}']", pair_of(given, start.shape)
        if not isinstance(form, Elementwise | Problem):
            hint = (
                "Give bounds for scalars, and for vectors whose numbers do not "
                "depend on each other."
            )
            problems.add("BAD_BOUNDS", at, "cannot have bounds", hint=hint)
        elif pair is None:
            problems.add("BAD_BOUNDS", at, f"is {given!r:.60}", value=given, limit="(lower, upper)")
        elif np.isnan(pair).any():
            hint = "Give -inf or inf for a side without a bound."
            problems.add(
                "BAD_BOUNDS",
                at,
                f"is {given!r:.60}, which has a NaN",
                value=given,
                limit="numbers",
                hint=hint,
            )
        elif not (pair[0] < pair[1]).all():
            problems.add(
                "BAD_BOUNDS",
                at,
                f"has lower {given[0]} >= upper {given[1]}",
                value=given,
                limit="lower < upper",
            )
        else:
            ends = np.sort([end / np.asarray(factor) for end in pair], axis=0)
            outside = np.maximum(ends[0] - np.asarray(start), np.asarray(start) - ends[1]).max()
            # a tuned model may be outside by round-off
            if outside > ALIKE * np.abs(np.where(np.isfinite(ends), ends, 0.0)).max():
                message, limit = (
                    f"excludes the start {np.asarray(start)}, which is outside by {outside:.4g}",
                    f"{given[0]} to {given[1]}",
                )
                problems.add(
                    "START_OUTSIDE",
                    at,
                    message,
                    value=start,
                    limit=limit,
                    hint="Change the start or the bound.",
                )
            elif not (np.maximum(low, ends[0]) < np.minimum(high, ends[1])).all():
                problems.add(
                    "BAD_BOUNDS",
                    at,
                    "leaves nothing between the bounds of tied parameters",
                    value=given,
                    limit="lower < upper",
                )
            low, high = np.maximum(low, ends[0]), np.minimum(high, ends[1])
    return np.asarray(low), np.asarray(high)


def prior_of(
    form: Parametrization, priors: Given, where: str, problems: Problems
) -> tuple[Array, Array] | None:
    """Mean and standard deviation of the first leaf, as arrays of its shape; None without a prior.
    Problem: BAD_PRIOR."""
    prior = None
    for leaf, factor, given in priors:
        at, pair = f"{where}['{leaf.path}']", pair_of(given, form.start.shape)
        if not isinstance(form, Elementwise | Ordered):
            problems.add(
                "BAD_PRIOR",
                at,
                "cannot have a prior",
                hint="Give priors for scalars and vectors only.",
            )
        elif pair is None or not np.isfinite(pair).all() or not (pair[1] > 0).all():
            problems.add(
                "BAD_PRIOR",
                at,
                f"is {given!r:.60}",
                value=given,
                limit="(mean, standard deviation > 0), finite",
            )
        else:
            prior = (
                device_array(pair[0] / np.asarray(factor)),
                device_array(pair[1] / np.abs(factor)),
            )
    return prior
