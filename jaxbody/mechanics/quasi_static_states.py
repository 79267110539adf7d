"""States of rest on supports that are displaced or move slowly: in equilibrium with the present
poses of the supports, and moving with them.

    dV/dDelta(q, Xi) = 0,   K v = K~ Xi'      and with closures  c(q, Xi) = 0,
    J v = -c_Xi Xi' as well

Such a state is the initial state of a run that has been at rest for a long time: displaced and
tilted with its base, under gravity, at the speed of its base.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxbody.core.arguments import checked_dict
from jaxbody.core.arrays import Array, Float, is_concrete, rows_or_nan
from jaxbody.core.compilation.compile_options import program
from jaxbody.core.errors import JaxbodyError, Problem, Problems, Status
from jaxbody.lagrange import potential
from jaxbody.mechanics.constraints import CLOSED, closed_on
from jaxbody.mechanics.equilibria import Equilibrium, change_of_equilibrium, equilibrium_at
from jaxbody.mechanics.equilibrium_solvers import AT_REST, search_by_descent
from jaxbody.mechanics.force_balances import change_of_balance, from_start
from jaxbody.mechanics.hessians import configuration_at
from jaxbody.mechanics.load_paths import in_full, tangent
from jaxbody.model.element_states import holding, relaxed
from jaxbody.model.joints.frame_tables import completed, drawn, gaps_from
from jaxbody.model.joints.kinematics import (
    Coordinates,
    Motions,
    coordinates_at_rest,
    displacements,
    imposed,
    rest_poses,
)
from jaxbody.model.models import Model, size_of
from jaxbody.model.preconditions import (
    check_independent,
    check_potential,
    check_precision,
    check_state,
)
from jaxbody.model.states import State

MAX_STEPS = 200


class Rest(eqx.Module):
    """The initial state that is given as "rest"."""


def as_initial(initial: Any) -> Any:
    """Return Rest() for "rest" and other values unchanged."""
    return Rest() if isinstance(initial, str) and initial == "rest" else initial


@program
def rest_state(model: Model, motions: Motions, t) -> tuple[State, Equilibrium]:
    """Return the state of rest at time t, NaN where there is none, and its equilibrium."""
    coordinates = Coordinates(relaxed(model))
    xi, xi_dot = imposed(motions, t) if motions else jnp.zeros((2, 0, 6))

    def displaced(xi):
        return eqx.tree_at(lambda c: c.supports, coordinates, coordinates.supports.displaced(xi))

    on_supports, unloaded = displaced(xi), in_full((), model.gravity.dtype)
    start = _start(coordinates, on_supports)
    search = (
        from_start(on_supports, start, unloaded, model, MAX_STEPS, stability=False)
        if model.forces
        else search_by_descent(on_supports, start, MAX_STEPS)
    )
    eq = equilibrium_at(on_supports, search, unloaded, model)
    q, valid = eq.state.q, jnp.isin(eq.status, jnp.array(AT_REST))
    if model.forces:
        z = eq.state.z[model.layout.first_order]
        v, _ = change_of_balance(lambda xi: (displaced(xi), unloaded), xi, xi_dot, q, z)
        return jax.tree.map(lambda x: rows_or_nan(valid, x), State(q, v, eq.state.z)), eq
    K = tangent(configuration_at(on_supports, q, base=False), unloaded)
    K = jnp.where(valid, K, jnp.nan)
    v = change_of_equilibrium(lambda xi: (displaced(xi), unloaded), xi, xi_dot, q, K)
    return jax.tree.map(lambda x: rows_or_nan(valid, x), State(q, v, eq.state.z)), eq


def _start(coordinates: Coordinates, on_supports: Coordinates):
    """Return the start of the search: the reference pose, with free bodies moved along with the
    first support."""
    if not len(on_supports.supports.p):
        return on_supports.reference.q
    moved = on_supports.supports[0] @ coordinates.supports[0].inverse()
    bodies = jax.vmap(lambda pose: moved @ pose)(coordinates.bodies)
    model = on_supports.model
    return coordinates_at_rest(model, rest_poses(model, on_supports.supports, bodies))


def initial_state_of(model: Model, motions: Motions, t, initial: Any, where: str) -> State | None:
    """Return the initial state of a run. Error: the status of the equilibrium, if "rest" is given
    and no equilibrium is found."""
    if not isinstance(initial, Rest):
        return initial
    state, eq = rest_state(model, motions, t)
    if is_concrete(eq.status) and int(eq.status) not in AT_REST:
        raise JaxbodyError(
            Problem(
                Status(int(eq.status)).name,
                where,
                f'is "rest", but there is no equilibrium: {eq.report()}',
                "rest",
                hint="Give initial=State(q, v), or attach the bodies that are free to move.",
            )
        )
    return state


def excitation(
    model: Model, at: Equilibrium | State, displaced: dict[str, Any]
) -> Float[Array, "nf"]:
    """Return the exact generalized force of a finite displacement Xi of supports, {name: (xi, phi)}
    [m, rad], with the coordinates held fixed:

        F^e = -(dV/dDelta(0, Xi) - dV/dDelta(0, 0)),     K~ Xi to first order; (54), (57) of
                                                         the paper

    With closures the force is given in the independent coordinates of `linearize`, which are held
    while the others follow; NaN where the loops do not close. Coordinates of elements with memory
    are held, as for a quick displacement. Error: MEMORY for hysteretic elements, whose force
    depends on the path.

    Errors: UNKNOWN_NAME for a support, BAD_SHAPE, CLOSED_LOOPS for a model with closures built from
    traced numbers.

    >>> spring = jb.Spring(
    ...     ("mass", [0, 0, 0]), ("base", [0, 1, 0]), stiffness=50.0, free_length=1.0
    ... )
    >>> model = jb.Model(
    ...     bodies={"mass": jb.Body(mass=2.0, inertia=[1, 1, 1])},
    ...     joints={"mass": jb.Guide("world", axis=[0, 1, 0])},
    ...     supports={"base": jb.Support()},
    ...     elements={"s": spring},
    ... )
    >>> force = jb.excitation(model, model.reference, {"base": [0, 0.1, 0, 0, 0, 0]})
    >>> round(float(force[0]), 9)
    5.0
    """
    check_precision("excitation", model)
    check_potential("excitation", model)
    check_independent("excitation", model)
    state = at.state if isinstance(at, Equilibrium) else at
    check_state(model, state, "state")
    if any(role == "hysteretic" for block in model.layout.blocks for role in block.roles):
        raise JaxbodyError(
            Problem(
                "MEMORY",
                "excitation.model",
                "has hysteretic elements, whose force depends on the path of the displacement",
                limit="elements without hysteresis",
                hint="Simulate the displacement with a jb.inputs.Motion.",
            )
        )
    with Problems() as problems:
        displaced = checked_dict(displaced, "excitation.displaced", "support: 6 numbers", problems)
        xi = displacements(model, displaced, "excitation", problems)
    return _excitation(model, state, xi)


@program
def _excitation(model: Model, state: State, xi: Float[Array, "ns 6"]) -> Float[Array, "nf"]:
    model = holding(model, completed(model, state).z)
    coordinates, still = Coordinates(model), jnp.zeros(model.layout.nv, xi.dtype)
    own = np.array(model.independent, int)
    rests, held = drawn(coordinates), np.isin(np.arange(len(still)), own)

    def energy(delta, xi):
        supports = coordinates.supports_at(xi, jnp.zeros_like(xi))
        q = coordinates.retract(state.q, still.at[own].set(delta))
        if model.closures:
            q = closed_on(coordinates, rests, supports, q, held)
        frames = coordinates.frames(q, still, supports)
        left = jnp.max(jnp.abs(gaps_from(model, rests, frames, q)), initial=0.0)
        return potential(model, frames), left <= CLOSED * size_of(model)

    def slope(xi):
        force, reached = jax.grad(energy, has_aux=True)(jnp.zeros(len(own), xi.dtype), xi)
        return rows_or_nan(reached, force)

    return slope(jnp.zeros_like(xi)) - slope(xi)
