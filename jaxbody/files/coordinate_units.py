"""Units of the coordinates of joints in a document, by the names that couplings have for them:
{"rack.q": "m", "nut.q.1": "rad"}."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

OF_FREE = {"type": "Free"}  # the joint of a body without one
OF_STEPS = {"move": "m", "turn": "rad"}


def coordinate_units(values: dict[str, Any], definitions: dict[str, Any]) -> dict[str, str]:
    """The coordinates of the bodies of a document, whose joints the schema defines."""
    joints, units = _table(values, "joints"), {}
    for body in _table(values, "bodies"):
        joint = joints.get(body, OF_FREE)
        row = (
            definitions.get(str(joint.get("type")), {}).get("coordinates", [])
            if isinstance(joint, dict)
            else []
        )
        if isinstance(row, str):  # the entry that states them
            steps = joint.get(row)
            row = [OF_STEPS.get(str(step), "") for step in steps] if isinstance(steps, list) else []
        units |= by_name(body, row)
    return units


def by_name(body: str, units: Sequence[str]) -> dict[str, str]:
    """Units of the coordinates of a joint by their names, without those of a quaternion, which
    have none."""
    names = [f"{body}.q"] if len(units) == 1 else [f"{body}.q.{i}" for i in range(len(units))]
    return {name: unit for name, unit in zip(names, units, strict=True) if unit}


def words_of_coupling(values: dict[str, Any], units: dict[str, str]) -> dict[str, str] | None:
    """What the words of units stand for in a coupling x = f(y): x is the force of its laws, y their
    argument. None where a unit is not known."""
    x, y = (units.get(str(values.get(entry))) for entry in ("of", "by"))
    return {"force": x, "argument": y} if x and y else None


def with_own_joints(values: dict[str, Any]) -> set[str]:
    """The bodies of a document whose joints are of the user's own, so that their coordinates are
    known when these are imported."""
    return {
        body
        for body, joint in _table(values, "joints").items()
        if isinstance(joint, dict) and ":" in str(joint.get("type"))
    }


def owner(path: Any) -> str:
    """The body that a coordinate belongs to."""
    return str(path).partition(".q")[0]


def _table(values: dict[str, Any], section: str) -> dict[str, Any]:
    table = values.get(section)
    return table if isinstance(table, dict) else {}
