"""Mounts and hard points from text tables with one row each: a name, other words, and numbers with
units in the headings or in the cells."""

import csv
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from jaxbody.core.errors import JaxbodyError, Problem, Problems, unknown
from jaxbody.core.source_files import check_file, decoded
from jaxbody.files.documents import LARGEST
from jaxbody.files.quantities import NUMBER, in_SI
from jaxbody.geometry.points_and_orientations import EulerAngles, matrix
from jaxbody.model.bodies import Body, Support
from jaxbody.model.elements.bushings import Bushing
from jaxbody.records.text_tables import split_unit


class Columns(NamedTuple):
    """The columns that a table may have: names of columns of words, SI units of columns of numbers
    by name, and names of required columns."""

    words: Sequence[str]
    units: Mapping[str, str]
    needed: Sequence[str]


def lines_of(
    path: Path, allowed: Columns, things: str, largest: float, problems: Problems
) -> list[tuple[str, dict[str, Any]]]:
    """Return the place ("mounts.csv:3") of each row of a table, and its words and numbers in SI by
    column; `things` is the plural noun for rows in messages.

    Errors: those of text files and of headings; problems of lines are added to `problems`."""
    check_file(path, largest)
    text = decoded(path.read_bytes(), path.name, "utf-8")
    rows = [
        (i, line)
        for i, line in enumerate(text.splitlines(), 1)
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
        (line, [cell.strip() for cell in next(csv.reader([row], delimiter=separator))])
        for line, row in rows
    ]
    with Problems() as of_headings:
        columns = _columns(path.name, *cells[0], allowed, of_headings)
    read = []
    for line, row in cells[1:]:
        where = f"{path.name}:{line}"
        if len(row) == len(columns):
            read.append((where, _values(row, columns, allowed, where, problems)))
        else:
            problems.add(
                "RAGGED_LINE",
                where,
                f"has {len(row)} cells",
                value=len(row),
                limit=f"{len(columns)}, as the headings",
            )
    return read


def _columns(
    name: str, line: int, headings: list[str], allowed: Columns, problems: Problems
) -> list[tuple[str, str | None]]:
    """Return the name and the unit (None without one) of each column, and check the names."""
    columns = [split_unit(heading) for heading in headings]
    names = [column for column, _ in columns]
    where, known = f"{name}:{line}", (*allowed.words, *allowed.units)
    problems.collected += [unknown(column, where, known) for column in names if column not in known]
    for column in allowed.needed:
        if column not in names:
            problems.add(
                "MISSING_ENTRY",
                where,
                f"has no column '{column}'",
                value=names,
                limit=", ".join(allowed.needed),
            )
    for column in {column for column in names if names.count(column) > 1}:
        problems.add("DUPLICATE_NAME", where, f"has the column '{column}' twice", value=column)
    return columns


