"""Reading records and frequency responses from measurement files: columns, units and times."""

import re
from typing import Any

import numpy as np

from jaxbody.core import units
from jaxbody.core.errors import JaxbodyError, Problem, Problems
from jaxbody.records import format_readers
from jaxbody.records.records import Record
from jaxbody.records.sources import Asked
from jaxbody.records.text_tables import Column
from jaxbody.records.universal_files import read_uff_responses

SAME = 1e-3  # largest difference between the same times, relative to their step


def read_record(
    path: Any,
    *,
    channels: dict[str, Any],
    time: Any = None,
    format: str | None = None,
    largest: float = 1e9,
    encoding: str = "utf-8",
    separator: str | None = None,
    decimal: str = ".",
    skip: int = 0,
    footer: int = 0,
    **options: Any,
) -> Record:
    """Read a Record from a file: CSV, LVM and other text tables (also .gz), Parquet, MATLAB, HDF5,
    UFF58, TDMS, MDF4, PEER AT2.

    Args:
        path: path of the file
        channels: {name: columns} or {name: (columns, unit)}, with the name or number (from 0) of a
            column, or a list of them; "X[2]" is column 2 (from 0) of an array X; "1+Z" in a UFF
            file is node 1 along Z; a unique id line is a name too; cells and structs of MATLAB have
            the names that they have there, "data{2}", "run(2).acc"
        time: a column or (column, unit); None: the times that LVM, UFF, TDMS, MDF and AT2 files
            state, or those of `rate=`
        format: text, parquet, mat, hdf5, uff, tdms, mdf or peer; None: according to the extension
            of the file
        largest: largest size of a file, and of the numbers read from it at 8 bytes each [bytes]
        encoding: encoding of text
        separator: separator between columns of text; None: that of the first line of numbers
        decimal: decimal mark of text, "." or ","
        skip: number of lines to leave out at the start of text
        footer: number of lines to leave out at its end
        options: those of `Record`

    Units come from the file ("acc [g]" or its own fields) or from you; if both state one, they must
    agree. The channel of an AT2 file is called "motion".

    Errors: NO_FILE, IS_DIRECTORY, NOT_A_FILE (a pipe, a device), EMPTY_FILE, TOO_LARGE,
    UNKNOWN_FORMAT, WRONG_FORMAT, MISSING_EXTRA, UNREADABLE, UNKNOWN_CHANNEL, NOT_A_NUMBER,
    NOT_A_RECORD (not over time), EXTERNAL_DATA (HDF5 that points to other files); TRUNCATED,
    RAGGED_LINE for other than the stated number of points; for text, with the line, ENCODING,
    NO_NUMBERS, BAD_LINE, DECIMAL_COMMA; UNIT_CONFLICT, DIFFERENT_TIMES and those of `Record`. Warns
    TIME_UNIT also for an unknown unit of the file's times.

    >>> import pathlib, tempfile
    >>> path = pathlib.Path(tempfile.mkdtemp()) / "run.csv"
    >>> _ = path.write_text("t [ms],acc [g]\\n0,0.1\\n10,0.2\\n20,0.0\\n")
    >>> jb.read_record(path, time="t", channels={"acc": "acc"})["acc"].round(3).tolist()
    [0.981, 1.961, 0.0]
    """
    name = str(getattr(path, "name", path))[-100:]
    with Problems() as problems:
        if not isinstance(channels, dict):
            raise JaxbodyError(
                Problem(
                    "WRONG_KIND",
                    "channels",
                    f"is {channels!r:.60}",
                    channels,
                    "a dict {name: column}",
                    'Write {"acc": ("ax", "m/s2")}: your own name, then column and unit.',
                )
            )
        wanted = {
            key: _wanted(spec, f"channels['{key}']", problems) for key, spec in channels.items()
        }
        clock = None if time is None else _wanted(time, "time", problems)
        if not channels:
            problems.add(
                "NO_DATA",
                "channels",
                "is empty",
                limit="at least one",
                hint='Give channels={"acc": ("ax", "m/s2")}.',
            )
    stated = {f"{name}['{key}']": unit for key, (_, unit) in wanted.items()} | (
        {} if clock is None else {f"{name}.times": clock[1]}
    )
    for where, unit in stated.items():
        problems.gather(
            lambda unit=unit, where=where: None if unit is None else units.parse(unit, where)
        )
    asked = [
        column
        for columns, _ in (*wanted.values(), *([clock] if clock else []))
        for column in columns
    ]

    def read(names: list[Asked]) -> Any:
        return format_readers.read_columns(
            path,
            list(dict.fromkeys(names)),
            format=format,
            largest=largest,
            encoding=encoding,
            separator=separator,
            decimal=decimal,
            skip=skip,
            footer=footer,
        )

    contents = problems.gather(lambda: read(asked))
    absent = {problem.value for problem in problems.collected if problem.code == "UNKNOWN_CHANNEL"}
    others = [column for column in asked if column not in absent]
    if absent and others:  # these may have problems too
        contents = problems.gather(lambda: read(others))
        wanted = {
            key: (columns, unit)
            for key, (columns, unit) in wanted.items()
            if not absent & {*columns}
        }
    if contents is None:
        raise JaxbodyError(*problems.collected)
    notes, without = list(contents.notes), clock is not None and bool(absent & {*clock[0]})
    times, time_unit = (
        (None, "s")
        if without
        else _clock(contents.columns, clock, options.get("rate"), name, problems, notes)
    )
    given = {}
    for key, (columns, unit) in wanted.items():
        parts = [_part(contents.columns[column], column) for column in columns]
        if len({len(part) for part in parts}) > 1 or (
            len(parts) > 1 and any(part.ndim > 1 for part in parts)
        ):
            problems.add(
                "BAD_SHAPE",
                f"{name}['{key}']",
                f"joins columns of shapes {[part.shape for part in parts]}",
                limit="columns of one length",
                hint="Read them as separate channels.",
            )
        else:
            in_file = {contents.columns[column].unit for column in columns}
            given[key] = (
                parts[0] if len(parts) == 1 else np.stack(parts, 1),
                agreed_unit(unit, in_file, f"{name}['{key}']", problems, notes),
            )
    problems.raise_if_any()
    record = Record(times, given, time_unit=time_unit, name=name, **options)
    record.notes = (*notes, *record.notes)
    return record


