"""The conditions c(q) = 0 of all closures of a model, and the configurations that fulfil them together with other conditions.

A configuration is found by Gauss-Newton steps

    q <- q (+) -F_q^+ F(q)

with the least squares inverse F_q^+, so that conditions that repeat others, such as those out of the plane of a planar linkage, do no harm.
A few more steps with the last inverse, held fixed, are differentiated as they are: each makes the derivatives of one more order exact, in
forward and reverse mode, whatever steps led there, and the inverse has no derivative.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxbody.core.arrays import Array, Bool, Float
from jaxbody.geometry.closures import Coupling, as_slide
from jaxbody.geometry.frames import Frame, Pose
from jaxbody.mechanics.kinematics import Chart, Coordinates, with_world
from jaxbody.models.models import Model
from jaxbody.models.sizes import scale_of, size_of
from jaxbody.models.storage import KindTable
from jaxbody.numerics.small_systems import independent_rows

Conditions = Callable[[Model, Any, Float[Array, "nq"]], Float[Array, "n"]]  # F of the model, of other numbers and of q
STEPS = 30  # of the search; ten are enough from a rough drawing
ORDERS = 4  # of derivatives that are exact
LARGEST_STEP = 0.5  # of an increment, of the size of the model or in rad
PRECISE = 1e-12  # of the size of the model; about where rounding begins
CLOSED = 1e-9  # of the size of the model
RANK = 1e-9  # singular values below this part of the largest count as zero


def names_of_rows(model: Model) -> tuple[str, ...]:
    """The name of each condition: ("upper ball x", ...)."""
    return tuple(f"{name} {row}" for table in model.closures for name in table.names for row in table.rows.rows)


def redundant_rows(model: Model, slopes: Float[Array, "n nv"]) -> tuple[str, ...]:
    """The conditions that follow from the others, such as those out of the plane of a planar linkage, by their slopes in meters."""
    independent = independent_rows(np.asarray(slopes))
    return tuple(name for i, name in enumerate(names_of_rows(model)) if i not in independent)


def turning_rows(model: Model) -> np.ndarray:
    """(n,): True for conditions on angles."""
    return np.array([turns for table in model.closures for _ in table.names for turns in _turning(table)], bool)


def _turning(table: KindTable) -> np.ndarray:
    return np.array([row.startswith("turn") for row in table.rows.rows])


def gaps(model: Model, coordinates: Coordinates, frames: Frame, q: Float[Array, "nq"]) -> Float[Array, "n"]:
    """c of all closures, in meters: angles and sines of angles times the size of the model."""
    drawn = with_world(coordinates.supports.at_rest(), coordinates.bodies.at_rest())
    size, found = jax.lax.stop_gradient(size_of(model)), []  # only a scale: c is zero
    for table in model.closures:
        ends, (A, B) = _ends(model, table, frames, q), _ends(model, table, drawn, q)
        values = jax.vmap(lambda closure, *poses: closure.gap(*poses))(table.rows, *ends, A.inverse() @ B)
        found.append((values * jnp.where(_turning(table), size, 1.0)[None]).ravel())
    return jnp.concatenate([jnp.zeros(0, frames.p.dtype), *found])


def closure_gaps(model: Model, values: Any, q: Float[Array, "nq"]) -> Float[Array, "n"]:
    """c(q), with the supports in their reference poses."""
    return gaps_at(Coordinates(model), q)


def gaps_at(coordinates: Coordinates, q: Float[Array, "nq"]) -> Float[Array, "n"]:
    """c(q)."""
    return gaps(coordinates.model, coordinates, coordinates.at_rest(q), q)


def closed(model: Model, q: Float[Array, "nq"]) -> Float[Array, "nq"]:
    """The nearest q in which all closures are fulfilled, as far as it is reached."""
    return _searched(closure_gaps, None, model, None, q)


def how_open(model: Model, q: Float[Array, "nq"]) -> Float[Array, ""]:
    """The largest |c| over the size of the model."""
    return _largest(closure_gaps(model, None, q)) / size_of(model)


def _ends(model: Model, table: KindTable, frames: Frame, q: Float[Array, "nq"]) -> list[Pose]:
    """The poses at both ends of each closure of a table; of couplings, their coordinates as poses."""
    if isinstance(table.rows, Coupling):
        places = [model.layout.coordinate_places[path][0] for path in (table.rows.of, table.rows.by)]
        return [as_slide(jnp.broadcast_to(q[i], len(table))) for i in places]
    rows = [np.array([model.layout.frame(name) for name in end]) for end in zip(*table.links, strict=True)]
    return [Pose(frames.p[end], frames.R[end]) for end in rows]


def solve(conditions: Conditions, model: Model, values: Any, start: Float[Array, "nq"], held: np.ndarray | None = None):
    """(q, largest |F| over the size of the model) where F(model, values, q) = 0, from a start, with the least movement where that leaves
    freedom; `held` is True for the coordinates that must not move."""
    q = near(conditions, model, values, _searched(conditions, held, *jax.lax.stop_gradient((model, values, start))), held)
    return q, _largest(conditions(model, values, q)) / size_of(model)


def near(conditions: Conditions, model: Model, values: Any, q: Float[Array, "nq"], held: np.ndarray | None = None) -> Float[Array, "nq"]:
    """The q with F = 0 next to one that has it for these values, as a function of the model and the values."""
    q = jax.lax.stop_gradient(q)
    inverse = jax.lax.stop_gradient(_inverse(conditions, held, *jax.lax.stop_gradient((model, values, q))))
    chart = Chart(model)
    return jax.lax.scan(lambda q, _: (chart.retract(q, -inverse @ conditions(model, values, q)), None), q, length=ORDERS)[0]


def _inverse(conditions: Conditions, held: np.ndarray | None, model: Model, values: Any, q: Float[Array, "nq"]) -> Float[Array, "nv n"]:
    """F_q^+, with the least movement in meters."""
    scale = scale_of(model, size_of(model)) * (1.0 if held is None else np.where(held, 0.0, 1.0))
    _, slopes = values_and_slopes(Chart(model), lambda q: conditions(model, values, q), q)
    return scale[:, None] * jnp.linalg.pinv(slopes * scale[None], rtol=RANK)


def _searched(conditions: Conditions, held: np.ndarray | None, model: Model, values: Any, start: Float[Array, "nq"]) -> Float[Array, "nq"]:
    """Steps until F is as small as rounding allows, or no more are left."""
    precise = PRECISE * size_of(model)

    def going_on(carry: tuple[Array, Array]) -> Bool[Array, ""]:
        i, q = carry
        return (i < STEPS) & (_largest(conditions(model, values, q)) > precise)

    def step(carry: tuple[Array, Array]) -> tuple[Array, Array]:
        i, q = carry
        return i + 1, _stepped(conditions, held, model, values, q)

    return jax.lax.while_loop(going_on, step, (jnp.array(0), start))[1]


def _stepped(conditions: Conditions, held: np.ndarray | None, model: Model, values: Any, q: Float[Array, "nq"]) -> Float[Array, "nq"]:
    """q after a Gauss-Newton step, shortened where an increment is larger than LARGEST_STEP."""
    size = size_of(model)
    delta = -_inverse(conditions, held, model, values, q) @ conditions(model, values, q)
    largest = _largest(delta / scale_of(model, size)) / size
    return Chart(model).retract(q, delta * jnp.where(largest > LARGEST_STEP, LARGEST_STEP / jnp.maximum(largest, LARGEST_STEP), 1.0))


def values_and_slopes(chart: Chart, conditions: Callable[[Array], Array], q: Float[Array, "nq"]):
    """F(q) and dF/dDelta."""
    zero = jnp.zeros(chart.model.layout.nv, q.dtype)
    return conditions(q), jax.jacfwd(lambda delta: conditions(chart.retract(q, delta)))(zero)


def _largest(x: Float[Array, "n"]) -> Float[Array, ""]:
    return jnp.max(jnp.abs(x), initial=0.0)
