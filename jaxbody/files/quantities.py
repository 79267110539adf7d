"""Quantities in model files: conversion of numbers with units to SI; units of joint coordinates.

    "21 N/mm"   "-2100, 700, 0 mm"   ["10 mm", "2 cm"]
    and, where the file states a unit system, 21e3

Numbers without a unit are in the unit system of the file. If it states none, they are an error,
unless they are zero or the quantity has no unit. A system may state both mass and force, such as
"kg" and "N" with "mm": then stiffnesses are in N/mm, inertias in kg mm2. If it states only one of
them, the unit of the other follows. If that is not kg or N (with mm, N and s it is the tonne),
numbers in it are an error, as they are rarely intended; if it is the unit of mass, so are numbers
for accelerations, such as gravity.
"""

import math
import re
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from jaxbody.core import units
from jaxbody.core.errors import JaxbodyError, Problem, Problems, warn
from jaxbody.core.printed_tables import printed_unit, unit_words

LONGEST = 10_000  # largest number of characters of one quantity
NUMBER = r"[+-]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][+-]?\d+)?|[+-]?(?:inf|nan)"
NUMBERS = re.compile(
    rf"[(\[]?\s*({NUMBER})((?:\s*[,;]\s*|\s+)(?:{NUMBER})(?=[\s,;)\]]|$))*\s*[)\]]?"
)
BASE = {
    "length": units.LENGTH,
    "time": units.TIME,
    "angle": units.ANGLE,
    "mass": units.MASS,
    "force": units.FORCE,
}
SI = {"length": "m", "time": "s", "angle": "rad", "mass": "kg"}


@dataclass(frozen=True)
class UnitSystem:
    """The factors to SI of the base units of a file; `derived`: "mass" or "force" if its unit
    follows from the others and is not kg or N, else ""."""

    length: float
    mass: float
    force: float
    time: float
    angle: float
    derived: str = ""

    def factor(self, unit: str) -> float:
        """Return the factor to SI of numbers in this system whose SI unit is `unit`, in which mass
        is expressed by kg or by N."""
        m, kg, s, rad, _ = units.parse(unit, "unit").dimension
        mass = self.mass if "kg" in unit else self.force * self.time**2 / self.length
        return self.length**m * mass**kg * self.time**s * self.angle**rad

    def states(self, unit: str) -> bool:
        """Return whether a quantity with the SI unit `unit` may be written without a unit: False if
        its unit in this system contains the derived unit of mass or force."""
        dimension = units.parse(unit, "unit").dimension
        if "kg" in unit or dimension == units.ACCELERATION:
            return self.derived != "mass"
        return not dimension[1] or self.derived != "force"


def unit_system(stated: Any, where: str, problems: Problems) -> UnitSystem | None:
    """Return the unit system of a file: "SI", or units of length, time, angle, and of mass, force
    or both; None if it states none. Errors: BAD_UNIT, UNKNOWN_UNIT."""
    hint = (
        'Write units = "SI", or units = {length = "mm", mass = "kg", force = "N", time = '
        '"s", angle = "deg"}.'
    )
    if stated is None:
        return None
    stated = SI if stated == "SI" else stated
    given = set(stated) if isinstance(stated, dict) else set()
    missing = {"length", "time", "angle"} - given
    if not given & {"mass", "force"}:
        missing |= {"mass or force"}
    others = sorted(given - set(BASE))
    if missing or others:
        messages = [f"has no {' and no '.join(sorted(missing))}"] * bool(missing)
        messages += [f"has {', '.join(others)}"] * bool(others)
        problems.add(
            "BAD_UNIT",
            where,
            " and ".join(messages) if isinstance(stated, dict) else f"is {stated!r:.60}",
            value=stated,
            limit="length, time, angle, and mass, force or both",
            hint=hint,
        )
        return None
    factors = {}
    for name, text in stated.items():
        unit = problems.gather(lambda text=text, name=name: units.parse(text, f"{where}.{name}"))
        if unit is not None and unit.dimension != BASE[name]:
            problems.add(
                "BAD_UNIT",
                f"{where}.{name}",
                f"is '{text}'",
                value=text,
                limit=f"a unit of {name}",
                hint=hint,
            )
        factors[name] = unit.factor if unit else 1.0
    length, time = factors["length"], factors["time"]
    mass = factors["mass"] if "mass" in factors else factors["force"] * time**2 / length
    force = factors["force"] if "force" in factors else mass * length / time**2
    derived = "mass" if "mass" not in factors else "force" if "force" not in factors else ""
    if abs((mass if derived == "mass" else force) - 1) <= 1e-9:
        derived = ""
    return UnitSystem(length, mass, force, time, factors["angle"], derived)


def dimension(unit: str, words: dict[str, str]) -> units.Dimension:
    """Return the dimension of a unit, in which `words` may stand for units."""
    return units.parse(_spelled(unit, words), "unit").dimension


