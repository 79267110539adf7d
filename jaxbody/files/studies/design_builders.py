"""Builders of designs: quantities of a document, in which units of limits and bounds are those of
what they limit, as `tune` takes them."""

from __future__ import annotations

import inspect
from dataclasses import dataclass
from typing import Any

import jax

from jaxbody.core import units
from jaxbody.files.builders import Builder
from jaxbody.files.documents import EntryPath
from jaxbody.files.studies.design_quantities import (
    QUANTITIES,
    Evaluation,
    Quantity,
    own_quantity,
    sensors_of,
)
from jaxbody.model.leaf_paths import Leaf, leaves_of, matching
from jaxbody.model.models import Model
from jaxbody.sensors.sensors import Sensor

OF_TABLE = ("type", "unit")  # entries of an own quantity that are not for its function
LARGEST_KEY = 2**32 - 1


@dataclass
class DesignBuilder:
    """Makes a design of the values at a path of a document. Problems are collected by the builder
    of the document."""

    builder: Builder
    model: Model
    sensors: dict[str, Sensor]
    values: dict[str, Any]
    path: EntryPath

    def add(self, code: str, message: str, value: Any, limit: str, hint: str, *parts: str) -> None:
        where = self.builder.document.where((*self.path, *parts))
        self.builder.problems.add(code, where, message, value=value, limit=limit, hint=hint)

    def unknown(self, name: str, known: Any, *parts: str) -> None:
        self.builder.unknown(name, known, (*self.path, *parts))

    def design(self) -> dict[str, Any]:
        """The arguments of `tune` beside the model, but for bounds and catalogues."""
        stated, limits, roads = (
            self.values["quantities"],
            self.values.get("limits", {}),
            self.values.get("roads", {}),
        )
        leaves = leaves_of(self.model)
        kinds = {name: self.kind(values, name) for name, values in stated.items()}
        for name in {self.values["minimize"], *limits} - set(stated):
            self.unknown(name, stated, *(("limits", name) if name in limits else ("minimize",)))
        for name in set(roads) - set(self.model.layout.supports):
            self.unknown(name, self.model.layout.supports, "roads", name)
        known = {name: kind for name, kind in kinds.items() if kind is not None}
        for name, kind in known.items():
            self.check(stated[name], kind, leaves, "quantities", name)
        pairs = {
            name: self.limit(limits[name], stated[name], kind, leaves, name)
            for name, kind in known.items()
            if name in limits
        }
        quantities = {
            name: (kind, {key: x for key, x in stated[name].items() if key not in OF_TABLE})
            for name, kind in known.items()
        }
        read = sensors_of(
            [values for values in stated.values() if values["type"] in QUANTITIES]
        ) & set(self.sensors)
        on = {name: (road["class"], road["speed"]) for name, road in roads.items()}
        given = {
            name: self.values[name]
            for name in ("free", "minimize", "starts")
            if name in self.values
        }
        given |= {"key": self.key(self.values["key"])} if "key" in self.values else {}
        return given | {
            "evaluate": Evaluation(
                quantities,
                {name: self.sensors[name] for name in self.sensors if name in read},
                on,
                tuple(self.values.get("band", (0.1, 100.0))),
            ),
            "limits": pairs,
        }

    def key(self, seed: int) -> Any:
        """The random key of a seed."""
        if 0 <= seed <= LARGEST_KEY:
            return jax.random.key(seed)
        self.add("BAD_NUMBER", f"is {seed!r:.30}", seed, f"0 to {LARGEST_KEY}", "", "key")
        return None

    def kind(self, values: dict[str, Any], name: str) -> Quantity | None:
        """The kind of a quantity: one by its name, or a function of a module of the user's that
        is allowed."""
        path, kind = ("quantities", name), str(values["type"])
        if kind in QUANTITIES:
            return QUANTITIES[kind]
        of = self.builder.own_object(kind, (*self.path, *path))
        if of is None:
            return None
        is_function = (
            callable(of)
            and not inspect.isclass(of)
            and getattr(of, "__module__", None) == kind.partition(":")[0]
        )
        if not (is_function and inspect.signature(of).parameters):
            self.add(
                "UNKNOWN_NAME",
                f"names '{kind}', which is no function of that module",
                kind,
                "a function of the model",
                "Name the module that defines it.",
                *path,
                "type",
            )
            return None
        unit = str(values.get("unit", "1"))
        self.builder.gather((*self.path, *path, "unit"), "", lambda: units.parse(unit, ""))
        self.check_call(of, values, *path)
        return own_quantity(of, unit)

    def check_call(self, of: Any, values: dict[str, Any], *path: str) -> None:
        """Check that a function takes the model and what is stated beside it."""
        parameters = dict(list(inspect.signature(of).parameters.items())[1:])
        if any(
            parameter.kind is inspect.Parameter.VAR_KEYWORD for parameter in parameters.values()
        ):
            return
        for name in set(values) - set(parameters) - set(OF_TABLE):
            self.unknown(name, parameters, *path, name)
        for name, parameter in parameters.items():
            if parameter.default is inspect.Parameter.empty and name not in values:
                self.add(
                    "MISSING_ENTRY",
                    f"has no '{name}'",
                    name,
                    "",
                    f"Give {name} = ..., which the function takes.",
                    *path,
                )

    def check(self, stated: dict[str, Any], kind: Quantity, leaves: list[Leaf], *path: str) -> None:
        """Check what a quantity is a function of."""
        if kind.on_roads and not self.values.get("roads"):
            self.add(
                "MISSING_ENTRY",
                "is a quantity of a ride, and there are no roads",
                None,
                "roads",
                'Write roads.NAME = {class = "C", speed = "20 m/s"}.',
                *path,
            )
        if stated["type"] not in QUANTITIES:
            return
        for name in set(stated.get("weights", {})) - set(self.sensors):
            self.unknown(name, self.sensors, *path, "weights", name)
        if stated.get("mode", 1) not in range(1, (count := len(self.model.layout.with_mass)) + 1):
            self.add(
                "BAD_NUMBER",
                f"is {stated['mode']}",
                stated["mode"],
                f"1 to {count}",
                "",
                *path,
                "mode",
            )
        if "path" in stated and stated["path"] not in {leaf.path for leaf in leaves}:
            self.builder.gather(
                (*self.path, *path, "path"), "", lambda: matching(leaves, [stated["path"]], "")
            )

    def limit(
        self, value: Any, stated: dict[str, Any], kind: Quantity, leaves: list[Leaf], name: str
    ) -> Any:
        """A limit, or a pair of them, in the unit of the quantity: of its kind, its sensor or
        its number."""
        of_path = next((leaf.kind.unit for leaf in leaves if leaf.path == stated.get("path")), "")
        sensor = (
            self.sensors.get(stated.get("sensor", "")) if stated["type"] in QUANTITIES else None
        )
        unit = sensor.unit_on(self.model) if sensor is not None else kind.unit or of_path
        pair = self.builder.quantity(value, unit, (*self.path, "limits", name))
        return tuple(pair) if isinstance(pair, list) else pair