def _wanted(spec: Any, where: str, problems: Problems) -> tuple[list[Asked], str | None]:
    """Return the requested columns and their unit; None if no unit is stated. Error: WRONG_KIND."""
    columns, unit = spec if isinstance(spec, tuple) and len(spec) == 2 else (spec, None)
    names = columns if isinstance(columns, list) else [columns]
    if (
        not names
        or not all(isinstance(name, str | int) for name in names)
        or not isinstance(unit, str | None)
    ):
        problems.add(
            "WRONG_KIND",
            where,
            f"is {spec!r:.60}",
            value=spec,
            limit='"ax", ("ax", "m/s2") or (["ax", "ay"], "m/s2")',
        )
        return [], None
    return names, unit  # pyright: ignore[reportReturnType]  checked above


def _part(column: Column, asked: Asked) -> np.ndarray:
    """Return the values of a column; for a name such as "X[2]", those of one column of the array.
    Error: UNKNOWN_CHANNEL."""
    index = re.search(r"\[(\d+)\]$", str(asked))
    if index is None or column.values.ndim == 1:
        return column.values
    if int(index[1]) >= column.values.shape[1]:
        raise JaxbodyError(
            Problem(
                "UNKNOWN_CHANNEL",
                str(asked),
                f"has {column.values.shape[1]} columns",
                asked,
                f"[0] to [{column.values.shape[1] - 1}]",
                "Columns count from 0.",
            )
        )
    return column.values[:, int(index[1])]


def agreed_unit(
    stated: str | None,
    in_file: set[str | None],
    where: str,
    problems: Problems,
    notes: list[str],
    hint: str = 'State it: ("column", "m/s2"), or "1" for numbers without a unit.',
) -> str:
    """Return the unit stated by the user or by the file; if both state one, they must agree. An
    unknown unit in the file is reported in `notes`. Errors: NO_UNIT, UNIT_CONFLICT."""
    known = in_file - {None}
    if stated is None and (len(in_file) != 1 or not known):
        what = "no unit" if not known else f"different units {sorted(map(str, in_file))}"
        problems.add("NO_UNIT", where, f"has {what} in the file", limit="one unit", hint=hint)
        return "1"
    if stated is None:
        return str(known.pop())
    for word in known:
        try:
            theirs = units.parse(str(word), where)
        except JaxbodyError:
            notes.append(f"{where}: '{word}' in the file, read as {stated}")
        else:
            ours = units.parse(stated, where)
            if (theirs.dimension, round(theirs.factor / ours.factor, 9)) != (ours.dimension, 1.0):
                problems.add(
                    "UNIT_CONFLICT",
                    where,
                    f"is in '{word}' in the file, not in '{stated}'",
                    value=stated,
                    limit=str(word),
                    hint="Leave the unit out to use that of the file, or give the numbers to "
                    "Record with the correct unit.",
                )
    return stated


