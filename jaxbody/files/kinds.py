"""Kinds of objects in model files: the arguments of each class and their schema, derived from its
constructor, fields and docstring."""

import functools
import inspect
import re
from collections.abc import Sequence
from dataclasses import MISSING, dataclass, fields
from typing import Any

from jaxbody.geometry import closures
from jaxbody.geometry.fields import Kind
from jaxbody.geometry.points_and_orientations import DIRECTIONS
from jaxbody.model.bodies import Body, Support
from jaxbody.model.elements.bushings import Bushing, Mount
from jaxbody.model.elements.contacts import Contact, Tyre
from jaxbody.model.elements.springs import Inerter, Spring, SpringDamper
from jaxbody.model.elements.torsions import AntiRollBar, Torsion
from jaxbody.model.forces.aerodynamic_forces import SectionAirloads
from jaxbody.model.forces.controllers import Controller
from jaxbody.model.forces.drives import Actuator, ControlledDamper
from jaxbody.model.forces.force_elements import ForceElement
from jaxbody.model.forces.magnetic_bearings import MagneticBearing
from jaxbody.model.forces.rotor_forces import WhirlForce
from jaxbody.model.inputs.loads import EngineTorque, Force, Unbalance
from jaxbody.model.inputs.motions import AtRest, Harmonic
from jaxbody.model.inputs.port_inputs import BaseMotion, Command, PointForce
from jaxbody.model.inputs.pulses import HalfSine, PulseMotion, Sawtooth, Trapezoid, Triangle
from jaxbody.model.inputs.roads import Road
from jaxbody.model.inputs.signals import Sine
from jaxbody.model.joints.combined_joints import (
    Composite,
    Cylindrical,
    HeavePitch,
    HeavePitchRoll,
    Planar,
    Translation,
    Universal,
)
from jaxbody.model.joints.joints import Ball, Fixed, Free, Guide, Hinge
from jaxbody.model.laws import (
    hydraulic_mounts,
    hysteresis_laws,
    laws,
    rubber_laws,
    spring_laws,
    tabulated_laws,
)
from jaxbody.sensors import drive_sensors, gauges, instruments, kinematic_sensors
from jaxbody.sensors.sensors import Sensor
from jaxbody.vibration.control import laws as control_laws

JOINTS = (
    Free,
    Fixed,
    Guide,
    Hinge,
    Ball,
    Universal,
    Cylindrical,
    Planar,
    Composite,
    Translation,
    HeavePitch,
    HeavePitchRoll,
)
ELEMENTS = (
    Spring,
    SpringDamper,
    Bushing,
    Mount,
    Torsion,
    AntiRollBar,
    Contact,
    Tyre,
    Inerter,
    MagneticBearing,
    WhirlForce,
    SectionAirloads,
    Actuator,
    ControlledDamper,
)
CLOSURES = (
    closures.Ball,
    closures.Hinge,
    closures.Guide,
    closures.Inline,
    closures.Weld,
    closures.Rod,
    closures.Coupling,
)
LAWS = (
    laws.Linear,
    laws.TwoSided,
    spring_laws.Polynomial,
    spring_laws.BumpStop,
    spring_laws.TensionOnly,
    spring_laws.AirSpring,
    spring_laws.Digressive,
    spring_laws.Friction,
    tabulated_laws.Tabulated,
    rubber_laws.Maxwell,
    hysteresis_laws.BoucWen,
    hysteresis_laws.Dahl,
    hysteresis_laws.LuGre,
    hydraulic_mounts.Hydraulic,
)
CONTROL_LAWS = (
    control_laws.PID,
    control_laws.Proportional,
    control_laws.LinearFeedback,
)
MOTIONS = (AtRest, Harmonic, Road, PulseMotion)
PULSES = (HalfSine, Sawtooth, Trapezoid, Triangle)
LOADS = (Force, Unbalance, EngineTorque)
INPUTS = (BaseMotion, PointForce, Command)  # inputs of measured responses
SENSORS = (
    kinematic_sensors.Position,
    kinematic_sensors.Velocity,
    kinematic_sensors.Acceleration,
    kinematic_sensors.Rotation,
    kinematic_sensors.AngularVelocity,
    kinematic_sensors.AngularAcceleration,
    instruments.Accelerometer,
    instruments.Gyro,
    instruments.Inclinometer,
    instruments.Elongation,
    instruments.LoadCell,
    instruments.ForcePlate,
    instruments.Reaction,
    instruments.JointAngle,
    gauges.Displacement,
    gauges.StringPotentiometer,
    gauges.LaserVibrometer,
    gauges.LaserDistance,
    instruments.BodyPose,
    instruments.Orientation,
    drive_sensors.DriveCommand,
    drive_sensors.DriveForce,
)
TYPES = {
    kind.__name__: kind
    for group in (JOINTS, ELEMENTS, LAWS, CONTROL_LAWS, MOTIONS, PULSES, LOADS, INPUTS, SENSORS)
    for kind in (*group, Controller, Sine)
}
OF_ELEMENTS = (instruments.OfElement, drive_sensors.DriveSensor, Command)  # `on` names an element
CLOSURE_TYPES = {kind.__name__: kind for kind in CLOSURES}  # some share names with joints
FIELDS: dict[tuple[type, str], str] = {  # fields whose names differ from those of the arguments
    (Contact, "distance"): "free_length",
    (PointForce, "direction"): "axis",
}


