"""The integration, by our own loops in blocks or by diffrax: tolerances, statuses, samples."""

from __future__ import annotations

import diffrax
import jax
import jax.numpy as jnp
import optimistix

from jaxbody.core.arrays import Array, Bool, Float
from jaxbody.core.compile_options import jit_optimized
from jaxbody.core.errors import Status
from jaxbody.inputs.signals import kinks_of
from jaxbody.laws.measured_curves import has_range
from jaxbody.mechanics.canonical_equations import Canonical
from jaxbody.mechanics.energies import outside_law_range
from jaxbody.mechanics.equations_of_motion import Dynamics, dynamics_of
from jaxbody.mechanics.kinematics import frames_at_time
from jaxbody.numerics import dormand_prince_steps
from jaxbody.numerics.gauss_collocations import Gauss
from jaxbody.numerics.precisions import reachable
from jaxbody.simulations.trajectories import Trajectory

FINEST = {"float64": 0.0, "float32": 1.5e-5}  # least local error; below it float32 takes shorter steps without a gain
SAFETY = 0.1  # local error over rtol, because the order between steps is lower than that of a step
CONSTANT = diffrax.ConstantStepSize | diffrax.StepTo
OWN_STEPS = diffrax.ConstantStepSize | None
STATUSES = (
    (diffrax.RESULTS.successful, Status.OK),
    (diffrax.RESULTS.max_steps_reached, Status.MAX_STEPS),
    (diffrax.RESULTS.dt_min_reached, Status.DT_MIN),
)


@jit_optimized
def integrate(model, times, motions, loads, initial, rtol, solver, stepsize_controller, adjoint, dt0, max_steps, meter) -> Trajectory:
    """The jitted core of `simulate`: arrays only, never raises."""
    dynamics = dynamics_of(model, motions, loads)
    initial = dynamics.coordinates.reference if initial is None else initial
    own_loops = (
        solver is None
        and isinstance(stepsize_controller, OWN_STEPS)
        and isinstance(adjoint, diffrax.ForwardMode | None)
        and isinstance(meter, diffrax.NoProgressMeter)
    )
    by = _by_blocks if own_loops else _by_diffrax
    form = Canonical(dynamics) if isinstance(solver, Gauss) else dynamics
    y0 = form.pack(initial, times[0])
    samples, t_end, y_end, code, accepted, rejected = by(form, y0, times, rtol, solver, stepsize_controller, adjoint, dt0, max_steps, meter)
    finite = jnp.isfinite(samples).all(1)
    overflow = (code == Status.OK.value) & ~finite.all()  # which constant steps do not detect
    last = jnp.maximum(jnp.argmin(finite) - 1, 0)
    t_end, y_end = jnp.where(overflow, times[last], t_end), jnp.where(overflow, samples[last], y_end)
    code = jnp.where(overflow, Status.NONFINITE.value, code)
    valid = (finite & (times <= t_end))[:, None]
    y = jnp.concatenate([_nan_unless(valid, jnp.where(valid, samples, y_end)), y_end[None]])
    unpacked = jax.vmap(form.unpack)(y, jnp.append(times, t_end))
    state, final = jax.tree.map(lambda x: x[:-1], unpacked), jax.tree.map(lambda x: x[-1], unpacked)
    if has_range(model.elements):
        beyond = jax.vmap(lambda t, state: jnp.any(outside_law_range(model, frames_at_time(model, motions, t, state))))(times, state)
        code = jnp.where((code == Status.OK.value) & jnp.any(beyond), Status.TABLE_RANGE.value, code)
    statistics = {"num_accepted_steps": accepted, "num_rejected_steps": rejected}
    end = (t_end, final)
    return Trajectory(times=times, state=state, status=code, statistics=statistics, end=end, model=model, motions=motions, loads=loads)


@jax.custom_jvp
def _nan_unless(valid: Bool[Array, "nt 1"], y: Float[Array, "nt ny"]) -> Float[Array, "nt ny"]:
    """y where it is valid, else NaN. So are its derivatives; with `jnp.where` alone they would be zero in reverse mode."""
    return jnp.where(valid, y, jnp.nan)


