"""The conditions c(q) = 0 of all closures of a model, and the configurations that fulfill them
together with other conditions.

A configuration is found by Gauss-Newton steps

    q <- q (+) -F_q^+ F(q)

with the least squares inverse F_q^+, which allows redundant conditions, such as those out of the
plane of a planar linkage. These steps are differentiated one by one, because the result depends on
all of them where degrees of freedom remain. They are followed by a few steps in which the last
inverse is kept; each of these makes the derivatives of one more order exact, in forward and reverse
mode.
"""

from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxbody.core.arrays import Array, Bool, Float, is_concrete, nan_unless
from jaxbody.core.compilation.compile_options import program
from jaxbody.core.errors import warn
from jaxbody.geometry.frames import Frame, Pose
from jaxbody.model.joints.frame_tables import completed, gaps_at, gaps_from
from jaxbody.model.joints.kinematics import Chart, Coordinates
from jaxbody.model.models import Model, scale_of, size_of
from jaxbody.model.states import State
from jaxbody.numerics.precisions import in_float64

# F(model, values, q)
Conditions = Callable[[Model, Any, Float[Array, "nq"]], Float[Array, "n"]]
CLOSING = 12  # steps for an initial state
STEPS = 30  # most steps of the search; ten are enough from a rough drawing
ORDERS = 4  # derivatives are exact up to this order
LARGEST_STEP = 0.5  # largest increment of a step, in sizes of the model or rad
PRECISE = 1e-12  # |c| over the size of the model at which rounding begins
CLOSED = 1e-9  # |c| over the size of the model up to which closures count as fulfilled
RANK = 1e-9  # singular values, relative to the largest, below which they count as zero


def closure_gaps(model: Model, values: Any, q: Float[Array, "nq"]) -> Float[Array, "n"]:
    """Return c(q) [m], with the supports in their reference poses; `values` have no effect."""
    return gaps_at(Coordinates(model), q)


def closed(coordinates: Coordinates, q: Float[Array, "nq"]) -> Float[Array, "nq"]:
    """Return the configuration nearest to q in which all closures are fulfilled; where the search
    fails, the configuration at which it ended."""
    return _searched(
        lambda _, coordinates, q: gaps_at(coordinates, q), None, coordinates.model, coordinates, q
    )


def closed_on(
    coordinates: Coordinates,
    rests: list[Pose],
    supports: Frame,
    q: Float[Array, "nq"],
    held: np.ndarray | None = None,
) -> Float[Array, "nq"]:
    """Return the configuration nearest to q in which all closures are fulfilled on moved supports,
    by a fixed number of steps that are differentiated with respect to q and the model. `rests`: the
    relative poses of the closures as drawn; `held`: True for the coordinates that must not move."""

    def conditions(model: Model, values: Any, q: Float[Array, "nq"]) -> Float[Array, "n"]:
        return gaps_from(
            model, rests, coordinates.frames(q, jnp.zeros(model.layout.nv, q.dtype), supports), q
        )

    step = partial(_stepped, conditions, held, coordinates.model, None)
    return jax.lax.scan(lambda q, _: (step(q), None), q, length=CLOSING)[0]


def assembled_reference(model: Model) -> State:
    """Return the state at rest nearest to the drawn one in which all closures are fulfilled and
    elements with memory are relaxed; it has derivatives with respect to every point and length.
    Where the search fails, the state is NaN if it is traced; otherwise a warning NOT_CLOSED is
    issued."""
    state, reached = _assembled(model)
    if not is_concrete(state):
        return jax.tree.map(lambda x: nan_unless(reached, x), state)
    if not reached:
        remedy = in_float64(state.q.dtype) or "`assemble` says which"
        warn("NOT_CLOSED", f"model.reference: its closures cannot be fulfilled; {remedy}")
    return state


@program
def _assembled(model: Model) -> tuple[State, Bool[Array, ""]]:
    coordinates = Coordinates(model)
    drawn = coordinates.reference
    q, far = solve(closure_gaps, model, None, drawn.q)
    return completed(model, State(q, drawn.v), coordinates.at_rest(q)), far <= CLOSED


def how_open(coordinates: Coordinates, q: Float[Array, "nq"]) -> Float[Array, ""]:
    """Return the largest |c| relative to the size of the model."""
    return _largest(gaps_at(coordinates, q)) / size_of(coordinates.model)


