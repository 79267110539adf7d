"""Units of parameters, by the field that a path leads to and what it is a field of: N/m of a spring's stiffness, N m/rad of a torsion's.

Of what a user has defined nothing is known, and no unit is said.
"""

from __future__ import annotations

from typing import Any

import jax
import numpy as np

from jaxbody.elements.torsions import Torsion
from jaxbody.models.leaf_paths import Leaf
from jaxbody.models.models import Model
from jaxbody.sensors.channels import Channel

FIELDS = {
    "kg": "mass", "kg m2": "inertia", "m/s2": "gravity", "N": "level", "N/m": "stiffness", "N s/m": "damping slow fast", "Hz": "frequency",
    "m": "com position a b c at point free_length radius gap engagement height distances heights footprint translation",
    "rad": "rotation rotation_phase translation_phase phase phases free_angle", "m/s": "speed velocity knee", "s": "delay lag",
    "Pa": "pressure ambient", "m2": "area", "kg m": "unbalance", "N m": "mean amplitudes",
}  # fmt: skip
UNITS = {field: unit for unit, fields in FIELDS.items() for field in fields.split()}
OF_TURNS = {"N": "N m", "N/m": "N m/rad", "N s/m": "N m s/rad", "m": "rad", "m/s": "rad/s"}  # of a law about an angle
BLOCKS = {"stiffness": ("N/m", "N", "N m/rad"), "damping": ("N s/m", "N s", "N m s/rad")}  # of a bushing: moves, mixed, turns


def units_of(leaf: Leaf, run: str, model: Model, experiments: dict[str, Any], value: np.ndarray) -> list[str]:
    """The unit of each number of a leaf, of the model (run "") or of a measurement; "" where there is none or it is not known."""
    name, *fields = leaf.path.removeprefix(f"{run}.").split(".") if run else leaf.path.split(".")
    if not fields:
        return [UNITS.get(name, "")] * value.size
    root = experiments[run].named()[name] if run else next(rows for rows in _rows(model, name) if _walk(rows, fields) is not None)
    if name in ("initial", "nodes") and isinstance(root, dict):
        row = _of_state(model, fields[0])
        return row * (value.size // len(row))
    owner, field = _walk(root, fields[:-1]), fields[-1]
    if isinstance(owner, Channel) and field in ("bias", "start"):
        return _of_channel(owner, value)
    if not isinstance(owner, Channel) and not type(owner).__module__.startswith("jaxbody."):
        return [""] * value.size
    if field in BLOCKS and value.ndim == 2:
        turns = np.arange(6) > 2
        return [BLOCKS[field][i] for i in np.ravel(turns[:, None].astype(int) + turns)]
    unit = {"spring": "N/m", "damper": "N s/m"}.get(next((f for f in fields if f in ("spring", "damper")), ""), "")
    unit = unit if field == "coefficient" else UNITS.get(field, "")
    turned = isinstance(root, Torsion) and len(fields) > 1
    return [OF_TURNS.get(unit, unit) if turned else unit] * value.size


def _rows(model: Model, name: str) -> list[Any]:
    return [table.rows for table in (model.bodies, model.supports, *model.joints, *model.elements) if name in table.names]


def _walk(thing: Any, fields: list[str]) -> Any:
    for field in fields:
        if isinstance(thing, dict):
            thing = thing.get(field)
        else:
            thing = thing[int(field)] if isinstance(thing, list | tuple) else getattr(thing, field, None)
    return thing


def _of_state(model: Model, field: str) -> list[str]:
    """Of q or v: moves and turns; the numbers of a quaternion have none."""
    found = []
    for kind in model.layout.kinds:
        moves, turns = ("m/s", "rad/s") if field == "v" else ("m", "rad")
        units = [turns if turn else moves for turn in kind.turns]
        if field == "q" and kind.nq > kind.nv:
            units = [unit for unit in units if unit == moves] + [""] * 4
        found += units
    return found


def _of_channel(channel: Channel, value: np.ndarray) -> list[str]:
    names = [unit.strip() for unit in channel.unit.split(",")]
    if len(names) == 1:
        return names * value.size
    with jax.ensure_compile_time_eval():
        which = np.ravel(channel.spread(np.arange(len(names))))
    return [names[int(i)] for i in which] if value.size == len(which) else [""] * value.size
