"""Printed results: small tables with units, in a terminal and in a notebook, and `plot` for a
picture."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from functools import wraps
from html import escape
from types import MethodType
from typing import Any

import jax
import numpy as np

from jaxbody.core.jax_internals import Tracer
from jaxbody.core.late_binding import handed_down
from jaxbody.core.printed_tables import PrintedTable, in_units, unit_words

MOST_ROWS = 400  # of a table that are printed
WIDEST = 120  # characters of a line of a table in text
ROUND_OFF = 1e-8  # smaller shares are not printed


class PlotMethod:
    """The method `plot(*, ax=None, ...)` of a class of results: a descriptor that returns the
    function that draws the object, with the object as its first argument."""

    def __get__(self, result: Any, kind: type) -> Callable[..., Any]:
        draw = handed_down("picture_of")(kind).draw
        return draw if result is None else MethodType(draw, result)


class Printed(ABC):
    """An object that prints as tables. The tables are made from its arrays in NumPy, so that no
    program of JAX runs."""

    plot = PlotMethod()

    @abstractmethod
    def _tables(self) -> list[PrintedTable]:
        """Return the tables that are printed."""

    def _summary_tables(self) -> list[PrintedTable]:
        """Return the tables of `summary`: those that are printed; some classes add more."""
        return in_numpy(self)._tables()

    def summary(self, *, units: Any = None) -> str:
        """Return the tables as text, with more than `print` shows for some classes.

        Args:
            units: None: SI; "mm": mm and deg; or those of a model file, `study.printed_units`. In
                other units than None, four significant digits and one number in a cell

        Errors: UNKNOWN_NAME, UNKNOWN_UNIT."""
        shown = self._summary_tables()
        return text(*shown if units is None else tables_in(shown, units))

    def __repr__(self) -> str:
        return text(*in_numpy(self)._tables())

    def __str__(self) -> str:
        return f"{self!r}\n"  # a blank line keeps printed results apart

    def _repr_html_(self) -> str:
        return html(*in_numpy(self)._tables())


def tables_in(shown: list[PrintedTable], units: Any) -> list[PrintedTable]:
    """Return tables in other units than SI, those of `Printed.summary`."""
    words = unit_words(units)
    return [part for table in shown for part in in_units(table, words)]


def summarized(title: str, ndim: int, **heads: str) -> Callable:
    """Return a decorator of `_tables` for results that may be batches.

    If the first of the attributes in `heads` does not have `ndim` axes, or is traced, the result
    prints as one table of the attributes, each with its heading."""

    def of_method(
        single: Callable[[Any], list[PrintedTable]],
    ) -> Callable[[Any], list[PrintedTable]]:
        @wraps(single)
        def shown(self) -> list[PrintedTable]:
            rows = [(head, getattr(self, name)) for name, head in heads.items()]
            alone = rows[0][1].ndim == ndim and not isinstance(rows[0][1], Tracer)
            return single(self) if alone else [PrintedTable(title, ("", ""), rows)]

        return shown

    return of_method


def in_numpy(tree: Any) -> Any:
    """Return the tree with JAX arrays converted to NumPy arrays; tracers stay."""
    return jax.tree.map(
        lambda x: np.asarray(x) if isinstance(x, jax.Array) and not isinstance(x, Tracer) else x,
        tree,
    )


def of_matrix(title: str, matrix: Any, names: tuple[str, ...]) -> PrintedTable:
    """Return a square matrix as a table with the names of its rows; dots for a large matrix or a
    batch."""
    few, matrix = matrix.ndim == 2 and len(names) <= 12, without_dust(matrix)
    heads = map(str, range(len(names))) if few else [""]
    return PrintedTable(
        title,
        ("", *heads),
        [(name, *(matrix[i] if few else ["..."])) for i, name in enumerate(names)],
    )


def number(value: Any) -> str:
    """Return a number with six digits, a short vector, or the shape of a larger array, as text;
    "traced" inside jit or vmap."""
    if value is None or isinstance(value, str):
        return value or ""
    if isinstance(value, Tracer):
        return "traced"
    array = np.asarray(value)
    if array.ndim == 0:
        return f"{array.item():.6g}" if array.dtype.kind == "f" else str(array.item())
    if array.ndim == 1 and array.size <= 7:
        return " ".join(f"{x:.6g}" for x in array.tolist())
    return "array " + " x ".join(map(str, array.shape))


def percent(share: Any) -> str:
    """Return a share in percent, with two digits; empty if it is round-off or not finite.

    >>> percent(0.0123), percent(2.1), percent(2e-14)
    ('1.2 %', '210 %', '')
    """
    return (
        f"{float(f'{100 * share:.2g}'):g} %"
        if np.isfinite(share) and abs(share) >= ROUND_OFF
        else ""
    )


def counted(count: int, what: str) -> str:
    """Return a count with its noun: "1 line", "2 lines"."""
    return f"{count} {what}{'' if count == 1 else 's'}"


def without_dust(values: Any, unit: Any = None) -> Any:
    """Return the numbers with rounding errors set to zero: those below 1e-12 of `unit`, or of the
    largest number."""
    if isinstance(values, Tracer):
        return values
    array = np.asarray(values)
    return np.where(
        np.abs(array) <= 1e-12 * (np.abs(array).max(initial=0.0) if unit is None else unit),
        0.0,
        array,
    )


def text(*shown: PrintedTable) -> str:
    """Return the tables as text with aligned columns; a blank line before every title but the
    first."""
    return "\n".join(
        ("\n" if i and table.title else "") + "\n".join(_lines(table))
        for i, table in enumerate(shown)
    )


def _lines(table: PrintedTable) -> list[str]:
    cells = [table.columns, *([number(cell) for cell in row] for row in table.rows[:MOST_ROWS])]
    widths = [max(len(row[i]) for row in cells) for i in range(len(table.columns))]
    names = range(table.lead)
    blocks = [list(names)]  # columns below each other where the table is too wide
    for i, width in enumerate(widths[len(names) :], start=len(names)):
        full = sum(widths[j] + 2 for j in blocks[-1]) + 2 + width > WIDEST
        if full and len(blocks[-1]) > len(names):
            blocks.append(list(names))
        blocks[-1].append(i)
    lines = [
        "  " + "  ".join(row[i].rjust(widths[i]) if i else row[i].ljust(widths[i]) for i in block)
        for block in blocks
        for row in cells
    ]
    lines = [line.rstrip() for line in lines] + (
        ["  " + _rest(table)] if len(table.rows) > MOST_ROWS else []
    )
    return [line for line in (table.title, *lines, table.note) if line]


def _rest(table: PrintedTable) -> str:
    return (
        f"... {len(table.rows) - MOST_ROWS} more of {len(table.rows)} rows; the result's "
        "attributes have all of them"
    )


def html(*shown: PrintedTable) -> str:
    """Return the tables as HTML, for a notebook."""
    blocks = []
    for table in shown:
        head = "".join(f"<th>{escape(c)}</th>" for c in table.columns)
        body = "".join(
            "<tr>" + "".join(f"<td>{escape(number(cell))}</td>" for cell in row) + "</tr>"
            for row in table.rows[:MOST_ROWS]
        )
        more = f"<p>{_rest(table)}</p>" if len(table.rows) > MOST_ROWS else ""
        blocks.append(
            f"<p><b>{escape(table.title)}</b></p><table><tr>{head}</tr>{body}</table>{more}<p>"
            f"{escape(table.note)}</p>"
        )
    return "".join(blocks)
