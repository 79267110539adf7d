"""Schema of measurements in model files: records, experiments, measured modes and responses, from
the arguments of their constructors."""

from typing import Any

from jaxbody.files.kinds import OWN, named, table_schema, texts_of
from jaxbody.files.studies.measurement_builders import OF_FILES
from jaxbody.fitting.experiments.experiments import Experiment
from jaxbody.fitting.experiments.measured_responses import UNITS, MeasuredModes, MeasuredResponse
from jaxbody.records.record_files import read_record
from jaxbody.records.records import Record

PAIR = {"minItems": 2, "maxItems": 2}
VALIDATE = {
    "type": "boolean",
    "description": (
        "Hold it out of the fit, and compare the fitted model with it, as `validate` "
        "does. Default: false."
    ),
}
FILE = {"type": "string", "description": "A file in the folder of this one."}
OF_RECORDS = {
    "fill": "string",
    "max_gap": "integer",
    "irregular": "boolean",
    "drop_duplicates": "boolean",
    "drop": "string",
}
ONE_COLUMN = {"type": ["string", "integer"]}
NAMES = {"oneOf": [ONE_COLUMN, {"type": "array", "items": ONE_COLUMN}]}
COLUMNS = table_schema(
    "Columns of the file.",
    ["columns"],
    {
        "columns": NAMES | {"description": "Name or number (from 0), or a list of them."},
        "unit": {"type": "string"},
    },
)


def by_name(what: str, about: str) -> dict[str, Any]:
    """Return the schema of a table of objects by name, all of the definition `what`."""
    return {
        "type": "object",
        "description": about,
        "additionalProperties": {"$ref": f"#/$defs/{what}"},
    }


def one_of(*names: str) -> dict[str, Any]:
    """Return the schema of an object of one of these definitions."""
    return {"oneOf": [{"$ref": f"#/$defs/{name}"} for name in names]}


def measured_sections() -> dict[str, Any]:
    """Return the schema definitions of measurements."""
    return {
        "column": {
            "description": (
                "The name or number (from 0) of a column, a list of them, or "
                "{columns = ..., unit = ...}."
            ),
            "oneOf": [*NAMES["oneOf"], COLUMNS],
        },
        "columns of the file": COLUMNS,
        "record": _record(),
        "Experiment": _experiment(),
        "MeasuredModes": _modes(),
        "MeasuredResponse": _response(),
        "experiment": one_of("Experiment", "MeasuredModes", "MeasuredResponse"),
    }


def _options(types: dict[str, str]) -> dict[str, Any]:
    texts = texts_of(Record) | texts_of(read_record)
    return {name: {"type": kind, "description": texts[name]} for name, kind in types.items()}


def _record() -> dict[str, Any]:
    """Return the schema of a record, from the arguments of `read_record`."""
    texts = texts_of(Record) | texts_of(read_record)
    return table_schema(
        "A measured record, as `read_record` reads it.",
        ["file", "channels"],
        {
            "file": FILE,
            "time": {"$ref": "#/$defs/column", "description": texts["time"]},
            "channels": by_name("column", texts["channels"]),
            "rate": {"type": ["number", "string"], "unit": "Hz", "description": texts["rate"]},
            "part": {
                "type": ["array", "string"],
                "unit": "s",
                **PAIR,
                "description": "Start and end of the part that is used.",
            },
            **_options(OF_FILES | OF_RECORDS),
        },
    )


