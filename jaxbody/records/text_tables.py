"""Tables of numbers in text files: lines with equal numbers of cells below a line of names, read as
they are or rejected with the number of the line.

Names and units are taken from the lines before the numbers, "acc [g]" or a line of units below the
names; skipped lines are in the notes. Nothing is guessed about the numbers: a decimal comma, a
footer or a line of another length is an error unless it is stated.
"""

import csv
import re
from collections import Counter
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from jaxbody.core.errors import MOST_PROBLEMS, JaxbodyError, Problem, Problems
from jaxbody.core.source_files import decoded
from jaxbody.core.tables import counted
from jaxbody.core.units import is_unit

# an empty cell or NaN is a missing sample
NUMBER = re.compile(r"[+-]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eEdD][+-]?\d+)?|nan|NaN|NAN|NA|")
COMMA_NUMBER = re.compile(r"[+-]?\d+,\d+(?:[eE][+-]?\d+)?")
THOUSANDS = re.compile(r"[+-]?\d{1,3}([,' ]\d{3})+(\.\d*)?|[+-]?\d{1,3}(\.\d{3})+(,\d*)?")
DATE = re.compile(r"\d{1,4}([-/.])\d{1,2}\1\d{1,4}([T ]\d{1,2}:\d\d.*)?|\d{1,2}:\d\d(:\d\d.*)?")
COMMENTS = ("#", "%", "!")
LONGEST_PREAMBLE = 1000


@dataclass
class Column:
    """One channel of a file: values (n,) or (n, k), the unit that the file states, and its own
    times [s], if any."""

    values: np.ndarray
    unit: str | None = None
    times: np.ndarray | None = None


@dataclass
class Contents:
    """Columns by name, notes on how they were read, and for text the line number of the names, or
    of the first numbers if there are no names."""

    columns: dict[Any, Column]
    notes: list[str] = field(default_factory=list)
    head: int = 1


def read_text(
    data: bytes,
    name: str,
    *,
    encoding="utf-8",
    separator: str | None = None,
    decimal: str = ".",
    skip: int = 0,
    footer: int = 0,
) -> Contents:
    """Read the columns of a text table.

    Args:
        data: content of the file
        name: name of the file, in messages
        encoding: encoding of the text
        separator: separator between columns; None: that of the first line of numbers
        decimal: decimal mark
        skip: number of lines to leave out at the start
        footer: number of lines to leave out at the end

    Errors, each with its line: ENCODING, NO_NUMBERS, BAD_LINE, RAGGED_LINE, DECIMAL_COMMA,
    TRUNCATED, NON_FINITE.
    """
    text = decoded(data, name, encoding)
    lines = [(i, line.strip(" \r")) for i, line in enumerate(re.split(r"\r\n|\n|\r", text), 1)]
    lines = [(i, line) for i, line in lines[skip:] if line.strip()]
    lines = lines[: len(lines) - footer] if footer else lines
    first = next(
        (
            k
            for k, (_, line) in enumerate(lines[:LONGEST_PREAMBLE])
            if _is_data(line, separator, decimal)
        ),
        None,
    )
    if first is None:
        raise _no_numbers(lines, name, separator, decimal)
    separator = separator or _separator(lines[first][1])
    rows = [(i, line) for i, line in lines[first:] if not line.startswith(COMMENTS)]
    values = numbers_of(rows, name, separator, decimal, complete=text.endswith(("\n", "\r")))
    if first and not _fits_head(lines[first - 1][1], separator, values.shape[1]):
        (i, head), width = lines[first - 1], values.shape[1]
        raise JaxbodyError(
            Problem(
                "RAGGED_LINE",
                f"{name}:{i}",
                f"names {len(_cells(head, separator))} columns: {head!r:.50}",
                head,
                f"{width}, as line {lines[first][0]} has",
                _ragged_hint(width, len(_cells(head, separator)), separator),
            )
        )
    names, units, used = _heads([line for _, line in lines[:first]], separator, values.shape[1])
    if any(NUMBER.fullmatch(cell) and cell for cell in names) and used:
        i, line = lines[first - used]
        raise JaxbodyError(
            Problem(
                "BAD_LINE",
                f"{name}:{i}",
                f"is {line!r:.60}",
                line,
                "names or numbers",
                (
                    _not_plain(_cells(line, separator))
                    or f"If it is neither names nor numbers, give skip={i}."
                ),
            )
        )
    columns = {
        head: Column(values[:, k], unit)
        for k, (head, unit) in enumerate(zip(distinct(names), units, strict=True))
    }
    notes = [
        f"left out {counted(count, 'line')} {where}"
        for count, where in ((skip, "at the start"), (footer, "at the end"))
        if count
    ]
    if first - used > 0:
        notes.append(f"ignored {counted(first - used, 'line')} before the table")
    return Contents(columns, notes, lines[first - used][0])


