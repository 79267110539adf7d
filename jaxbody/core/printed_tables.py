"""Tables of numbers with their units in the headings, and their conversion to another system of
units than SI, with four significant digits and one number in a cell.

    printed number = SI number * (factor of the SI unit) / (factor of the printed unit)
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from jaxbody.core import units
from jaxbody.core.errors import check_all_known, check_known

SI = {"length": "m", "mass": "kg", "force": "N", "time": "s", "angle": "rad"}
SYSTEMS = {"SI": {}, "mm": {"length": "mm", "angle": "deg"}}
DUST = 1e-14  # smaller numbers are rounding errors
NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?")
IN_TEXT = re.compile(
    rf"(?<![\w.])({NUMBER.pattern}(?: to {NUMBER.pattern})?) "
    r"(N s/m|N m/rad|N/m|N/rad|N m|N|kg m2|kg|m/s2|m/s|m|rad/s|rad)(?![\w/])"
)

AMOUNT = re.compile(rf"(?:{NUMBER.pattern}|inf|to|\.\.|[<>= -])+")  # "1 to 2", ">= 3"

Words = Mapping[str, str]


@dataclass
class PrintedTable:
    """A title, the headings of the columns, and rows of names and numbers; `note` is printed below.
    A heading "mass [kg]", or a column "unit", states the SI unit of numbers."""

    title: str
    columns: tuple[str, ...]
    rows: list[tuple[Any, ...]]
    note: str = ""
    digits: int = 4  # in other units than SI

    @property
    def lead(self) -> int:
        """The number of columns of names, which each piece of a wide table has: two for the parts
        of a case."""
        return 1 + (self.columns[1:2] == ("part",))


def unit_words(system: Any) -> Words:
    """Return the printed word of each SI word that differs: {"m": "mm", "rad": "deg"}.

    Args:
        system: "SI"; "mm", for mm and deg; or units by name, as a model file states them:
            {"length": "mm", "mass": "kg", "force": "N", "time": "s", "angle": "deg"}

    Errors: UNKNOWN_NAME, UNKNOWN_UNIT."""
    if isinstance(system, str):
        check_known(system, "units", SYSTEMS)
        system = SYSTEMS[system]
    check_all_known(system, "units", SI)
    for name, word in system.items():
        units.parse(word, f"units.{name}")
    return {SI[name]: word for name, word in system.items()}


def printed_unit(unit: str, words: Words) -> tuple[str, float]:
    """Return a unit in the printed words, and the factor of numbers in it; a text that is not a
    unit stays, with the factor 1.

    >>> printed_unit("N s/m", {"m": "mm"})
    ('N s/mm', 0.001)
    """
    if " per " in unit:
        above, below = (printed_unit(part, words) for part in unit.split(" per ", 1))
        return f"{above[0]} per {below[0]}", above[1] / below[1]
    new = re.sub(r"[A-Za-z°]+", lambda word: words.get(word.group(), word.group()), unit)
    if new == unit or not units.is_unit(unit):
        return unit, 1.0
    return new, units.parse(unit, "").factor / units.parse(new, "").factor


def text_in(text: str, words: Words) -> str:
    """Return a text in which numbers with an SI unit, such as "0.5 m", are in the printed units."""

    def in_words(match: re.Match) -> str:
        unit, factor = printed_unit(match[2], words)
        if unit == match[2]:
            return match[0]
        return f"{NUMBER.sub(lambda x: f'{_rounded(float(x[0]) * factor):g}', match[1])} {unit}"

    return IN_TEXT.sub(in_words, text)


def in_units(table: PrintedTable, words: Words) -> list[PrintedTable]:
    """Return a table in the printed units. A column of vectors becomes three; rows of vectors and
    rows of numbers, as of bushings and springs, become tables of their own."""
    groups: dict[tuple[bool, ...], list[list[Any]]] = {}
    heads = [head.removesuffix("]").partition(" [") for head in table.columns]
    own = table.columns.index("unit") if "unit" in table.columns else -1
    for row in table.rows:
        cells = [
            printed_unit(cell, words)[0]
            if i == own
            else _cell(cell, unit or (row[own] if own >= 0 else ""), words, table.digits)
            for i, (cell, (*_, unit)) in enumerate(zip(row, heads, strict=True))
        ]
        vectors = tuple(isinstance(cell, list) and len(cell) == 3 for cell in cells)
        flat = [
            x
            for cell, three in zip(cells, vectors, strict=True)
            for x in (cell if three else [cell])
        ]
        groups.setdefault(vectors, []).append(flat)
    shown = []
    for vectors, rows in (groups or {(False,) * len(heads): []}).items():
        names = [
            f"{name} {axis}".strip() + (f" [{printed_unit(unit, words)[0]}]" if unit else "")
            for (name, _, unit), three in zip(heads, vectors, strict=True)
            for axis in ("xyz" if three else [""])
        ]
        kept = [
            i
            for i in range(len(names))
            if len(groups) < 2 or any(row[i] not in ("", None) for row in rows)
        ]
        cells = [tuple(row[i] for i in kept) for row in rows]
        shown.append(PrintedTable("", tuple(names[i] for i in kept), cells))
    shown[0].title, shown[-1].note = text_in(table.title, words), text_in(table.note, words)
    return shown


def _cell(value: Any, unit: str, words: Words, digits: int) -> Any:
    """Return a number, a vector or the numbers of a text with a unit in the printed units; names
    stay."""
    factor = printed_unit(unit, words)[1]
    if isinstance(value, str):
        if unit and AMOUNT.fullmatch(value):
            return NUMBER.sub(lambda x: f"{float(x.group()) * factor:.{digits}g}", value)
        return text_in(value, words)
    import numpy as np  # slow to import, and messages about a file need neither

    from jaxbody.core.jax_internals import Tracer

    if isinstance(value, Tracer) or np.asarray(value).dtype.kind != "f" or np.ndim(value) > 1:
        return value
    if np.ndim(value):
        return [_rounded(x * factor, digits) for x in value]
    return _rounded(value * factor, digits)


def _rounded(value: Any, digits: int = 4) -> float:
    """Return a number with few significant digits; 0 for rounding errors."""
    return 0.0 if abs(value) < DUST else float(f"{value:.{digits}g}")
