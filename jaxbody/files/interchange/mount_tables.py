"""Mounts from a data sheet: a text table with a line for each mount, its place, stiffness and
damping, with units."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from jaxbody.core.errors import JaxbodyError, Problem, Problems, unknown
from jaxbody.files.documents import LARGEST
from jaxbody.files.interchange.unit_tables import Columns, lines_of
from jaxbody.geometry.orientations import Euler, matrix
from jaxbody.model.bodies import Body, Support
from jaxbody.model.elements.bushings import Bushing

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
                lambda values=values, where=where: _mount(values, bodies, where)
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


def _mount(values: dict[str, Any], bodies: Mapping[str, Body | Support], where: str) -> Bushing:
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
    try:
        return Bushing(
            *places,
            stiffness=stiffness,
            damping=damping,
            orientation=turns[0],
            orientation_b=turns[1],
        )
    except JaxbodyError as error:
        problems = [
            Problem(x.code, f"{where} {x.where}", x.message, x.value, x.limit, x.hint)
            for x in error.problems
        ]
        raise JaxbodyError(*problems) from None
