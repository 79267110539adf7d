"""Builders: the checked values of a document become objects by the constructors, whose problems get
the lines of the document."""

from __future__ import annotations

import dataclasses
import importlib
import inspect
import json
import re
import warnings
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import equinox as eqx
import numpy as np

from jaxbody.core import units
from jaxbody.core.errors import JaxbodyError, Problem, Problems, unknown
from jaxbody.files.documents import Document, EntryPath, shown
from jaxbody.files.kinds import (
    CLOSURES,
    PLAIN,
    SECTIONS,
    TYPES,
    Argument,
    arguments_of,
    class_of,
    object_schema,
)
from jaxbody.files.quantities import by_name, in_SI, owner, words_of_coupling
from jaxbody.files.schemas import Check
from jaxbody.geometry.closures import Closure, Coupling
from jaxbody.geometry.fields import in_domain, kind_of
from jaxbody.geometry.points_and_orientations import Euler, direction
from jaxbody.model.elements.elements import Element
from jaxbody.model.inputs.base_motions import base_motion
from jaxbody.model.inputs.loads import Load
from jaxbody.model.inputs.motions import Motion, Sampled
from jaxbody.model.inputs.signals import Samples, Signal
from jaxbody.model.joints.joints import Joint
from jaxbody.model.laws.laws import Law, Linear, Sum
from jaxbody.model.laws.tabulated_laws import Table
from jaxbody.model.models import Model
from jaxbody.records.record_files import read_record
from jaxbody.records.records import Record
from jaxbody.sensors.sensors import Sensor

IN_PLACE = ("file", "part")  # entries of a record that are no arguments of read_record
MORE_THAN_A_TURN = r".* rad, more than a turn; if it is in degrees"
PLACE = re.compile(
    r"(bodies|supports|joints|elements|closures|energies|dissipations)\['(.*?)'\]|(gravity)"
)