def _spelled(unit: str, words: dict[str, str]) -> str:
    """Replace words in a unit: "force/argument" with {"force": "N", "argument": "m"} becomes
    (N)/(m). Return "1" for no unit, or if words are left whose meaning is not known."""
    for word, meaning in words.items():
        unit = re.sub(rf"\b{word}\b", f"({meaning})", unit)
    return "1" if not unit or re.search(r"\b(force|argument)\b", unit) else unit


def in_SI(
    value: Any,
    unit: str,
    words: dict[str, str],
    system: UnitSystem | None,
    where: str,
    problems: Problems,
) -> Any:
    """Convert a number, or nested lists of numbers, to SI.

    Args:
        value: number, text, or list of these
        unit: SI unit of all numbers, or units of the parts of a row, separated by commas, and of
            the rows of a matrix, separated by semicolons ("N/m, N; N, N m/rad"); "^n" means the
            powers 1, 2, ... in a row
        words: meaning of the words of the unit, such as {"force": "N"}
        system: unit system of numbers without a unit; None: they are an error
        where: place of the value, for messages
        problems: collection to which problems are added

    Errors: NO_UNIT, UNKNOWN_UNIT, WRONG_DIMENSION, NOT_A_NUMBER. Warning: UNIT for more than one
    turn in rad."""
    blocks = [[part.strip() for part in row.split(",")] for row in unit.split(";")]
    is_matrix = isinstance(value, list) and any(isinstance(row, list) for row in value)
    if not is_matrix and len(blocks) > 1:
        blocks = [blocks[0][:1]]
    return _converted(value, _Expected(blocks, words, system, where, problems), ())


