"""Models in TOML and JSON files: `read_model` builds a model with the constructors, `write_model`
writes every number exactly, as the values of a document in SI."""

import dataclasses
import inspect
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import numpy as np
import tomlkit

from jaxbody.core.arrays import is_concrete
from jaxbody.core.errors import JaxbodyError, Problem, Problems
from jaxbody.core.source_files import extension_of, writing
from jaxbody.core.units import si_words
from jaxbody.files.builders import Builder
from jaxbody.files.documents import LARGEST, read_document
from jaxbody.files.kinds import (
    CLOSURES,
    PLAIN,
    SECTIONS,
    TYPES,
    Argument,
    arguments_of,
    definition_of,
)
from jaxbody.files.quantities import coordinate_units, dimension, words_of_coupling
from jaxbody.files.schemas import VERSION, checked_values, schema
from jaxbody.geometry.closures import Equation
from jaxbody.geometry.points_and_orientations import IDENTITY
from jaxbody.model.elements.bushings import FramePair
from jaxbody.model.forces.controllers import ControlLaw
from jaxbody.model.inputs.signals import Constant, Sine
from jaxbody.model.joints.joints import Free
from jaxbody.model.laws.laws import Function, Law, Linear, Sum
from jaxbody.model.layouts import WORLD
from jaxbody.model.models import Model, refuse_batch
from jaxbody.model.storage import with_attributes

IN_LINE = 8  # largest number of items of an array in one line
SMALL = 3  # largest number of rows of a matrix in one line
SHORT = ("supports", "joints")  # sections whose objects take one line each
NOT_IN_FILES = "A file holds numbers and names only."


def values_of(model: Model, allow: Sequence[str] = ()) -> dict[str, Any]:
    """Return the values of a document that states a model, in SI; `allow`: modules whose classes
    may be named."""
    if not is_concrete(model):
        raise JaxbodyError(
            Problem(
                "TRACED",
                "write_model",
                "cannot be called inside jit, vmap or grad",
                hint="Write the result of the program.",
            )
        )
    refuse_batch(model, "write_model")
    parts, writer = model.parts(), Writer(allow)
    parts["elements"] = {name: _as_given(model, name) for name in parts["elements"]}
    parts["controllers"] = {
        name: with_attributes(x, {"reads": {each: x.reads[each] for each in x.order}})
        for name, x in parts["controllers"].items()
    }
    parts["joints"] = {
        name: joint
        for name, joint in parts["joints"].items()
        if not (type(joint) is Free and joint.parent == "world")
    }
    values = {"jaxbody": VERSION, "units": "SI", "gravity": numbers_of(model.gravity)}
    with writer.problems:
        return values | {
            name: {key: writer.table(x, f"{name}.{key}") for key, x in parts[name].items()}
            for name in SECTIONS
            if parts[name]
        }


def _as_given(model: Model, name: str) -> Any:
    """Return an element, without the orientation of its second frame if that follows exactly from
    the reference pose."""
    element = model[name]
    if not issubclass(type(element), FramePair):
        return element
    plain = eqx.tree_at(
        lambda m: (m.orientation, m.orientation_b),
        element,
        (np.asarray(numbers_of(element.orientation)), None),
    )
    turns = (
        np.asarray(numbers_of(model[end].orientation) if end != WORLD else IDENTITY)
        for end in element.between
    )
    if _same(element.orientation_b, plain.as_drawn(*turns).orientation_b):
        return eqx.tree_at(lambda m: m.orientation_b, element, None)
    return element