class Builder:
    """Makes the objects of a document by their constructors."""

    def __init__(
        self, document: Document, values: dict[str, Any], folder: Path, allow: Sequence[str]
    ):
        self.document, self.values, self.folder, self.allow = document, values, folder, allow
        self.problems = Problems()
        # of what is known only when a class of the user's is imported
        self.check = Check(document, self.problems)
        self.with_own_joints: set[str] = set()  # bodies
        self.records: dict[str, Record | None] = {}  # each is read once, when something needs it
        self.files: list[Path] = []  # that are read

    def model(self) -> Model:
        parts: dict[str, Any] = {}
        for name in SECTIONS:
            tables = self.values.get(name, {})
            parts[name] = {
                key: self.thing(value, class_of(name, value.get("type")), (name, key), {})
                for key, value in tables.items()
            }
            if name == "joints":
                self.know_coordinates(parts[name])
        self.problems.raise_if_any()
        if "gravity" in self.values:
            parts["gravity"] = self.values["gravity"]
        model = self.problems.gather(lambda: Model(**parts), self.placed_in_model)
        self.problems.raise_if_any()
        return model

    def know_coordinates(self, joints: dict[str, Joint | None]) -> None:
        """Complete the coordinates that are known by those of joints of the user's own."""
        own, self.check.own_joints = self.check.own_joints, set()
        for body in own:
            joint = joints[body]
            self.check.coordinates |= by_name(body, joint.block(body).q_units) if joint else {}
        self.with_own_joints = own

    def thing(self, values: Any, kind: type | None, path: EntryPath, words: dict[str, str]) -> Any:
        """An object of a class, which the values name where it is not given."""
        if kind is None:
            kind = TYPES.get(values["type"])
        if kind is None:
            kind = self.own(values["type"], path)
            if kind is None:
                return None
            values = self.checked(values, object_schema(kind, values["type"]), path, words)
        if kind is Coupling:
            if {owner(values["of"]), owner(values["by"])} & self.with_own_joints:
                values = self.checked(values, object_schema(kind, values["type"]), path, words)
            words = words_of_coupling(values or {}, self.check.coordinates) or {}
        if values is None:
            return None
        if kind is Table and set(values) != {"type", "x", "forces"}:
            return self.table(values, path)
        given = {
            argument.name: self.value(
                values[argument.name],
                argument,
                (*path, argument.name),
                words | dict(argument.words),
            )
            for argument in arguments_of(kind)
            if argument.name in values
        }
        return (
            None
            if any(x is None for x in given.values())
            else self.gather(path, kind.__name__, lambda: _made(kind, given))
        )

    def value(self, value: Any, argument: Argument, path: EntryPath, words: dict[str, str]) -> Any:
        if argument.role == "law":
            law = self.law(value, path, words)
            # a number would be its ratio
            return Linear(law) if argument.name == "function" and isinstance(law, float) else law
        if argument.role == "signal":
            return self.signal(value, path, words)
        if argument.role == "pulse":
            return self.thing(value, None, path, words)
        if argument.role == "end":
            return value if isinstance(value, str) else tuple(value)
        if isinstance(value, dict):
            return self.problems.gather(lambda: Euler(value["sequence"], value["angles"]))
        return tuple(value) if argument.role == "words" else value

    def checked(
        self, values: Any, node: dict[str, Any], path: EntryPath, words: dict[str, str]
    ) -> Any:
        """Values that the check of the document left as they are, in SI; None with a problem."""
        before = len(self.problems.collected)
        values = self.check.value(values, node, path, words)
        return values if len(self.problems.collected) == before else None

    def law(self, value: Any, path: EntryPath, words: dict[str, str]) -> Any:
        if isinstance(value, list):
            terms = [self.law(x, (*path, i), words) for i, x in enumerate(value)]
            return (
                None
                if any(term is None for term in terms)
                else self.problems.gather(lambda: Sum(*terms))
            )
        return self.thing(value, None, path, words) if isinstance(value, dict) else value

    def signal(self, value: Any, path: EntryPath, words: dict[str, str]) -> Any:
        """Three numbers, or a signal; samples are a channel of a record."""
        if not isinstance(value, dict) or value["type"] != "Samples":
            return self.thing(value, None, path, words) if isinstance(value, dict) else value
        unit = units.parse(words["value"], "signal").dimension
        kind = {"kind": value["kind"]} if "kind" in value else {}
        return self.of_record(
            value,
            path,
            lambda record, x: Samples(record.times, self.rows(record, x, "channel", unit), **kind),
        )

    def motion(self, value: Any, path: EntryPath) -> Any:
        """A motion by its constructor, or of channels of a record."""
        made = {"Sampled": self.sampled, "base_motion": self.base_motion}.get(value["type"])
        return (
            self.thing(value, None, path, {}) if made is None else self.of_record(value, path, made)
        )

    def of_record(self, value: dict[str, Any], path: EntryPath, make: Any) -> Any:
        """What `make` makes of a record and these values."""
        record = self.record(value["record"])
        return (
            None
            if record is None
            else self.gather(path, value["type"], lambda: make(record, value))
        )

    def record(self, name: str) -> Record | None:
        if name not in self.records:
            path: EntryPath = ("records", name)
            self.records[name] = self.gather(
                path, "", lambda: self._read(self.values["records"][name], path)
            )
        return self.records[name]

    def _read(self, values: dict[str, Any], path: EntryPath) -> Record | None:
        file = self.beside(values["file"], (*path, "file"))
        columns = {name: _column(spec) for name, spec in values["channels"].items()}
        options = {
            name: value
            for name, value in values.items()
            if name not in (*IN_PLACE, "channels", "time")
        }
        time = {"time": _column(values["time"])} if "time" in values else {}
        record = file and self.problems.gather(
            lambda: read_record(file, channels=columns, **time, **options),
            lambda problem: self._of_column(problem, values, path),
        )
        return record if record is None or "part" not in values else record.part(*values["part"])

    def _of_column(self, problem: Problem, values: dict[str, Any], path: EntryPath) -> Problem:
        """A problem of reading a record, at its line; where a unit is missing, at that of the
        column, with what to write there."""
        names: dict[str, EntryPath] = {".times": ("time",)}
        names |= {f"['{name}']": ("channels", name) for name in values["channels"]}
        entry = next(
            (
                entry
                for end, entry in names.items()
                if problem.code == "NO_UNIT" and problem.where.endswith(end)
            ),
            None,
        )
        if entry is None:
            return self.placed(problem, path, "")
        spec = values["time"] if entry == ("time",) else values["channels"][entry[-1]]
        column, example = (
            (spec["columns"] if isinstance(spec, dict) else spec),
            "ms" if entry == ("time",) else "m/s2",
        )
        written = (
            f"{shown(entry)} = {{columns = {json.dumps(column, ensure_ascii=False)}, "
            f'unit = "{example}"}}'
        )
        without = "" if entry == ("time",) else ', or unit = "1" for numbers without one'
        hint = f"Write {written} with its unit{without}."
        return dataclasses.replace(problem, where=self.document.where((*path, *entry)), hint=hint)

    def sampled(self, record: Record, value: dict[str, Any]) -> Motion:
        dimensions = {"translation": units.LENGTH, "rotation": units.ANGLE}
        rows = {
            name: self.rows(record, value, name, of)
            for name, of in dimensions.items()
            if name in value
        }
        return Sampled(record.times, **rows)

    def base_motion(self, record: Record, value: dict[str, Any]) -> Motion:
        options = {
            name: x
            for name, x in value.items()
            if name not in ("type", "record", "acceleration", "axis")
        }
        axis = {"axis": _direction(value)} if "axis" in value else {}
        return base_motion(record, value["acceleration"], **axis, **options).motion

    def rows(
        self, record: Record, value: dict[str, Any], name: str, dimension: units.Dimension
    ) -> np.ndarray:
        """A channel of three columns, or of one along the `axis`. Errors: UNKNOWN_CHANNEL,
        WRONG_DIMENSION, BAD_SHAPE."""
        x, unit = record[value[name]], record.units[value[name]]
        si, quaternion = units.si_words(dimension), dimension == units.ANGLE and x.shape[1:] == (4,)
        if unit not in (("", "1") if quaternion else (si,)):
            raise JaxbodyError(
                Problem(
                    "WRONG_DIMENSION",
                    f".{name}",
                    f"is the channel '{value[name]}', which is in {unit}",
                    unit,
                    si,
                    "Name another channel.",
                )
            )
        if "axis" in value and x.ndim == 1:
            return x[:, None] * _direction(value)
        if x.ndim == 1:
            raise JaxbodyError(
                Problem(
                    "BAD_SHAPE",
                    f".{name}",
                    f"is the channel '{value[name]}' of one column",
                    x.shape,
                    "three",
                    'Name the direction of its one column: axis = "z".',
                )
            )
        return x

    def table(self, values: dict[str, Any], path: EntryPath) -> Any:
        """The measured curve in a file beside the document."""
        name = values.get("file")
        if name is None or {"x", "forces"} & set(values):
            self.problems.add(
                "MISSING_ENTRY",
                self.document.where(path),
                "needs either points or a file",
                limit="one of them",
                hint='Give x = [...] and forces = [...], or file = "curve.csv".',
            )
            return None
        file = self.beside(name, (*path, "file"))
        return None if file is None else self.gather((*path, "file"), "", lambda: Table.read(file))

    def beside(self, name: str, path: EntryPath) -> Path | None:
        """A file in the folder of the document."""
        if not (Path(name).is_absolute() or ".." in Path(name).parts):
            self.files.append(self.folder / name)
            return self.files[-1]
        where, hint = self.document.where(path), "Put it beside the model file."
        self.problems.add(
            "OUTSIDE_FOLDER",
            where,
            f"names '{name}'",
            value=name,
            limit="a file in the folder of this one",
            hint=hint,
        )
        return None

    def quantity(self, value: Any, unit: str, path: EntryPath) -> Any:
        """Numbers in SI, whose unit the schema does not know."""
        return in_SI(value, unit, {}, self.check.system, self.document.where(path), self.problems)

    def unknown(self, name: str, known: Iterable[str], path: EntryPath) -> None:
        self.problems.collected.append(unknown(name, self.document.where(path), tuple(known)))

    def measurement(self, kind: Any, given: dict[str, Any], model: Model, path: EntryPath) -> Any:
        """A measurement by its constructor, if it fits the model."""
        made = self.gather(path, kind.__name__, lambda: kind(**given))
        if made is not None:
            self.gather(path, "", lambda: made.check(model, ""))
        return made

    def gather(self, path: EntryPath, kind: str, make: Callable[[], Any]) -> Any:
        """What `make` returns; None with its problems, at their lines, where it fails. It does not
        warn of large angles, whose unit the document states."""
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", message=MORE_THAN_A_TURN)
            return self.problems.gather(make, lambda problem: self.placed(problem, path, kind))

    def own(self, name: str, path: EntryPath) -> type | None:
        """A class of the user's from a module that is allowed."""
        kind = self.own_object(name, path)
        if kind is None or (
            inspect.isclass(kind)
            and issubclass(kind, Element | Joint | Closure | Law | Load | Sensor | Signal)
        ):
            return kind
        if (
            path[0] in ("energies", "dissipations")
            and inspect.isclass(kind)
            and issubclass(kind, eqx.Module)
        ):
            return kind
        self.problems.add(
            "UNKNOWN_NAME",
            self.document.where((*path, "type")),
            (
                f"names '{name}', which is no element, joint, closure, law, load, motion, sensor "
                "or equinox.Module of energies"
            ),
            value=name,
        )
        return None

    def own_object(self, name: str, path: EntryPath) -> Any:
        """What "module:name" is in a module that is allowed; None with a problem."""
        module, _, attribute = name.partition(":")
        where = self.document.where((*path, "type"))
        if module not in self.allow:
            self.problems.add(
                "NOT_ALLOWED",
                where,
                f"names the module '{module}'",
                value=name,
                limit=str(list(self.allow)),
                hint=f"If you trust it, give allow=['{module}'].",
            )
            return None
        try:
            found = getattr(importlib.import_module(module), attribute, None)
        except ImportError as error:
            self.problems.add(
                "UNKNOWN_NAME",
                where,
                f"names the module '{module}', which cannot be imported: {error}",
                value=name,
            )
            return None
        if found is None:
            self.problems.add(
                "UNKNOWN_NAME",
                where,
                f"names '{name}', and the module has no '{attribute}'",
                value=name,
            )
        return found

    def placed(self, problem: Problem, path: EntryPath, kind: str) -> Problem:
        """The problem of a constructor, at its line."""
        rest = problem.where.removeprefix(kind)
        found = re.match(r"\.(\w+)", rest)
        if found and (*path, found[1]) in self.document.lines:
            path, rest = (*path, found[1]), rest[found.end() :]
        rest = f": {rest}" if rest and rest[0] not in ",.[ " else rest
        words = {"limit": in_words_of_files(problem.limit), "hint": in_words_of_files(problem.hint)}
        return dataclasses.replace(problem, where=self.document.where(path) + rest, **words)

    def placed_in_model(self, problem: Problem) -> Problem:
        """A problem that the model as a whole has, at its line."""
        found = PLACE.match(problem.where)
        path = tuple(part for part in found.groups() if part) if found else ()
        rest = problem.where[found.end() :] if found else f" {problem.where}"
        return dataclasses.replace(problem, where=self.document.where(path) + rest)


