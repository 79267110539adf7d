"""Measurement files by format: the columns that are wanted, with the units and times that the file itself states.

    .csv .txt .tsv .dat .asc, also .gz     a table of text
    .parquet .pq                           pyarrow      unit in the field's metadata or the name
    .mat                                   scipy; h5py for version 7.3
    .h5 .hdf5                              h5py         unit in the attribute `unit` or `units`
    .uff .unv .uf                          pyuff        functions of time (sets 58)
    .tdms                                  npTDMS       unit and times in the channel's properties
    .mf4 .mdf                              asammdf      unit and times in the file
    .at2 .vt2 .dt2                         PEER ground motions

Readers are imported where they are used, and said by name where they are missing. Nothing is unpickled and no network is used.
"""

from __future__ import annotations

import difflib
import gzip
import importlib
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from jaxbody.errors import JaxbodyError, Problem
from jaxbody.mat_files import read_matlab
from jaxbody.texts import Column, Contents, read_text, split_unit

Pick = Callable[[list[str]], dict[str, str]]  # {name as asked for: name in the file}, of all names in the file
MAGIC = {b"\x89HDF": "hdf5", b"PAR1": "parquet", b"TDSm": "tdms", b"MDF ": "mdf", b"MATLAB": "mat", b"PK\x03\x04": "zip or xlsx", b"\x1f\x8b": "gzip"}  # fmt: skip
DIRECTIONS = {0: "", 1: "+X", -1: "-X", 2: "+Y", -2: "-Y", 3: "+Z", -3: "-Z", 4: "+RX", -4: "-RX", 5: "+RY", -5: "-RY", 6: "+RZ", -6: "-RZ"}


def read_columns(path: Any, wanted: list[str], *, format: str | None = None, largest: float = 1e9, **text: Any) -> Contents:
    """The columns that are wanted of a file, under the names that they were asked for.

    Errors: NO_FILE, IS_DIRECTORY, EMPTY_FILE, TOO_LARGE, UNKNOWN_FORMAT, WRONG_FORMAT, MISSING_EXTRA, UNREADABLE, UNKNOWN_CHANNEL, NOT_A_NUMBER and
    those of text tables.
    """
    path = Path(path)
    kind = _kind(path, format, largest)

    def pick(names: list[str]) -> dict[str, str]:
        return {name: _find(name, names, path.name) for name in wanted}

    try:
        options = {"text": {"largest": largest, **text}, "mat": {"largest": largest}}.get(kind, {})
        return READERS[kind](path, pick, **options)
    except JaxbodyError:
        raise
    except MemoryError:
        raise JaxbodyError(
            Problem("TOO_LARGE", path.name, "does not fit into memory", hint="Read fewer channels, or cut the file.")
        ) from None
    except Exception as error:  # whatever a reader of another project raises on a broken file
        told = f"cannot be read as {kind}: {type(error).__name__}: {str(error).splitlines()[0] if str(error) else ''}"[:200]
        raise JaxbodyError(
            Problem("UNREADABLE", path.name, told, path, hint="Is it whole? Was it closed by the program that wrote it?")
        ) from None


SUFFIXES = {
    "text": ".csv .txt .tsv .dat .asc", "parquet": ".parquet .pq", "mat": ".mat", "hdf5": ".h5 .hdf5 .hdf", "uff": ".uff .unv .uf",
    "tdms": ".tdms", "mdf": ".mf4 .mdf", "peer": ".at2 .vt2 .dt2",
}  # fmt: skip


def _kind(path: Path, format: str | None, largest: float) -> str:
    """The format of a file that is there, by its suffix or as stated, and not against its first bytes."""
    if format is not None and format not in SUFFIXES:
        raise JaxbodyError(Problem("UNKNOWN_FORMAT", "format", f"is {format!r}", format, " ".join(SUFFIXES), "Give one of these."))
    try:
        size = path.stat().st_size
        with path.open("rb") as file:
            start = file.read(8)
    except IsADirectoryError:
        raise JaxbodyError(
            Problem("IS_DIRECTORY", str(path), "is a directory", path, "a file", "Give the path of one file in it.")
        ) from None
    except (OSError, ValueError) as error:
        told = f"cannot be read: {getattr(error, 'strerror', None) or error}"
        raise JaxbodyError(Problem("NO_FILE", str(path)[-200:], told, path, hint="Give the path of a file.")) from None
    if size == 0:
        raise JaxbodyError(Problem("EMPTY_FILE", path.name, "has no bytes", 0, "> 0", "Was it copied before it was written?"))
    if size > largest:
        raise JaxbodyError(_too_large(path.name, size, largest))
    suffixes = [suffix.lower() for suffix in path.suffixes]
    suffix = suffixes[-2] if suffixes[-1:] == [".gz"] and len(suffixes) > 1 else suffixes[-1] if suffixes else ""
    kind = format or next((kind for kind, known in SUFFIXES.items() if suffix in known.split()), None)
    if kind is None:
        hint = f'If you know what it is, say format="text", or another of {" ".join(SUFFIXES)}.'
        raise JaxbodyError(Problem("UNKNOWN_FORMAT", path.name, f"has the ending '{suffix}'", suffix, " ".join(SUFFIXES.values()), hint))
    found = next((word for magic, word in MAGIC.items() if start.startswith(magic)), None)
    expected = {"text": {None, "gzip"} if suffixes[-1:] == [".gz"] else {None}, "uff": {None}, "peer": {None}, "mat": {"mat", "hdf5", None}}.get(kind, {kind})  # fmt: skip
    if found not in expected:
        told = f"is taken for {kind}, but begins like {found or 'something else'}"
        raise JaxbodyError(Problem("WRONG_FORMAT", path.name, told, start, hint='Is the ending right? If it is not, say format="...".'))
    return kind


