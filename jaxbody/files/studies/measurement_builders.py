"""Builders of measured modes and responses, from numbers in the document or columns of a file next
to it."""

from collections.abc import Iterator
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np

from jaxbody.core import units
from jaxbody.core.arrays import float_array
from jaxbody.core.errors import JaxbodyError, Problem, Problems
from jaxbody.files.builders import EntryBuilder
from jaxbody.fitting.experiments.measured_responses import (
    UNITS,
    MeasuredModes,
    MeasuredResponse,
    response_unit,
)
from jaxbody.records.format_readers import read_columns
from jaxbody.records.record_files import agreed_unit, read_responses
from jaxbody.vibration.ports import component_units

OF_FILES = {  # JSON types of the options of text tables
    "format": "string",
    "encoding": "string",
    "separator": "string",
    "decimal": "string",
    "skip": "integer",
    "footer": "integer",
}


class MeasurementBuilder(EntryBuilder):
    """Builder of measured modes or responses from their entry in a document."""

    def build(self) -> MeasuredModes | MeasuredResponse | None:
        """Return the measured modes or responses, by the type of the entry; None if there are
        problems."""
        known = {"MeasuredModes": self.modes, "MeasuredResponse": self.response}
        kind = self.values["type"]
        if kind in known:
            return known[kind]()
        self.builder.unknown(kind, ("Experiment", *known), (*self.path, "type"))
        return None

    def modes(self) -> MeasuredModes | None:
        """Build the result of a modal test."""
        plain = ("number", "pairing", "noise")
        given = {name: self.values[name] for name in plain if name in self.values}
        given |= {
            name: self.numbers(self.values[name], unit, name)
            for name, unit in UNITS.items()
            if name in self.values
        }
        given["sensors"] = {
            name: self.sensors[name]
            for name in self.values.get("sensors", ())
            if name in self.sensors
        }
        return self.made(MeasuredModes, given)

    def response(self) -> MeasuredResponse | None:
        """Build measured frequency responses."""
        inputs = {name: self.input(value, name) for name, value in self.values["inputs"].items()}
        of_outputs = component_units(self.sensors, self.model)
        for section in ("measured", "noise"):
            for output, by_input in self.values.get(section, {}).items():
                self.check_known([output], of_outputs, section)
                self.check_known(by_input, inputs, section, output)
        if self.failed or None in inputs.values():
            return None
        pairs = {
            (y, u): value
            for y, by_input in self.values["measured"].items()
            for u, value in by_input.items()
        }
        unit = {pair: response_unit(of_outputs[pair[0]], inputs[pair[1]].unit) for pair in pairs}
        frequencies, measured = (
            self.of_universal_file(pairs)
            if any("response" in value for value in pairs.values())
            else self.of_numbers(pairs, unit)
        )
        # an output may be a component of what a sensor reads
        read = {y if y in self.sensors else y.rpartition(".")[0] for y, _ in pairs}
        given: dict[str, Any] = {
            "frequencies": frequencies,
            "inputs": inputs,
            "outputs": {name: sensor for name, sensor in self.sensors.items() if name in read},
            "measured": measured,
        }
        if "noise" in self.values:
            given["noise"] = {
                (y, u): self.builder.quantity(
                    level, unit.get((y, u), ""), (*self.path, "noise", y, u)
                )
                for y, by_input in self.values["noise"].items()
                for u, level in by_input.items()
            }
        if "loss_factor" in self.values:
            given["loss_factor"] = self.values["loss_factor"]
        return self.made(MeasuredResponse, given)

    def made(self, kind: Any, given: dict[str, Any]) -> Any:
        """Build a measurement if its entry has no problems so far, and check that it fits the
        model."""
        return None if self.failed else self.builder.measurement(kind, given, self.model, self.path)

    def input(self, value: dict[str, Any], name: str) -> Any:
        """Build an input, a force on a body or the motion of a support, and check that it fits the
        model."""
        path = (*self.path, "inputs", name)
        made = self.builder.thing(value, None, path, {})
        problem = made and made.problem(self.model, self.builder.document.where((*path, "on")))
        if problem:
            self.builder.problems.collected.append(problem)
        return made

    def of_universal_file(self, pairs: dict[tuple[str, str], dict[str, Any]]) -> tuple[Any, Any]:
        """Return frequencies and responses from a universal file."""
        for pair, value in pairs.items():
            if "response" not in value:
                self.add(
                    "MISSING_ENTRY",
                    "has no 'response'",
                    "measured",
                    *pair,
                    limit="as the other pairs have",
                )
        if "frequencies" in self.values:
            self.add(
                "UNKNOWN_NAME",
                "is stated, and the file has its own",
                "frequencies",
                limit="none with 'response'",
            )
        if "file" not in self.values:
            self.add("MISSING_ENTRY", "has no 'file'", limit='file = "plate.uff"')
        file = (
            None if self.failed else self.builder.beside(self.values["file"], (*self.path, "file"))
        )
        wanted = {
            pair: (value.get("response"), *value.get("units", (None, None)))
            for pair, value in pairs.items()
        }

        def placed(problem: Problem) -> Problem:
            if problem.code == "NO_UNIT":
                problem = replace(problem, hint='Write units = ["m/s2", "N"] beside the response.')
            return self.builder.placed(problem, (*self.path, "file"), "")

        read = file and self.builder.problems.gather(lambda: read_responses(file, wanted), placed)
        return read or (None, None)

    def of_numbers(
        self, pairs: dict[tuple[str, str], dict[str, Any]], unit: dict[tuple[str, str], str]
    ) -> tuple[Any, Any]:
        """Return frequencies and responses from numbers or columns."""
        if "frequencies" not in self.values:
            self.add("MISSING_ENTRY", "has no 'frequencies'", limit="one for each measured number")
        return self.numbers(self.values.get("frequencies", []), "Hz", "frequencies"), {
            (y, u): self.complex(value, unit[y, u], "measured", y, u)
            for (y, u), value in pairs.items()
        }

    def complex(self, value: dict[str, Any], unit: str, *parts: str) -> Any:
        """Return complex numbers from real and imaginary parts, or from magnitudes and phases."""
        pairs = (("real", "imaginary"), ("magnitude", "phase"))
        chosen = next((names for names in pairs if set(names) == set(value)), None)
        if chosen is None:
            self.add(
                "MISSING_ENTRY",
                f"has {', '.join(value) or 'no entries'}",
                *parts,
                limit="real and imaginary, or magnitude and phase",
            )
            return None
        first, second = (
            self.numbers(value[name], "rad", *parts, name)
            if name == "phase"
            else self.numbers(value[name], unit, *parts, name, own=True)
            for name in chosen
        )
        if first is None or second is None:
            return None
        if first.shape != second.shape:
            self.add(
                "BAD_SHAPE",
                f"has {first.size} and {second.size} numbers",
                *parts,
                limit="as many of both",
            )
            return None
        return first + 1j * second if chosen[0] == "real" else first * np.exp(1j * second)

    def numbers(self, value: Any, unit: str, *parts: str, own: bool = False) -> Any:
        """Return numbers of the document, or of columns of the file, in SI; `own`: their unit is
        not in the schema."""
        path = (*self.path, *parts)
        if isinstance(value, dict):
            return (
                None
                if self.columns is None
                else self.builder.gather(path, "", lambda: self.of_columns(value, unit))
            )
        numbers = self.builder.quantity(value, unit, path) if own else value
        return self.builder.gather(path, "", lambda: np.atleast_1d(float_array(numbers, "")))

    def of_columns(self, value: dict[str, Any], unit: str) -> np.ndarray:
        """Return one column, or several side by side, in SI. Errors: NO_UNIT, UNIT_CONFLICT,
        WRONG_DIMENSION."""
        names = value["columns"] if isinstance(value["columns"], list) else [value["columns"]]
        columns = [self.columns[name] for name in names]
        with Problems() as problems:
            stated = agreed_unit(
                value.get("unit"),
                {column.unit for column in columns},
                "",
                problems,
                [],
                'State it: {columns = "f", unit = "Hz"}, or "1" for numbers without a unit.',
            )
        factor, expected = units.parse(stated, ""), units.parse(unit or "1", "").dimension
        if factor.dimension != expected:
            raise JaxbodyError(
                Problem(
                    "WRONG_DIMENSION",
                    "",
                    f"is in {stated}",
                    stated,
                    f"a unit such as {units.si_words(expected)}",
                    "Name another column.",
                )
            )
        table = np.stack([column.values * factor.factor for column in columns], -1)
        return table if isinstance(value["columns"], list) else table[:, 0]

    @cached_property
    def columns(self) -> Any:
        """Columns of the file that the entry names; None if they cannot be read."""
        if "file" not in self.values:
            self.add("MISSING_ENTRY", "names columns, but no 'file'", limit='file = "measured.csv"')
            return None
        file = self.builder.beside(self.values["file"], (*self.path, "file"))
        names = list(dict.fromkeys(_columns_in(self.values)))
        options = {name: self.values[name] for name in OF_FILES if name in self.values}
        return file and self.builder.gather(
            (*self.path, "file"), "", lambda: read_columns(file, names, **options).columns
        )


def _columns_in(values: dict[str, Any]) -> Iterator[Any]:
    """Yield the names of all columns in an entry."""
    for name, value in values.items():
        if name == "columns":
            yield from value if isinstance(value, list) else [value]
        elif isinstance(value, dict):
            yield from _columns_in(value)
