"""Measurement files: their format, names of channels, numbers of data sets, and errors
of readers."""

import contextlib
import difflib
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from jaxbody.core import units
from jaxbody.core.errors import JaxbodyError, Problem, warn
from jaxbody.core.source_files import check_file, check_size
from jaxbody.records.text_tables import Column, split_unit

# dimensions that the axis of a record or response may have, with their factors, and units that some
# programs write in capitals
AXES = {
    "s": ({units.TIME: 1.0}, ("s", "ms", "us")),
    "Hz": ({units.RATE: 1.0, units.ANGULAR_RATE: 1 / units.TURN}, ("Hz", "kHz")),
}
Asked = str | int  # name of a column, or its number
# a function of all names in the file and their aliases that returns {requested name: name in the
# file}
Pick = Callable[..., dict[Asked, str]]
MAGIC = {
    b"\x89HDF": "hdf5", b"PAR1": "parquet", b"TDSm": "tdms", b"MDF ": "mdf", b"MATLAB": "mat",
    b"PK\x03\x04": "zip or xlsx", b"\x1f\x8b": "gzip",
}  # fmt: skip
SUFFIXES = {
    "text": ".csv .txt .tsv .dat .asc .lvm",
    "parquet": ".parquet .pq",
    "mat": ".mat",
    "hdf5": ".h5 .hdf5 .hdf",
    "uff": ".uff .unv .uf",
    "tdms": ".tdms",
    "mdf": ".mf4 .mdf",
    "peer": ".at2 .vt2 .dt2",
}


def kind_of(path: Path, format: str | None, largest: float) -> str:
    """Return the format of an existing file, by its suffix or as stated by the user, checked
    against its first bytes. Errors: UNKNOWN_FORMAT, WRONG_FORMAT, those of `check_file`."""
    if format is not None and format not in SUFFIXES:
        raise JaxbodyError(
            Problem(
                "UNKNOWN_FORMAT",
                "format",
                f"is {format!r}",
                format,
                " ".join(SUFFIXES),
                "Give one of these.",
            )
        )
    check_file(path, largest)
    with path.open("rb") as file:
        start = file.read(8)
    suffixes = [suffix.lower() for suffix in path.suffixes]
    suffix = (
        suffixes[-2]
        if suffixes[-1:] == [".gz"] and len(suffixes) > 1
        else suffixes[-1]
        if suffixes
        else ""
    )
    kind = format or next(
        (kind for kind, known in SUFFIXES.items() if suffix in known.split()), None
    )
    if kind is None:
        raise JaxbodyError(
            Problem(
                "UNKNOWN_FORMAT",
                path.name,
                f"has the extension '{suffix}'",
                suffix,
                " ".join(SUFFIXES.values()),
                f'If you know the format, give format="text", or another of {" ".join(SUFFIXES)}.',
            )
        )
    content = next((word for magic, word in MAGIC.items() if start.startswith(magic)), None)
    expected = {
        "text": {None, "gzip"} if suffixes[-1:] == [".gz"] else {None},
        "uff": {None},
        "peer": {None},
        "mat": {"mat", "hdf5", None},
    }.get(kind, {kind})
    if content not in expected:
        raise JaxbodyError(
            Problem(
                "WRONG_FORMAT",
                path.name,
                f"is read as {kind}, but begins like {content or 'something else'}",
                start,
                hint='Check the extension, or give format="...".',
            )
        )
    return kind


def check_numbers(name: str, count: float, largest: float) -> None:
    """Check that `count` numbers to be read take at most `largest` bytes. Error: TOO_LARGE."""
    check_size(name, 8.0 * count, largest, f"bytes of numbers ({count:.4g})")


def find_name(
    asked: str | int,
    names: list[str],
    where: str,
    aliases: list[str] | None = None,
    others: dict[str, tuple[str, str]] | None = None,
) -> str:
    """Return the name in the file, or its alias, of a requested channel. A name matches in full,
    without its unit, or without an index such as [2]; a number is the index of a name, from 0.
    Errors: UNKNOWN_CHANNEL, NOT_A_NUMBER.

    Args:
        asked: the requested name or number
        names: names of the channels in the file
        where: name of the file, in messages
        aliases: other names of channels
        others: {name: (what it is, hint)} of entries that are no arrays of numbers"""
    if isinstance(asked, int):
        if 0 <= asked < len(names):
            return names[asked]
        raise JaxbodyError(
            Problem(
                "UNKNOWN_CHANNEL",
                where,
                f"has no channel of number {asked}: it has {len(names)}, counted from 0",
                asked,
                f"0 to {len(names) - 1}",
                _shown(names),
            )
        )
    names = [*names, *(aliases or ())]
    for name in (str(asked), re.sub(r"\[\d+\]$", "", str(asked))):
        matches = [known for known in names if known == name] or [
            known for known in names if split_unit(known)[0] == split_unit(name)[0]
        ]
        if len(matches) == 1:
            return matches[0]
    if others and asked in others:
        what, hint = others[str(asked)]
        raise JaxbodyError(
            Problem(
                "NOT_A_NUMBER",
                where,
                f"'{asked}' is {what}",
                asked,
                "numbers, (n,) or (n, k)",
                hint,
            )
        )
    near = difflib.get_close_matches(str(asked), names, 3, 0.5)
    raise JaxbodyError(
        Problem(
            "UNKNOWN_CHANNEL",
            where,
            f"has no channel '{asked}'",
            asked,
            hint=(f"Did you mean {' or '.join(near)}? " if near else "") + _shown(names),
        )
    )