def _too_large(name: str, size: float, largest: float) -> Problem:
    hint = f"Say largest={max(1, round(size * 1.1 / 1e9))}e9 if there is memory for about five times that, or cut the file."
    return Problem("TOO_LARGE", name, f"has {size:.4g} bytes", size, f"{largest:.4g} bytes", hint)


def _find(asked: str, names: list[str], where: str) -> str:
    """The name in the file of a channel: itself, or without its unit, or without an index such as [2]."""
    for name in (str(asked), re.sub(r"\[\d+\]$", "", str(asked))):
        matches = [known for known in names if known == name] or [known for known in names if split_unit(known)[0] == split_unit(name)[0]]
        if len(matches) == 1:
            return matches[0]
    near = difflib.get_close_matches(str(asked), names, 3, 0.5)
    shown = ", ".join(names[:12]) + (", ..." if len(names) > 12 else "")
    hint = (f"Did you mean {' or '.join(near)}? " if near else "") + f"It has: {shown or 'nothing that can be read'}."
    raise JaxbodyError(Problem("UNKNOWN_CHANNEL", where, f"has no channel '{asked}'", asked, hint=hint))


def _needed(module: str, package: str, extra: str, what: str) -> Any:
    try:
        return importlib.import_module(module)
    except ImportError:
        hint = f"pip install 'jaxbody[{extra}]'"
        raise JaxbodyError(
            Problem("MISSING_EXTRA", what, f"needs the package {package}, which is not installed", package, hint=hint)
        ) from None


def numeric(values: Any, name: str, where: str) -> np.ndarray:
    """Float64 numbers (n,) or (n, k); what is no number is an error."""
    array = np.asarray(values)
    if array.dtype.kind not in "biuf" or array.ndim not in (1, 2):
        told = f"'{name}' holds {array.dtype} of shape {array.shape}"
        raise JaxbodyError(Problem("NOT_A_NUMBER", where, told, array.dtype, "numbers, (n,) or (n, k)", "Read another channel."))
    return array.astype(np.float64)


def _text(path: Path, pick: Pick, *, largest: float, **how: Any) -> Contents:
    data = path.read_bytes()
    if data[:2] == b"\x1f\x8b":
        with gzip.open(path) as file:  # a little can hold a lot
            data = file.read(int(largest) + 1)
        if len(data) > largest:
            raise JaxbodyError(_too_large(path.name, len(data), largest))
    found = read_text(data, path.name, **how)
    return Contents({asked: found.columns[name] for asked, name in pick(list(found.columns)).items()}, found.notes)


def _parquet(path: Path, pick: Pick) -> Contents:
    parquet = _needed("pyarrow.parquet", "pyarrow", "files", path.name)
    schema = parquet.read_schema(path)
    names = pick(list(schema.names))
    table = parquet.read_table(path, columns=list(dict.fromkeys(names.values())))
    columns = {}
    for asked, name in names.items():
        values, meta = table.column(name).to_numpy(), schema.field(name).metadata or {}
        unit = next((meta[key].decode("utf-8", "replace") for key in (b"unit", b"units") if key in meta), split_unit(name)[1])
        if values.dtype.kind == "M":
            values, unit = (values - values[0]) / np.timedelta64(1, "s"), "s"
        columns[asked] = Column(numeric(values, name, path.name), unit)
    return Contents(columns)


def _mat(path: Path, pick: Pick, *, largest: float) -> Contents:
    if path.read_bytes()[:1024].find(b"\x89HDF") >= 0:
        return _hdf5(path, pick, transposed=True)
    found = read_matlab(path, largest)
    return Contents({asked: Column(numeric(found[name], name, path.name)) for asked, name in pick(list(found)).items()})


def _hdf5(path: Path, pick: Pick, transposed: bool = False) -> Contents:
    h5py = _needed("h5py", "h5py", "files", path.name)
    names: list[str] = []

    def note(name: str, item: Any) -> None:
        if isinstance(item, h5py.Dataset) and item.dtype.kind in "biuf" and item.ndim in (1, 2) and not name.startswith("#"):
            names.append(name)

    columns = {}
    with h5py.File(path, "r") as file:
        file.visititems(note)
        for asked, name in pick(names).items():
            data = file[name]
            unit = next((data.attrs[key] for key in ("unit", "units", "Unit", "Units") if key in data.attrs), None)
            values = numeric(data[()], name, path.name)
            if transposed and values.ndim == 2:
                values = values.T[:, 0] if 1 in values.shape and values.shape[0] == 1 else values.T
                values = values[0] if values.ndim == 2 and values.shape[0] == 1 else values
            columns[asked] = Column(values, unit.decode() if isinstance(unit, bytes) else None if unit is None else str(unit))
    return Contents(columns)


