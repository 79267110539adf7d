"""Free paths and patterns: single leaves, or leaves tied by "left.k = right.k", also with factors,
"left.a = right.a * [1, -1, 1]"; bounds and priors of a free parameter, converted from all its
leaves to the first and checked against its start.

A leaf is x f, where x is the value of the first leaf: bounds a <= x f <= b are a/f <= x <= b/f, and
exchange sides for f < 0.
"""

import json
import re
from collections.abc import Iterable
from fnmatch import fnmatchcase
from typing import Any

import numpy as np

from jaxbody.core.arrays import Array, concrete, device_array
from jaxbody.core.errors import Problem, Problems
from jaxbody.fitting.parameters.transforms import (
    Elementwise,
    Ordered,
    Parametrization,
    Positive,
    Shifted,
)
from jaxbody.model.leaf_paths import Leaf, matching

ALIKE = 1e-9  # largest relative difference of the starts of tied parameters

Factor = float | tuple[float, ...]
Tie = dict[Leaf, Factor]  # {leaf: ratio of its value to that of the first leaf}


def ties(
    leaves: list[Leaf],
    free: Iterable[str],
    where: str,
    problems: Problems,
    absent: dict[str, str] | None = None,
) -> list[Tie]:
    """Return the free parameters as {leaf: factor}. Each leaf that a path or pattern names is one
    parameter; all leaves of "a = b" or "a = b * factor" together are one parameter, where the
    factor is a number or a list of numbers.

    Args:
        leaves: all leaves that paths may name.
        free: paths, patterns and ties.
        where: name of the argument, for messages.
        problems: collects the errors.
        absent: {path: hint} of optional leaves that are not given, by default none.
    """
    entries, paths = [str(entry) for entry in free], [leaf.path for leaf in leaves]
    for entry in [entry for i, entry in enumerate(entries) if entry in entries[:i]]:
        problems.add(
            "LISTED_TWICE",
            where,
            f"lists '{entry}' twice",
            value=entry,
            hint="List each parameter once.",
        )
    sides = {
        entry: [_side(side, where, problems) for side in _split(entry, paths)] for entry in entries
    }
    for entry in [
        entry
        for entry, parts in sides.items()
        if len(parts) > 1 and not all(pattern for pattern, _ in parts)
    ]:
        problems.add(
            "UNKNOWN_PATH",
            where,
            f"'{entry}' ties nothing on one side",
            value=entry,
            limit="a path on both sides",
            hint='Write "left.stiffness = right.stiffness".',
        )
        sides[entry] = [part for part in sides[entry] if part[0]]
    named = dict.fromkeys(pattern for parts in sides.values() for pattern, _ in parts)
    matched = matching(leaves, named, where, problems, absent)
    listed: set[Leaf] = set()
    free_ties: list[Tie] = []
    for entry, parts in sides.items():
        selected: dict[Leaf, Any] = {}
        for pattern, factor in parts:
            for leaf in matched[pattern]:
                if not np.array_equal(selected.setdefault(leaf, factor), factor):
                    problems.add(
                        "BAD_TIE",
                        where,
                        f"'{entry}' ties {leaf.path} to itself with another factor",
                        value=entry,
                        limit="two parameters",
                        hint="Name the other one.",
                    )
        for leaf in selected:
            if leaf in listed:
                problems.add(
                    "LISTED_TWICE",
                    where,
                    f"lists {leaf.path} twice, also by '{entry}'",
                    value=entry,
                    hint="List each parameter once.",
                )
        listed |= set(selected)
        first = next(iter(selected.values()), 1.0)
        tied: Tie = {leaf: _ratio(first, factor) for leaf, factor in selected.items()}
        single: list[Tie] = [{leaf: 1.0} for leaf in selected]
        free_ties += single if len(parts) == 1 else [tied] if tied else []
    if not free_ties and not problems.collected:
        problems.add(
            "NOTHING_FREE",
            where,
            "is empty",
            limit="at least one path",
            hint='Name the unknowns: free=["*.stiffness"].',
        )
    return free_ties


def _split(entry: str, paths: list[str]) -> list[str]:
    """Return the sides of a tie. A name may contain an equals sign without spaces around it."""
    if any(fnmatchcase(path, entry) for path in paths):
        return [entry]
    return re.split(r"\s=\s" if re.search(r"\s=\s", entry) else "=", entry)


def _side(text: str, where: str, problems: Problems) -> tuple[str, Any]:
    """Return the pattern and the factor of "pattern * factor"."""
    parts = re.fullmatch(r"(.*\S)\s+\*\s+(\S.*)", text.strip())
    if parts is None:
        return text.strip(), 1.0
    try:
        factor = np.asarray(json.loads(parts[2]), float)
    except (TypeError, ValueError):
        factor = np.zeros(())
    if factor.ndim > 1 or not (np.isfinite(factor) & (factor != 0)).all():
        problems.add(
            "BAD_TIE",
            where,
            f"has the factor {parts[2]}",
            value=text,
            limit="a nonzero number or a list of nonzero numbers",
            hint='Write "left.a = right.a * [1, -1, 1]".',
        )
        return parts[1], 1.0
    return parts[1], factor