LIMITS = {
    "nonnegative": {"minimum": 0},
    "positive": {"exclusiveMinimum": 0},
    "fraction": {"minimum": 0, "maximum": 1},
}

OWN = {"type": ["number", "array", "string"]}  # in the unit of a quantity or sensor
DIRECTION = {
    "oneOf": [
        {"type": ["array", "string"], "unit": "", "pattern": "[0-9]"},
        {"type": "string", "enum": ["x", "y", "z"]},
    ]
}
PLAIN_SCHEMAS: dict[str, dict[str, Any]] = {  # by the roles of arguments
    "word": {"type": "string"},
    "words": {"type": "array"},
    "whole": {"type": "integer"},
    "flag": {"type": "boolean"},
    "own": OWN,
    "direction": DIRECTION,
    "sensors": {"type": "object", "additionalProperties": {"$ref": "#/$defs/sensor"}},
    "elements": {
        "oneOf": [
            {"type": "string", "name_of": "element"},
            {"type": "array", "items": {"type": "string", "name_of": "element"}},
        ]
    },
    "of_input": {
        "oneOf": [{"type": "string", "enum": list(DIRECTIONS)}, {"type": "array", "unit": ""}]
    },
}
PLAIN = {"bodies": Body, "supports": Support}  # sections with objects of one class only
SECTIONS = {
    "bodies": "Bodies by name.",
    "supports": "Bodies by name whose motion is imposed.",
    "joints": "Joints by the name of the body that each carries. A body without a joint is free.",
    "elements": "Springs, dampers, contacts and forces by name.",
    "closures": "Joints and rods that close loops, and couplings of coordinates, by name.",
    "controllers": "Laws between sensors and actuators or controlled dampers, by name.",
    "energies": (
        "Potential energies of your own by name: functions of frames, classes of an allowed module."
    ),
    "dissipations": "Dissipations of your own by name, likewise.",
}


@dataclass(frozen=True)
class Argument:
    """An argument of a class in a file, and the name of the field that holds it.

    `role`: number, own (number in the unit of a quantity or sensor), end (name and point), law,
    control_law, signal, pulse, direction, of_input (direction, or rotation about one), frame,
    element or coordinate (their names), elements (one name or several), sensors, word, words, whole
    (integer) or flag (boolean)."""

    name: str
    role: str
    field: str
    default: Any
    kind: Kind = Kind()  # noqa: RUF009
    words: tuple[tuple[str, str], ...] = ()  # meaning of words in the units of a law or signal
    types: tuple[str, ...] = ()  # JSON types: number, array, or both
    text: str = ""  # description in the docstring

    @property
    def required(self) -> bool:
        return self.default is inspect.Parameter.empty


def class_of(section: str, type_name: Any = None) -> type | None:
    """Return the class of an object in a section; None for a user-defined class."""
    return PLAIN.get(section) or (CLOSURE_TYPES if section == "closures" else TYPES).get(type_name)


def definition_of(section: str, type_name: Any = None) -> str:
    """Return the name of the schema definition of an object in a section."""
    return {"bodies": "body", "supports": "support", "closures": f"closure {type_name}"}.get(
        section, str(type_name)
    )


@functools.cache
def arguments_of(kind: type) -> tuple[Argument, ...]:
    """Return the arguments of a class."""
    parameters = inspect.signature(kind).parameters.values()
    starred = (inspect.Parameter.VAR_POSITIONAL, inspect.Parameter.VAR_KEYWORD)
    defaults = {each.name: each.default for each in parameters if each.kind not in starred}
    known, texts = {each.name: each for each in fields(kind)}, texts_of(kind)
    if any(each.kind in starred[1:] for each in parameters):  # by **chain, or **numbers of fields
        defaults |= (
            dict.fromkeys(kind.stages)
            if issubclass(kind, Sensor)
            else {
                name: inspect.Parameter.empty
                for name, each in known.items()
                if name not in defaults and "kind" in each.metadata and each.default is MISSING
            }
        )
    arguments = []
    for name, default in defaults.items():
        own = known.get(FIELDS.get((kind, name), name))
        text = texts.get(name, "")
        if own is None:
            arguments.append(Argument(name, "end", name, default, text=text))
            continue
        arguments.append(
            Argument(
                name,
                _role(kind, own.name, str(own.type), own.metadata),
                own.name,
                default,
                own.metadata.get("kind", Kind()),
                tuple(own.metadata.get("words", {}).items()),
                _types(str(own.type)),
                text,
            )
        )
    return tuple(arguments)


