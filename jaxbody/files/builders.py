"""Builders: make objects from the checked values of a document with their constructors; problems
that the constructors report get the line numbers of the document."""

from __future__ import annotations

import dataclasses
import importlib
import inspect
import json
import re
import warnings
from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Iterable, Sequence
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
from jaxbody.geometry.points_and_orientations import EulerAngles, direction
from jaxbody.model.elements.elements import Element
from jaxbody.model.forces.controllers import ControlLaw
from jaxbody.model.forces.force_elements import ForceElement
from jaxbody.model.inputs.base_motions import base_motion
from jaxbody.model.inputs.motions import Motion, Sampled
from jaxbody.model.inputs.signals import Samples, Signal
from jaxbody.model.joints.joints import Joint
from jaxbody.model.laws.laws import Law, Linear, Sum
from jaxbody.model.laws.tabulated_laws import Tabulated
from jaxbody.model.models import Model
from jaxbody.records.record_files import read_record
from jaxbody.records.records import Record
from jaxbody.sensors.sensors import Sensor

MORE_THAN_A_TURN = r".* rad, more than a turn; if it is in degrees"
PLACE = re.compile(rf"({'|'.join(SECTIONS)})\['(.*?)'\]|(gravity)")


@dataclasses.dataclass
class EntryBuilder(ABC):
    """Base class of builders of one entry of a study, from its `values` and its `path` in the
    document; problems are collected by `builder`, the builder of the document."""

    builder: Builder
    model: Model
    sensors: dict[str, Sensor]
    values: dict[str, Any]
    path: EntryPath

    def __post_init__(self) -> None:
        self.before = len(self.builder.problems.collected)

    @property
    def failed(self) -> bool:
        """Whether this entry has problems already, so that its constructor need not be called."""
        return len(self.builder.problems.collected) > self.before

    def add(
        self,
        code: str,
        message: str,
        *parts: str,
        value: Any = None,
        limit: str = "",
        hint: str = "",
    ) -> None:
        """Add a problem of the entry; `parts` are the keys below the path of the entry."""
        where = self.builder.document.where((*self.path, *parts))
        self.builder.problems.add(code, where, message, value=value, limit=limit, hint=hint)

    @abstractmethod
    def build(self) -> Any:
        """Build the object that the entry states, or the arguments of a function; problems are
        collected."""

    def check_known(self, names: Iterable[str], known: Collection[str], *parts: str) -> None:
        """Add a problem for each of the `names` that is not among the `known` ones; `parts` are the
        keys from the entry to the names."""
        for name in names:
            if name not in known:
                self.builder.unknown(name, known, (*self.path, *parts, name))