def distinct(names: list[str]) -> list[str]:
    """Return the names made distinct: "name#k" with the column number k for a name that occurs more
    than once, and k alone for an empty name."""
    often = Counter(names)
    return [
        name if name and often[name] == 1 else f"{name}#{k}" if name else str(k)
        for k, name in enumerate(names)
    ]


def _cells(line: str, separator: str) -> list[str]:
    if '"' in line:
        cells = next(
            csv.reader(
                [line],
                delimiter=separator if separator.strip() or separator == "\t" else " ",
                skipinitialspace=True,
            )
        )
    else:
        cells = line.split(None if separator == " " else separator)
    return [cell.strip() for cell in cells]


def _fits_head(head: str, separator: str, width: int) -> bool:
    """Return whether a line above the numbers is valid: as many names as columns, a comment, or
    other text."""
    cells = _cells(head, separator)
    return (
        head.startswith(COMMENTS)
        or separator == " "
        or len(cells) in (1, width)
        or (len(cells) == width + 1 and not cells[-1])
    )


def _separator(line: str) -> str:
    return next((mark for mark in ("\t", ";", ",") if mark in line), " ")


def _is_data(line: str, separator: str | None, decimal: str) -> bool:
    if line.startswith(COMMENTS):
        return False
    separator = separator or _separator(line)
    cells = _cells(line, separator)
    return all(
        NUMBER.fullmatch(_pointed(cell, decimal))
        or (separator != "," and COMMA_NUMBER.fullmatch(cell))
        for cell in cells
    ) and any(cell[:1].isdigit() or cell[:1] in ("+", "-", ".") for cell in cells)


def _pointed(cell: str, decimal: str) -> str:
    return cell if decimal == "." else cell.replace(".", "?").replace(decimal, ".")


def _not_plain(cells: list[str]) -> str:
    """Return the hint for a number with thousands separators, or for a date or a time of day; "" if
    there is none."""
    for cell in cells:
        if THOUSANDS.fullmatch(cell) and not NUMBER.fullmatch(cell):
            return (
                f"{cell!r} has thousands separators, or quotes around them: write numbers without "
                "them."
            )
        if DATE.fullmatch(cell):
            return (
                f"'{cell:.30}' is a date or a time of day: write seconds in its place, or give "
                "jb.Record the columns that pandas.read_csv(..., parse_dates=) reads, with "
                "(t - t[0]).dt.total_seconds()."
            )
    return ""


def _no_numbers(
    lines: list[tuple[int, str]], name: str, separator: str | None, decimal: str
) -> JaxbodyError:
    i, line = lines[0] if lines else (1, "")
    hint = (
        f"Give numbers separated by {separator or 'commas, semicolons, tabs or blanks'}, with "
        f"decimal '{decimal}', below a line of names."
    )
    cells = [_cells(row, separator or _separator(row)) for _, row in lines[:LONGEST_PREAMBLE]]
    hint = next((text for row in cells if (text := _not_plain(row))), hint)
    return JaxbodyError(
        Problem(
            "NO_NUMBERS",
            name,
            (
                f"has no line with numbers only; line {i} is {line!r:.60}"
                if lines
                else "has only blank lines"
            ),
            i,
            "a table of numbers",
            hint,
        )
    )