def in_words_of_files(text: str) -> str:
    """A text about arguments of Python, as they are written in a file: `irregular = true` for
    `irregular=True`, `rate` for `rate=`."""
    text = re.sub(r"\b(\w+)=\((\"\w+\"), (\"[^\"]+\")\)", r"\1 = {columns = \2, unit = \3}", text)
    text = re.sub(r"\b(\w+)=(True|False)\b", lambda found: f"{found[1]} = {found[2].lower()}", text)
    text = re.sub(r"\b(\w+)=(?=[\"\d\[{-])", r"\1 = ", text)
    return re.sub(r"\b(\w+)=(?=[\s,.;)]|$)", r"\1", text)


def _made(kind: type, given: dict[str, Any]) -> Any:
    """An object by its constructor. The constructor of a user's class may check nothing: numbers
    become arrays, and are checked."""
    if kind in (*TYPES.values(), *CLOSURES, *PLAIN.values()):
        return kind(**given)
    numbers = {each.name for each in arguments_of(kind) if each.role == "number"}
    made = kind(
        **{
            name: np.asarray(value, float) if name in numbers else value
            for name, value in given.items()
        }
    )
    with Problems() as problems:
        for name in numbers & set(given):
            in_domain(getattr(made, name), kind_of(made, name), f"{kind.__name__}.{name}", problems)
    return made


def _column(spec: Any) -> Any:
    """A column as `read_record` takes it."""
    return (spec["columns"], spec.get("unit")) if isinstance(spec, dict) else spec


def _direction(values: dict[str, Any]) -> np.ndarray:
    with Problems() as problems:
        axis = direction(values["axis"], ".axis", problems)
    return np.asarray(axis)