class Builder:
    """Builder of the objects of a document by their constructors."""

    def __init__(
        self, document: Document, values: dict[str, Any], folder: Path, allow: Sequence[str]
    ):
        self.document, self.values, self.folder, self.allow = document, values, folder, allow
        self.problems = Problems()
        # for entries that can be checked only after a user-defined class is imported
        self.check = Check(document, self.problems)
        self.with_own_joints: set[str] = set()  # bodies with joints of user-defined classes
        self.records: dict[str, Record | None] = {}  # each is read when first needed
        self.files: list[Path] = []  # paths of curves and records

    def model(self) -> Model:
        parts: dict[str, Any] = {}
        for name in SECTIONS:
            parts[name] = {
                key: self.thing(value, class_of(name, value.get("type")), (name, key), {})
                for key, value in self.values.get(name, {}).items()
            }
            if name == "joints":
                self.know_coordinates(parts[name])
        self.problems.raise_if_any()
        if "gravity" in self.values:
            parts["gravity"] = self.values["gravity"]
        with self.problems:
            return self.problems.gather(lambda: Model(**parts), self.placed_in_model)

    def know_coordinates(self, joints: dict[str, Joint | None]) -> None:
        """Add the units of the coordinates of joints of user-defined classes, once these joints are
        built."""
        self.with_own_joints, self.check.own_joints = self.check.own_joints, set()
        for body in self.with_own_joints:
            joint = joints[body]
            self.check.coordinates |= by_name(body, joint.block(body).q_units) if joint else {}

    def thing(self, values: Any, kind: type | None, path: EntryPath, words: dict[str, str]) -> Any:
        """Build an object of the class `kind`, or, if this is None, of the class that the entry
        `type` names. Return None if there are problems."""
        kind = kind or TYPES.get(values["type"])
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
        if kind is Tabulated and set(values) != {"type", "x", "forces"}:
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
        match argument.role:
            case "law":
                law = self.law(value, path, words)
                if argument.name == "function" and isinstance(law, float):
                    return Linear(law)  # Coupling takes a bare number as its ratio
                return law
            case "signal":
                return self.signal(value, path, words)
            case "pulse" | "control_law":
                return self.thing(value, None, path, words)
            case "sensors":
                return {name: self.thing(x, None, (*path, name), {}) for name, x in value.items()}
            case "end":
                return value if isinstance(value, str) else tuple(value)
            case "words":
                return tuple(value)
            case _ if isinstance(value, dict):
                return self.problems.gather(lambda: EulerAngles(value["sequence"], value["angles"]))
        return value

    def checked(
        self, values: Any, node: dict[str, Any], path: EntryPath, words: dict[str, str]
    ) -> Any:
        """Check values that were not checked with the document, because they depend on a
        user-defined class, and return them in SI; return None if there are problems."""
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
        """Return three numbers, or a signal; a signal of the type "Samples" is made from a channel
        of a record."""
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
        """Build a motion by its constructor, or from channels of a record."""
        made = {"Sampled": self.sampled, "base_motion": self.base_motion}.get(value["type"])
        return (
            self.thing(value, None, path, {}) if made is None else self.of_record(value, path, made)
        )

    def of_record(self, value: dict[str, Any], path: EntryPath, make: Any) -> Any:
        """Return `make(record, value)`, where the entry `record` of `value` names the record;
        return None if there are problems."""
        record = self.record(value["record"])
        return record and self.gather(path, value["type"], lambda: make(record, value))

    def record(self, name: str) -> Record | None:
        if name not in self.records:
            path: EntryPath = ("records", name)
            self.records[name] = self.gather(
                path, "", lambda: self._read(self.values["records"][name], path)
            )
        return self.records[name]

    def _read(self, values: dict[str, Any], path: EntryPath) -> Record | None:
        file = self.beside(values["file"], (*path, "file"))
        options = {
            name: _column(value) if name == "time" else value
            for name, value in values.items()
            if name not in ("file", "part")
        }
        options["channels"] = {name: _column(spec) for name, spec in values["channels"].items()}
        record = file and self.problems.gather(
            lambda: read_record(file, **options),
            lambda problem: self._of_column(problem, values, path),
        )
        return record if record is None or "part" not in values else record.part(*values["part"])

    def _of_column(self, problem: Problem, values: dict[str, Any], path: EntryPath) -> Problem:
        """Return a problem of reading a record with its line of the document as location. For a
        missing unit this is the line of the column, and the hint says how to state the unit
        there."""
        names = [name for name in values["channels"] if problem.where.endswith(f"['{name}']")]
        of_time = problem.where.endswith(".times")
        if problem.code != "NO_UNIT" or not (names or of_time):
            return self.placed(problem, path, "")
        entry = ("time",) if of_time else ("channels", names[0])
        spec = values["time"] if of_time else values["channels"][names[0]]
        column = json.dumps(spec["columns"] if isinstance(spec, dict) else spec, ensure_ascii=False)
        unit, else_ = ("ms", "") if of_time else ("m/s2", ', or unit = "1" for numbers without one')
        hint = (
            f'Write {shown(entry)} = {{columns = {column}, unit = "{unit}"}} with its unit{else_}.'
        )
        return dataclasses.replace(problem, where=self.document.where((*path, *entry)), hint=hint)

    def sampled(self, record: Record, value: dict[str, Any]) -> Motion:
        rows = {
            name: self.rows(record, value, name, dimension)
            for name, dimension in (("translation", units.LENGTH), ("rotation", units.ANGLE))
            if name in value
        }
        return Sampled(record.times, **rows)

    def base_motion(self, record: Record, value: dict[str, Any]) -> Motion:
        options: dict[str, Any] = {
            name: _direction(value) if name == "axis" else x
            for name, x in value.items()
            if name not in ("type", "record")
        }
        return base_motion(record, **options).motion

    def rows(
        self, record: Record, value: dict[str, Any], name: str, dimension: units.Dimension
    ) -> np.ndarray:
        """Return the samples of a channel of three columns, or of one column along the `axis`.
        Errors: UNKNOWN_CHANNEL, WRONG_DIMENSION, BAD_SHAPE."""
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
        """Read a measured force curve from a file in the folder of the document; return None if
        there are problems."""
        if "file" not in values or {"x", "forces"} & set(values):
            self.problems.add(
                "MISSING_ENTRY",
                self.document.where(path),
                "needs either points or a file",
                limit="one of them",
                hint='Give x = [...] and forces = [...], or file = "curve.csv".',
            )
            return None
        file = self.beside(values["file"], (*path, "file"))
        return file and self.gather((*path, "file"), "", lambda: Tabulated.read(file))

    def beside(self, name: str, path: EntryPath) -> Path | None:
        """Return the path of a file in the folder of the document; for a file elsewhere, add a
        problem and return None."""
        if not (Path(name).is_absolute() or ".." in Path(name).parts):
            self.files.append(self.folder / name)
            return self.files[-1]
        self.problems.add(
            "OUTSIDE_FOLDER",
            self.document.where(path),
            f"names '{name}'",
            value=name,
            limit="a file in the folder of this one",
            hint="Put it beside the model file.",
        )
        return None

    def quantity(self, value: Any, unit: str, path: EntryPath) -> Any:
        """Convert numbers whose unit the schema cannot state to SI."""
        return in_SI(value, unit, {}, self.check.system, self.document.where(path), self.problems)

    def unknown(self, name: str, known: Iterable[str], path: EntryPath) -> None:
        self.problems.collected.append(unknown(name, self.document.where(path), tuple(known)))

    def measurement(self, kind: Any, given: dict[str, Any], model: Model, path: EntryPath) -> Any:
        """Build a measurement by its constructor and check that it fits the model."""
        made = self.gather(path, kind.__name__, lambda: kind(**given))
        if made is not None:
            self.gather(path, "", lambda: made.check(model, ""))
        return made

    def gather(self, path: EntryPath, kind: str, make: Callable[[], Any]) -> Any:
        """Return the result of `make`; if it fails, add its problems at their lines and return
        None. Warnings of large angles are suppressed, as the document states their unit."""
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", message=MORE_THAN_A_TURN)
            return self.problems.gather(make, lambda problem: self.placed(problem, path, kind))

    def own(self, name: str, path: EntryPath) -> type | None:
        """Import a user-defined class from an allowed module; if that fails, add a problem and
        return None."""
        kind = self.own_object(name, path)
        bases = Element | ForceElement | Joint | Closure | Law | ControlLaw | Sensor | Signal
        if path[0] in ("energies", "dissipations"):
            bases |= eqx.Module
        if kind is None or (inspect.isclass(kind) and issubclass(kind, bases)):
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
        """Import the object "module:name" from an allowed module; if that fails, add a problem and
        return None."""
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
        message = f"names '{name}', and the module has no '{attribute}'"
        try:
            named = getattr(importlib.import_module(module), attribute, None)
        except ImportError as error:
            named = None
            message = f"names the module '{module}', which cannot be imported: {error}"
        if named is None:
            self.problems.add("UNKNOWN_NAME", where, message, value=name)
        return named

    def placed(self, problem: Problem, path: EntryPath, kind: str) -> Problem:
        """Return a problem that the constructor of the class `kind` reports, with its line of the
        document as location."""
        rest = problem.where.removeprefix(kind)
        entry = re.match(r"\.(\w+)", rest)
        if entry and (*path, entry[1]) in self.document.lines:
            path, rest = (*path, entry[1]), rest[entry.end() :]
        rest = f": {rest}" if rest and rest[0] not in ",.[ " else rest
        return dataclasses.replace(
            problem,
            where=self.document.where(path) + rest,
            limit=in_words_of_files(problem.limit),
            hint=in_words_of_files(problem.hint),
        )

    def placed_in_model(self, problem: Problem) -> Problem:
        """Return a problem that the constructor of Model reports, with its line of the document as
        location."""
        place = PLACE.match(problem.where)
        path = tuple(filter(None, place.groups())) if place else ()
        rest = problem.where[place.end() :] if place else f" {problem.where}"
        return self.placed(dataclasses.replace(problem, where=rest), path, "")


def in_words_of_files(text: str) -> str:
    """Rewrite a text about Python arguments as they are written in a file: `irregular = true` for
    `irregular=True`, `rate` for `rate=`."""
    text = re.sub(r"\b(\w+)=\((\"\w+\"), (\"[^\"]+\")\)", r"\1 = {columns = \2, unit = \3}", text)
    text = re.sub(r"\b(\w+)=(True|False)\b", lambda match: f"{match[1]} = {match[2].lower()}", text)
    text = re.sub(r"\b(\w+)=(?=[\"\d\[{-])", r"\1 = ", text)
    return re.sub(r"\b(\w+)=(?=[\s,.;)]|$)", r"\1", text)


def _made(kind: type, given: dict[str, Any]) -> Any:
    """Call a constructor. As that of a user-defined class may check nothing, its numbers are
    converted to arrays and checked here."""
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
    """Return the specification of a column as `read_record` accepts it."""
    return (spec["columns"], spec.get("unit")) if isinstance(spec, dict) else spec


def _direction(values: dict[str, Any]) -> np.ndarray:
    with Problems() as problems:
        axis = direction(values["axis"], ".axis", problems)
    return np.asarray(axis)
