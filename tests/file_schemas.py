"""The schema of model files, from the arguments of all classes of objects and of the functions that
use a study: `python tests/file_schemas.py` writes jaxbody/files/schema.json."""

import json
from typing import Any

from measured_sections import PAIR, by_name, measured_sections, one_of

from jaxbody.design.tuners import tune
from jaxbody.files import kinds
from jaxbody.files.kinds import (
    DIRECTION,
    OWN,
    SECTIONS,
    named,
    object_schema,
    table_schema,
    texts_of,
)
from jaxbody.files.schemas import ANYTHING, SCHEMA_FILE, VERSION
from jaxbody.files.studies.design_builders import QUANTITIES
from jaxbody.fitting.fitters import fit
from jaxbody.fitting.multistarts import multistart
from jaxbody.model.bodies import Body, Support
from jaxbody.model.inputs.base_motions import base_motion
from jaxbody.model.inputs.motions import Sampled
from jaxbody.model.inputs.signals import KINDS, Samples
from jaxbody.vibration.comfort_weightings import WEIGHTINGS

# objects made from channels of a record
FROM_RECORDS = {"Sampled": Sampled, "base_motion": base_motion, "Samples": Samples}
OF_STUDIES = {
    "records": "Measured data by name.",
    "sensors": "What instruments read, by name.",
    "loads": "Forces and moments on bodies, by name.",
    "motion": "Motions of supports, by the name of the support.",
    "experiments": "Measured runs, modes and responses by name.",
    "designs": "What `tune` minimizes and limits, by name.",
}
SINGULAR = {name: name.removesuffix("s") for name in (*SECTIONS, *OF_STUDIES)}
SINGULAR |= {"bodies": "body", "energies": "own function", "dissipations": "own function"}