def _uff(path: Path, pick: Pick) -> Contents:
    pyuff = _needed("pyuff", "pyuff", "files", path.name)
    file = pyuff.UFF(str(path))
    sets = [file.read_sets(i) for i, kind in enumerate(file.get_set_types()) if int(kind) == 58]
    heads = [f"{int(s['rsp_node'])}{DIRECTIONS.get(int(s['rsp_dir']), '')}" for s in sets]
    names = [head if heads.count(head) == 1 else f"{head}#{i}" for i, head in enumerate(heads)]
    columns = {}
    for asked, name in pick(names).items():
        s = sets[names.index(name)]
        if int(s["func_type"]) not in (0, 1) or np.iscomplexobj(s["data"]):
            told = f"'{name}' is no function of time (function type {int(s['func_type'])})"
            raise JaxbodyError(Problem("NOT_A_RECORD", path.name, told, s["func_type"], "0 or 1", "Read a time response."))
        unit = str(s.get("ordinate_axis_units_lab") or "").strip()
        columns[asked] = Column(numeric(s["data"], name, path.name), None if unit in ("", "NONE") else unit, np.asarray(s["x"], float))
    return Contents(columns)


def _tdms(path: Path, pick: Pick) -> Contents:
    nptdms = _needed("nptdms", "npTDMS", "files", path.name)
    with nptdms.TdmsFile.open(path) as file:
        channels = {f"{group.name}/{channel.name}": channel for group in file.groups() for channel in group.channels()}
        columns = {}
        for asked, name in pick(list(channels)).items():
            channel = channels[name]
            unit = channel.properties.get("unit_string") or channel.properties.get("NI_UnitDescription")
            times = np.asarray(channel.time_track(), float) if "wf_increment" in channel.properties else None
            columns[asked] = Column(numeric(channel[:], name, path.name), unit or None, times)
    return Contents(columns)


def _mdf(path: Path, pick: Pick) -> Contents:
    asammdf = _needed("asammdf", "asammdf", "mdf", path.name)
    with asammdf.MDF(path) as file:
        places = {}
        for name, found in file.channels_db.items():
            found = [place for place in found if file.masters_db.get(place[0]) != place[1]]
            places |= {name if len(found) == 1 else f"{name}#{place[0]}": place for place in found}
        columns = {}
        for asked, name in pick(list(places)).items():
            group, index = places[name]
            signal = file.get(group=group, index=index)
            columns[asked] = Column(numeric(signal.samples, name, path.name), signal.unit or None, np.asarray(signal.timestamps, float))
    return Contents(columns)


def _peer(path: Path, pick: Pick) -> Contents:
    """Four lines of heading, of which the third states the unit and the fourth number and step; then the samples, row by row."""
    lines = path.read_text(encoding="latin-1").splitlines()
    heading = " ".join(lines[2:4]).upper()
    unit = re.search(r"UNITS OF\s+([A-Z/0-9]+)", heading)
    number = re.search(r"NPTS\s*=\s*(\d+)", heading) or re.search(
        r"^\s*(\d+)\s+[\d.E+-]+\s+NPTS", lines[3].upper() if len(lines) > 3 else ""
    )
    step = re.search(r"DT\s*=\s*([\d.E+-]+)", heading) or re.search(
        r"^\s*\d+\s+([\d.E+-]+)\s+NPTS", lines[3].upper() if len(lines) > 3 else ""
    )
    if unit is None or number is None or step is None:
        told = "lacks its heading: 'UNITS OF G' in line 3, 'NPTS= 4000, DT= .005 SEC' in line 4"
        raise JaxbodyError(Problem("WRONG_FORMAT", path.name, told, heading[:60], hint='If it is another table, say format="text".'))
    values, count = [], int(number[1])
    for i, line in enumerate(lines[4:], 5):
        try:
            values += [float(cell) for cell in line.split()]
        except ValueError:
            raise JaxbodyError(
                Problem("BAD_LINE", f"{path.name}:{i}", f"is {line!r:.60}", i, "numbers", "Cut what is no sample.")
            ) from None
    if len(values) != count:
        code, hint = ("TRUNCATED", "Copy it again.") if len(values) < count else ("RAGGED_LINE", "Is the heading that of this record?")
        raise JaxbodyError(Problem(code, path.name, f"has {len(values)} samples", len(values), f"{count}, as its heading says", hint))
    times = float(step[1]) * np.arange(count)
    column = Column(np.array(values), unit[1].lower(), times)
    return Contents({asked: column for asked in pick(["motion"])})


READERS: dict[str, Callable[..., Contents]] = {
    "text": _text, "parquet": _parquet, "mat": _mat, "hdf5": _hdf5, "uff": _uff, "tdms": _tdms, "mdf": _mdf, "peer": _peer,
}  # fmt: skip
