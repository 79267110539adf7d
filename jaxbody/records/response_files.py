"""Measured frequency responses from universal files (sets 58), in SI units, as MeasuredResponse takes them."""

from __future__ import annotations

from typing import Any

import numpy as np

from jaxbody.core import units
from jaxbody.core.errors import JaxbodyError, Problem, Problems
from jaxbody.records.universal_files import read_uff_responses


def read_responses(
    path: Any, pairs: dict[tuple[str, str], Any], *, largest: float = 1e9
) -> tuple[np.ndarray, dict[tuple[str, str], np.ndarray]]:
    """(frequencies [Hz], {(output, input): complex (nf,)}) of the frequency responses in a universal file (sets 58 of function type 4).

    pairs {(output, input): "4+Z/1+Z"}: response over reference, each a node and a direction, +X to -Z or +RX to -RZ; or
    {(output, input): ("4+Z/1+Z", "m/s2", "N")} with their units, where the file states none. Where both state one, they must agree.

    Errors: those of a file in `read_record`, NOT_A_RESPONSE, NO_UNIT, UNKNOWN_UNIT, UNIT_CONFLICT, DIFFERENT_FREQUENCIES.

    >>> frequencies, measured = read_responses("plate.uff", {("corner", "hammer"): "4+Z/1+Z"})  # doctest: +SKIP
    """
    wanted = {pair: spec if isinstance(spec, tuple) else (spec, None, None) for pair, spec in pairs.items()}
    found = read_uff_responses(path, [spec[0] for spec in wanted.values()], largest)
    problems, measured, grid = Problems(), {}, None
    for pair, (name, above, below) in wanted.items():
        response, where = found[name], f"{path}['{name}']"
        grid = response.frequencies if grid is None else grid
        if grid.shape != response.frequencies.shape or np.abs(grid - response.frequencies).max() > 1e-9 * grid.max():
            problems.add("DIFFERENT_FREQUENCIES", where, "has frequencies of its own", limit="one set", hint="Read it by itself.")
            continue
        factors = [_factor(*both, where, problems) for both in ((above, response.above), (below, response.below))]
        measured[pair] = response.values * factors[0] / factors[1]
    problems.raise_if_any()
    if grid is None:
        raise JaxbodyError(Problem("NO_DATA", "pairs", "is empty", limit="at least one", hint='Say {("y", "f"): "4+Z/1+Z"}.'))
    return grid, measured


def _factor(stated: str | None, said: str | None, where: str, problems: Problems) -> float:
    """The factor to SI of the unit stated by the user, by the file, or by both in agreement."""
    found = []
    for text in (stated, said):
        try:
            found += [] if text is None else [units.parse(text, where)]
        except JaxbodyError as error:
            problems.collected += error.problems
            return 1.0
    if not found:
        problems.add("NO_UNIT", where, "has no unit in the file", limit="one each", hint='State them: ("4+Z/1+Z", "m/s2", "N").')
        return 1.0
    if (len(found) == 2 and found[0].dimension != found[1].dimension) or abs(found[0].factor / found[-1].factor - 1) > 1e-9:
        hint = "Believe the file by stating none."
        problems.add("UNIT_CONFLICT", where, f"is in '{said}' in the file, not in '{stated}'", value=stated, limit=str(said), hint=hint)
    return found[0].factor