def schema() -> dict[str, Any]:
    """Return the JSON schema of model files."""
    of_type = {name: object_schema(kind, name) for name, kind in kinds.TYPES.items()}
    of_type |= {
        kinds.definition_of("closures", name): object_schema(kind, name)
        for name, kind in kinds.CLOSURE_TYPES.items()
    }

    euler = {
        "type": "object",
        "required": ["sequence", "angles"],
        "additionalProperties": False,
        "properties": {
            "sequence": {
                "type": "string",
                "description": (
                    'Axes of the turns: "ZYX": axes that turn with the body, "xyz": fixed axes.'
                ),
            },
            "angles": {
                "type": ["array", "string"],
                "unit": "rad",
                "description": "One angle for each axis.",
            },
        },
    }
    definitions = {
        "end": {
            "description": (
                'The name of a body, a support or "world", and a point in its frame: '
                '["engine", "0.2, 0, -0.1 m"]; the name alone means its origin.'
            ),
            "oneOf": [
                named("frame"),
                {
                    "type": "array",
                    "prefixItems": [named("frame"), {"type": ["array", "string"], "unit": "m"}],
                },
            ],
        },
        "orientation": {
            "oneOf": [
                {
                    "type": ["array"],
                    "unit": "",
                    "description": "Unit quaternion w, x, y, z, or a rotation matrix.",
                },
                euler,
            ]
        },
        "law": {
            "description": (
                "The coefficient of a linear law, a law, or a list of laws, which are added."
            ),
            "oneOf": [
                {"type": ["number", "string"], "unit": "force/argument"},
                {"type": "array", "items": {"$ref": "#/$defs/law"}},
                *({"$ref": f"#/$defs/{kind.__name__}"} for kind in kinds.LAWS),
            ],
        },
        "control_law": one_of(*(kind.__name__ for kind in kinds.CONTROL_LAWS)),
        "controller": one_of("Controller"),
        "joint": one_of(*(kind.__name__ for kind in kinds.JOINTS)),
        "pulse": one_of(*(kind.__name__ for kind in kinds.PULSES)),
        "motion": one_of(*(kind.__name__ for kind in kinds.MOTIONS), "Sampled", "base_motion"),
        "element": one_of(*(kind.__name__ for kind in (*kinds.ELEMENTS, *kinds.LOADS))),
        "closure": one_of(*(kinds.definition_of("closures", name) for name in kinds.CLOSURE_TYPES)),
        "own function": {
            "type": "object",
            "required": ["type"],
            "additionalProperties": ANYTHING,
            "properties": {
                "type": {
                    "type": "string",
                    "description": "module:Class, of an equinox.Module with __call__(frames).",
                }
            },
        },
        "load": one_of(*(kind.__name__ for kind in kinds.LOADS)),
        "sensor": one_of(*(kind.__name__ for kind in kinds.SENSORS)),
        "signal": {
            "description": "Three numbers, or a signal.",
            "oneOf": [
                {"type": ["array", "string"], "unit": "value"},
                *one_of("Sine", "Samples")["oneOf"],
            ],
        },
        "body": object_schema(Body),
        "support": object_schema(Support),
        **of_type,
        **{name: _of_record(name, kind) for name, kind in FROM_RECORDS.items()},
        "input": one_of(*(kind.__name__ for kind in kinds.INPUTS)),
        **measured_sections(),
        "quantity": one_of(*(f"quantity {name}" for name in QUANTITIES)),
        **{f"quantity {name}": _quantity(name) for name in QUANTITIES},
        "design": _design(),
    }
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "A model of jaxbody",
        "type": "object",
        "required": ["jaxbody", "bodies"],
        "additionalProperties": False,
        "properties": {
            "$schema": {"type": "string"},
            "jaxbody": {
                "type": "integer",
                "const": VERSION,
                "description": "The version of the file format.",
            },
            "description": {"type": "string"},
            "units": {
                "description": (
                    'The units of numbers without a unit: "SI", or those of length, time, '
                    "angle, and mass or force."
                ),
                "oneOf": [
                    {"type": "string", "enum": ["SI"]},
                    {
                        "type": "object",
                        "properties": {
                            name: {"type": "string"}
                            for name in ("length", "mass", "force", "time", "angle")
                        },
                    },
                ],
            },
            "gravity": {
                "type": ["array", "string"],
                "unit": "m/s2",
                "description": "In world axes.",
            },
            **{
                name: by_name(SINGULAR[name], text)
                for name, text in (SECTIONS | OF_STUDIES).items()
            },
            "fit": _fit(),
        },
        "$defs": definitions,
    }


def _of_record(name: str, kind: Any) -> dict[str, Any]:
    """Return the schema of an object that is made from channels of a record."""
    texts = texts_of(base_motion)
    channels = {
        "Sampled": ("translation", "rotation"),
        "base_motion": ("acceleration", "rates"),
        "Samples": ("channel",),
    }[name]
    properties = {"type": {"const": name}, "record": named("record")}
    for channel in channels:
        properties[channel] = {
            "type": "string",
            "description": texts.get(channel, f"Name of a channel: {channel}."),
        }
    properties["axis"] = DIRECTION | {"description": "Direction of a channel of one column."}
    if name == "base_motion":
        row, number = {"type": ["array", "string"]}, {"type": ["number", "string"]}
        properties |= {
            "at": row | {"unit": "m", "description": texts["at"]},
            "gravity": row | {"unit": "m/s2", "description": texts["gravity"]},
            "degree": {"type": "integer", "description": texts["degree"]},
            "cutoff": number | {"unit": "Hz", "description": texts["cutoff"]},
        }
    if name == "Samples":
        properties["kind"] = {
            "type": "string",
            "enum": list(KINDS),
            "description": "The interpolation between samples.",
        }
    needed = channels[:1] if name != "Sampled" else ()
    return table_schema(kinds.about(kind), ["type", "record", *needed], properties)


