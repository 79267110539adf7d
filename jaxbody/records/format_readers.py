"""Readers of measurement files by format: the requested columns, with the units and times that the
file states.

    .csv .txt .tsv .dat .asc, also .gz     a table of text
    .lvm                                   a table of text with LabVIEW's headings, which state
                                           units and times
    .parquet .pq                           pyarrow      unit in the field's metadata or the name
    .mat                                   scipy; h5py for version 7.3
    .h5 .hdf5                              h5py         unit in the attribute `unit` or `units`
    .uff .unv .uf                          pyuff        functions of time (sets 58)
    .tdms                                  npTDMS       unit and times in the channel's properties
    .mf4 .mdf                              asammdf      unit and times in the file
    .at2 .vt2 .dt2                         PEER ground motions

Packages are imported when they are used; if one is missing, the message names it. Nothing is
unpickled, no network is used, and only the file itself is read. The number of values is compared
with the limit before they are read, because a small file can hold many. Source of .lvm:
Specification for the LabVIEW Measurement File, National Instruments.
"""

import gzip
import re
import zlib
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from jaxbody.core.errors import JaxbodyError, Problem, Problems, import_extra
from jaxbody.core.source_files import check_size, decoded
from jaxbody.records.matlab_files import read_matlab
from jaxbody.records.sources import (
    Asked,
    Pick,
    along,
    check_numbers,
    column,
    find_name,
    kind_of,
    numeric,
    reader_errors,
    stated_number,
)
from jaxbody.records.text_tables import (
    Column,
    Contents,
    distinct,
    numbers_of,
    read_text,
    split_unit,
)
from jaxbody.records.universal_files import read_uff

MOST_INFLATED = 1032  # zlib's largest ratio of decompressed to compressed size
# masters of MDF groups that are not times: sample numbers; angle, distance
INDEX, OF_MASTERS = 4, {2: "rad", 3: "m"}
DEFLATE, SHUFFLE, FLETCHER = 1, 2, 3  # HDF5's numbers of its filters
OF_LABVIEW, END = b"LabVIEW Measurement", "***End_of_Header***"
DIMENSIONS = {"": None, "Time": None, "Frequency": "Hz"}  # of LabVIEW


def read_columns(
    path: Any, wanted: list[Asked], *, format: str | None = None, largest: float = 1e9, **text: Any
) -> Contents:
    """Read the columns `wanted` of a file, by name or number, and return them under these names.
    `largest`: the largest size of the file and of its numbers [bytes]; `text`: options of
    `read_text`.

    Errors: NO_FILE, IS_DIRECTORY, NOT_A_FILE, EMPTY_FILE, TOO_LARGE, UNKNOWN_FORMAT,
    WRONG_FORMAT, MISSING_EXTRA, UNREADABLE, UNKNOWN_CHANNEL, NOT_A_NUMBER, EXTERNAL_DATA and
    those of text tables.
    """
    path = Path(path)
    kind = kind_of(path, format, largest)

    def pick(names: list[str], *more: Any) -> dict[Asked, str]:
        with Problems() as problems:
            chosen = {
                name: problems.gather(partial(find_name, name, names, path.name, *more))
                for name in wanted
            }
        return chosen

    with reader_errors(path, kind):
        return READERS[kind](path, pick, largest, **(text if kind == "text" else {}))


def _text(path: Path, pick: Pick, largest: float, **options: Any) -> Contents:
    data = path.read_bytes()
    if data[:2] == b"\x1f\x8b":
        with gzip.open(path) as file:
            data = file.read(int(largest) + 1)
        check_size(path.name, len(data), largest)
    if data.startswith(OF_LABVIEW):
        return _lvm(data, path.name, options["encoding"], pick)
    table = read_text(data, path.name, **options)
    return Contents(
        {asked: table.columns[name] for asked, name in pick(list(table.columns)).items()},
        table.notes,
    )


def _lvm(data: bytes, name: str, encoding: str, pick: Pick) -> Contents:
    """Read an .lvm file of one segment: a table below headings that state its separator and decimal
    mark, and unit and times of each channel."""
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


def _parquet(path: Path, pick: Pick, largest: float) -> Contents:
    file = import_extra("pyarrow.parquet", path.name).ParquetFile(path)
    schema = file.schema_arrow
    names = pick(list(schema.names))
    for name in names.values():
        if (
            re.match(
                r"(dictionary<values=)?(u?int|half|float|double|bool|timestamp|date)",
                str(schema.field(name).type),
            )
            is None
        ):
            raise _no_number(path, name, schema.field(name).type)
    check_numbers(path.name, len(set(names.values())) * file.metadata.num_rows, largest)
    table = file.read(columns=list(dict.fromkeys(names.values())))
    columns = {}
    for asked, name in names.items():
        meta = schema.field(name).metadata or {}
        unit = next(
            (meta[key].decode("utf-8", "replace") for key in (b"unit", b"units") if key in meta),
            split_unit(name)[1],
        )
        columns[asked] = column(table.column(name).to_numpy(), name, path.name, unit)
    return Contents(columns)