def solve(
    conditions: Conditions,
    model: Model,
    values: Any,
    start: Float[Array, "nq"],
    held: np.ndarray | None = None,
):
    """Return (q, largest |F| over the size of the model) with F(model, values, q) = 0; of several
    solutions, the one near `start` that needs the least movement. `held`: True for the coordinates
    that must not move."""
    q = near(conditions, model, values, _searched(conditions, held, model, values, start), held)
    return q, _largest(conditions(model, values, q)) / size_of(model)


def near(
    conditions: Conditions,
    model: Model,
    values: Any,
    q: Float[Array, "nq"],
    held: np.ndarray | None = None,
) -> Float[Array, "nq"]:
    """Return q with F = 0 as a differentiable function of the model and the values, from a q that
    fulfills F = 0 for these values."""
    inverse = jax.lax.stop_gradient(
        _inverse(conditions, held, *jax.lax.stop_gradient((model, values, q)))
    )
    return jax.lax.scan(
        lambda q, _: (Chart(model).retract(q, -inverse @ conditions(model, values, q)), None),
        q,
        length=ORDERS,
    )[0]


def _inverse(
    conditions: Conditions,
    held: np.ndarray | None,
    model: Model,
    values: Any,
    q: Float[Array, "nq"],
) -> Float[Array, "nv n"]:
    """Return F_q^+, which gives the least movement in meters."""
    scale = scale_of(model, size_of(model)) * (1.0 if held is None else np.where(held, 0.0, 1.0))
    _, slopes = values_and_slopes(Chart(model), lambda q: conditions(model, values, q), q)
    return scale[:, None] * jnp.linalg.pinv(slopes * scale[None], rtol=RANK)


@partial(jax.custom_jvp, nondiff_argnums=(0, 1))
def _searched(
    conditions: Conditions,
    held: np.ndarray | None,
    model: Model,
    values: Any,
    start: Float[Array, "nq"],
) -> Float[Array, "nq"]:
    """Return q after steps until F is as small as rounding allows, or STEPS steps."""

    def going_on(carry: tuple[Array, Array]) -> Bool[Array, ""]:
        i, q = carry
        return (i < STEPS) & _unprecise(conditions, model, values, q)

    def step(carry: tuple[Array, Array]) -> tuple[Array, Array]:
        i, q = carry
        return i + 1, _stepped(conditions, held, model, values, q)

    return jax.lax.while_loop(going_on, step, (jnp.array(0), start))[1]


@_searched.defjvp
def _searched_jvp(conditions: Conditions, held: np.ndarray | None, primals: Any, tangents: Any):
    """Differentiate the same steps in a loop of fixed length, which reverse mode requires."""

    def steps(model: Model, values: Any, start: Array) -> Array:
        def step(q: Array, _: None) -> tuple[Array, None]:
            more = partial(_stepped, conditions, held, model, values, q)
            return jax.lax.cond(_unprecise(conditions, model, values, q), more, lambda: q), None

        return jax.lax.scan(step, start, length=STEPS)[0]

    return jax.jvp(steps, primals, tangents)


def _unprecise(
    conditions: Conditions, model: Model, values: Any, q: Float[Array, "nq"]
) -> Bool[Array, ""]:
    return _largest(conditions(model, values, q)) > PRECISE * size_of(model)


def _stepped(
    conditions: Conditions,
    held: np.ndarray | None,
    model: Model,
    values: Any,
    q: Float[Array, "nq"],
) -> Float[Array, "nq"]:
    """Return q after one Gauss-Newton step, shortened where an increment is larger than
    LARGEST_STEP."""
    size = size_of(model)
    delta = -_inverse(conditions, held, model, values, q) @ conditions(model, values, q)
    largest = _largest(delta / scale_of(model, size)) / size
    return Chart(model).retract(
        q,
        delta
        * jnp.where(largest > LARGEST_STEP, LARGEST_STEP / jnp.maximum(largest, LARGEST_STEP), 1.0),
    )


def values_and_slopes(chart: Chart, conditions: Callable[[Array], Array], q: Float[Array, "nq"]):
    """Return F(q) and dF/dDelta, of the conditions F."""
    zero = jnp.zeros(chart.model.layout.nv, q.dtype)
    return conditions(q), jax.jacfwd(lambda delta: conditions(chart.retract(q, delta)))(zero)


def _largest(x: Float[Array, "n"]) -> Float[Array, ""]:
    return jnp.max(jnp.abs(x), initial=0.0)