def _values(
    row: list[str],
    columns: list[tuple[str, str | None]],
    allowed: Columns,
    where: str,
    problems: Problems,
) -> dict[str, Any]:
    """Return the words of a row, and its numbers in SI, by the names of the columns."""
    values: dict[str, Any] = {}
    for cell, (name, unit) in zip(row, columns, strict=True):
        if not cell:
            if name in allowed.needed:
                problems.add(
                    "MISSING_ENTRY",
                    f"{where} {name}",
                    "is empty",
                    limit="a number" if name in allowed.units else "a name",
                    hint="Write 0 if it is zero." if name in allowed.units else "",
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
    """Convert a cell to SI; its unit is `unit`, from the heading, or written in the cell."""
    own = Problems()
    text = f"{cell} {unit}" if unit and re.fullmatch(NUMBER, cell) else cell
    value = in_SI(text, wanted, {}, None, where, own)
    if isinstance(value, list):
        own.add("NOT_A_NUMBER", where, f"is '{cell}'", value=cell, limit="one number")
        value = 0.0
    hint = f"Write it in the heading, {name} [{wanted}], or here, {cell} {wanted}."
    problems.collected += [
        replace(problem, hint=hint) if problem.code == "NO_UNIT" else problem
        for problem in own.collected
    ]
    return value


def _by_name(
    path: Any,
    allowed: Columns,
    thing: str,
    largest: float,
    make: Callable[[dict[str, Any], str, Problems], Any],
) -> dict[str, Any]:
    """Return {name: make(values, place, problems)} of the rows of a table; `thing` is the noun for
    a row in messages."""
    things: dict[str, Any] = {}
    with Problems() as problems:
        for where, values in lines_of(Path(path), allowed, f"{thing}s", largest, problems):
            name = values.get("name", "")
            if name in things:
                message = f"'{name}' is the name of a {thing.removeprefix('hard ')} above"
                problems.add("DUPLICATE_NAME", where, message, value=name)
            made = problems.gather(lambda values=values, where=where: make(values, where, problems))
            if made is not None:
                things[name] = made
    return things


AXES = ("x", "y", "z")
UNITS = {
    **dict.fromkeys(AXES, "m"),
    **{f"r{axis}": "rad" for axis in AXES},
    **{f"k{axis}": "N/m" for axis in AXES},
    **{f"kr{axis}": "N m/rad" for axis in AXES},
    **{f"c{axis}": "N s/m" for axis in AXES},
    **{f"cr{axis}": "N m s/rad" for axis in AXES},
}
MOUNT_COLUMNS = Columns(("name", "a", "b"), UNITS, ("name", *AXES, "kx", "ky", "kz"))


def read_mounts(
    path: Any, bodies: Mapping[str, Body | Support], *, largest: float = LARGEST
) -> dict[str, Bushing]:
    """Read the mounts in a text table, as bushings by name: elements of a model.

        name,  x [mm], y [mm], z [mm], kx [N/mm], ky [N/mm], kz [N/mm], cx [N s/mm], ...
        left,  100,    250,    500,    200,       200,       400,       0.2, ...

    x, y, z are the position of the mount in world axes, in the reference pose; kx, ky, kz and cx,
    cy, cz its stiffness and damping along its axes, krx ... and crx ... about them; rx, ry, rz
    [deg] rotate its axes from those of the world, first about z, then y, then x. Columns may be in
    any order; columns other than name, x, y, z, kx, ky, kz may be missing, and their cells empty,
    which means zero. A unit is in the heading, or next to the number, "21 N/mm". The command
    `jaxbody new --mounts mounts.csv` prints a model file with these mounts.

    Args:
        path: path of the file; columns are separated by commas, semicolons or tabs, lines that
            start with # are comments
        bodies: {name: Body or Support}. Columns a and b name the two bodies of each mount. Default:
            the first and the second of `bodies`, or the world if there is only one
        largest: largest size of the file [bytes]

    Errors, all at once with their lines: those of text files, NO_NUMBERS, UNKNOWN_NAME,
    MISSING_ENTRY, RAGGED_LINE, DUPLICATE_NAME, NO_UNIT, UNKNOWN_UNIT, WRONG_DIMENSION,
    NOT_A_NUMBER, DECIMAL_COMMA, and those of bushings.

    >>> import pathlib, tempfile
    >>> path = pathlib.Path(tempfile.mkdtemp(), "mounts.csv")
    >>> _ = path.write_text(
    ...     "name, x [mm], y [mm], z [mm], kx [N/mm], ky [N/mm], kz [N/mm]\\n"
    ...     "left, 0, 250, 500, 200, 200, 400\\n"
    ... )
    >>> mounts = jb.files.read_mounts(
    ...     path,
    ...     {"engine": jb.Body(180.0, [8, 12, 10], position=[0, 0, 0.6]), "frame": jb.Support()},
    ... )
    >>> (
    ...     mounts["left"].between,
    ...     mounts["left"].a.round(9).tolist(),
    ...     mounts["left"].stiffness.tolist(),
    ... )
    (('engine', 'frame'), [0.0, 0.25, -0.1], [200000.0, 200000.0, 400000.0])
    """
    return _by_name(
        path,
        MOUNT_COLUMNS,
        "mount",
        largest,
        lambda values, where, problems: _mount(values, bodies, where, problems),
    )


def mounted_frames(path: Any, *, largest: float = LARGEST) -> tuple[list[str], list[str]]:
    """Return the names in column a of a mount table, which are bodies, and the other names in
    column b, which are supports. Numbers are not checked. Errors: those of text files and of the
    headings."""
    lines = lines_of(Path(path), MOUNT_COLUMNS, "mounts", largest, Problems())
    first, second = (
        {values[end]: None for _, values in lines if values.get(end, "world") != "world"}
        for end in "ab"
    )
    return list(first), [name for name in second if name not in first]


def _mount(
    values: dict[str, Any], bodies: Mapping[str, Body | Support], where: str, problems: Problems
) -> Bushing | None:
    """Return the bushing of one row, whose two frames coincide in the reference pose."""
    own = [*bodies, "world", "world"]
    R = matrix(np.asarray(EulerAngles("ZYX", [values.get(f"r{axis}", 0.0) for axis in "zyx"])))
    places, turns = [], []
    for end in (values.get("a", own[0]), values.get("b", own[1])):
        if end not in own:
            raise JaxbodyError(unknown(end, where, tuple(own[:-1])))
        body = bodies.get(end, Support())
        R_body = matrix(np.asarray(body.orientation))
        places.append((end, R_body.T @ (_point(values) - np.asarray(body.position))))
        turns.append(R_body.T @ R)
    stiffness, damping = (
        np.array([values.get(f"{c}{axis}", 0.0) for axis in ("x", "y", "z", "rx", "ry", "rz")])
        for c in "kc"
    )
    turns_matter = stiffness[3:].any() or damping[3:].any()
    stiffness, damping = (np.diag(x) if turns_matter else x[:3] for x in (stiffness, damping))
    return problems.gather(
        lambda: Bushing(
            *places,
            stiffness=stiffness,
            damping=damping,
            orientation=turns[0],
            orientation_b=turns[1],
        ),
        lambda problem: replace(problem, where=f"{where} {problem.where}"),
    )


def _point(values: dict[str, Any]) -> np.ndarray:
    return np.array([values.get(axis, 0.0) for axis in AXES])


def read_hard_points(path: Any, *, largest: float = LARGEST) -> dict[str, np.ndarray]:
    """Read the hard points in a text table, {name: position [m]}, for `double_wishbone`,
    `macpherson` and `five_link`.

        name,        x [mm], y [mm], z [mm]
        lower outer,      0,    900,    200

    Columns may be in any order; a unit is in the heading, or next to the number, "900 mm". The
    suspension has default positions for points that are not in the file.

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
    >>> points = jb.files.read_hard_points(path)
    >>> points["tie rod inner"].tolist()
    [0.05, 0.2, 0.255]
    >>> toe = jb.suspension.double_wishbone(points).curves([-0.04, 0.04])["toe"]  # doctest: +SKIP
    """
    return _by_name(
        path,
        Columns(("name",), dict.fromkeys(AXES, "m"), ("name", *AXES)),
        "hard point",
        largest,
        lambda values, where, problems: _point(values),
    )