def numbers_of(
    rows: list[tuple[int, str]], name: str, separator: str, decimal: str, *, complete: bool
) -> np.ndarray:
    """Return the numbers (n, k) of the lines of a table, NaN where a cell is empty.

    Args:
        rows: (line number, line) of the table
        name: name of the file, in messages
        separator: separator between columns
        decimal: decimal mark
        complete: whether the file ends with a line end; otherwise a short last line is TRUNCATED

    Errors: BAD_LINE, RAGGED_LINE, DECIMAL_COMMA, TRUNCATED, NON_FINITE."""
    if decimal == "." and '"' not in rows[0][1]:
        with suppress(ValueError, OverflowError):  # fast, sufficient for nearly all files
            values = np.loadtxt(
                [line for _, line in rows],
                delimiter=None if separator == " " else separator,
                comments=None,
                ndmin=2,
            )
            if np.isfinite(values).all():
                return values
    with Problems() as problems:
        cells = [_cells(line, separator) for _, line in rows]
        width = len(cells[0])
        no_numbers = [
            [cell for cell in row if not NUMBER.fullmatch(_pointed(cell, decimal))] for row in cells
        ]
        last_good = max(
            (k for k, row in enumerate(cells) if len(row) == width and not no_numbers[k]), default=0
        )
        commas = [next(filter(COMMA_NUMBER.fullmatch, wrong), None) for wrong in no_numbers]
        for k, ((i, line), row) in enumerate(zip(rows, cells, strict=True)):
            where, wrong, comma = f"{name}:{i}", no_numbers[k], commas[k]
            if len(row) != width:
                last = k == len(rows) - 1 and not complete and len(row) < width
                problems.add(
                    "TRUNCATED" if last else "RAGGED_LINE",
                    where,
                    f"has {len(row)} cells: {line!r:.50}",
                    value=len(row),
                    limit=f"{width}, as line {rows[0][0]} has",
                    hint=(
                        "The file ends within a line: copy it again, or give footer=1."
                        if last
                        else _ragged_hint(len(row), width, separator)
                    ),
                )
            elif comma is not None:
                if any(commas[:k]):
                    continue  # reported with the first line that has one
                others = sum(map(bool, commas)) - 1
                thousands = " If it separates thousands, write numbers without it."
                problems.add(
                    "DECIMAL_COMMA",
                    where,
                    f"has {comma!r}" + f", as {others} lines after it have" * (others > 0),
                    value=comma,
                    limit="a decimal point",
                    hint=f'It may be a decimal comma: give decimal=",", separator="{separator}".'
                    + (thousands if THOUSANDS.fullmatch(comma) else ""),
                )
            elif wrong and wrong[0].lower().lstrip("+-") in ("inf", "infinity", "1.#inf"):
                problems.add(
                    "NON_FINITE",
                    where,
                    f"has {wrong[0]!r}",
                    value=wrong[0],
                    limit="finite",
                    hint="Leave the cell empty for a missing sample.",
                )
            elif wrong:
                at_end = k > last_good
                if at_end and k > last_good + 1:
                    continue  # reported with the first line of the footer
                hint = (
                    f"If the table ends before it, give footer={len(rows) - k}. If"
                    if at_end
                    else "Numbers follow: if"
                )
                problems.add(
                    "BAD_LINE",
                    where,
                    f"has {wrong[0]!r:.40} in column {row.index(wrong[0]) + 1}",
                    value=wrong[0],
                    limit="numbers",
                    hint=(
                        _not_plain(wrong)
                        or f"{hint} it means a missing sample, leave the cell empty or write nan."
                    ),
                )
            if len(problems.collected) >= MOST_PROBLEMS:
                break
    values = np.array([[_number(_pointed(cell, decimal)) for cell in row] for row in cells])
    if width > 1 and all(row[-1] == "" for row in cells):  # a separator at the end of every line
        values = values[:, :-1]
    huge = np.argwhere(np.isinf(values))
    if len(huge):
        i = rows[huge[0][0]][0]
        raise JaxbodyError(
            Problem(
                "NON_FINITE",
                f"{name}:{i}",
                "has a number too large for float64",
                i,
                "finite",
                "Leave the cell empty.",
            )
        )
    return values


def _number(cell: str) -> float:
    return (
        float(cell.replace("d", "e").replace("D", "e"))
        if cell[-1:].isdigit() or cell[-1:] == "."
        else np.nan
    )


def _ragged_hint(cells: int, width: int, separator: str) -> str:
    if separator == "," and cells % 2 == 0 and 2 * width in (cells, 2 * cells):
        return (
            "Are there decimal commas? A file with them needs another separator: "
            'decimal=",", separator=";".'
        )
    return (
        "All lines of the table need the same number of cells; footer= leaves out lines at the end."
    )


def _heads(lines: list[str], separator: str, width: int) -> tuple[list[str], list[str | None], int]:
    """Return names and units from the lines above the numbers, and the number of these lines;
    columns without names have empty names."""
    rows = []
    for line in reversed(lines[-2:]):
        row = _cells(line.lstrip("".join(COMMENTS)).strip(), separator)
        row = row[:width] if len(row) == width + 1 and not row[-1] else row
        if len(row) != width and separator != " ":
            row = _cells(line.lstrip("".join(COMMENTS)).strip(), " ")
        if len(row) != width:
            break
        rows.insert(0, row)
    units: list[str | None] = [None] * width
    below = [cell.strip("[]() ") for cell in rows[-1]] if len(rows) == 2 else []
    if below and any(below) and all(cell in ("", "-") or is_unit(cell) for cell in below):
        units = [cell or None for cell in below]
        names = [split_unit(cell)[0] for cell in rows[0]]
    elif rows:
        names, units = (
            list(part) for part in zip(*(split_unit(cell) for cell in rows[-1]), strict=True)
        )
        rows = rows[-1:]
    else:
        names = [""] * width
    return names, units, len(rows)


def _opening(head: str) -> int:
    """Return the position of the bracket that the last character closes; -1 if there is none."""
    opens = {"]": "[", ")": "("}.get(head[-1:])
    depth = 0
    for at in range(len(head) - 1, -1, -1) if opens else ():
        depth += (head[at] == head[-1]) - (head[at] == opens)
        if depth == 0:
            return at
    return -1


def split_unit(head: str) -> tuple[str, str | None]:
    """Return name and unit from a heading such as "acc [g]"; parentheses are read only if they
    contain a unit.

    >>> split_unit("acc [g]"), split_unit("speed (m/s)"), split_unit("x (left)")
    (('acc', 'g'), ('speed', 'm/s'), ('x (left)', None))
    """
    head = head.strip()
    start = _opening(head)
    name, unit = head[:start].rstrip(), head[start + 1 : -1].strip()
    if start <= 0 or not name or unit.isdigit() or not (head.endswith("]") or is_unit(unit)):
        return head, None
    return name, unit or None