def _role(kind: type, name: str, annotation: str, metadata: Any) -> str:
    """Return the role of a constructor argument; see `Argument`."""
    spans = kind in (*ELEMENTS, *CLOSURES) or issubclass(kind, gauges.Gauge)
    if (name in ("a", "b") and spans) or (name == "on" and issubclass(kind, ForceElement)):
        return "end"
    if name in ("on", "parent", "relative_to"):
        return "element" if issubclass(kind, OF_ELEMENTS) else "frame"
    if kind is closures.Coupling and name in ("of", "by", "function"):
        return "law" if name == "function" else "coordinate"
    if kind in INPUTS and name in ("axis", "direction"):
        return "of_input"
    words = {
        "ControlLaw": "control_law",
        "Law": "law",
        "Signal": "signal",
        "Pulse": "pulse",
        "dict[": "sensors",
    }
    if metadata.get("static"):
        several = "elements" if name == "drives" else "words"
        words |= {"bool": "flag", "tuple": several, "int": "whole", "": "word"}
    for word, role in words.items():
        if word in annotation:
            return role
    stated = metadata.get("kind", Kind())
    if stated.domain == "direction" and "Array, '3'" in annotation:
        return "direction"
    return "own" if stated.unit == "unit" else "number"


def _types(annotation: str) -> tuple[str, ...]:
    """Return the JSON types of a number, a row of numbers, or both where the annotation does not
    distinguish them."""
    if annotation == "Number" or "Array, ''" in annotation:
        return ("number",)
    return ("array",) if re.search(r"Array, '\w", annotation) else ("number", "array")


def texts_of(kind: Any) -> dict[str, str]:
    """Return the description of each argument in a docstring, by name."""
    of_sensor = isinstance(kind, type) and issubclass(kind, Sensor) and kind is not Sensor
    texts = texts_of(Sensor) if of_sensor else {}
    for names, text in re.findall(
        r"^ {4}([\w, ]+): (.*(?:\n {8}.*)*)", inspect.getdoc(kind) or "", re.M
    ):
        texts |= {name.strip(): re.sub(r"\s+", " ", text) for name in names.split(",")}
    return texts


def object_schema(kind: type, type_name: str = "") -> dict[str, Any]:
    """Return the schema of an object of a class."""
    arguments = arguments_of(kind)
    properties: dict[str, Any] = {"type": {"const": type_name}} if type_name else {}
    properties |= {argument.name: argument_schema(argument) for argument in arguments}
    required = [argument.name for argument in arguments if argument.required]
    if kind is tabulated_laws.Tabulated:
        properties["file"] = {
            "type": "string",
            "description": (
                "A text file of two columns with units, in the folder of the model file."
            ),
        }
        required = []
    required = [*(["type"] if type_name else []), *required]
    return table_schema(about(kind), required, properties) | _coordinates(kind)


def about(kind: Any) -> str:
    """Return the first paragraph of a docstring, without "Return" at its beginning."""
    text = (inspect.getdoc(kind) or "").partition("\n\n")[0]
    return re.sub("^Return (.)", lambda start: start[1].upper(), text)


def _coordinates(kind: type) -> dict[str, Any]:
    """Return the keywords of the schema of a joint for its coordinates: their units ("" for those
    of a quaternion), or the entry that states its steps; for a coupling, that its units depend on
    coordinates."""
    if kind is closures.Coupling:
        return {"couples": True}
    if kind is Composite:
        return {"coordinates": "steps"}
    of_joint: Any = kind
    return {"coordinates": list(of_joint.block(kind, "").q_units)} if kind in JOINTS else {}


def argument_schema(argument: Argument) -> dict[str, Any]:
    """Return the schema of an argument."""
    about = {"description": argument.text} if argument.text else {}
    match argument.role:
        case "end" | "law" | "control_law" | "signal" | "pulse" as role:
            words = {"words": dict(argument.words)} if argument.words else {}
            return {"$ref": f"#/$defs/{role}", **about, **words}
        case "frame" | "element" | "coordinate" as role:
            return named(role) | about
    if argument.role in PLAIN_SCHEMAS:
        return PLAIN_SCHEMAS[argument.role] | about
    if argument.kind.domain == "rotation":
        return {"$ref": "#/$defs/orientation", **about}
    unit = "force/argument^n" if argument.kind.unit == "powers" else argument.kind.unit
    limits = LIMITS.get(argument.kind.domain, {}) if "array" not in argument.types else {}
    return {"type": [*argument.types, "string"], "unit": unit, **about, **limits}


def named(what: str) -> dict[str, Any]:
    """Return the schema of the name of a frame (a body, a support or the world), an element, a
    coordinate, a record or a sensor."""
    return {"type": "string", "name_of": what}


def table_schema(about: str, required: Sequence[str], properties: dict[str, Any]) -> dict[str, Any]:
    """Return the schema of a table with these properties."""
    return {
        "type": "object",
        "description": re.sub(r"\s+", " ", about),
        "required": list(required),
        "additionalProperties": False,
        "properties": properties,
    }
