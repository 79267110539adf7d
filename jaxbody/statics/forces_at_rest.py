"""Forces at rest: of what is attached to a support, and how deformations and forces stand in tables."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxbody.core import tables
from jaxbody.core.arrays import Array, Float, is_concrete
from jaxbody.elements.torsions import Torsion
from jaxbody.mechanics.hessians import configuration_at, frame_twists, slope
from jaxbody.mechanics.kinematics import Coordinates
from jaxbody.models.models import Model
from jaxbody.statics.load_paths import AppliedLoads, summed, with_load_gravity

Row = tuple[Any, ...]


def on_supports(
    coordinates: Coordinates, q: Float[Array, "nq"], applied: AppliedLoads, factor: Float[Array, ""] | float = 1.0
) -> Float[Array, "ns 6"]:
    """Force and moment about its origin on each support: -dV/dXi, and the loads on all that it carries by joints, in world axes."""
    layout = coordinates.model.layout
    if not layout.supports:
        return jnp.zeros((0, 6), q.dtype)
    at = with_load_gravity(configuration_at(coordinates, q), applied, factor)
    total, twists, t = -slope(at)[layout.nv :], frame_twists(at)[:, layout.nv :], jnp.zeros((), q.dtype)
    for load, weight in zip(applied.loads, applied.weights, strict=True):
        row = layout.frame(load.on)
        now = at.frames[row].at_time(t)
        F, M = summed(lambda load, weight, now=now: tuple(weight * x for x in load.wrench(now)), load, weight)
        total = total + factor * jnp.sum(twists[row] * jnp.concatenate([F, M])[None], -1)
    return total.reshape(-1, 6)


def element_rows(model: Model, deformations: dict[str, Array], forces: dict[str, Array]) -> tuple[tuple[str, ...], list[Row]]:
    """The headings and rows of a table of elements; what is about axes stands in columns of its own, where an element has it."""
    e, f = (_without_dust(numbers) for numbers in (deformations, forces))
    rows = [(name, *along_and_about(model, name, e[name]), *along_and_about(model, name, f[name])) for name in deformations]
    heads = ("element", "deformation [m]", "rotation [rad]", "force [N]", "moment [N m]")
    if any(row[2] is not None for row in rows):
        return heads, rows
    return ("element", "elongation [m]", "force [N]"), [(name, e, force) for name, e, _, force, _ in rows]


def along_and_about(model: Model, name: str, numbers: Any) -> tuple[Any, Any]:
    """The numbers of an element along its axes, and those about them."""
    element = model[name]
    if element.size == 1:
        return (None, numbers) if isinstance(element, Torsion) else (numbers, None)
    return numbers[..., :3], numbers[..., 3:]


def _without_dust(numbers: dict[str, Any]) -> dict[str, Any]:
    """The numbers, zero where they are rounding errors of the largest."""
    every = jax.tree.leaves(numbers)
    largest = max((np.abs(x).max(initial=0.0) for x in every), default=0.0) if is_concrete(every) else 0.0
    return jax.tree.map(lambda x: tables.without_dust(x, largest), numbers)


def support_rows(reactions: dict[str, tuple[Array, Array]]) -> tuple[tuple[str, ...], list[Row]]:
    """The headings and rows of a table of supports."""
    rows = [(name, *both) for name, both in _without_dust(reactions).items()]
    return ("support", "force on it [N]", "moment [N m]"), rows