@_nan_unless.defjvp
def _nan_unless_jvp(primals, tangents):
    valid, y = primals

    def backward(_, slope):
        return jnp.where(valid | (slope == 0), slope, jnp.nan)

    change = jax.lax.custom_linear_solve(lambda x: x, tangents[1], lambda _, x: jnp.where(valid, x, jnp.nan), backward)
    return _nan_unless(valid, y), change


def _tolerances(dynamics: Dynamics, span, rtol):
    """rtol and atol of the local error, and the shortest step: constants for both modes of differentiation."""
    dynamics, span, local = jax.lax.stop_gradient((dynamics, span, SAFETY * rtol))
    local = jnp.maximum(local, FINEST[local.dtype.name])
    return local, local / 100 * dynamics.scales(span), reachable(1e-13, span.dtype, 1) * span


def _by_blocks(dynamics, y0, times, rtol, solver, controller, adjoint, dt0, max_steps, meter):
    """Integration by our own loops (`dormand_prince_steps`)."""
    limits = _tolerances(dynamics, times[-1] - times[0], rtol)
    signals = [signal for load in dynamics.loads for signal in load.signals()]
    constant = isinstance(controller, diffrax.ConstantStepSize)
    kinks = None if constant else kinks_of((*dynamics.motions, *signals))
    most = max_steps + (0 if kinks is None else len(kinks))
    first, kinks = jax.lax.stop_gradient((dt0, kinks))
    problem = dormand_prince_steps.InitialValueProblem(type(dynamics).drive, type(dynamics).driven, *limits, first, most, kinks, constant)
    forward = isinstance(adjoint, diffrax.ForwardMode)
    result = (
        dormand_prince_steps.solve(problem, dynamics, y0, times)
        if forward
        else dormand_prince_steps.solve_both_ways((dynamics, y0, times), problem=problem)
    )
    course = result.course
    return result.samples, times[0] + result.tau, result.y, course.code, course.accepted, course.rejected


def _by_diffrax(dynamics, y0, times, rtol, solver, controller, adjoint, dt0, max_steps, meter):
    """Integration by diffrax, with the user's objects and defaults for the others."""
    adjoint = adjoint or (diffrax.DirectAdjoint() if isinstance(controller, CONSTANT) else diffrax.RecursiveCheckpointAdjoint())
    if controller is None:
        local, atol, shortest = _tolerances(dynamics, times[-1] - times[0], rtol)
        controller = diffrax.PIDController(rtol=local, atol=atol, norm=optimistix.max_norm, dtmin=shortest, force_dtmin=False)
    solution = diffrax.diffeqsolve(
        diffrax.ODETerm(lambda t, y, dynamics: dynamics.rate(t, y)),
        solver or diffrax.Dopri8(),
        times[0],
        times[-1],
        dt0,
        y0,
        dynamics,
        saveat=diffrax.SaveAt(subs=[diffrax.SubSaveAt(ts=times), diffrax.SubSaveAt(t1=True)]),
        stepsize_controller=controller,
        adjoint=adjoint,
        max_steps=max_steps,
        throw=False,
        progress_meter=meter,
    )
    assert solution.ys is not None and solution.ts is not None
    code = jnp.select(
        [solution.result == result for result, _ in STATUSES], [status.value for _, status in STATUSES], Status.NOT_CONVERGED.value
    )
    t_end, y_end = solution.ts[1][-1], solution.ys[1][-1]
    ahead = t_end + (times[-1] - times[0]) * jnp.array([0.0, 1e-12, 1e-9, 1e-6])
    stuck = (code != Status.OK.value) & ~jnp.isfinite(jax.vmap(lambda t: dynamics.rate(t, y_end))(ahead)).all()
    steps = (solution.stats[f"num_{kind}_steps"] for kind in ("accepted", "rejected"))
    return solution.ys[0].at[0].set(y0), t_end, y_end, jnp.where(stuck, Status.NONFINITE.value, code), *steps
