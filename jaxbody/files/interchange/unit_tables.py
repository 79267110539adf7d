"""Text tables with a line for each thing: a name, other words, and numbers with units in the
headings or in the cells."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

from jaxbody.core.errors import JaxbodyError, Problem, Problems, unknown
from jaxbody.core.source_files import check_file, decoded
from jaxbody.files.quantities import NUMBER, in_SI
from jaxbody.records.text_tables import split_unit


class Columns(NamedTuple):
    """The columns that a table may have: words, numbers with their SI units, and those that must
    be there."""

    words: Sequence[str]
    units: Mapping[str, str]
    needed: Sequence[str]


def lines_of(
    path: Path, allowed: Columns, things: str, largest: float, problems: Problems
) -> list[tuple[str, dict[str, Any]]]:
    """Where each line stands, and its words and numbers in SI; `things`: what lines are, in
    the plural.

    Errors: those of text files and of headings; problems of lines are added."""
    check_file(path, largest)
    lines = decoded(path.read_bytes(), path.name, "utf-8").splitlines()
    rows = [
        (i + 1, line)
        for i, line in enumerate(lines)
        if line.strip() and not line.lstrip().startswith("#")
    ]
    if len(rows) < 2:
        raise JaxbodyError(
            Problem(
                "NO_NUMBERS",
                path.name,
                f"has no line of headings and lines of {things}",
                limit=", ".join(allowed.needed),
            )
        )
    separator = max(";\t,", key=rows[0][1].count)
    if separator == ";" and any("," in line for _, line in rows[1:]):
        raise JaxbodyError(
            Problem(
                "DECIMAL_COMMA",
                path.name,
                "has commas in its numbers",
                limit="decimal points",
                hint="Replace them.",
            )
        )
    cells = [
        (line, [cell.strip() for cell in next(csv.reader(io.StringIO(text), delimiter=separator))])
        for line, text in rows
    ]
    with Problems() as of_headings:
        columns = _columns(path.name, *cells[0], allowed, of_headings)
    found = []
    for line, row in cells[1:]:
        where = f"{path.name}:{line}"
        if len(row) == len(columns):
            found.append((where, _values(row, columns, allowed, where, problems)))
        else:
            problems.add(
                "RAGGED_LINE",
                where,
                f"has {len(row)} cells",
                value=len(row),
                limit=f"{len(columns)}, as the headings",
            )
    return found


def _columns(
    name: str, line: int, headings: list[str], allowed: Columns, problems: Problems
) -> list[tuple[str, str | None]]:
    """The name and the unit of each column."""
    columns = [split_unit(heading) for heading in headings]
    found = [column for column, _ in columns]
    where = f"{name}:{line}"
    for column in found:
        if column not in allowed.units and column not in allowed.words:
            problems.collected.append(unknown(column, where, (*allowed.words, *allowed.units)))
    for column in allowed.needed:
        if column not in found:
            problems.add(
                "MISSING_ENTRY",
                where,
                f"has no column '{column}'",
                value=found,
                limit=", ".join(allowed.needed),
            )
    for column in {column for column in found if found.count(column) > 1}:
        problems.add("DUPLICATE_NAME", where, f"has the column '{column}' twice", value=column)
    return columns


def _values(
    row: list[str],
    columns: list[tuple[str, str | None]],
    allowed: Columns,
    where: str,
    problems: Problems,
) -> dict[str, Any]:
    """The words of a line, and its numbers in SI."""
    values: dict[str, Any] = {}
    for cell, (name, unit) in zip(row, columns, strict=True):
        if not cell:
            hint = "Write 0 if it is zero." if name in allowed.units else ""
            if name in allowed.needed:
                problems.add(
                    "MISSING_ENTRY",
                    f"{where} {name}",
                    "is empty",
                    limit="a number" if hint else "a name",
                    hint=hint,
                )
        elif name in allowed.words:
            values[name] = cell
        else:
            values[name] = _number(
                cell, name, unit, allowed.units[name], f"{where} {name}", problems
            )
    return values


def _number(
    cell: str, name: str, unit: str | None, wanted: str, where: str, problems: Problems
) -> float:
    """A cell in SI; its unit is in the heading or beside the number."""
    own = Problems()
    value = in_SI(
        f"{cell} {unit}" if unit and re.fullmatch(NUMBER, cell) else cell,
        wanted,
        {},
        None,
        where,
        own,
    )
    if isinstance(value, list):
        own.add("NOT_A_NUMBER", where, f"is '{cell}'", value=cell, limit="one number")
        value = 0.0
    hint = f"Write it in the heading, {name} [{wanted}], or here, {cell} {wanted}."
    problems.collected += [
        replace(problem, hint=hint) if problem.code == "NO_UNIT" else problem
        for problem in own.collected
    ]
    return value
