"""Forces at rest: of what is attached to a support, and how deformations and forces stand
in tables."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxbody.core import tables
from jaxbody.core.arrays import Array, Float, is_concrete
from jaxbody.mechanics.hessians import Configuration, frame_twists, slope
from jaxbody.mechanics.load_paths import AppliedLoads, generalized_force, summed, with_load_gravity
from jaxbody.model.elements.torsions import Torsion
from jaxbody.model.models import Model

Row = tuple[Any, ...]


def residual_and_reactions(
    at: Configuration, applied: AppliedLoads, factor: Float[Array, ""] | float = 1.0
) -> tuple[Float[Array, "nv"], Float[Array, "ns 6"]]:
    """dV/dDelta - lambda Q; and force and moment about its origin on each support, -dV/dXi with the
    loads on all that it carries by joints, in world axes. `at` has columns for the base."""
    layout, nv = at.model.layout, at.model.layout.nv
    G = slope(with_load_gravity(at, applied, factor))
    Q = generalized_force(at.model, at.q, applied.loads, applied.weights, jnp.zeros(nv, at.q.dtype))
    total, twists, t = -G[nv:], frame_twists(at)[:, nv:], jnp.zeros((), at.q.dtype)
    for load, weight in zip(applied.loads, applied.weights, strict=True):
        row = layout.frame(load.on)
        now = at.frames[row].at_time(t)
        F, M = summed(
            lambda load, weight, now=now: tuple(weight * x for x in load.wrench(now)), load, weight
        )
        total = total + factor * jnp.sum(twists[row] * jnp.concatenate([F, M])[None], -1)
    return G[:nv] - factor * Q, total.reshape(-1, 6)


def element_rows(
    model: Model, deformations: dict[str, Array], forces: dict[str, Array]
) -> tuple[tuple[str, ...], list[Row]]:
    """The headings and rows of a table of elements; what is about axes stands in columns of its
    own, where an element has it."""
    e, f = (_without_dust(numbers) for numbers in (deformations, forces))
    rows = [
        (name, *along_and_about(model, name, e[name]), *along_and_about(model, name, f[name]))
        for name in deformations
    ]
    heads = ("element", "deformation [m]", "rotation [rad]", "force [N]", "moment [N m]")
    if any(row[2] is not None for row in rows):
        return heads, rows
    return ("element", "elongation [m]", "force [N]"), [
        (name, e, force) for name, e, _, force, _ in rows
    ]


def along_and_about(model: Model, name: str, numbers: Any) -> tuple[Any, Any]:
    """The numbers of an element along its axes, and those about them."""
    element = model[name]
    if element.size == 1:
        return (None, numbers) if isinstance(element, Torsion) else (numbers, None)
    return numbers[..., :3], numbers[..., 3:]


def _without_dust(numbers: dict[str, Any]) -> dict[str, Any]:
    """The numbers, zero where they are rounding errors of the largest."""
    every = jax.tree.leaves(numbers)
    largest = (
        max((np.abs(x).max(initial=0.0) for x in every), default=0.0) if is_concrete(every) else 0.0
    )
    return jax.tree.map(lambda x: tables.without_dust(x, largest), numbers)


def support_rows(reactions: dict[str, tuple[Array, Array]]) -> tuple[tuple[str, ...], list[Row]]:
    """The headings and rows of a table of supports."""
    rows = [(name, *both) for name, both in _without_dust(reactions).items()]
    return ("support", "force on it [N]", "moment [N m]"), rows