def _mat(path: Path, pick: Pick, largest: float) -> Contents:
    with path.open("rb") as file:
        start = file.read(1024)
    if b"\x89HDF" in start:
        return _hdf5(path, pick, largest, transposed=True)
    arrays, others = read_matlab(path, largest)
    return Contents(
        {
            asked: column(arrays[name], name, path.name)
            for asked, name in pick(list(arrays), None, others).items()
        }
    )


def _hdf5(path: Path, pick: Pick, largest: float, transposed: bool = False) -> Contents:
    h5py = import_extra("h5py", path.name)
    names: list[str] = []
    elsewhere: list[str] = []
    others: dict[str, tuple[str, str]] = {}

    def note(name: str, item: Any) -> None:
        if not isinstance(item, h5py.Dataset) or name.startswith("#"):
            return
        if item.dtype.kind in "biuf" and item.ndim in (1, 2):
            (elsewhere if item.external or item.is_virtual else names).append(name)
        elif h5py.check_ref_dtype(item.dtype):
            others[name] = (
                "a cell or struct array of MATLAB 7.3",
                "Save it with -v7, or its parts as arrays of their own.",
            )
        else:
            others[name] = f"{item.dtype} of shape {item.shape}", "Read another dataset."

    columns = {}
    with h5py.File(path, "r") as file:
        file.visititems(note)
        file.visititems_links(
            lambda name, link: (
                elsewhere.append(name) if isinstance(link, h5py.ExternalLink) else None
            )
        )
        chosen = pick([*names, *elsewhere], None, others)
        for name in elsewhere:
            if name in chosen.values():
                raise JaxbodyError(
                    Problem(
                        "EXTERNAL_DATA",
                        path.name,
                        f"has '{name}' in another file",
                        name,
                        "data in the file itself",
                        "Read that file, or copy all data into one with h5repack.",
                    )
                )
        sizes = [
            (file[name].size, np.prod(file[name].chunks or (0,), dtype=float))
            for name in set(chosen.values())
        ]
        check_numbers(
            path.name,
            sum(size for size, _ in sizes) + max((chunk for _, chunk in sizes), default=0.0),
            largest,
        )
        for name in set(chosen.values()):
            _check_chunks(path.name, file[name], largest)
        for asked, name in chosen.items():
            data = file[name]
            unit = next(
                (
                    data.attrs[key]
                    for key in ("unit", "units", "Unit", "Units")
                    if key in data.attrs
                ),
                None,
            )
            values = numeric(data[()], name, path.name)
            if transposed and values.ndim == 2:
                values = values.ravel() if 1 in values.shape else values.T
            columns[asked] = Column(
                values,
                unit.decode() if isinstance(unit, bytes) else None if unit is None else str(unit),
            )
    return Contents(columns)


def _check_chunks(where: str, data: Any, largest: float) -> None:
    """Check that no chunk that could exceed the limit inflates beyond its stated size, which HDF5
    detects too late. Error: TOO_LARGE."""
    plan = data.id.get_create_plist()
    filters = [plan.get_filter(i)[0] for i in range(plan.get_nfilters())]
    most = MOST_INFLATED ** filters.count(DEFLATE)
    # including Fletcher checksums
    stated = np.prod(data.chunks or (0,), dtype=float) * data.dtype.itemsize + 4 * len(filters)
    suspects: list[Any] = []
    if data.chunks and most > 1:
        data.id.chunk_iter(
            lambda chunk: (
                suspects.append(chunk.chunk_offset) if most * chunk.size > largest else None
            )
        )
    for at in suspects:
        skipped, packed = data.id.read_direct_chunk(at)
        for i in reversed([i for i in range(len(filters)) if not skipped >> i & 1]):
            if filters[i] == DEFLATE:
                packed = zlib.decompressobj().decompress(packed, int(stated) + 1)
                if len(packed) > stated:
                    raise JaxbodyError(
                        Problem(
                            "TOO_LARGE",
                            where,
                            (
                                f"has a chunk of '{data.name}' that inflates to more than the "
                                f"{stated:.4g} bytes stated for it"
                            ),
                            at,
                            f"{stated:.4g} bytes",
                            "It is damaged, or meant to exhaust the memory.",
                        )
                    )
            elif filters[i] == FLETCHER:
                packed = packed[:-4]
            elif filters[i] != SHUFFLE:
                break  # other filters of h5py inflate a hundredfold at most


