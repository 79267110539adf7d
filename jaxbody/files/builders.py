"""Builders: the checked values of a document become objects by the constructors, whose problems get the lines of the document."""

from __future__ import annotations

import dataclasses
import importlib
import inspect
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from jaxbody.core.errors import JaxbodyError, Problem, Problems, unknown
from jaxbody.elements.elements import Element
from jaxbody.files.documents import Document, EntryPath
from jaxbody.files.kinds import PLAIN, SECTIONS, TYPES, Argument, arguments_of, object_schema
from jaxbody.files.schemas import Check
from jaxbody.geometry.fields import check_domain, kind_of
from jaxbody.geometry.orientations import Euler
from jaxbody.inputs.motions import Motion
from jaxbody.laws.laws import Law, Sum
from jaxbody.laws.measured_curves import Table
from jaxbody.models.joints import Joint
from jaxbody.models.models import Model

PLACE = re.compile(r"(bodies|supports|joints|elements)\['(.*?)'\]|(gravity)")


class Builder:
    """Makes the objects of a document by their constructors."""

    def __init__(self, document: Document, values: dict[str, Any], folder: Path, allow: Sequence[str]):
        self.document, self.values, self.folder, self.allow = document, values, folder, allow
        self.problems = Problems()
        self.check = Check(document, self.problems)  # of what is known only when a class of the user's is imported

    def model(self) -> Model:
        parts: dict[str, Any] = {
            name: {key: self.thing(value, PLAIN.get(name), (name, key), {}) for key, value in self.values.get(name, {}).items()}
            for name in SECTIONS
        }
        self.problems.raise_if_any()
        if "gravity" in self.values:
            parts["gravity"] = self.values["gravity"]
        try:
            return Model(**parts)
        except JaxbodyError as error:
            raise JaxbodyError(*map(self.placed_in_model, error.problems)) from None

    def motion(self, supports: Sequence[str]) -> dict[str, Motion]:
        """The motions of supports."""
        given = self.values.get("motion", {})
        for name in set(given) - set(supports):
            self.problems.collected.append(unknown(name, self.document.where(("motion", name)), tuple(supports)))
        motions = {name: self.thing(value, None, ("motion", name), {}) for name, value in given.items()}
        self.problems.raise_if_any()
        return motions

    def thing(self, values: Any, kind: type | None, path: EntryPath, words: dict[str, str]) -> Any:
        """An object of a class, which the values name where it is not given."""
        if kind is None:
            kind = TYPES.get(values["type"])
        if kind is None:
            kind = self.own(values["type"], path)
            if kind is None:
                return None
            before = len(self.problems.collected)
            values = self.check.value(values, object_schema(kind, values["type"]), path, words)
            if len(self.problems.collected) > before:
                return None
        if kind is Table and set(values) != {"type", "x", "forces"}:
            return self.table(values, path)
        given = {
            argument.name: self.value(values[argument.name], argument, (*path, argument.name), words | dict(argument.words))
            for argument in arguments_of(kind)
            if argument.name in values
        }
        try:
            return _made(kind, given)
        except JaxbodyError as error:
            self.problems.collected += [self.placed(problem, path, kind.__name__) for problem in error.problems]
            return None

    def value(self, value: Any, argument: Argument, path: EntryPath, words: dict[str, str]) -> Any:
        if argument.role == "law":
            return self.law(value, path, words)
        if argument.role == "end":
            return value if isinstance(value, str) else tuple(value)
        if isinstance(value, dict):
            return self.problems.gather(lambda: Euler(value["sequence"], value["angles"]))
        return tuple(value) if argument.role == "words" else value

    def law(self, value: Any, path: EntryPath, words: dict[str, str]) -> Any:
        if isinstance(value, list):
            terms = [self.law(x, (*path, i), words) for i, x in enumerate(value)]
            return None if any(term is None for term in terms) else self.problems.gather(lambda: Sum(*terms))
        return self.thing(value, None, path, words) if isinstance(value, dict) else value

    def table(self, values: dict[str, Any], path: EntryPath) -> Any:
        """The measured curve in a file beside the document."""
        name = values.get("file")
        if name is None or {"x", "forces"} & set(values):
            hint = 'Give x = [...] and forces = [...], or file = "curve.csv".'
            self.problems.add("MISSING_ENTRY", self.document.where(path), "needs either points or a file", limit="one of them", hint=hint)
            return None
        where = self.document.where((*path, "file"))
        if Path(name).is_absolute() or ".." in Path(name).parts:
            hint = "Put it beside the model file."
            self.problems.add("OUTSIDE_FOLDER", where, f"names '{name}'", value=name, limit="a file in the folder of this one", hint=hint)
            return None
        try:
            return Table.read(self.folder / name)
        except JaxbodyError as error:
            self.problems.collected += [dataclasses.replace(each, where=f"{where}: {each.where}") for each in error.problems]
            return None

    def own(self, name: str, path: EntryPath) -> type | None:
        """A class of the user's from a module that is allowed."""
        module, _, attribute = name.partition(":")
        where = self.document.where((*path, "type"))
        if module not in self.allow:
            hint = f"If you trust it, give allow=['{module}']."
            self.problems.add("NOT_ALLOWED", where, f"names the module '{module}'", value=name, limit=str(list(self.allow)), hint=hint)
            return None
        try:
            kind = getattr(importlib.import_module(module), attribute, None)
        except ImportError as error:
            self.problems.add("UNKNOWN_NAME", where, f"names the module '{module}', which cannot be imported: {error}", value=name)
            return None
        if not (inspect.isclass(kind) and issubclass(kind, Element | Joint | Law | Motion)):
            self.problems.add("UNKNOWN_NAME", where, f"names '{name}', which is no element, joint, law or motion", value=name)
            return None
        return kind

    def placed(self, problem: Problem, path: EntryPath, kind: str) -> Problem:
        """The problem of a constructor, at its line."""
        rest = problem.where.removeprefix(kind)
        found = re.match(r"\.(\w+)", rest)
        if found and (*path, found[1]) in self.document.lines:
            path, rest = (*path, found[1]), rest[found.end() :]
        return dataclasses.replace(problem, where=self.document.where(path) + rest)

    def placed_in_model(self, problem: Problem) -> Problem:
        """A problem that the model as a whole has, at its line."""
        found = PLACE.match(problem.where)
        path = tuple(part for part in found.groups() if part) if found else ()
        rest = problem.where[found.end() :] if found else f" {problem.where}"
        return dataclasses.replace(problem, where=self.document.where(path) + rest)


def _made(kind: type, given: dict[str, Any]) -> Any:
    """An object by its constructor. The constructor of a user's class may check nothing: numbers become arrays, and are checked."""
    if kind in TYPES.values() or kind in PLAIN.values():
        return kind(**given)
    numbers = {each.name for each in arguments_of(kind) if each.role == "number"}
    made = kind(**{name: np.asarray(value, float) if name in numbers else value for name, value in given.items()})
    with Problems() as problems:
        for name in numbers & set(given):
            check_domain(getattr(made, name), kind_of(made, name), f"{kind.__name__}.{name}", problems)
    return made
