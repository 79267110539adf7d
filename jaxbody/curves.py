"""Measured curves from files: two columns whose first line names them with their units."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np

from jaxbody.errors import JaxbodyError, Problem

UNITS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "in": 0.0254, "rad": 1.0, "deg": np.pi / 180}
RATES = {f"{unit}/s": factor for unit, factor in UNITS.items()}
FORCES = {"N": 1.0, "kN": 1e3, "lbf": 4.4482216152605, "N m": 1.0, "Nm": 1.0}


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
    units = [cell[cell.find("[") + 1 : cell.rfind("]")].strip() if "[" in cell and "]" in cell else None for cell in head[1]]
    if len(units) != 2 or None in units:
        raise fail(
            "NO_UNIT", head[0], "names no two columns with units", "elongation [mm], force [N]", "Write the units into the first line."
        )
    factors = []
    for unit, known in zip(units, ({**UNITS, **RATES}, FORCES), strict=True):
        if unit not in known:
            raise fail("UNKNOWN_UNIT", head[0], f"unit '{unit}' is unknown", " ".join(known))
        factors.append(known[unit])
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
