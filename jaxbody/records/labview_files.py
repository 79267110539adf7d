"""LabVIEW's text files (.lvm): a table below headings that state its separator and decimal mark,
and unit and times of each channel.

Source: Specification for the LabVIEW Measurement File, National Instruments.
"""

from __future__ import annotations

import numpy as np

from jaxbody.core.errors import JaxbodyError, Problem
from jaxbody.core.source_files import decoded
from jaxbody.records.sources import Pick, along
from jaxbody.records.text_tables import Column, Contents, distinct, numbers_of

MAGIC, END = b"LabVIEW Measurement", "***End_of_Header***"
DIMENSIONS = {"": None, "Time": None, "Frequency": "Hz"}


def read_lvm(data: bytes, name: str, encoding: str, pick: Pick) -> Contents:
    """Read the requested columns of an .lvm file of one segment, each with its unit and times.
    Errors: ENCODING, WRONG_FORMAT, NO_NUMBERS, NOT_A_RECORD and those of tables."""
    lines = list(enumerate(decoded(data, name, encoding).splitlines(), 1))
    ends = [k for k, (_, line) in enumerate(lines) if line.startswith(END)]
    if len(ends) not in (1, 2):
        raise JaxbodyError(
            Problem(
                "WRONG_FORMAT",
                name,
                f"has {max(len(ends) - 1, 0)} segments, each with its headings",
                len(ends),
                "one",
                "Write one segment a file, or cut it into files.",
            )
        )
    separator = "," if any(line.startswith("Separator,") for _, line in lines[: ends[0]]) else "\t"
    rows = [(i, line.split(separator)) for i, line in lines]
    head = {cells[0].strip(): [cell.strip() for cell in cells[1:]] for _, cells in rows[: ends[-1]]}
    table = [(i, cells) for i, cells in rows[ends[-1] + 1 :] if any(cell.strip() for cell in cells)]
    names = [cell.strip() for cell in table[0][1]] if table else []
    if len(table) < 2 or "X_Value" not in names:
        raise JaxbodyError(
            Problem(
                "NO_NUMBERS",
                name,
                f"has no table below '{END}'",
                limit="a line of names from X_Value on, and numbers",
            )
        )
    names = names[: names.index("Comment")] if "Comment" in names else names
    decimal = (head.get("Decimal_Separator") or ["."])[0] or "."
    values = numbers_of(
        [(i, separator.join(cells[: len(names)])) for i, cells in table[1:]],
        name,
        separator,
        decimal,
        complete=True,
    )

    known = distinct(names)
    columns = {}
    for asked, label in pick(known).items():
        k = known.index(label)
        stated = {word: "".join(cells[k - 1 : k]) for word, cells in head.items()}  # of this column
        if names[k] == "X_Value":
            columns[asked] = Column(values[:, k])
            continue
        x = next((values[:, j] for j in range(k, -1, -1) if names[j] == "X_Value"), None)
        if head.get("X_Columns", [""])[0] == "No":
            start, step = (stated.get(word, "").replace(decimal, ".") for word in ("X0", "Delta_X"))
            x = float(start or 0) + float(step) * np.arange(len(values)) if step else None
        axis = stated.get("X_Unit_Label") or DIMENSIONS.get(
            stated.get("X_Dimension", ""), stated.get("X_Dimension")
        )
        times = None if x is None else along(x, axis, "s", f"{name}['{label}']")
        columns[asked] = Column(values[:, k], stated.get("Y_Unit_Label") or None, times)
    return Contents(columns)
