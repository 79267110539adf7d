"""At rest on supports that are displaced or move: in equilibrium where they are, moving along as slowly as they do.

    dV/dDelta(q, Xi) = 0,   K v = K~ Xi'

is where a run begins that has stood for long: off its reference pose where its base is, at the speed of its base; tilted with it, gravity counts.
"""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxbody.core.compile_options import jit_unoptimized
from jaxbody.core.errors import JaxbodyError, Problem, Status, is_concrete
from jaxbody.mechanics.hessians import configuration_at
from jaxbody.mechanics.kinematics import Coordinates, Motions
from jaxbody.models.models import Model, at_rest_in, rest_poses
from jaxbody.models.states import State
from jaxbody.statics.equilibria import Equilibrium, equilibrium_at, no_loads, search_by_descent
from jaxbody.statics.load_paths import residual, tangent

GOOD = (Status.OK.value, Status.TABLE_RANGE.value)
MAX_STEPS = 200


class Rest(eqx.Module):
    """In place of an initial state: at rest, as "rest" means it."""


def as_initial(initial: Any) -> Any:
    """ "rest" as what it means."""
    return Rest() if isinstance(initial, str) and initial == "rest" else initial


@jit_unoptimized
def rest_state(model: Model, motions: Motions, t) -> tuple[State, Equilibrium]:
    """The state at rest at time t, NaN where there is none, and the equilibrium that it is."""
    coordinates = Coordinates(model)
    xi, xi_dot = jnp.zeros((0, 6)), jnp.zeros((0, 6))
    if motions:
        xi, xi_dot = jax.jvp(lambda t: jnp.stack([motion(t) for motion in motions]), (t,), (jnp.ones_like(t),))

    def displaced(xi):
        return eqx.tree_at(lambda c: c.supports, coordinates, coordinates.supports.displaced(xi))

    there, none = displaced(xi), no_loads(model.gravity.dtype)
    eq = equilibrium_at(there, search_by_descent(there, _carried(coordinates, there), MAX_STEPS), none)
    q, good = eq.state.q, jnp.isin(eq.status, np.array(GOOD))
    drift = jax.jvp(lambda xi: residual(configuration_at(displaced(xi), q, base=False), none), (xi,), (xi_dot,))[1]
    K = tangent(configuration_at(there, q, base=False), none)
    v = -jnp.linalg.solve(jnp.where(good, K, jnp.nan), drift)
    return State(jnp.where(good, q, jnp.nan), v), eq


def _carried(coordinates: Coordinates, there: Coordinates):
    """Where the search begins: the reference pose, bodies that are free on the world carried along with the first support."""
    if not len(there.supports.p):
        return there.reference.q
    now, before = (jax.tree.map(lambda x: x[0], supports) for supports in (there.supports, coordinates.supports))
    moved = now @ before.inverse()
    bodies = jax.vmap(lambda pose: moved @ pose)(coordinates.bodies)
    return at_rest_in(there.model, rest_poses(there.model, there.supports, bodies)).q


def initial_state_of(model: Model, motions: Motions, t, initial: State | Rest | None, where: str) -> State | None:
    """The state that a run begins from. Error: the code of the equilibrium's status, where rest is asked for and there is none."""
    if not isinstance(initial, Rest):
        return initial
    state, eq = rest_state(model, motions, t)
    if is_concrete(eq.status) and int(eq.status) not in GOOD:
        hint = "Give initial=State(q, v), or hold what is free to move."
        message = f'is "rest", which is none here: {eq.report()}'
        raise JaxbodyError(Problem(Status(int(eq.status)).name, where, message, "rest", hint=hint))
    return state
