"""Measured frequency responses from universal files (sets 58), in SI units, in the form
for MeasuredResponse."""

from __future__ import annotations

from typing import Any

import numpy as np

from jaxbody.core import units
from jaxbody.core.errors import JaxbodyError, Problem, Problems
from jaxbody.records.record_files import agreed_unit
from jaxbody.records.universal_files import read_uff_responses


def read_responses(
    path: Any, pairs: dict[tuple[str, str], Any], *, largest: float = 1e9
) -> tuple[np.ndarray, dict[tuple[str, str], np.ndarray]]:
    """Read frequency responses from a universal file (sets 58 of function type 4). Return the
    frequencies [Hz] and {(output, input): complex (nf,)}.

    `pairs` is {(output, input): "4+Z/1+Z"}, response over reference, each a node and a direction,
    +X to -Z or +RX to -RZ; or, where the file states no units, {(output, input): ("4+Z/1+Z",
    "m/s2", "N")}. If you and the file both state units, they must agree. `largest`: largest size of
    the file [bytes].

    Errors: those of a file in `read_record`, NOT_A_RESPONSE, NO_UNIT, UNKNOWN_UNIT, UNIT_CONFLICT,
    DIFFERENT_FREQUENCIES.

    >>> frequencies, measured = jb.records.read_responses(
    ...     "plate.uff", {("corner", "hammer"): "4+Z/1+Z"}
    ... )  # doctest: +SKIP
    """
    wanted = {
        pair: spec if isinstance(spec, tuple) else (spec, None, None)
        for pair, spec in pairs.items()
    }
    responses = read_uff_responses(path, [spec[0] for spec in wanted.values()], largest)
    measured, grid = {}, None
    with Problems() as problems:
        for pair, (name, above, below) in wanted.items():
            response, where = responses[name], f"{path}['{name}']"
            grid = response.frequencies if grid is None else grid
            if (
                grid.shape != response.frequencies.shape
                or np.abs(grid - response.frequencies).max() > 1e-9 * grid.max()
            ):
                problems.add(
                    "DIFFERENT_FREQUENCIES",
                    where,
                    "has different frequencies from the first one",
                    limit="one set",
                    hint="Read it separately.",
                )
            else:
                measured[pair] = (
                    response.values
                    * _factor(above, response.above, where, problems)
                    / _factor(below, response.below, where, problems)
                )
    if grid is None:
        raise JaxbodyError(
            Problem(
                "NO_DATA",
                "pairs",
                "is empty",
                limit="at least one",
                hint='Give {("y", "f"): "4+Z/1+Z"}.',
            )
        )
    return grid, measured


def _factor(stated: str | None, in_file: str | None, where: str, problems: Problems) -> float:
    """Return the factor to SI of the unit stated by the user or by the file; if both state one,
    they must agree."""
    hint = 'State both: ("4+Z/1+Z", "m/s2", "N").'
    unit = problems.gather(
        lambda: units.parse(agreed_unit(stated, {in_file}, where, problems, [], hint), where)
    )
    return 1.0 if unit is None else unit.factor