class Writer:
    """Writer of objects as tables of their arguments, without those equal to the defaults of the
    constructor."""

    def __init__(self, allow: Sequence[str]):
        self.allow, self.problems = allow, Problems()

    def type_of(self, thing: Any, where: str) -> str:
        """Return the name of an object's class in a file."""
        kind = type(thing)
        if kind in (*TYPES.values(), *CLOSURES):
            return kind.__name__
        if (
            isinstance(thing, Function | Equation | jax.tree_util.Partial)
            or "<locals>" in kind.__qualname__
        ):
            what = "function" if kind is jax.tree_util.Partial else kind.__name__
            self.problems.add(
                "OWN_CODE",
                where,
                f"is a {what} of your own Python",
                value=thing,
                hint=(
                    f"{NOT_IN_FILES} Write a class in a module of yours, and name the "
                    "module in allow=[...]."
                ),
            )
        elif kind.__module__ not in self.allow:
            self.problems.add(
                "NOT_ALLOWED",
                where,
                f"is a {kind.__name__} from {kind.__module__}",
                value=thing,
                hint=f"Give allow=['{kind.__module__}'] here and to read_model.",
            )
        return f"{kind.__module__}:{kind.__qualname__}"

    def table(self, thing: Any, where: str) -> dict[str, Any]:
        """Return the table of an object."""
        values: dict[str, Any] = (
            {} if type(thing) in PLAIN.values() else {"type": self.type_of(thing, where)}
        )
        points = getattr(thing, "points", ()) or [getattr(thing, end, None) for end in "ab"]
        ends = zip(getattr(thing, "between", ()), map(numbers_of, points), strict=False)
        for argument in arguments_of(type(thing)) if dataclasses.is_dataclass(thing) else ():
            if argument.role == "end":
                values[argument.name] = list(next(ends))
            else:
                value = getattr(thing, argument.field, None)
                value = value.value if isinstance(value, Constant) else value
                if not (value is None or _same(value, argument.default) or np.size(value) == 0):
                    values[argument.name] = self.value(value, argument, f"{where}.{argument.name}")
        return values

    def value(self, value: Any, argument: Argument, where: str) -> Any:
        """Return the value of an argument in a file."""
        if isinstance(value, Law | Sine | ControlLaw):
            return self.law(value, where)
        if argument.role == "sensors":
            return {name: self.table(x, f"{where}.{name}") for name, x in value.items()}
        if argument.role in ("frame", "element", "coordinate", "word", "whole", "flag"):
            return value
        if argument.role in ("words", "elements"):
            return list(value)
        if not hasattr(value, "dtype"):
            kind = "function" if callable(value) else type(value).__name__
            self.problems.add("OWN_CODE", where, f"is a {kind}", value=value, hint=NOT_IN_FILES)
            return 0.0
        numbers = numbers_of(value)
        if argument.kind.domain == "inertia" and _same(value, np.diag(np.diag(value))):
            return [row[i] for i, row in enumerate(numbers)]
        return numbers

    def law(self, law: Law | Sine | ControlLaw, where: str) -> Any:
        """Return the value of a law in a file: a list of laws for a sum, the coefficient for a
        linear law, else a table."""
        if isinstance(law, Sum):
            return [self.law(term, f"{where}[{i}]") for i, term in enumerate(law.terms)]
        return numbers_of(law.coefficient) if isinstance(law, Linear) else self.table(law, where)


def numbers_of(value: Any) -> Any:
    """Return an array as nested lists of Python numbers; numbers in float32 have their shortest
    decimal form."""
    array = np.asarray(value)
    if array.dtype != np.float32:
        return array.astype(float).tolist()
    return np.vectorize(lambda x: float(str(x)), otypes=[float])(array).tolist()


def _same(value: Any, default: Any) -> bool:
    """Return whether a value is exactly equal to a default."""
    if default is inspect.Parameter.empty or default is None or isinstance(value, Law):
        return False
    if not hasattr(value, "dtype"):
        return value == default
    other = np.asarray(default, float).astype(value.dtype)
    return other.shape == value.shape and other.tobytes() == np.asarray(value).tobytes()


def json_of(values: Any) -> str:
    """Return the text of a JSON document, one entry per line."""
    return json.dumps(values, indent=1, ensure_ascii=False) + "\n"


def toml_of(values: dict[str, Any], units: bool = False) -> str:
    """Return the text of a TOML document: a table for each body and element, a line for each
    support and joint; `units`: with comments that give the units of the numbers."""
    document, coordinates = tomlkit.document(), coordinate_units(values, schema()["$defs"])
    for name, value in values.items():
        if name not in SECTIONS:
            document.add(name, _with_unit(value, schema()["properties"][name]) if units else value)
            continue
        section = tomlkit.table(is_super_table=name not in SHORT)
        for key, entries in value.items():
            if name in SHORT:
                section.add(tomlkit.key(key), _item(entries))
                continue
            definition = schema()["$defs"].get(definition_of(name, entries.get("type")), {})
            nodes = definition.get("properties", {})
            words = words_of_coupling(entries, coordinates) or {}
            table = tomlkit.table()
            for entry, content in entries.items():
                table.add(
                    entry,
                    _with_unit(content, nodes.get(entry, {}), words) if units else _item(content),
                )
            section.add(tomlkit.key(key), table)
        document.add(name, section)
    return tomlkit.dumps(document)