def _ratio(first: Any, own: Any) -> Factor:
    ratio = np.asarray(first) / np.asarray(own)
    return float(ratio) if ratio.ndim == 0 else tuple(ratio.tolist())


def times(x: Any, factor: Factor) -> Any:
    """Return the value of a leaf from the value `x` of the first leaf of its tie."""
    return x if factor == 1.0 else x * np.asarray(factor)


def check_alike(tie: Tie, starts: list[Any], form: Parametrization, problems: Problems) -> None:
    """Check that the starts of tied leaves agree with the tie, and that only scalars and vectors
    have factors. Errors: TIED_APART, BAD_TIE."""
    first, values = next(iter(tie)), [concrete(start) for start in starts]
    for (leaf, factor), start in zip(tie.items(), values, strict=True):
        if start is None or values[0] is None:
            continue
        tied = equation([first.path, leaf.path], [1.0, factor])
        allowed = (
            ((),)
            if isinstance(form, Ordered)
            else ((), start.shape)
            if isinstance(form, Positive | Shifted)
            else ()
        )
        if factor != 1.0 and np.shape(factor) not in allowed:
            problems.add(
                "BAD_TIE",
                leaf.path,
                f"of shape {start.shape} cannot be tied by {tied}",
                value=factor,
                limit="scalars and vectors, by a number or one for each; rows in order, by a "
                "number",
            )
        elif start.shape != values[0].shape or not np.allclose(
            start, times(values[0], factor), rtol=ALIKE, atol=0
        ):
            problems.add(
                "TIED_APART",
                leaf.path,
                f"starts at {start}, but {tied}, and {first.path} starts at {values[0]}",
                value=start,
                hint="Set matching values with jb.replace.",
            )


def equation(paths: Iterable[str], factors: Iterable[Factor]) -> str:
    """Return the text of a tie: "left.a = right.a * [1, -1, 1]"."""

    def side(path: str, factor: Factor) -> str:
        inverse = 1 / np.asarray(factor)
        return (
            path
            if factor == 1.0
            else f"{path} * "
            + np.array2string(inverse, separator=", ", formatter={"float": "{:g}".format})
        )

    return " = ".join(map(side, paths, factors))


Given = Iterable[tuple[Leaf, Factor, Any]]  # leaves, their factors, and their bounds or priors


def pair_of(given: Any, shape: tuple[int, ...]) -> list[np.ndarray] | None:
    """Return a pair (lower, upper) or (mean, deviation) as arrays of this shape; None if it is not
    a pair of numbers."""
    try:
        lower, upper = given
        return [np.broadcast_to(np.asarray(end, float), shape) for end in (lower, upper)]
    except (TypeError, ValueError):
        return None


def limits_of(
    form: Parametrization | Problem, start: Array, bounds: Given, where: str, problems: Problems
) -> tuple[np.ndarray, np.ndarray]:
    """Return the largest lower and the smallest upper bound of the first leaf, -inf and inf without
    bounds.

    Args:
        form: the parametrization, or the problem if the start is at a limit of the domain.
        start: the value of the first leaf.
        bounds: pairs (lower, upper) of the leaves.
        where: name of the argument, for messages.
        problems: collects BAD_BOUNDS and START_OUTSIDE.
    """
    low, high = np.full(start.shape, -np.inf), np.full(start.shape, np.inf)
    for leaf, factor, given in bounds:
        at, pair = f"{where}['{leaf.path}']", pair_of(given, start.shape)
        if not isinstance(form, Elementwise | Problem):
            problems.add(
                "BAD_BOUNDS",
                at,
                "cannot have bounds",
                hint="Give bounds for scalars, and for vectors whose numbers do not "
                "depend on each other.",
            )
        elif pair is None:
            problems.add("BAD_BOUNDS", at, f"is {given!r:.60}", value=given, limit="(lower, upper)")
        elif np.isnan(pair).any():
            problems.add(
                "BAD_BOUNDS",
                at,
                f"is {given!r:.60}, which has a NaN",
                value=given,
                limit="numbers",
                hint="Give -inf or inf for a side without a bound.",
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
                problems.add(
                    "START_OUTSIDE",
                    at,
                    f"excludes the start {np.asarray(start)}, which is outside by {outside:.4g}",
                    value=start,
                    limit=f"{given[0]} to {given[1]}",
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
    """Return mean and standard deviation of the first leaf, as arrays of its shape; None without a
    prior. Error: BAD_PRIOR."""
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