@dataclass(frozen=True)
class _Expected:
    """The units that the numbers of one quantity must have."""

    blocks: list[list[str]]
    words: dict[str, str]
    system: UnitSystem | None
    where: str
    problems: Problems

    def unit(self, index: tuple[tuple[int, int], ...]) -> str:
        """Return the unit of the number at an index, which holds a pair (i, n), item i of n, for
        each dimension."""
        (i, n), (j, m) = ((0, 1), (0, 1), *index)[-2:]
        row = self.blocks[i * len(self.blocks) // n]
        return _spelled(row[j * len(row) // m].replace("^n", f"^{j + 1}" if j else ""), self.words)

    def dimension(self, index: tuple[tuple[int, int], ...]) -> units.Dimension:
        return units.parse(self.unit(index), "unit").dimension


def _converted(value: Any, expected: _Expected, index: tuple[tuple[int, int], ...]) -> Any:
    if isinstance(value, list):
        return [_converted(x, expected, (*index, (i, len(value)))) for i, x in enumerate(value)]
    read = _of_text if isinstance(value, str) else _of_number
    numbers = expected.problems.gather(lambda: read(value, expected, index))
    return 0.0 if numbers is None else numbers


def _of_number(value: Any, expected: _Expected, index: tuple[tuple[int, int], ...]) -> float:
    """Convert a number without a unit to SI. Errors: NOT_A_NUMBER, NO_UNIT."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise JaxbodyError(
            Problem(
                "NOT_A_NUMBER",
                expected.where,
                f"is {value!r:.60}, which is not a number",
                value,
                "a number, or a text with its unit",
            )
        )
    unit, dimension = expected.unit(index), expected.dimension(index)
    too_large = isinstance(value, int) and abs(value) > sys.float_info.max
    value = math.inf if too_large else float(value)
    if dimension == units.NONE or value == 0 or not math.isfinite(value):
        return value
    si = unit if unit in units.KNOWN else units.si_words(dimension)
    if expected.system is None:
        usual, _ = printed_unit(si, unit_words("mm"))
        raise JaxbodyError(
            Problem(
                "NO_UNIT",
                expected.where,
                f"is {value:g} without a unit",
                value,
                f"a unit such as {usual}",
                f'Write "{value:g} {usual}", or state units = "SI", or units = {{length = "mm", '
                'mass = "kg", force = "N", time = "s", angle = "deg"}, at the top of the file.',
            )
        )
    meant = times(value, expected.system.factor(unit))
    if not expected.system.states(unit):
        of = expected.system.derived
        also = f', or add {of} = "{"kg" if of == "mass" else "N"}" to the units of the file'
        raise JaxbodyError(
            Problem(
                "NO_UNIT",
                expected.where,
                f"is {value:g} without a unit, which would be {meant:.6g} {si} by the units of "
                "the file",
                value,
                f"a unit such as {si}",
                f'Write "{value:g} {si}"{also if dimension != units.ACCELERATION else ""}.',
            )
        )
    _warn_of_degrees([value], dimension, expected.system.angle, expected.where)
    return meant


def _warn_of_degrees(
    numbers: list[float], dimension: units.Dimension, factor: float, where: str
) -> None:
    """Issue the warning UNIT for an angle in rad of more than one turn, which may be meant in
    degrees; angles stated in degrees are not checked."""
    largest = max(map(abs, numbers))
    if dimension == units.ANGLE and factor == 1.0 and largest > units.TURN:
        warn(
            "UNIT",
            f"{where}: is {largest:g} rad, more than a turn; if it is in degrees, "
            f'write "{largest:g} deg"',
        )


def times(value: float, factor: float) -> float:
    """Return value * factor, divided by 1/factor where this is a whole number: 700 mm are 700/1000
    m, as 700 * 0.001 is rounded twice."""
    divisor = 1 / factor
    return (
        value if factor == 1 else value / divisor if divisor == round(divisor) else value * factor
    )


def _of_text(text: str, expected: _Expected, index: tuple[tuple[int, int], ...]) -> Any:
    """Convert a text, numbers with or without a unit, to SI. Errors: NOT_A_NUMBER, UNKNOWN_UNIT,
    WRONG_DIMENSION."""
    match = NUMBERS.match(text.strip()) if len(text) <= LONGEST else None
    if match is None:
        raise JaxbodyError(
            Problem(
                "NOT_A_NUMBER",
                expected.where,
                f"is {text!r:.60}",
                text,
                'a number with its unit, such as "21 N/mm"',
            )
        )
    numbers = [float(number) for number in re.findall(NUMBER, match.group())]
    written = text.strip()[match.end() :].strip()
    if not written:
        return _converted(numbers if len(numbers) > 1 else numbers[0], expected, index)
    unit = units.parse(written, expected.where)
    several = [(*index, (i, len(numbers))) for i in range(len(numbers))]
    for dimension in map(expected.dimension, several if len(numbers) > 1 else [index]):
        if dimension != unit.dimension:
            raise JaxbodyError(_mismatch(text, unit, dimension, expected.where))
    _warn_of_degrees(numbers, unit.dimension, unit.factor, expected.where)
    values = [times(number, unit.factor) for number in numbers]
    return values if len(values) > 1 else values[0]


def _mismatch(text: str, unit: units.Unit, dimension: units.Dimension, where: str) -> Problem:
    """Return the problem of a unit of the wrong dimension."""
    si = units.si_words(dimension)
    hint = f"Give it in {si}." if dimension != units.NONE else "It has no unit."
    # the wanted unit is the given one divided by an acceleration
    if [a - b for a, b in zip(dimension, unit.dimension, strict=True)] == [1, 0, -2, 0, 0]:
        hint += " Pounds and kilograms of force are lbf and kgf."
    return Problem(
        "WRONG_DIMENSION", where, f"is '{text}', in {unit.si}", text, f"a unit such as {si}", hint
    )


OF_STEPS = {"move": "m", "turn": "rad"}


def coordinate_units(values: dict[str, Any], definitions: dict[str, Any]) -> dict[str, str]:
    """Return the SI units of the coordinates of all bodies of a document, by name, from the
    definitions of joints in the schema."""
    joints, units = table_of(values, "joints"), {}
    for body in table_of(values, "bodies"):
        joint = joints.get(body, {"type": "Free"})
        if not isinstance(joint, dict):
            continue
        row = definitions.get(str(joint.get("type")), {}).get("coordinates", [])
        if isinstance(row, str):  # the name of the entry that states the steps
            steps = joint.get(row)
            row = [OF_STEPS.get(str(step), "") for step in steps] if isinstance(steps, list) else []
        units |= by_name(body, row)
    return units


def by_name(body: str, units: Sequence[str]) -> dict[str, str]:
    """Return the units of the coordinates of a body by their names, without those of a quaternion,
    which have none."""
    names = [f"{body}.q"] if len(units) == 1 else [f"{body}.q.{i}" for i in range(len(units))]
    return {name: unit for name, unit in zip(names, units, strict=True) if unit}


def words_of_coupling(values: dict[str, Any], units: dict[str, str]) -> dict[str, str] | None:
    """Return the meaning of the words of units in a coupling x = f(y): "force" is the unit of x,
    "argument" that of y. None if one of them is not known."""
    x, y = (units.get(str(values.get(entry))) for entry in ("of", "by"))
    return {"force": x, "argument": y} if x and y else None


def with_own_joints(values: dict[str, Any]) -> set[str]:
    """Return the bodies of a document with joints of user-defined classes; the coordinates of these
    joints are unknown until the classes are imported."""
    return {
        body
        for body, joint in table_of(values, "joints").items()
        if isinstance(joint, dict) and ":" in str(joint.get("type"))
    }


def owner(path: Any) -> str:
    """Return the body of a coordinate, such as "arm" of "arm.q.0"."""
    return str(path).partition(".q")[0]


def table_of(values: dict[str, Any], section: str) -> dict[str, Any]:
    """Return a section of a document; an empty one if it is missing or is not a table."""
    table = values.get(section)
    return table if isinstance(table, dict) else {}
