"""Universal files (UFF, UNV), sets 58: functions of time and frequency responses by node and
direction, "4+Z"."""

from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from jaxbody.core.errors import JaxbodyError, Problem, import_extra
from jaxbody.records.sources import (
    Pick,
    along,
    column,
    find_name,
    kind_of,
    reader_errors,
    stated_number,
)
from jaxbody.records.text_tables import Contents, distinct

DIRECTIONS = {
    0: "",
    1: "+X",
    -1: "-X",
    2: "+Y",
    -2: "-Y",
    3: "+Z",
    -3: "-Z",
    4: "+RX",
    -4: "-RX",
    5: "+RY",
    -5: "-RY",
    6: "+RZ",
    -6: "-RZ",
}

KINDS = {
    0: "a general function",
    1: "a time response",
    2: "an auto spectrum",
    3: "a cross spectrum",
    4: "a frequency response",
    5: "a transmissibility",
    6: "a coherence",
    7: "an auto correlation",
    8: "a cross correlation",
    9: "a power spectral density",
    10: "an energy spectral density",
    12: "a spectrum",
    24: "a shock response spectrum",
    26: "a multiple coherence",
}

OF_AXES = {8: "m", 18: "Hz", 19: "rpm", 20: "1"}  # data types of abscissas that are not times


def sets_of(path: Path) -> list[dict[str, Any]]:
    """Return the functions (sets 58) of a universal file. Error: WRONG_FORMAT."""
    file = import_extra("pyuff", path.name).UFF(str(path))
    kinds = [int(kind) for kind in file.get_set_types()]
    if 58 not in kinds:
        raise JaxbodyError(
            Problem(
                "WRONG_FORMAT",
                path.name,
                (
                    f"has no function of time or response (set 58), only sets {sorted(set(kinds))}"
                    if kinds
                    else "has no complete set: it is no universal file, or is cut off"
                ),
                kinds,
                "sets 58",
                (
                    "Export responses as functions (set 58)."
                    if kinds
                    else 'Check the extension, or give format="...".'
                ),
            )
        )
    return [file.read_sets(i) for i, kind in enumerate(kinds) if kind == 58]


def _uff_place(s: dict[str, Any], of: str) -> str:
    """Return node and direction, such as "4+Z", of the response (`of` "rsp") or reference
    ("ref")."""
    return f"{int(s[of + '_node'])}{DIRECTIONS.get(int(s[of + '_dir']), '')}"


def _uff_unit(s: dict[str, Any], axis: str) -> str | None:
    unit = str(s.get(f"{axis}_axis_units_lab") or "").strip()
    return None if unit in ("", "NONE") else unit


def _axes(s: dict[str, Any], name: str, path: Path, si: str) -> tuple[np.ndarray, np.ndarray]:
    """Return the axis of a function in SI, and as many of its values as the heading states."""
    where, stated, unit = f"{path.name}['{name}']", int(s["num_pts"]), _uff_unit(s, "abscissa")
    if int(s["func_type"]) == 0:  # a general function, which may be one of frequency or distance
        unit = unit or OF_AXES.get(int(s["abscissa_spec_data_type"]))
    values = stated_number(np.asarray(s["data"]), stated, where)
    return along(np.asarray(s["x"], float)[:stated], unit, si, where), values


def _is(s: dict[str, Any]) -> str:
    kind = int(s["func_type"])
    return f"is {KINDS.get(kind, 'a function')} (function type {kind})"


def read_uff(path: Path, pick: Pick, largest: float) -> Contents:
    """Read functions of time, by node and direction or by a unique id line. Errors: WRONG_FORMAT,
    UNKNOWN_CHANNEL, NOT_A_RECORD, TRUNCATED, RAGGED_LINE."""
    sets = sets_of(path)
    names = distinct([_uff_place(s, "rsp") for s in sets])
    lines = [str(s.get("id1") or "").strip() for s in sets]
    known, often = {"", "NONE", *names}, Counter(lines)
    places = {line: i for i, line in enumerate(lines) if line not in known and often[line] == 1}
    columns = {}
    for asked, name in pick(names, list(places)).items():
        s = sets[names.index(name) if name in names else places[name]]
        if int(s["func_type"]) not in (0, 1) or np.iscomplexobj(s["data"]):
            raise JaxbodyError(
                Problem(
                    "NOT_A_RECORD",
                    path.name,
                    f"'{name}' {_is(s)}, not a function of time",
                    name,
                    "types 0 and 1",
                    (
                        "Export time responses; jb.records.read_responses reads frequency "
                        "responses, and jb.vibration.PSD.from_record makes densities of records."
                    ),
                )
            )
        times, values = _axes(s, name, path, "s")
        columns[asked] = column(values, name, path.name, _uff_unit(s, "ordinate"), times)
    return Contents(columns)


@dataclass
class Response:
    """A frequency response in a file: frequencies [Hz], complex values, units of numerator
    and denominator."""

    frequencies: np.ndarray
    values: np.ndarray
    above: str | None
    below: str | None


def read_uff_responses(path: Any, wanted: list[str], largest: float) -> dict[str, Response]:
    """Read the frequency responses named "response/reference" in a universal file. Errors:
    NOT_A_RESPONSE, UNKNOWN_CHANNEL, those of a file."""
    path = Path(path)
    kind_of(path, "uff", largest)
    with reader_errors(path, "uff"):
        # frequency responses first, with the names that they would have without the others
        sets = sorted(sets_of(path), key=lambda s: int(s["func_type"]) != 4)
        count = sum(int(s["func_type"]) == 4 for s in sets)
        names = [f"{_uff_place(s, 'rsp')}/{_uff_place(s, 'ref')}" for s in sets]
        names, others = distinct(names[:count]), dict(zip(names[count:], sets[count:], strict=True))
        responses = {}
        for asked in wanted:
            if asked in others and asked not in names:
                raise JaxbodyError(
                    Problem(
                        "NOT_A_RESPONSE",
                        path.name,
                        f"'{asked}' {_is(others[asked])}, not a frequency response",
                        asked,
                        "type 4",
                        (
                            "Export frequency responses, H1 or H2 (function type 4); "
                            "jb.vibration.PSD takes a power spectral density as numbers."
                        ),
                    )
                )
            name = find_name(asked, names, path.name)
            s = sets[names.index(name)]
            x, y = _axes(s, name, path, "Hz")
            if not (np.isfinite(x).all() and np.isfinite(y).all() and len(x) == len(y) > 0):
                raise JaxbodyError(
                    Problem(
                        "NOT_A_RESPONSE",
                        path.name,
                        (
                            f"'{asked}' has {len(y)} values at {len(x)} frequencies, or "
                            "values that are not finite"
                        ),
                        len(y),
                        "one finite value each",
                        "Export it again.",
                    )
                )
            responses[asked] = Response(
                x, y.astype(complex), _uff_unit(s, "ordinate"), _uff_unit(s, "orddenom")
            )
    return responses
