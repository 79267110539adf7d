"""Kinds of objects in model files: the arguments of each class, read from its constructor and its fields, and the schema of all of them.

    python -c "from jaxbody.files.kinds import write_schema; write_schema()"

writes the schema again after a field has changed.
"""

from __future__ import annotations

import functools
import inspect
import json
import re
from dataclasses import dataclass, fields
from typing import Any

from jaxbody.elements.bushings import Bushing
from jaxbody.elements.contacts import Contact, Tyre
from jaxbody.elements.springs import Spring, SpringDamper
from jaxbody.elements.torsions import AntiRollBar, Torsion
from jaxbody.files.schemas import SCHEMA_FILE, VERSION
from jaxbody.geometry.fields import Kind
from jaxbody.inputs.motions import AtRest, Harmonic
from jaxbody.laws import damper_laws, laws, measured_curves, spring_laws
from jaxbody.models.bodies import Body, Support
from jaxbody.models.joints import Ball, Fixed, Free, Guide, HeavePitch, HeavePitchRoll, Hinge, Translation

JOINTS = (Free, Fixed, Guide, Hinge, Ball, Translation, HeavePitch, HeavePitchRoll)
ELEMENTS = (Spring, SpringDamper, Bushing, Torsion, AntiRollBar, Contact, Tyre)
LAWS = (
    laws.Linear, laws.TwoSided, spring_laws.Polynomial, spring_laws.Stop, spring_laws.TensionOnly, spring_laws.AirSpring,
    damper_laws.Digressive, damper_laws.Friction, measured_curves.Table,
)  # fmt: skip
MOTIONS = (AtRest, Harmonic)
TYPES = {kind.__name__: kind for kind in (*JOINTS, *ELEMENTS, *LAWS, *MOTIONS)}
FIELDS: dict[tuple[type, str], str] = {(Contact, "distance"): "free_length"}  # of arguments that are not named as the field is
FORMULAS = {"powers": "force/argument^n"}
LIMITS = {"nonnegative": {"minimum": 0}, "positive": {"exclusiveMinimum": 0}, "fraction": {"minimum": 0, "maximum": 1}}
PLAIN = {"bodies": Body, "supports": Support}  # sections whose objects are all of one class
SECTIONS = {
    "bodies": "Bodies by name.",
    "supports": "Bodies by name whose motion is imposed.",
    "joints": "Joints by the name of the body that each carries. A body without a joint is free.",
    "elements": "Springs, dampers and contacts by name.",
}
FRAME = {"type": "string", "frame": True}  # the name of a body, a support or the world
MOTION = "Motions of supports, by the name of the support."


@dataclass(frozen=True)
class Argument:
    """An argument of a class in a file, and the field of the object that holds it.

    `role`: number, end (of an element), law, word, words or flag."""

    name: str
    role: str
    field: str
    default: Any
    kind: Kind
    words: tuple[tuple[str, str], ...]  # of the units below it
    types: tuple[str, ...]  # of JSON: a number, a row, or either
    text: str  # of the docstring

    @property
    def required(self) -> bool:
        return self.default is inspect.Parameter.empty

    def node(self) -> dict[str, Any]:
        """Its schema."""
        about = {"description": self.text} if self.text else {}
        if self.role == "end":
            return {"$ref": "#/$defs/end", **about}
        if self.role == "law":
            return {"$ref": "#/$defs/law", **about, **({"words": dict(self.words)} if self.words else {})}
        if self.name == "parent":
            return FRAME | about
        if self.role in ("word", "words", "flag"):
            return {"type": {"word": "string", "words": "array", "flag": "boolean"}[self.role], **about}
        if self.kind.domain == "rotation":
            return {"$ref": "#/$defs/orientation", **about}
        limits = LIMITS.get(self.kind.domain, {}) if "array" not in self.types else {}
        return {
            "type": [*self.types, "string"],
            "unit": FORMULAS.get(self.kind.unit, self.kind.unit),
            **about,
            **limits,
        }


@functools.cache
def arguments_of(kind: type) -> tuple[Argument, ...]:
    """The arguments of a class."""
    known, texts = {each.name: each for each in fields(kind)}, _texts(kind)
    found = []
    for name, parameter in inspect.signature(kind).parameters.items():
        own = FIELDS.get((kind, name), name)
        if parameter.kind is inspect.Parameter.VAR_POSITIONAL:
            continue
        if own not in known or (own in ("a", "b") and kind in ELEMENTS):
            role, stated = "end", {}
        else:
            stated = known[own].metadata
            role = _role(known[own].type, stated)
        words = tuple(stated.get("words", {}).items())
        types = _types(str(known[own].type)) if own in known else ()
        found.append(Argument(name, role, own, parameter.default, stated.get("kind", Kind()), words, types, texts.get(name, "")))
    return tuple(found)