def _quantity(name: str) -> dict[str, Any]:
    """Return the schema of a quantity of a design."""
    known = {
        "path": {
            "type": "string",
            "description": "Path of a number of the model, such as left.stiffness.",
        },
        "mode": {"type": "integer", "minimum": 1, "description": "Number of the mode, from 1."},
        "on": named("element"),
        "band": {
            "type": ["array", "string"],
            "unit": "Hz",
            **PAIR,
            "description": "Lower and upper end.",
        },
        "sensor": named("sensor"),
        "weights": {
            "type": "object",
            "additionalProperties": {"type": "string", "enum": sorted(WEIGHTINGS)},
            "description": "Frequency weighting by sensor: Wk for z, Wd for x and y.",
        },
    }
    quantity = QUANTITIES[name]
    stated = {option: known[option] for option in quantity.stated}
    return table_schema(
        kinds.about(quantity.of), ["type", *stated], {"type": {"const": name}, **stated}
    )


def _design() -> dict[str, Any]:
    """Return the schema of a design, from the arguments of `tune`."""
    texts = texts_of(tune)
    road = {
        "class": {"type": "string", "enum": list("ABCDEFGH"), "description": "Of ISO 8608."},
        "speed": {"type": ["number", "string"], "unit": "m/s"},
    }
    return table_schema(
        "What `jaxbody tune` chooses.",
        ["free", "minimize", "quantities"],
        {
            "free": _fit()["properties"]["free"],
            "minimize": {"type": "string", "description": texts["minimize"]},
            "quantities": by_name(
                "quantity",
                "What is minimized or limited, by name: of a type below, or module:function.",
            ),
            "limits": {
                "type": "object",
                "additionalProperties": OWN,
                "description": texts["limits"],
            },
            "bounds": _fit()["properties"]["bounds"],
            "catalogues": {
                "type": "object",
                "additionalProperties": {"type": ["array", "string"]},
                "description": texts["catalogues"],
            },
            "starts": {"type": "integer", "description": texts["starts"]},
            "key": {
                "type": "integer",
                "description": "Seed of the random key for the drawn designs. Default: 0.",
            },
            "roads": {
                "type": "object",
                "description": "Uneven roads under supports, by name, independent of each other.",
                "additionalProperties": table_schema("An uneven road.", ["class", "speed"], road),
            },
            "band": {
                "type": ["array", "string"],
                "unit": "Hz",
                **PAIR,
                "description": "Of the roads. Default: 0.1 to 100 Hz.",
            },
        },
    )


def _fit() -> dict[str, Any]:
    """Return the schema of the section fit, from the arguments of `fit` and `multistart`."""
    texts, of_starts, pair = texts_of(fit), texts_of(multistart), {"type": "array", **PAIR}
    return table_schema(
        "What `jaxbody fit` estimates from the experiments.",
        ["free"],
        {
            "free": {
                "oneOf": [{"type": "string"}, {"type": "array", "items": {"type": "string"}}],
                "description": texts["free"],
            },
            "bounds": {
                "type": "object",
                "additionalProperties": pair,
                "description": texts["bounds"],
            },
            "priors": {
                "type": "object",
                "additionalProperties": pair,
                "description": texts["priors"],
            },
            "loss": {"type": "string", "description": texts["loss"]},
            "max_evaluations": {"type": "integer", "description": texts["max_evaluations"]},
            "rtol": {
                "type": "number",
                "description": "Tolerance of the integration, as in `simulate`.",
            },
            "max_steps": {"type": "integer", "description": texts["max_steps"]},
            "starts": {
                "type": "integer",
                "description": (
                    f"{of_starts['starts']} Default: none; `jaxbody fit` then runs `multistart`."
                ),
            },
            "spread": {"type": "number", "description": of_starts["spread"]},
            "seed": {"type": "integer", "description": of_starts["seed"]},
        },
    )


if __name__ == "__main__":
    SCHEMA_FILE.write_text(json.dumps(schema(), indent=1) + "\n", encoding="utf-8")
