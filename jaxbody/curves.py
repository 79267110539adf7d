"""Measured curves from files: two columns whose first line names them with their units."""

from __future__ import annotations

import csv
from pathlib import Path

from jaxbody import units
from jaxbody.errors import JaxbodyError, Problem
from jaxbody.texts import split_unit

LENGTHS = (units.LENGTH, units.ANGLE, units.SPEED, units.ANGULAR_RATE)
FORCES = (units.FORCE, units.MOMENT)


def read_columns(path: Path) -> tuple[list[float], list[float]]:
    """Two columns in SI units."""

    def fail(code, line, told, limit="", hint=""):
        return JaxbodyError(Problem(code, f"{path.name}:{line}", told, line, limit, hint))

    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise JaxbodyError(Problem("NO_FILE", str(path), f"cannot be read: {error}", path, hint="Give the path of a text file.")) from None
    rows = [(i, row) for i, row in enumerate(csv.reader(lines), 1) if row and not row[0].lstrip().startswith("#")]
    head = rows[0] if rows else (1, [])
    stated = [split_unit(cell)[1] for cell in head[1]]
    if len(stated) != 2 or None in stated:
        raise fail(
            "NO_UNIT", head[0], "names no two columns with units", "elongation [mm], force [N]", "Write the units into the first line."
        )
    factors = []
    for text, dimensions in zip(stated, (LENGTHS, FORCES), strict=True):
        unit = units.parse(str(text), f"{path.name}:{head[0]}")
        if unit.dimension not in dimensions:
            limit = " or ".join(units.si_words(dimension) for dimension in dimensions)
            raise fail("WRONG_DIMENSION", head[0], f"is in '{text}'", limit, "First elongation or its rate, then force or moment.")
        factors.append(unit.factor)
    columns: tuple[list[float], list[float]] = ([], [])
    for i, row in rows[1:]:
        try:
            numbers = [float(cell) for cell in row]
        except ValueError:
            numbers = []
        if len(numbers) != 2:
            raise fail("BAD_LINE", i, f"is {','.join(row)!r:.60}", "two numbers", "Separate by commas, with a decimal point.")
        for column, number, factor in zip(columns, numbers, factors, strict=True):
            column.append(number * factor)
    return columns