def _experiment() -> dict[str, Any]:
    state = table_schema(
        "Coordinates and speeds of the joints, in the order of the bodies, and states of elements "
        "with memory, by default at rest.",
        ["q", "v"],
        {key: {"type": ["array", "string"]} for key in ("q", "v", "z")},
    )
    return table_schema(
        "One measured run.",
        ["record"],
        {
            "type": {"const": "Experiment"},
            "record": named("record"),
            "sensors": {
                "type": "array",
                "items": named("sensor"),
                "description": "Default: all whose names are channels of the record.",
            },
            "motion": {
                "type": "object",
                "additionalProperties": {"$ref": "#/$defs/motion"},
                "description": "Default: the motions of the file.",
            },
            "loads": {
                "type": "object",
                "additionalProperties": {"$ref": "#/$defs/load"},
                "description": "Default: the loads of the file.",
            },
            "initial": {
                "oneOf": [{"type": "string", "enum": ["rest"]}, state],
                "description": texts_of(Experiment)["initial"],
            },
            "noise": {
                "type": "object",
                "additionalProperties": OWN,
                "description": "Standard deviations by sensor. Default: estimated.",
            },
            "leave_out": {
                "type": ["number", "string"],
                "unit": "s",
                "description": texts_of(Experiment)["leave_out"],
            },
            "validate": VALIDATE,
        },
    )


def _numbers(unit: str | None, text: str, *types: str) -> dict[str, Any]:
    """Return the schema of numbers in a unit (None if it depends on the model), or of columns of
    the file."""
    numbers = OWN if unit is None else {"type": [*types, "string"], "unit": unit}
    return {"oneOf": [numbers, {"$ref": "#/$defs/columns of the file"}], "description": text}


def _modes() -> dict[str, Any]:
    texts = texts_of(MeasuredModes)
    noise = {name: OWN | {"unit": unit} for name, unit in UNITS.items()}
    return table_schema(
        "Result of a modal test, for a fit.",
        ["type", "frequency"],
        {
            "type": {"const": "MeasuredModes"},
            "file": FILE,
            "frequency": _numbers(UNITS["frequency"], texts["frequency"], "array"),
            "damping_ratio": _numbers(UNITS["damping_ratio"], texts["damping_ratio"], "array"),
            "shapes": _numbers(UNITS["shapes"], texts["shapes"], "array"),
            "sensors": {"type": "array", "items": named("sensor"), "description": texts["sensors"]},
            "number": {
                "type": "array",
                "items": {"type": "integer"},
                "description": texts["number"],
            },
            "pairing": {
                "type": "string",
                "enum": ["order", "mac"],
                "description": texts["pairing"],
            },
            "noise": table_schema(texts["noise"], [], noise),
            "validate": VALIDATE,
            **_options(OF_FILES),
        },
    )


def _response() -> dict[str, Any]:
    texts = texts_of(MeasuredResponse)
    one = {
        "real": _numbers(None, "Real part."),
        "imaginary": _numbers(None, "Imaginary part."),
        "magnitude": _numbers(None, "Magnitude."),
        "phase": _numbers(
            "rad", "Of exp(i 2 pi f t): negative where the output is behind the input.", "array"
        ),
        "response": {
            "type": "string",
            "description": (
                'In a universal file: "4+Z/1+Z", nodes and directions of output and input.'
            ),
        },
        "units": {
            "type": "array",
            "items": {"type": "string"},
            **PAIR,
            "description": "Of output and input, where that file states none.",
        },
    }
    pair = table_schema("real and imaginary, magnitude and phase, or response.", [], one)
    by_input = {"type": "object", "description": "By the names of inputs."}
    factor = {"type": ["number", "string"], "unit": ""}
    return table_schema(
        "Measured frequency responses, for a fit.",
        ["type", "inputs", "measured"],
        {
            "type": {"const": "MeasuredResponse"},
            "file": FILE,
            "frequencies": _numbers(
                "Hz", texts["frequencies"] + " Default: those of a universal file.", "array"
            ),
            "inputs": by_name("input", "Motions of supports and forces by name."),
            "measured": {
                "type": "object",
                "additionalProperties": by_input | {"additionalProperties": pair},
                "description": "By the names of sensors; acc.x is one component.",
            },
            "noise": {
                "type": "object",
                "additionalProperties": by_input | {"additionalProperties": OWN},
                "description": f"By the names of sensors: {texts['noise']}",
            },
            "loss_factor": {
                "oneOf": [factor, {"type": "object", "additionalProperties": factor}],
                "description": texts["loss_factor"],
            },
            "validate": VALIDATE,
            **_options(OF_FILES),
        },
    )
