"""Records from measurement files: which columns, in which units, at which times."""

from __future__ import annotations

import re
from typing import Any

import numpy as np

from jaxbody.core import units
from jaxbody.core.errors import JaxbodyError, Problem, Problems
from jaxbody.records import readers
from jaxbody.records.records import Record
from jaxbody.records.sources import Asked
from jaxbody.records.text_tables import Column


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
    """The Record in a file: CSV and other text tables (also .gz), Parquet, MATLAB, HDF5, UFF58, TDMS, MDF4, PEER AT2.

    Args:
        path: of the file
        channels: {name: columns} or {name: (columns, unit)}, with the name or number (from 0) of a column, or a list of them; "X[2]" is a
            column of an array; "1+Z" in a UFF file is node 1 along Z, which its id line may name too where that is unique
        time: a column or (column, unit); None: the times that UFF, TDMS, MDF and AT2 files state, or those of `rate=`
        format: None: by the ending of the file
        largest: size of a file, and of the numbers read from it, 8 bytes each [bytes]
        encoding: of text
        separator: between columns of text; None: that of the first line of numbers
        decimal: "," for decimal commas
        skip: number of lines to leave out at the start of text
        footer: number of lines to leave out at its end
        options: of `Record`

    Units come from the file, "acc [g]" or its own fields, or from you; where both state one they must agree. The channel of an AT2 file is
    called "motion".

    Errors: NO_FILE, IS_DIRECTORY, NOT_A_FILE (a pipe, a device), EMPTY_FILE, TOO_LARGE, UNKNOWN_FORMAT, WRONG_FORMAT, MISSING_EXTRA,
    UNREADABLE, UNKNOWN_CHANNEL, NOT_A_NUMBER, EXTERNAL_DATA (HDF5 that points to other files); for text, with the line, ENCODING,
    NO_NUMBERS, BAD_LINE, RAGGED_LINE, DECIMAL_COMMA, TRUNCATED; UNIT_CONFLICT, DIFFERENT_TIMES and those of `Record`.

    >>> import pathlib, tempfile
    >>> path = pathlib.Path(tempfile.mkdtemp()) / "run.csv"
    >>> _ = path.write_text("t [ms],acc [g]\\n0,0.1\\n10,0.2\\n20,0.0\\n")
    >>> read_record(path, time="t", channels={"acc": "acc"})["acc"].round(3).tolist()
    [0.981, 1.961, 0.0]
    """
    problems, name = Problems(), str(getattr(path, "name", path))[-100:]
    if not isinstance(channels, dict):
        told, hint = f"is {channels!r:.60}", 'Write {"acc": ("ax", "m/s2")}: your name, then column and unit.'
        raise JaxbodyError(Problem("WRONG_KIND", "channels", told, channels, "a dict {name: column}", hint))
    wanted = {key: _wanted(spec, f"channels['{key}']", problems) for key, spec in channels.items()}
    clock = None if time is None else _wanted(time, "time", problems)
    if not channels:
        problems.add("NO_DATA", "channels", "is empty", limit="at least one", hint='Say channels={"acc": ("ax", "m/s2")}.')
    problems.raise_if_any()
    stated = {f"{name}['{key}']": unit for key, (_, unit) in wanted.items()} | ({} if clock is None else {f"{name}.times": clock[1]})
    for where, unit in stated.items():
        problems.gather(lambda unit=unit, where=where: None if unit is None else units.parse(unit, where))
    asked = [column for columns, _ in (*wanted.values(), *([clock] if clock else [])) for column in columns]
    text = {"encoding": encoding, "separator": separator, "decimal": decimal, "skip": skip, "footer": footer}
    found = problems.gather(lambda: readers.read_columns(path, list(dict.fromkeys(asked)), format=format, largest=largest, **text))
    problems.raise_if_any()
    notes = list(found.notes)
    times, time_unit = _clock(found.columns, clock, options.get("rate"), name, problems, notes)
    given = {}
    for key, (columns, unit) in wanted.items():
        parts = [_part(found.columns[column], column) for column in columns]
        if len({len(part) for part in parts}) > 1 or (len(parts) > 1 and any(part.ndim > 1 for part in parts)):
            told = f"joins columns of shapes {[part.shape for part in parts]}"
            problems.add("BAD_SHAPE", f"{name}['{key}']", told, limit="columns of one length", hint="Read them as channels of their own.")
            continue
        said = {found.columns[column].unit for column in columns}
        agreed = _unit(unit, said, f"{name}['{key}']", problems, notes)
        given[key] = (parts[0] if len(parts) == 1 else np.stack(parts, 1), agreed)
    problems.raise_if_any()
    record = Record(times, given, time_unit=time_unit, name=name, **options)
    record.notes = (*notes, *record.notes)
    return record


