"""Update of numbers in a model file: each is replaced in its entry, in the unit used there.
Comments and the order of entries are kept."""

import json
import math
import re
from pathlib import Path
from typing import Any

import jax
import numpy as np
import tomlkit

from jaxbody.core import units
from jaxbody.core.errors import Problems
from jaxbody.core.source_files import replacing, writing
from jaxbody.files.documents import Document, EntryPath
from jaxbody.files.kinds import arguments_of, class_of
from jaxbody.files.model_files import json_of, numbers_of
from jaxbody.files.quantities import NUMBERS, UnitSystem, times, unit_system
from jaxbody.fitting.parameters.spaces import Space, units_of
from jaxbody.model.bodies import Body

POINT = "point"  # last key of the path of an attachment point


def update(path: Path, document: Document, space: Space, trees: dict[str, Any]) -> list[str]:
    """Write the values of free parameters into a file; `trees`: the model as "" and the experiments
    by name, with these values. Return the paths of parameters that have no entry in the file, such
    as the gain of a sensor in one of several experiments. Error: NOT_SAVED."""
    text, is_toml, left = path.read_text(encoding="utf-8"), path.suffix == ".toml", []
    content: Any = tomlkit.parse(text) if is_toml else json.loads(text)
    system = unit_system(document.values.get("units"), "units", Problems())
    for run, leaf in (place for parameter in space.parameters for place in parameter.places):
        find = _run_place if run else _place
        place = find(document.values, leaf.path)
        if place is None:
            left.append(leaf.path)
            continue
        value = np.asarray(leaf.read(jax.tree.leaves(trees[run])))
        _set(content, place, value, units_of(leaf, space.model, value), system)
    with writing(path), replacing(path) as new:
        new.write_text(tomlkit.dumps(content) if is_toml else json_of(content), encoding="utf-8")
    return left


def _run_place(values: dict[str, Any], path: str) -> EntryPath | None:
    """Return the path of the entry of an initial state, "run1.initial.v", or of a loss factor,
    "hammer.loss_factor.all"; None for other parameters of an experiment."""
    run, part, *rest = path.split(".")
    if isinstance(values["experiments"][run].get(part), dict) and part in (
        "initial",
        "loss_factor",
    ):
        return ("experiments", run, part, *rest)
    return ("experiments", run, part) if part == "loss_factor" else None


def _place(values: dict[str, Any], path: str) -> EntryPath | None:
    """Return the path of the entry of a number of the model, "left.spring.terms.0.coefficient";
    None for a number in another file."""
    name, *parts = path.split(".")
    if not parts:
        return (name,)
    of_body = parts[0] in {argument.field for argument in arguments_of(Body)}
    carriers = ("bodies", "supports") if of_body else ("joints",)
    sections = (*carriers, "elements", "closures", "controllers", "energies", "dissipations")
    section = next(section for section in sections if name in values.get(section, {}))
    table = values[section][name]
    kind = class_of(section, table.get("type"))
    arguments = arguments_of(kind) if kind else ()
    ends = dict(zip("abc", (each.name for each in arguments if each.role == "end"), strict=False))
    if parts[0] in ends:
        return (section, name, ends[parts[0]], POINT)
    place: EntryPath = (
        section,
        name,
        next((each.name for each in arguments if parts[0] == each.field), parts[0]),
    )
    node = table.get(place[-1])
    for part in parts[1:]:
        if isinstance(node, list):
            if part != "terms":
                place, node = (*place, int(part)), node[int(part)]
        elif isinstance(node, dict):
            if "file" in node:
                return None
            place, node = (*place, part), node.get(part)
    return place


def _set(
    content: Any, place: EntryPath, value: np.ndarray, si: list[str], system: UnitSystem | None
) -> None:
    """Set the entry at a path to a value in SI, in the units of its old value; `si`: SI units of
    its numbers."""
    *keys, last = place if place[-1] != POINT else place[:-1]
    for key in keys:
        content = content[key]
    old = content[last] if isinstance(last, int) else content.get(last)
    if place[-1] == POINT:  # an end is a name, or a name and a point
        name, point = (old, None) if isinstance(old, str) else old
        content[last] = [name, _written(value, point, si, system)]
    else:
        content[last] = _written(value, old, si, system)


def _written(value: np.ndarray, old: Any, si: list[str], system: UnitSystem | None) -> Any:
    """Return numbers given in SI in the form and the units of the old ones."""
    match = NUMBERS.match(old.strip()) if isinstance(old, str) else None
    count = (
        len(re.findall(r"[^\s,;()\[\]]+", match.group()))
        if match
        else np.size(old)
        if isinstance(old, list)
        else 1
    )
    if value.ndim == 2 and count == len(value) and np.array_equal(value, np.diag(np.diag(value))):
        value, si = np.diag(value), [*np.reshape(si, value.shape).diagonal()]
    same_length = isinstance(old, list) and value.ndim and len(old) == len(value)
    if same_length or value.ndim > 1:
        rows = np.reshape(si, (len(value), -1)).tolist()
        olds = old if same_length else [None] * len(value)
        return [
            _written(x, each, row, system) for x, each, row in zip(value, olds, rows, strict=True)
        ]
    stated = match and str(old).strip()[match.end() :].strip()
    if stated:
        return _text(value, stated, units.parse(stated, "unit").factor)
    if not any(si) or not value.any():  # zero needs no unit
        return numbers_of(value)
    if (
        system is not None
        and isinstance(old, int | float | list | str)
        and all(system.states(unit or "1") for unit in si)
    ):
        numbers = [
            _number(x, system.factor(unit or "1"))
            for x, unit in zip(value.ravel().tolist(), si, strict=True)
        ]
        return numbers if value.ndim else numbers[0]
    return (
        _text(value, si[0], 1.0)
        if len(set(si)) == 1
        else [_text(x, unit, 1.0) for x, unit in zip(value, si, strict=True)]
    )


def _text(value: np.ndarray, unit: str, factor: float) -> str:
    """Return numbers given in SI as text with a unit; `factor`: the unit in SI units."""
    return f"{', '.join(repr(_number(x, factor)) for x in value.ravel().tolist())} {unit}"


def _number(value: float, factor: float) -> float:
    """Return the number whose product with the factor of a unit is exactly `value` (SI), as it is
    when the file is read; if there is no such number, the nearest."""
    near = value / factor
    around = (near, math.nextafter(near, math.inf), math.nextafter(near, -math.inf))
    return next((x for x in around if times(x, factor) == value), near)
