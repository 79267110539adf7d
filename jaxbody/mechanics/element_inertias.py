"""Inertia of elements that have a kinetic energy T(e, e_dot) of their own, such as inerters:
forces, and parts of the mass matrix.

With J = de/d(Delta, Xi),   M | -M~ | M_bb have J' T'' J,
and the force d/dt dT/de_dot - dT/de acts as tension does.
"""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp

from jaxbody.core.arrays import Array, Float
from jaxbody.geometry.frames import Frame, Instant
from jaxbody.model.elements.elements import Element
from jaxbody.model.joints.element_tables import (
    end_rows,
    inertial_tables,
    of_table,
    summed_on_frames,
)
from jaxbody.model.models import Model
from jaxbody.model.storage import KindTable


def accelerated(model: Model, now: Instant, table: KindTable, function) -> Any:
    """function(element, (A, B, ...), their derivatives in time) of the elements of one table, for
    the accelerations of the frames."""
    ends = (
        tuple(frames[rows] for rows in end_rows(model, table)) for frames in (now, now.changes())
    )
    return jax.vmap(function)(table.rows, *ends)


def inertial_wrenches(
    model: Model, now: Instant
) -> tuple[Float[Array, "n 3"], Float[Array, "n 3"]]:
    """Force and moment about its origin that the inertia of elements exerts on each frame, in
    world axes."""
    tables = inertial_tables(model)
    by_table = [accelerated(model, now, table, _inertial_wrenches) for table in tables]
    return summed_on_frames(model, tables, by_table)


def _inertial_wrenches(element: Element, frames, rates):
    return element.inertial_wrenches(frames, rates)


def element_inertia(
    model: Model, frames: Frame, twists: Float[Array, "nf n 6"]
) -> tuple[Float[Array, "n n"], Float[Array, "n"]]:
    """The part of the elements in the mass matrix of coordinates whose unit speeds move the frames
    by `twists`, and in the momenta of the frames' velocities."""
    mass, momenta = 0.0, 0.0
    for table in inertial_tables(model):
        slopes, second, first = of_table(model, frames, table, _of_element)
        rows: Any = end_rows(model, table)
        J = sum(
            slope @ jnp.swapaxes(twists[row], 1, 2) for slope, row in zip(slopes, rows, strict=True)
        )
        mass, momenta = (
            mass + jnp.sum(jnp.swapaxes(J, 1, 2) @ second @ J, 0),
            momenta + jnp.sum(J * first[:, :, None], (0, 1)),
        )
    return mass, momenta  # pyright: ignore[reportReturnType]  of at least one table


def _of_element(element: Element, *frames: Frame):
    """de_dot/d(velocity, angular velocity) of each frame, T'' and T' in e_dot."""
    e, e_dot = element.rates(*frames)
    k = e.size

    def rates(velocities):
        return element.rates(
            *(Frame(f.p, f.R, x[:3], x[3:]) for f, x in zip(frames, velocities, strict=True))
        )[1].reshape(k)

    slopes = jax.jacfwd(rates)([jnp.zeros(6, e.dtype)] * len(frames))
    second = jax.jacfwd(lambda rate: element.momentum(e, rate))(e_dot)
    return slopes, second.reshape(k, k), element.momentum(e, e_dot).reshape(k)
