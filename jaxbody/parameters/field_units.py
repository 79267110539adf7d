"""Units of parameters: what the field says that a path leads to, and of initial states the coordinates."""

from __future__ import annotations

import numpy as np

from jaxbody.geometry import fields
from jaxbody.models.leaf_paths import Leaf
from jaxbody.models.models import Model


def units_of(leaf: Leaf, run: str, model: Model, value: np.ndarray) -> list[str]:
    """The unit of each number of a leaf, of the model (run "") or of a measurement; "" where there is none or it is not known."""
    name, _, field = leaf.path.removeprefix(f"{run}.").partition(".")
    if run and name in ("initial", "nodes"):
        row = _of_state(model, field)
        return row * (value.size // len(row))
    return fields.units_of(leaf.kind, value.shape)


def _of_state(model: Model, field: str) -> list[str]:
    """Of q or v: moves and turns; the numbers of a quaternion have none."""
    units = []
    for kind in model.layout.kinds:
        move, turn = ("m/s", "rad/s") if field == "v" else ("m", "rad")
        own = [turn if turns else move for turns in kind.turns]
        units += [unit for unit in own if unit == move] + [""] * 4 if field == "q" and kind.nq > kind.nv else own
    return units
