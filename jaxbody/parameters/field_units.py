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
    row = model.layout.v_units if leaf.kind.domain == "speeds" else model.layout.q_units
    return list(row) * (value.size // len(row))