def _tdms(path: Path, pick: Pick, largest: float) -> Contents:
    with import_extra("nptdms", path.name).TdmsFile.open(path) as file:
        channels = {
            f"{group.name}/{channel.name}": channel
            for group in file.groups()
            for channel in group.channels()
        }
        columns, chosen = {}, pick(list(channels))
        starts = [channels[name].properties.get("wf_start_time") for name in chosen.values()]
        starts = (
            dict(zip(chosen, starts, strict=True))
            if all(isinstance(start, np.datetime64) for start in starts)
            else {}
        )
        for name in set(chosen.values()):
            if channels[name].dtype.kind not in "biufM":
                raise _no_number(path, name, channels[name].dtype)
        check_numbers(path.name, sum(len(channels[name]) for name in set(chosen.values())), largest)
        for asked, name in chosen.items():
            channel, get, times = channels[name], channels[name].properties.get, None
            if get("wf_increment"):
                axis = get("wf_start_offset", 0.0) + get("wf_increment") * np.arange(len(channel))
                times = along(axis, get("wf_xunit_string"), "s", f"{path.name}['{name}']")
                times += (
                    (starts[asked] - min(starts.values())) / np.timedelta64(1, "s")
                    if starts
                    else 0.0
                )
            columns[asked] = column(
                channel[:], name, path.name, get("unit_string") or get("NI_UnitDescription"), times
            )
    return Contents(columns)


def _mdf(path: Path, pick: Pick, largest: float) -> Contents:
    with import_extra("asammdf", path.name).MDF(path) as file:
        places = {}
        for name, entries in file.channels_db.items():
            entries = [place for place in entries if file.masters_db.get(place[0]) != place[1]]
            places |= {
                name if len(entries) == 1 else f"{name}#{place[0]}": place for place in entries
            }
        columns, wanted = {}, pick(list(places))
        groups = [file.groups[places[name][0]].channel_group for name in set(wanted.values())]
        check_numbers(path.name, sum(2 * group.cycles_nr for group in groups), largest)
        check_size(
            path.name,
            max((group.samples_byte_nr * group.cycles_nr for group in groups), default=0),
            largest,
            "bytes of samples in a group",
        )
        for asked, name in wanted.items():
            group, index = places[name]
            signal = file.get(group=group, index=index)
            times, kind, holder = None, signal.master_metadata[1], group
            if group not in file.masters_db:
                holder = getattr(file.groups[group].channel_group, "cg_master_index", None)
            # otherwise the timestamps of asammdf are sample numbers
            if holder in file.masters_db and kind != INDEX:
                axis = OF_MASTERS.get(kind) or file.get_channel_unit(
                    group=holder, index=file.masters_db[holder]
                )
                times = along(signal.timestamps, axis, "s", f"{path.name}['{name}']")
            columns[asked] = column(signal.samples, name, path.name, signal.unit, times)
    return Contents(columns)


def _peer(path: Path, pick: Pick, largest: float) -> Contents:
    """Read a PEER file: a heading of four lines, with the unit in the third, the number of samples
    and the time step in the fourth; then the samples, row by row."""
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
        raise JaxbodyError(
            Problem(
                "WRONG_FORMAT",
                path.name,
                "lacks its heading: 'UNITS OF G' in line 3, 'NPTS= 4000, DT= .005 SEC' in line 4",
                heading[:60],
                hint='If it is another table, give format="text".',
            )
        )
    values, count = [], int(number[1])
    for i, line in enumerate(lines[4:], 5):
        try:
            values += [float(cell) for cell in line.split()]
        except ValueError:
            raise JaxbodyError(
                Problem(
                    "BAD_LINE",
                    f"{path.name}:{i}",
                    f"is {line!r:.60}",
                    i,
                    "numbers",
                    "Delete anything that is not a sample.",
                )
            ) from None
    column = Column(
        stated_number(np.array(values), count, path.name),
        unit[1].lower(),
        float(step[1]) * np.arange(count),
    )
    return Contents({asked: column for asked in pick(["motion"])})


def _no_number(path: Path, name: str, kind: Any) -> JaxbodyError:
    return JaxbodyError(
        Problem(
            "NOT_A_NUMBER",
            path.name,
            f"'{name}' holds {kind}",
            kind,
            "numbers",
            "Read another channel.",
        )
    )


READERS: dict[str, Callable[..., Contents]] = {
    "text": _text,
    "parquet": _parquet,
    "mat": _mat,
    "hdf5": _hdf5,
    "uff": read_uff,
    "tdms": _tdms,
    "mdf": _mdf,
    "peer": _peer,
}
