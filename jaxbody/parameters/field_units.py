"""Units of parameters: what the field says that a path leads to, and of initial states the coordinates."""

from __future__ import annotations

import numpy as np

from jaxbody.geometry import fields
from jaxbody.models.leaf_paths import Leaf
from jaxbody.models.models import Model


def units_of(leaf: Leaf, model: Model, value: np.ndarray) -> list[str]:
    """The unit of each number of a leaf; "" where there is none or it is not known."""
    if leaf.kind.domain not in ("configuration", "speeds"):
        return fields.units_of(leaf.kind, value.shape)
    row = _of_state(model, leaf.kind.domain == "speeds")
    return row * (value.size // len(row))


def _of_state(model: Model, speeds: bool) -> list[str]:
    """Of q or v: moves and turns; the numbers of a quaternion have none."""
    units = []
    for kind in model.layout.kinds:
        move, turn = ("m/s", "rad/s") if speeds else ("m", "rad")
        own = [turn if turns else move for turns in kind.turns]
        units += own if speeds or kind.nq == kind.nv else [unit for unit in own if unit == move] + [""] * 4
    return units