def _clock(
    columns: dict[Any, Column],
    clock: Any,
    rate: Any,
    name: str,
    problems: Problems,
    notes: list[str],
) -> tuple[Any, str]:
    """Return times and their unit, from the requested column or as the file states them; times are
    None where a rate is given. Errors: DIFFERENT_TIMES, NO_TIME."""
    if clock is not None:
        column = columns[clock[0][0]]
        return _part(column, clock[0][0]), agreed_unit(
            clock[1], {column.unit}, f"{name}.times", problems, notes
        )
    own = {key: column.times for key, column in columns.items() if column.times is not None}
    if own and len(own) == len(columns):
        first, times = next(iter(own.items()))
        for key, other in own.items():
            if (
                len(other) != len(times)
                or (
                    np.abs(other - times) > SAME * np.abs(times[-1:] - times[:1]) / len(times)
                ).any()
            ):
                parts = [
                    f"'{k}' {len(t)} samples from {min(t, default=0):.9g} s on"
                    for k, t in ((first, times), (key, other))
                ]
                problems.add(
                    "DIFFERENT_TIMES",
                    name,
                    f"has of {' and of '.join(parts)}",
                    limit="the same times",
                    hint="Read them as separate records, with one experiment for each.",
                )
        return times, "s"
    if rate is None:
        problems.add(
            "NO_TIME",
            name,
            "states no times",
            limit="time= or rate=",
            hint='Give time=("t", "s"), or rate= [Hz].',
        )
    return None, "s"


def read_responses(
    path: Any, pairs: dict[tuple[str, str], Any], *, largest: float = 1e9
) -> tuple[np.ndarray, dict[tuple[str, str], np.ndarray]]:
    """Read frequency responses from a universal file (sets 58 of function type 4). Return the
    frequencies [Hz] and {(output, input): complex (nf,)}.

    `pairs` is {(output, input): "4+Z/1+Z"}, response over reference, each a node and a direction,
    +X to -Z or +RX to -RZ; or, where the file states no units, {(output, input): ("4+Z/1+Z",
    "m/s2", "N")}. If you and the file both state units, they must agree. `largest`: largest size of
    the file [bytes].

    Errors: those of a file in `read_record`, NOT_A_RESPONSE, NO_UNIT, UNKNOWN_UNIT, UNIT_CONFLICT,
    DIFFERENT_FREQUENCIES.

    >>> frequencies, measured = jb.records.read_responses(
    ...     "plate.uff", {("corner", "hammer"): "4+Z/1+Z"}
    ... )  # doctest: +SKIP
    """
    wanted = {
        pair: spec if isinstance(spec, tuple) else (spec, None, None)
        for pair, spec in pairs.items()
    }
    responses = read_uff_responses(path, [spec[0] for spec in wanted.values()], largest)
    measured, grid = {}, None
    with Problems() as problems:
        for pair, (name, above, below) in wanted.items():
            response, where = responses[name], f"{path}['{name}']"
            grid = response.frequencies if grid is None else grid
            if (
                grid.shape != response.frequencies.shape
                or np.abs(grid - response.frequencies).max() > 1e-9 * grid.max()
            ):
                problems.add(
                    "DIFFERENT_FREQUENCIES",
                    where,
                    "has different frequencies from the first one",
                    limit="one set",
                    hint="Read it separately.",
                )
            else:
                measured[pair] = (
                    response.values
                    * _factor(above, response.above, where, problems)
                    / _factor(below, response.below, where, problems)
                )
    if grid is None:
        raise JaxbodyError(
            Problem(
                "NO_DATA",
                "pairs",
                "is empty",
                limit="at least one",
                hint='Give {("y", "f"): "4+Z/1+Z"}.',
            )
        )
    return grid, measured


def _factor(stated: str | None, in_file: str | None, where: str, problems: Problems) -> float:
    """Return the factor to SI of the unit stated by the user or by the file; if both state one,
    they must agree."""
    hint = 'State both: ("4+Z/1+Z", "m/s2", "N").'
    unit = problems.gather(
        lambda: units.parse(agreed_unit(stated, {in_file}, where, problems, [], hint), where)
    )
    return 1.0 if unit is None else unit.factor