def _wanted(spec: Any, where: str, problems: Problems) -> tuple[list[Asked], str | None]:
    """Columns and, where it is stated, unit."""
    columns, unit = spec if isinstance(spec, tuple) and len(spec) == 2 else (spec, None)
    names = columns if isinstance(columns, list) else [columns]
    if not names or not all(isinstance(name, str | int) for name in names) or not isinstance(unit, str | None):
        problems.add("WRONG_KIND", where, f"is {spec!r:.60}", value=spec, limit='"ax", ("ax", "m/s2") or (["ax", "ay"], "m/s2")')
        return [], None
    return names, unit  # pyright: ignore[reportReturnType]  checked above


def _part(column: Column, asked: Asked) -> np.ndarray:
    """The values; of an array, the column that "X[2]" means."""
    index = re.search(r"\[(\d+)\]$", str(asked))
    if index is None or column.values.ndim == 1:
        return column.values
    if int(index[1]) >= column.values.shape[1]:
        told = f"has {column.values.shape[1]} columns"
        raise JaxbodyError(
            Problem("UNKNOWN_CHANNEL", str(asked), told, asked, f"[0] to [{column.values.shape[1] - 1}]", "They count from 0.")
        )
    return column.values[:, int(index[1])]


def _unit(stated: str | None, said: set[str | None], where: str, problems: Problems, notes: list[str]) -> str:
    """The unit stated by the user, by the file, or by both in agreement."""
    told = said - {None}
    if stated is None and (len(said) != 1 or not told):
        what = "no unit" if not told else f"different units {sorted(map(str, said))}"
        hint = 'State it: ("column", "m/s2"); "1" is a number without one.'
        problems.add("NO_UNIT", where, f"has {what} in the file", limit="one unit", hint=hint)
        return "1"
    if stated is None:
        return str(told.pop())
    for word in told:
        try:
            theirs = units.parse(str(word), where)
        except JaxbodyError:
            notes.append(f"{where}: the file says '{word}', taken as {stated}")
            continue
        ours = units.parse(stated, where)
        if (theirs.dimension, round(theirs.factor / ours.factor, 9)) != (ours.dimension, 1.0):
            hint = "Believe the file by stating none, or give the numbers to Record with the unit that is right."
            problems.add("UNIT_CONFLICT", where, f"is in '{word}' in the file, not in '{stated}'", value=stated, limit=str(word), hint=hint)
    return stated


def _clock(columns: dict[Any, Column], clock: Any, rate: Any, name: str, problems: Problems, notes: list[str]) -> tuple[Any, str]:
    """Times and their unit: of a column, of the file itself, or none where a rate is given."""
    if clock is not None:
        column = columns[clock[0][0]]
        return _part(column, clock[0][0]), _unit(clock[1], {column.unit}, f"{name}.times", problems, notes)
    own = [column.times for column in columns.values() if column.times is not None]
    if len(own) == len(columns) and not (rate is not None and not own):
        if any(
            len(other) != len(own[0]) or np.abs(other - own[0]).max(initial=0.0) > 1e-9 * np.abs(np.diff(own[0])).sum() for other in own[1:]
        ):
            hint = "Read them as records of their own, an experiment for each."
            problems.add("DIFFERENT_TIMES", name, "samples its channels at different times", limit="one clock", hint=hint)
        return own[0], "s"
    if rate is None:
        problems.add("NO_TIME", name, "has no times of its own", limit="time= or rate=", hint='Say time=("t", "s"), or rate= [Hz].')
    return None, "s"
