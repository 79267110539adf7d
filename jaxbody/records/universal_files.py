"""Universal files (UFF, UNV), sets 58: functions of time and frequency responses by node and direction, "4+Z"."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from jaxbody.core.errors import JaxbodyError, Problem, import_extra
from jaxbody.records.sources import Pick, find_name, kind_of, numeric, reader_errors
from jaxbody.records.text_tables import Column, Contents

DIRECTIONS = {0: "", 1: "+X", -1: "-X", 2: "+Y", -2: "-Y", 3: "+Z", -3: "-Z", 4: "+RX", -4: "-RX", 5: "+RY", -5: "-RY", 6: "+RZ", -6: "-RZ"}


def sets_of(path: Path) -> list[dict[str, Any]]:
    """The functions (sets 58) of a universal file."""
    pyuff = import_extra("pyuff", path.name)
    file = pyuff.UFF(str(path))
    kinds = [int(kind) for kind in file.get_set_types()]
    if 58 not in kinds:
        message = (
            f"has no function of time or response (set 58), only sets {sorted(set(kinds))}"
            if kinds
            else "is not a universal file: it has no sets"
        )
        hint = "Export responses as functions (set 58)." if kinds else 'Check the extension, or give format="...".'
        raise JaxbodyError(Problem("WRONG_FORMAT", path.name, message, kinds, "sets 58", hint))
    return [file.read_sets(i) for i, kind in enumerate(kinds) if kind == 58]


def _uff_place(s: dict[str, Any], of: str) -> str:
    """Node and direction of the response (`rsp`) or reference (`ref`), "4+Z"."""
    return f"{int(s[of + '_node'])}{DIRECTIONS.get(int(s[of + '_dir']), '')}"


def _uff_unit(s: dict[str, Any], axis: str) -> str | None:
    unit = str(s.get(f"{axis}_axis_units_lab") or "").strip()
    return None if unit in ("", "NONE") else unit


def _distinct(names: list[str]) -> list[str]:
    often = Counter(names)
    return [name if often[name] == 1 else f"{name}#{i}" for i, name in enumerate(names)]


def read_uff(path: Path, pick: Pick, largest: float) -> Contents:
    """Functions of time, by node and direction or by a unique id line. Errors: WRONG_FORMAT, UNKNOWN_CHANNEL, NOT_A_RECORD."""
    sets = sets_of(path)
    names = _distinct([_uff_place(s, "rsp") for s in sets])
    lines = [str(s.get("id1") or "").strip() for s in sets]
    known, often = {"", "NONE", *names}, Counter(lines)
    places = {line: i for i, line in enumerate(lines) if line not in known and often[line] == 1}
    columns = {}
    for asked, name in pick(names, list(places)).items():
        s = sets[names.index(name) if name in names else places[name]]
        if int(s["func_type"]) not in (0, 1) or np.iscomplexobj(s["data"]):
            message = f"'{name}' is not a function of time (function type {int(s['func_type'])})"
            hint = "Read a time response; read_responses reads frequency responses."
            raise JaxbodyError(Problem("NOT_A_RECORD", path.name, message, s["func_type"], "0 or 1", hint))
        columns[asked] = Column(numeric(s["data"], name, path.name), _uff_unit(s, "ordinate"), np.asarray(s["x"], float))
    return Contents(columns)


@dataclass
class Response:
    """A frequency response in a file: frequencies [Hz], complex values, units of numerator and denominator."""

    frequencies: np.ndarray
    values: np.ndarray
    above: str | None
    below: str | None


def read_uff_responses(path: Any, wanted: list[str], largest: float) -> dict[str, Response]:
    """Frequency responses of a universal file by "response/reference"."""
    path = Path(path)
    kind_of(path, "uff", largest)
    with reader_errors(path, "uff"):
        sets = [s for s in sets_of(path) if int(s["func_type"]) == 4]
        names = _distinct([f"{_uff_place(s, 'rsp')}/{_uff_place(s, 'ref')}" for s in sets])
        responses = {}
        for asked in wanted:
            s = sets[names.index(find_name(asked, names, path.name))]
            x, y = np.asarray(s["x"], float), np.asarray(s["data"], complex)
            if not (np.isfinite(x).all() and np.isfinite(y).all() and len(x) == len(y) > 0):
                message = f"'{asked}' has {len(y)} values at {len(x)} frequencies, or values that are not finite"
                raise JaxbodyError(Problem("NOT_A_RESPONSE", path.name, message, len(y), "one finite value each", "Export it again."))
            responses[asked] = Response(x, y, _uff_unit(s, "ordinate"), _uff_unit(s, "orddenom"))
    return responses
