"""Hard points from a table of a suspension's drawing: a text file with a line for each point,
with units."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from jaxbody.core.errors import Problems
from jaxbody.files.documents import LARGEST
from jaxbody.files.interchange.mount_tables import AXES
from jaxbody.files.interchange.unit_tables import Columns, lines_of

HARD_POINT_COLUMNS = Columns(("name",), dict.fromkeys(AXES, "m"), ("name", *AXES))


def read_hard_points(path: Any, *, largest: float = LARGEST) -> dict[str, np.ndarray]:
    """The hard points in a text table, {name: place [m]}, for `double_wishbone`, `macpherson`
    and `five_link`.

        name,        x [mm], y [mm], z [mm]
        lower outer,      0,    900,    200

    Columns may be in any order; a unit is in the heading, or beside the number, "900 mm". Points
    that the file does not have are those of the ready suspension.

    Args:
        path: path of the file; columns are separated by commas, semicolons or tabs, lines that
            start with # are comments
        largest: largest size of the file [bytes]

    Errors, all at once with their lines: those of text files, NO_NUMBERS, UNKNOWN_NAME,
    MISSING_ENTRY, RAGGED_LINE, DUPLICATE_NAME, NO_UNIT, UNKNOWN_UNIT, WRONG_DIMENSION,
    NOT_A_NUMBER, DECIMAL_COMMA.

    >>> import pathlib, tempfile
    >>> path = pathlib.Path(tempfile.mkdtemp(), "corner.csv")
    >>> _ = path.write_text("name, x [mm], y [mm], z [mm]\\ntie rod inner, 50, 200, 255\\n")
    >>> points = read_hard_points(path)
    >>> points["tie rod inner"].tolist()
    [0.05, 0.2, 0.255]
    >>> toe = double_wishbone(points).curves([-0.04, 0.04])["toe"]  # doctest: +SKIP
    """
    points: dict[str, np.ndarray] = {}
    with Problems() as problems:
        for where, values in lines_of(
            Path(path), HARD_POINT_COLUMNS, "hard points", largest, problems
        ):
            name = values.get("name", "")
            if name in points:
                problems.add(
                    "DUPLICATE_NAME", where, f"'{name}' is the name of a point above", value=name
                )
            points[name] = np.array([values.get(axis, 0.0) for axis in AXES])
    return points