def _with_unit(value: Any, node: dict[str, Any], words: dict[str, str] | None = None) -> Any:
    """Return the TOML item of a value, with a comment that gives the unit of its numbers."""
    item, unit = _item(value), node.get("unit", "")
    if node.get("$ref") == "#/$defs/end":
        unit = "m"
    elif node.get("$ref") == "#/$defs/law" and isinstance(value, float):
        unit = "force/argument"
    elif ";" in unit and isinstance(value[0], list):
        return item.comment(f"in blocks {unit}")
    if not unit:
        return item
    all_words = (words or {}) | node.get("words", {})
    return item.comment(si_words(dimension(unit.partition(",")[0], all_words)))


def _item(value: Any) -> Any:
    if isinstance(value, dict):
        table = tomlkit.inline_table()
        for name, content in value.items():
            table.add(name, _item(content))
        return table
    if not isinstance(value, list):
        return tomlkit.item(value)
    array = tomlkit.array()
    array.extend(map(_item, value))
    rows = list | dict if len(value) > SMALL else dict
    return array.multiline(len(value) > IN_LINE or any(isinstance(x, rows) for x in value))


def read_model(path: Any, *, allow: Sequence[str] = (), largest: float = LARGEST) -> Model:
    """Read a model from a TOML or JSON file.

    Numbers are written as text with a unit, "21 N/mm"; if the file states `units`, numbers without
    a unit are in that system. Entries have the names of the arguments of the constructors. All
    problems are reported at once, each with its line. Nothing in the file is executed.

    Args:
        path: path of the file, .toml or .json
        allow: names of your modules whose elements, joints, closures and laws the file may use:
            type = "mine.laws:Cubic"
        largest: largest size of the file [bytes]

    Errors: NO_FILE, IS_DIRECTORY, NOT_A_FILE, EMPTY_FILE, TOO_LARGE, ENCODING,
    UNKNOWN_FORMAT, SYNTAX, DUPLICATE_NAME, FILE_VERSION, UNKNOWN_NAME, MISSING_ENTRY,
    WRONG_KIND, NO_UNIT, UNKNOWN_UNIT, WRONG_DIMENSION, NOT_A_NUMBER, NOT_ALLOWED,
    OUTSIDE_FOLDER, and those of the constructors.

    >>> import pathlib, tempfile
    >>> path = pathlib.Path(tempfile.mkdtemp(), "pendulum.toml")
    >>> _ = path.write_text('''jaxbody = 1
    ... gravity = "0, -9.81, 0 m/s2"
    ... bodies.bob = {mass = "200 g0", com = "0, -50, 0 cm"}
    ... joints.bob = {type = "Hinge", parent = "world", axis = [0, 0, 1]}
    ... ''')
    >>> jb.read_model(path)  # doctest: +NORMALIZE_WHITESPACE
    Traceback (most recent call last):
    jaxbody.core.errors.JaxbodyError: pendulum.toml:3 bodies.bob.mass: is '200 g0', in m/s2
    (allowed: a unit such as kg). ...
    >>> _ = path.write_text(path.read_text().replace("200 g0", "0.2 kg"))
    >>> float(jb.read_model(path)["bob"].com[1])
    -0.5
    """
    path = Path(path)
    document = read_document(path, largest)
    return Builder(document, checked_values(document), path.parent, allow).model()


def write_model(model: Model, path: Any, *, allow: Sequence[str] = ()) -> None:
    """Write a model to a TOML or JSON file, from which `read_model` reads exactly the same numbers.

    Args:
        model: the model
        path: path of the file, .toml or .json; a file of the same name is replaced
        allow: names of your modules whose elements, joints, closures and laws may be written
            by name

    Errors: UNKNOWN_FORMAT, OWN_CODE, NOT_ALLOWED, BAD_SHAPE for a batch of models,
    TRACED, NOT_SAVED.

    >>> import pathlib, tempfile
    >>> car, path = jb.presets.quarter_car(), pathlib.Path(tempfile.mkdtemp(), "car.toml")
    >>> jb.write_model(car, path)
    >>> bool(jnp.all(jb.read_model(path)["tyre"].stiffness == car["tyre"].stiffness))
    True
    """
    path = Path(path)
    values = values_of(model, allow)
    text_of = toml_of if extension_of(path, ".toml", ".json") == ".toml" else json_of
    with writing(path):
        path.write_text(text_of(values), encoding="utf-8")
