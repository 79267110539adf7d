"""MATLAB files of versions 5 to 7: the tags of all elements are checked before SciPy reads the
file, because SciPy's C code does not.

An element is a tag (type, bytes) and its data, padded to 8 bytes; data of up to 4 bytes are in the
tag itself. A matrix holds elements: flags, dimensions, name, then its numbers, or for a struct the
names of its fields and a matrix for each.
Source: MAT-File Format, MathWorks.
"""

import math
import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np

from jaxbody.core.source_files import check_size
from jaxbody.records.sources import check_numbers

NUMBERS = {1: 1, 2: 1, 3: 2, 4: 2, 5: 4, 6: 4, 7: 4, 9: 8, 12: 8, 13: 8}  # bytes of each
TEXT = {16: 1, 17: 2, 18: 4}
MATRIX, COMPRESSED = 14, 15
KNOWN = {*NUMBERS, *TEXT, MATRIX, COMPRESSED}
CELL, STRUCT, OBJECT, CHARS, DEEPEST = 1, 2, 3, 4, 20
ELEMENT = 16  # memory of an element without its data (object, name, shape), in units of 8 bytes


def read_matlab(
    path: Path, largest: float
) -> tuple[dict[str, np.ndarray], dict[str, tuple[str, str]]]:
    """Read the arrays of a file. Return the numeric arrays by their names in MATLAB, "run.acc",
    "data{2}" or "run(2).acc", counted from 1, and {name: (what it is, hint)} of everything else.
    Raises ValueError for a broken file. Error: TOO_LARGE."""
    from scipy.io import loadmat

    check(path.read_bytes(), path.name, largest)
    arrays: dict[str, np.ndarray] = {}
    others: dict[str, tuple[str, str]] = {}

    def walk(name: str, value: Any) -> str | None:
        """Add a value and its parts to the arrays and others; return the name of the first array in
        it."""
        if isinstance(value, np.ndarray) and value.dtype.kind in "biuf" and value.ndim in (1, 2):
            arrays[name] = value
            return name
        parts, what = (
            [],
            "text"
            if isinstance(value, str)
            else f"{getattr(value, 'dtype', type(value).__name__)}, shape {np.shape(value)}",
        )
        if fields := getattr(value, "_fieldnames", None):
            parts, what = [(f".{field}", getattr(value, field)) for field in fields], "a struct"
        elif isinstance(value, np.ndarray) and value.dtype == object:
            structs = value.size > 0 and all(
                hasattr(x, "_fieldnames") for _, x in np.ndenumerate(value)
            )
            (start, end), what = ("()", "a struct array") if structs else ("{}", "a cell array")
            parts = [
                (start + ",".join(str(i + 1) for i in index) + end, x)
                for index, x in np.ndenumerate(value)
            ]
        first = next(filter(None, [walk(name + part, x) for part, x in parts]), None)
        others[name] = (
            what,
            f"Read an array in it, such as '{first}'."
            if first
            else "Save it as an array of real numbers.",
        )
        return first

    for name, value in loadmat(path, squeeze_me=True, struct_as_record=False).items():
        if not name.startswith("__"):
            walk(name, value)
    return arrays, others


def check(data: bytes, name: str, largest: float) -> None:
    """Raise ValueError unless all elements of the file are complete and of the right type. Error:
    TOO_LARGE if all numbers together exceed the limit."""
    _require(
        len(data) >= 136 and data[126:128] in (b"IM", b"MI"),
        "no header of a MATLAB file of version 5 to 7",
    )
    order = "<" if data[126:128] == b"IM" else ">"
    count, elements = 0, _elements(data[128:], order, name, largest)
    for kind, content in elements:
        if kind == COMPRESSED:
            unpacked = zlib.decompressobj()
            content = unpacked.decompress(content, int(min(largest, 2**40)) + 1)
            check_size(name, len(content), largest, "bytes or more in a compressed array")
            _require(
                unpacked.eof and not unpacked.unconsumed_tail, "a compressed array is incomplete"
            )
            ((kind, content),) = _elements(content, order, name, largest)
        _require(kind == MATRIX, f"an element is of type {kind} instead of an array")
        count += _check_matrix(content, order, 0, name, largest)
        check_numbers(name, count, largest)


def _require(good: bool, problem: str) -> None:
    if not good:
        raise ValueError(problem)


def _elements(data: bytes, order: str, name: str, largest: float) -> list[tuple[int, bytes]]:
    """Return (type, content) of each element in the data."""
    elements, at = [], 0
    while at < len(data):
        check_numbers(name, ELEMENT * len(elements), largest)
        _require(at + 8 <= len(data), "the file ends within a tag")
        kind, size = struct.unpack_from(order + "II", data, at)
        if kind >> 16:  # a small element: its size in the upper half, its data in the tag
            kind, size, start, step = kind & 0xFFFF, kind >> 16, at + 4, 8
            _require(size <= 4, f"a small element has {size} bytes, more than 4")
        else:
            start, step = at + 8, 8 + (size if kind == COMPRESSED else -(-size // 8) * 8)
        _require(kind in KNOWN, f"an element is of the unknown type {kind}")
        _require(start + size <= len(data), "the file ends within an element")
        elements.append((kind, data[start : start + size]))
        at += step
    return elements


def _check_matrix(content: bytes, order: str, depth: int, name: str, largest: float) -> int:
    """Check flags, dimensions, name and the parts of a matrix; return the memory that they take, in
    units of 8 bytes."""
    if not content:
        return ELEMENT  # an empty cell
    _require(depth <= DEEPEST, "arrays are nested too deeply")
    parts = _elements(content, order, name, largest)
    kinds = [kind for kind, _ in parts]
    _require(
        kinds[:3] == [6, 5, 1] and len(parts[0][1]) == 8,
        "an array lacks flags, dimensions or name",
    )
    flags = struct.unpack(order + "I", parts[0][1][:4])[0]
    kind, is_complex = flags & 0xFF, bool(flags & 0x800)
    count = math.prod(np.frombuffer(parts[1][1], order + "i4").tolist())
    if kind in (CELL, STRUCT, OBJECT):
        names = 0 if kind == CELL else 3 if kind == OBJECT else 2
        inner = parts[3 + names :]
        fields = 1
        if names:
            width = struct.unpack(order + "i", parts[2 + names - 1][1].ljust(4, b"\0")[:4])[0]
            fields = len(parts[2 + names][1]) // width if width > 0 else 0
        _require(
            len(inner) == count * fields and {k for k, _ in inner} <= {MATRIX},
            "a struct or cell lacks some of its parts",
        )
        return ELEMENT + sum(
            _check_matrix(matrix, order, depth + 1, name, largest) for _, matrix in inner
        )
    elif kind in (CHARS, *range(6, 16)):
        allowed = NUMBERS | TEXT if kind == CHARS else NUMBERS
        _require(
            len(parts) == 4 + is_complex and set(kinds[3:]) <= set(allowed),
            "an array lacks its numbers",
        )
        return ELEMENT + sum(len(part) // allowed[kind] for kind, part in parts[3:])
    else:
        what = {16: "a function handle", 17: "a table, timetable, datetime or string"}.get(
            kind, "an unknown object"
        )
        raise ValueError(
            f"an array is of class {kind}, {what}: save its numbers alone, dates "
            "as seconds(t - t(1))"
        )