def along(x: Any, unit: str | None, si: str, where: str) -> np.ndarray:
    """Return times (`si` is "s") or frequencies ("Hz") in SI, from an axis in the unit that the
    file states for it; without a unit it is in SI. Errors: NOT_A_RECORD, NOT_A_RESPONSE for an axis
    of another quantity. Warns TIME_UNIT, UNIT for an unknown unit."""
    dimensions, usual = AXES[si]
    known = next((name for name in usual if name.lower() == str(unit).lower()), unit)
    if not known or not units.is_unit(known):
        if known:
            warn(
                "TIME_UNIT" if si == "s" else "UNIT",
                f"{where} states '{unit:.40}' as the unit of its axis, which is "
                f"unknown: read as {si}",
            )
        return np.asarray(x, float)
    read = units.parse(known, where)
    if read.dimension not in dimensions:
        of, code, other = (
            ("time", "NOT_A_RECORD", "record")
            if si == "s"
            else ("frequency", "NOT_A_RESPONSE", "response")
        )
        raise JaxbodyError(
            Problem(
                code,
                where,
                f"is over '{unit}', not over {of}",
                unit,
                f"{' '.join(usual)} ...",
                f"Read another channel, or export it as a {other} over {of}.",
            )
        )
    return np.asarray(x, float) * (read.factor * dimensions[read.dimension])


def stated_number(values: np.ndarray, stated: int, where: str) -> np.ndarray:
    """Return as many values as the heading states; zeros after them only fill up a line. Errors:
    TRUNCATED for fewer values, RAGGED_LINE for more."""
    if 0 <= stated <= len(values) and not np.any(values[stated:]):
        return values[:stated]
    code, hint = (
        ("TRUNCATED", "Copy or export it again.")
        if len(values) < stated
        else ("RAGGED_LINE", "Is this the heading of another record?")
    )
    raise JaxbodyError(
        Problem(
            code,
            where,
            f"has {len(values)} samples",
            len(values),
            f"{stated}, as its heading says",
            hint,
        )
    )


def _shown(names: list[str]) -> str:
    return (
        "It has: "
        f"{', '.join(names[:12]) or 'nothing that can be read'}"
        f"{', ...' if len(names) > 12 else ''}."
    )


@contextlib.contextmanager
def reader_errors(path: Path, kind: str) -> Iterator[None]:
    """Turn any exception of a third-party reader on a broken file into UNREADABLE."""
    try:
        yield
    except JaxbodyError:
        raise
    except MemoryError:
        raise JaxbodyError(
            Problem(
                "TOO_LARGE",
                path.name,
                "does not fit into memory",
                hint="Read fewer channels, or split the file.",
            )
        ) from None
    except Exception as error:
        raise JaxbodyError(
            Problem(
                "UNREADABLE",
                path.name,
                (
                    f"cannot be read as {kind}: {type(error).__name__}: "
                    f"{str(error).splitlines()[0] if str(error) else ''}"
                )[:200],
                path,
                hint="Is it complete, and was it closed by the program that wrote it?",
            )
        ) from None


def column(
    values: Any, name: str, where: str, unit: str | None = None, times: np.ndarray | None = None
) -> Column:
    """Return a column of numbers, or of dates as seconds since the first one. Error:
    NOT_A_NUMBER."""
    if np.asarray(values).dtype.kind == "M":
        values, unit = (values - values[0]) / np.timedelta64(1, "s"), "s"
    return Column(numeric(values, name, where), unit or None, times)


def numeric(values: Any, name: str, where: str) -> np.ndarray:
    """Return float64 numbers (n,) or (n, k). Error: NOT_A_NUMBER."""
    array = np.asarray(values)
    if array.dtype.kind not in "biuf" or array.ndim not in (1, 2):
        raise JaxbodyError(
            Problem(
                "NOT_A_NUMBER",
                where,
                f"'{name}' holds {array.dtype} of shape {array.shape}",
                array.dtype,
                "numbers, (n,) or (n, k)",
                "Read another channel.",
            )
        )
    return array.astype(np.float64)
