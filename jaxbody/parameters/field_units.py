"""Units of parameters: those of the field at a path, and for initial states those of the coordinates."""

from __future__ import annotations

from jaxbody.core.arrays import Array
from jaxbody.geometry import fields
from jaxbody.models.leaf_paths import Leaf
from jaxbody.models.models import Model


def units_of(leaf: Leaf, model: Model, value: Array) -> list[str]:
    """The unit of each number of a leaf; "" for none, or if it is unknown."""
    if leaf.kind.domain not in ("configuration", "speeds"):
        return fields.units_of(leaf.kind, value.shape)
    row = _of_state(model, leaf.kind.domain == "speeds")
    return row * (value.size // len(row))


def _of_state(model: Model, speeds: bool) -> list[str]:
    """Units of q or v, by coordinate; the numbers of a quaternion have none."""
    units = []
    for kind in model.layout.kinds:
        length, angle = ("m/s", "rad/s") if speeds else ("m", "rad")
        own = [angle if turns else length for turns in kind.turns]
        units += own if speeds or kind.nq == kind.nv else [unit for unit in own if unit == length] + [""] * 4
    return units
