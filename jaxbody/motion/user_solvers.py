"""The equations of motion as a function of time, state and model, for a solver of one's own, and
its solution as a trajectory."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp

from jaxbody.core.arrays import Array, Float
from jaxbody.core.errors import Problems, Status
from jaxbody.mechanics.closed_loops import acceleration
from jaxbody.model.element_states import holding
from jaxbody.model.inputs.loads import Load, loads_of
from jaxbody.model.joints.element_tables import state_rates
from jaxbody.model.joints.kinematics import Chart, Motions, frames_at_time
from jaxbody.model.models import Model
from jaxbody.model.preconditions import check_moves, check_precision
from jaxbody.model.states import State
from jaxbody.motion.simulations import motions_of
from jaxbody.motion.trajectories import Trajectory


class EquationsOfMotion(eqx.Module):
    """f(t, state, model) with the motions and loads of `equations_of_motion`."""

    motions: Motions
    loads: tuple[Load, ...]

    def __call__(self, t: Any, state: State, model: Model) -> State:
        """The rates q', v' and z' of a state at time t [s]."""
        time, held = jnp.asarray(t, state.q.dtype), holding(model, state.z)
        z_dot = (
            state_rates(held, frames_at_time(held, self.motions, time, state))
            if model.layout.nz
            else state.z
        )
        return State(
            Chart(model).rate(state.q, state.v),
            acceleration(model, state, time, self.motions, self.loads),
            z_dot,
        )

    def trajectory(self, times: Float[Array, "nt"], states: State, model: Model) -> Trajectory:
        """States at these times, such as `ts` and `ys` of a solution, with all that a trajectory
        knows: poses, forces, energies, plots, and what sensors read by `measure`. Quaternions
        are normalized."""
        states = State(jax.vmap(model.layout.normalized)(states.q), states.v, states.z)
        return Trajectory(
            times=times,
            state=states,
            status=jnp.array(Status.OK.value),
            statistics={},
            end=(times[-1], jax.tree.map(lambda x: x[-1], states)),
            model=model,
            motions=self.motions,
            loads=self.loads,
        )


def equations_of_motion(
    model: Model, *, motion: dict[str, Any] | None = None, loads: dict[str, Load] | None = None
) -> EquationsOfMotion:
    """The equations of motion y' = f(t, y, model) for `diffrax.ODETerm`, with any solver,
    controller, adjoint, SaveAt and Event.

    y is a State, `f(t, y, model)` the State of its rates; give the model as `args`, by which
    derivatives are taken. `f.trajectory(ts, ys, model)` makes the solution a Trajectory. The
    equations are those that `simulate` integrates: structured, with multipliers where there are
    closures, to which `simulate` projects each step and a solver of one's own does not: there c
    drifts by its errors.

    Args:
        motion: {support: motion}; a support without an entry is at rest.
        loads: {name: load} on bodies; by default none.

    Errors: UNKNOWN_NAME for a support, UNKNOWN_BODY for a load, NOTHING_MOVES; MEMORY from f, of a
    state without the z of its elements.

    A mass on a spring falls until it has moved by 0.05 m:

    >>> import diffrax, optimistix
    >>> spring = Spring(("mass", [0, 0, 0]), ("world", [0, 0, 1]), stiffness=50.0, free_length=1.0)
    >>> model = Model(
    ...     bodies={"mass": Body(mass=2.0, inertia=[1, 1, 1])},
    ...     joints={"mass": Guide("world", axis=[0, 0, 1])},
    ...     elements={"s": spring},
    ...     gravity=[0, 0, -9.81],
    ... )
    >>> f = equations_of_motion(model)
    >>> low = diffrax.Event(lambda t, y, args, **_: y.q[0] + 0.05, optimistix.Newton(1e-9, 1e-9))
    >>> done = diffrax.diffeqsolve(
    ...     diffrax.ODETerm(f),
    ...     diffrax.Tsit5(),
    ...     0.0,
    ...     2.0,
    ...     0.01,
    ...     model.reference,
    ...     args=model,
    ...     event=low,
    ...     stepsize_controller=diffrax.PIDController(rtol=1e-9, atol=1e-9),
    ... )
    >>> round(float(done.ts[0]), 6), round(float(jnp.arccos(1 - 0.05 * 25 / 9.81) / 5), 6)
    (0.102068, 0.102068)
    """
    check_precision("equations_of_motion", model)
    check_moves("equations_of_motion", model)
    with Problems() as problems:
        motions = problems.gather(lambda: motions_of(model, motion))
        loads_on = problems.gather(lambda: loads_of(loads, model.layout.bodies))
    return EquationsOfMotion(motions or (), loads_on or ())
