"""Free paths and patterns: single leaves, or leaves tied by "left.k = right.k", also with factors,
"left.a = right.a * [1, -1, 1]"."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable
from fnmatch import fnmatchcase
from typing import Any

import numpy as np

from jaxbody.core.arrays import concrete
from jaxbody.core.errors import Problems
from jaxbody.fitting.parameters.transforms import Ordered, Parametrization, Positive, Shifted
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
    """The free parameters: each leaf of a path or pattern is one, and all leaves of "a = b" or
    "a = b * factor" together, where the factor is a number or a list of numbers.

    Args:
        leaves: all leaves that paths may name.
        free: paths, patterns and ties.
        where: name of the argument, for messages.
        problems: collects the errors.
        absent: {path: hint} of leaves that do not exist but could, by default none.
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
        limit, hint = "a path on both sides", 'Write "left.stiffness = right.stiffness".'
        problems.add(
            "UNKNOWN_PATH",
            where,
            f"'{entry}' ties nothing on one side",
            value=entry,
            limit=limit,
            hint=hint,
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
                    message = f"'{entry}' ties {leaf.path} to itself with another factor"
                    problems.add(
                        "BAD_TIE",
                        where,
                        message,
                        value=entry,
                        limit="two parameters",
                        hint="Name the other one.",
                    )
        for leaf in selected:
            if leaf in listed:
                message = f"lists {leaf.path} twice, also by '{entry}'"
                problems.add(
                    "LISTED_TWICE", where, message, value=entry, hint="List each parameter once."
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
    """The sides of a tie. A name may have an equals sign in it, without spaces around it."""
    if any(fnmatchcase(path, entry) for path in paths):
        return [entry]
    return re.split(r"\s=\s" if re.search(r"\s=\s", entry) else "=", entry)


def _side(text: str, where: str, problems: Problems) -> tuple[str, Any]:
    """The pattern and the factor of "pattern * factor"."""
    parts = re.fullmatch(r"(.*\S)\s+\*\s+(\S.*)", text.strip())
    if parts is None:
        return text.strip(), 1.0
    try:
        factor = np.asarray(json.loads(parts[2]), float)
    except (TypeError, ValueError):
        factor = np.zeros(())
    if factor.ndim > 1 or not (np.isfinite(factor) & (factor != 0)).all():
        limit = "a nonzero number or a list of nonzero numbers"
        problems.add(
            "BAD_TIE",
            where,
            f"has the factor {parts[2]}",
            value=text,
            limit=limit,
            hint='Write "left.a = right.a * [1, -1, 1]".',
        )
        return parts[1], 1.0
    return parts[1], factor


def _ratio(first: Any, own: Any) -> Factor:
    ratio = np.asarray(first) / np.asarray(own)
    return float(ratio) if ratio.ndim == 0 else tuple(ratio.tolist())


def times(x: Any, factor: Factor) -> Any:
    """The value of a leaf from the value of the first leaf of its tie."""
    return x if factor == 1.0 else x * np.asarray(factor)


def check_alike(tie: Tie, starts: list[Any], form: Parametrization, problems: Problems) -> None:
    """Check that the starts of tied leaves agree with the tie; only scalars and vectors may have
    factors. Errors: TIED_APART, BAD_TIE."""
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
            limit = "scalars and vectors, by a number or one for each; rows in order, by a number"
            problems.add(
                "BAD_TIE",
                leaf.path,
                f"of shape {start.shape} cannot be tied by {tied}",
                value=factor,
                limit=limit,
            )
        elif start.shape != values[0].shape or not np.allclose(
            start, times(values[0], factor), rtol=ALIKE, atol=0
        ):
            message = f"starts at {start}, but {tied}, and {first.path} starts at {values[0]}"
            problems.add(
                "TIED_APART",
                leaf.path,
                message,
                value=start,
                hint="Set matching values with jb.replace.",
            )


def equation(paths: Iterable[str], factors: Iterable[Factor]) -> str:
    """The text of a tie: "left.a = right.a * [1, -1, 1]"."""

    def side(path: str, factor: Factor) -> str:
        inverse = 1 / np.asarray(factor)
        return (
            path
            if factor == 1.0
            else f"{path} * "
            + np.array2string(inverse, separator=", ", formatter={"float": "{:g}".format})
        )

    return " = ".join(map(side, paths, factors))