def _role(annotation: Any, metadata: Any) -> str:
    text = str(annotation)
    if "Law" in text:
        return "law"
    if metadata.get("static"):
        return "flag" if "bool" in text else "words" if "tuple" in text else "word"
    return "number"


def _types(annotation: str) -> tuple[str, ...]:
    """One number, a row of them, or either where the annotation does not say which."""
    if annotation == "Number" or "Array, ''" in annotation:
        return ("number",)
    return ("array",) if re.search(r"Array, '\w", annotation) else ("number", "array")


def _texts(kind: type) -> dict[str, str]:
    """What the docstring says of each argument."""
    texts: dict[str, str] = {}
    for names, text in re.findall(r"^ {4}([\w, ]+): (.*(?:\n {8}.*)*)", inspect.getdoc(kind) or "", re.M):
        texts |= {name.strip(): re.sub(r"\s+", " ", text) for name in names.split(",")}
    return texts


def schema() -> dict[str, Any]:
    """The JSON schema of model files."""
    of_type = {name: object_schema(kind, name) for name, kind in TYPES.items()}
    point = {"type": ["array", "string"], "unit": "m"}
    quaternion = {"type": ["array"], "unit": "", "description": "Unit quaternion w, x, y, z, or a rotation matrix."}
    euler = {
        "type": "object", "required": ["sequence", "angles"], "additionalProperties": False,
        "properties": {
            "sequence": {"type": "string", "description": 'Axes of the turns: "ZYX": axes that turn with the body, "xyz": fixed axes.'},
            "angles": {"type": ["array", "string"], "unit": "rad", "description": "One angle for each axis."},
        },
    }  # fmt: skip
    definitions = {
        "end": {
            "description": 'The name of a body, a support or "world", and a point in its frame: ["engine", "0.2, 0, -0.1 m"].',
            "oneOf": [
                FRAME,
                {"type": "array", "prefixItems": [FRAME, point]},
            ],
        },
        "orientation": {"oneOf": [quaternion, euler]},
        "law": {
            "description": "The coefficient of a linear law, a law, or a list of laws, which are added.",
            "oneOf": [
                {"type": ["number", "string"], "unit": "force/argument"},
                {"type": "array", "items": {"$ref": "#/$defs/law"}},
                *({"$ref": f"#/$defs/{kind.__name__}"} for kind in LAWS),
            ],
        },
        "joint": {"oneOf": [{"$ref": f"#/$defs/{kind.__name__}"} for kind in JOINTS]},
        "motion": {"oneOf": [{"$ref": f"#/$defs/{kind.__name__}"} for kind in MOTIONS]},
        "element": {"oneOf": [{"$ref": f"#/$defs/{kind.__name__}"} for kind in ELEMENTS]},
        "body": object_schema(Body),
        "support": object_schema(Support),
        **of_type,
    }
    named = {"bodies": "body", "supports": "support", "joints": "joint", "elements": "element", "motion": "motion"}
    sections = {
        name: {"type": "object", "description": text, "additionalProperties": {"$ref": f"#/$defs/{named[name]}"}}
        for name, text in (SECTIONS | {"motion": MOTION}).items()
    }
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "A model of jaxbody",
        "type": "object",
        "required": ["jaxbody", "bodies"],
        "additionalProperties": False,
        "properties": {
            "$schema": {"type": "string"},
            "jaxbody": {"type": "integer", "const": VERSION, "description": "The version of the file format."},
            "description": {"type": "string"},
            "units": {
                "description": 'The units of numbers without a unit: "SI", or those of length, time, angle, and mass or force.',
                "oneOf": [
                    {"type": "string", "enum": ["SI"]},
                    {"type": "object", "properties": {name: {"type": "string"} for name in ("length", "mass", "force", "time", "angle")}},
                ],
            },
            "gravity": {"type": ["array", "string"], "unit": "m/s2", "description": "In world axes."},
            **sections,
        },
        "$defs": definitions,
    }


def object_schema(kind: type, type_name: str = "") -> dict[str, Any]:
    """The schema of an object of a class."""
    arguments = arguments_of(kind)
    properties: dict[str, Any] = {"type": {"const": type_name}} if type_name else {}
    properties |= {argument.name: argument.node() for argument in arguments}
    required = [argument.name for argument in arguments if argument.required]
    if kind is measured_curves.Table:
        properties["file"] = {"type": "string", "description": "A text file of two columns with units, in the folder of the model file."}
        required = []
    about = (inspect.getdoc(kind) or "").partition("\n\n")[0]
    return {
        "type": "object",
        "description": re.sub(r"\s+", " ", about),
        "required": [*(["type"] if type_name else []), *required],
        "additionalProperties": False,
        "properties": properties,
    }


def write_schema() -> None:
    """Write the schema beside this file."""
    SCHEMA_FILE.write_text(json.dumps(schema(), indent=1) + "\n", encoding="utf-8")
