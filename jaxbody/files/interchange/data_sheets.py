"""Mounts and hard points from text tables with a line for each: a name, other words, and numbers
with units in the headings or in the cells."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from jaxbody.core.errors import JaxbodyError, Problem, Problems, unknown
from jaxbody.core.source_files import check_file, decoded
from jaxbody.files.documents import LARGEST
from jaxbody.files.quantities import NUMBER, in_SI
from jaxbody.geometry.points_and_orientations import Euler, matrix
from jaxbody.model.bodies import Body, Support
from jaxbody.model.elements.bushings import Bushing
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
    """The mounts in a text table, as bushings by name: elements of a model.

        name,  x [mm], y [mm], z [mm], kx [N/mm], ky [N/mm], kz [N/mm], cx [N s/mm], ...
        left,  100,    250,    500,    200,       200,       400,       0.2, ...

    x, y, z are the place of the mount in world axes, in the reference pose; kx, ky, kz and cx, cy,
    cz its stiffness and damping along its axes, krx ... and crx ... about them; rx, ry, rz [deg]
    turn its axes from those of the world, first about z, then y, then x. Columns may be in any
    order; others than name, x, y, z, kx, ky, kz may be missing, or empty, which is zero. A unit is
    in the heading, or in the number, "21 N/mm". The command `jaxbody new --mounts mounts.csv`
    prints a model file with these mounts.

    Args:
        path: path of the file; columns are separated by commas, semicolons or tabs, lines that
            start with # are comments
        bodies: {name: Body or Support}. Columns a and b name the two of each mount; without them,
            or where they are empty, it is between the first of these and the second, or the world
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
    >>> mounts = read_mounts(
    ...     path, {"engine": Body(180.0, [8, 12, 10], position=[0, 0, 0.6]), "frame": Support()}
    ... )
    >>> (
    ...     mounts["left"].between,
    ...     mounts["left"].a.round(9).tolist(),
    ...     mounts["left"].stiffness.tolist(),
    ... )
    (('engine', 'frame'), [0.0, 0.25, -0.1], [200000.0, 200000.0, 400000.0])
    """
    mounts: dict[str, Bushing] = {}
    with Problems() as problems:
        for where, values in lines_of(Path(path), MOUNT_COLUMNS, "mounts", largest, problems):
            name = values.get("name", "")
            if name in mounts:
                problems.add(
                    "DUPLICATE_NAME", where, f"'{name}' is the name of a mount above", value=name
                )
            mount = problems.gather(
                lambda values=values, where=where: _mount(values, bodies, where, problems)
            )
            if mount is not None:
                mounts[name] = mount
    return mounts


def mounted_frames(path: Any, *, largest: float = LARGEST) -> tuple[list[str], list[str]]:
    """The names in column a of a data sheet, which are those of bodies, and the other names in
    column b, those of supports. Numbers are not checked. Errors: those of text files and of
    the headings."""
    lines = [
        values for _, values in lines_of(Path(path), MOUNT_COLUMNS, "mounts", largest, Problems())
    ]
    first, second = (
        [values[end] for values in lines if end in values and values[end] != "world"]
        for end in "ab"
    )
    return list(dict.fromkeys(first)), [name for name in dict.fromkeys(second) if name not in first]


def _mount(
    values: dict[str, Any], bodies: Mapping[str, Body | Support], where: str, problems: Problems
) -> Bushing | None:
    """The bushing of one line, whose two frames coincide in the reference pose."""
    own = [*bodies, "world", "world"]
    ends, point = (
        (values.get("a", own[0]), values.get("b", own[1])),
        [values.get(axis, 0.0) for axis in AXES],
    )
    R = matrix(np.asarray(Euler("ZYX", [values.get(f"r{axis}", 0.0) for axis in "zyx"])))
    places, turns = [], []
    for end in ends:
        if end not in own:
            raise JaxbodyError(unknown(end, where, tuple(own[:-1])))
        body = bodies.get(end, Support())
        R_body = matrix(np.asarray(body.orientation))
        places.append((end, R_body.T @ (np.asarray(point) - np.asarray(body.position))))
        turns.append(R_body.T @ R)
    stiffness, damping = (
        np.array([values.get(f"{c}{axis}", 0.0) for axis in ("x", "y", "z", "rx", "ry", "rz")])
        for c in "kc"
    )
    if not (stiffness[3:].any() or damping[3:].any()):
        stiffness, damping = stiffness[:3], damping[:3]
    else:
        stiffness, damping = np.diag(stiffness), np.diag(damping)
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
