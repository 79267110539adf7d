"""The integration by diffrax, in blocks of steps or by its own loop: tolerances, statuses, samples;
checks of its steps: objects of diffrax, steps too long for the motion, for what acts on it or for a
sampled controller."""

from functools import partial
from typing import Any

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix

from jaxbody.core.arguments import check_kind, positive_number, whole_number
from jaxbody.core.arrays import Array, concrete, is_concrete, rows_or_nan, time_text
from jaxbody.core.compilation.compile_options import program_with
from jaxbody.core.errors import JaxbodyError, Problem, Problems, Status, warn
from jaxbody.mechanics.closed_loops import ClosedLoops, after_samples, dynamics_of, state_slopes
from jaxbody.mechanics.dynamics import Dynamics
from jaxbody.mechanics.hessians import matrices
from jaxbody.model.element_states import between_samples
from jaxbody.model.forces.controllers import check_continuous, next_sample, sampled_names
from jaxbody.model.inputs.loads import Load
from jaxbody.model.inputs.signals import kinks_of
from jaxbody.model.joints.frame_tables import completed, outside_law_range
from jaxbody.model.joints.kinematics import Motions, frames_at_time
from jaxbody.model.laws.tabulated_laws import has_range
from jaxbody.model.models import Model, options_of_motion
from jaxbody.model.preconditions import check_potential
from jaxbody.model.states import State
from jaxbody.motion.canonical_equations import Canonical
from jaxbody.motion.trajectories import Trajectory
from jaxbody.numerics.adjoints import BlockAdjoint, Driven, Lasting, Projected, Unstarted, Watched
from jaxbody.numerics.eigenproblems import companion
from jaxbody.numerics.gauss_collocations import Gauss
from jaxbody.numerics.precisions import reachable
from jaxbody.numerics.runge_kutta_steps import TRIAL, Jumps, first_length

# least local error; below it steps in float32 become shorter without a gain in accuracy
FINEST = {"float64": 0.0, "float32": 1.5e-5}
# allowed local error over rtol; below 1 because interpolation within a step is of lower order than
# the results at its ends
SAFETY = 0.1
CONSTANT = diffrax.ConstantStepSize | diffrax.StepTo
STATUSES = (
    (diffrax.RESULTS.successful, Status.OK),
    (diffrax.RESULTS.max_steps_reached, Status.MAX_STEPS),
    (diffrax.RESULTS.dt_min_reached, Status.DT_MIN),
)


def _drive(t, dynamics: Dynamics) -> Any:
    return dynamics.drive(t)


def _driven(u, y, dynamics: Dynamics) -> Array:
    return dynamics.driven(u, y)


def _canonical(t, y, canonical: Canonical) -> Array:
    return canonical.rate(t, y)


def _driven_on_closures(u, y, dynamics: ClosedLoops):
    return dynamics.driven_on_closures(u, y)


def _projected(u, y, saddle, dynamics: ClosedLoops) -> Array:
    return dynamics.closer(u, y, saddle)


def _after_samples(t, y, dynamics: Dynamics) -> Array:
    return after_samples(dynamics, t, y)


def _next_sample(t, dynamics: Dynamics) -> Array:
    return next_sample(dynamics.model, t)


MOTION, CANONICAL = Driven(_drive, _driven), diffrax.ODETerm(_canonical)
LOOPS = Driven(_drive, _driven_on_closures, _projected)
SAMPLES = Jumps(_after_samples, _next_sample)
SAMPLED_MOTION = Driven(_drive, _driven, None, SAMPLES)
SAMPLED_LOOPS = Driven(_drive, _driven_on_closures, _projected, SAMPLES)


@program_with(lambda model, times, *_: options_of_motion(model, times))
def integrate(
    model,
    times,
    motions,
    loads,
    initial,
    rtol,
    solver,
    stepsize_controller,
    adjoint,
    dt0,
    max_steps,
    meter,
    equations,
) -> Trajectory:
    """Integrate the motion: the jitted core of `simulate`, which takes arrays only and never
    raises. Inside, time is counted from the first sample."""
    given, times = times, times - times[0]
    motions_after, loads_after = (
        tuple(part.after(given[0]) for part in parts) for parts in (motions, loads)
    )
    sampled = sampled_names(model)
    dynamics = dynamics_of(between_samples(model), motions_after, loads_after, equations)
    if initial is None:
        initial = dynamics.coordinates.reference
    else:
        supports = dynamics.coordinates.supports_moving(motions_after, times[0])
        frames = dynamics.coordinates.frames(initial.q, initial.v, supports)
        initial = completed(model, initial, frames)
    initial, closing = dynamics.begun(times[0], initial)
    by_default = (
        solver is None
        and isinstance(stepsize_controller, diffrax.ConstantStepSize | None)
        and isinstance(adjoint, diffrax.ForwardMode | None)
        and isinstance(meter, diffrax.NoProgressMeter)
    )
    in_blocks = by_default or isinstance(adjoint, BlockAdjoint)
    form, term = dynamics, LOOPS if model.closures else MOTION
    if sampled:
        if not in_blocks or isinstance(stepsize_controller, CONSTANT):
            check_continuous("simulate with a solver or steps of your own", model)
        term = SAMPLED_LOOPS if model.closures else SAMPLED_MOTION
    if isinstance(solver, Gauss):
        _check_for_gauss(model)
        form, term = Canonical(dynamics), CANONICAL
    y0 = form.pack(initial, times[0])
    y0 = after_samples(dynamics, times[0], y0) if sampled else y0
    solver = solver or diffrax.Dopri8()
    controller = _after(given[0], stepsize_controller)
    tolerances = (
        {} if isinstance(controller, CONSTANT) else _tolerances(dynamics, times, initial, rtol)
    )
    if in_blocks:
        options = _in_blocks(
            dynamics, times, tolerances, solver, controller, adjoint, dt0, max_steps
        )
    else:
        solver = (
            Projected(solver) if model.closures and isinstance(controller, CONSTANT) else solver
        )
        options = _as_given(
            form, y0, times, tolerances, solver, controller, adjoint, dt0, max_steps
        )
    solution = diffrax.diffeqsolve(
        term,
        t0=times[0],
        t1=times[-1],
        y0=y0,
        args=form,
        throw=False,
        progress_meter=meter,
        **options,
    )
    ts, ys = (jnp.concatenate(jax.tree.leaves(x)) for x in (solution.ts, solution.ys))
    samples, t_end, y_end = ys[:-1].at[0].set(y0), ts[-1], ys[-1]
    code = (
        solution.stats["status"]
        if in_blocks
        else _status(solution.result, form, t_end, y_end, times[-1] - times[0])
    )
    finite = jnp.isfinite(samples).all(1)
    overflow = (code == Status.OK.value) & ~finite.all()  # constant steps do not detect it
    last = jnp.maximum(jnp.argmin(finite) - 1, 0)
    t_end, y_end = (
        jnp.where(overflow, times[last], t_end),
        jnp.where(overflow, samples[last], y_end),
    )
    code = jnp.where(overflow, Status.NONFINITE.value, code)
    valid = (finite & (times <= t_end))[:, None]
    samples = jnp.where(valid, samples, y_end)
    samples = jax.vmap(dynamics.projected)(jnp.where(valid[:, 0], times, t_end), samples)
    valid = valid & jnp.isfinite(samples)
    code = jnp.where((code == Status.OK.value) & ~valid.all(), Status.NONFINITE.value, code)
    y = jnp.concatenate([rows_or_nan(valid, samples), y_end[None]])
    unpacked = jax.vmap(form.unpack)(y, jnp.append(times, t_end))
    state, final = jax.tree.map(lambda x: x[:-1], unpacked), jax.tree.map(lambda x: x[-1], unpacked)
    code = dynamics.ended(code, t_end, final, closing)
    if has_range(model.elements):
        frames = jax.vmap(partial(frames_at_time, model, dynamics.motions))(times, state)
        beyond = jax.vmap(lambda frames: jnp.any(outside_law_range(model, frames)))(frames)
        code = jnp.where(
            (code == Status.OK.value) & jnp.any(beyond), Status.TABLE_RANGE.value, code
        )
    return Trajectory(
        times=given,
        state=state,
        status=code,
        statistics={
            name: solution.stats[name] for name in ("num_accepted_steps", "num_rejected_steps")
        },
        end=(given[0] + t_end, final),
        model=model,
        motions=motions,
        loads=loads,
        closing=closing,
    )


def _after(t0, controller):
    """Return the controller with its own times, if it has any, counted from t0."""
    names = [
        name for name in ("ts", "step_ts", "jump_ts") if getattr(controller, name, None) is not None
    ]
    times = [jnp.asarray(getattr(controller, name)) - t0 for name in names]
    return (
        eqx.tree_at(
            lambda controller: [getattr(controller, name) for name in names], controller, times
        )
        if names
        else controller
    )


def _check_for_gauss(model: Model) -> None:
    """Refuse models that Gauss cannot integrate: those with states of elements, with force
    elements or with closures. Errors: MEMORY, NO_POTENTIAL, CLOSED_LOOPS."""
    check_potential("jb.Gauss", model)
    if model.layout.nz:
        raise JaxbodyError(
            Problem(
                "MEMORY",
                "solver",
                "is jb.Gauss, but the model has elements with memory: "
                + ", ".join(model.layout.states[:4]),
                limit="models without memory",
                hint="Leave solver= out, or give diffrax.Kvaerno5() for stiff models.",
            )
        )
    if model.closures:
        raise JaxbodyError(
            Problem(
                "CLOSED_LOOPS",
                "solver",
                f"is jb.Gauss, but the model has closures: {', '.join(model.closure_names[:4])}",
                limit="models without closures",
                hint="Leave solver= out.",
            )
        )


def _in_blocks(
    dynamics: Dynamics, times, tolerances, solver, controller, adjoint, dt0, max_steps
) -> dict[str, Any]:
    """Return the options of diffeqsolve for `BlockAdjoint`, which contain the times and the first
    step; steps end at kinks of motions and loads."""
    if controller is None:
        controller, more = _cut_at_kinks(dynamics, diffrax.PIDController(**tolerances))
        max_steps += more
    one_way = isinstance(adjoint, diffrax.ForwardMode) or (
        isinstance(adjoint, BlockAdjoint) and adjoint.forward_only
    )
    return {
        "solver": solver,
        "dt0": None,
        "saveat": diffrax.SaveAt(t1=True),
        "stepsize_controller": Unstarted(controller),
        "adjoint": BlockAdjoint(times, dt0, forward_only=one_way),
        "max_steps": max_steps,
    }


def _as_given(
    dynamics: Any,
    y0,
    times,
    tolerances,
    solver,
    controller,
    adjoint,
    dt0,
    max_steps,
) -> dict[str, Any]:
    """Return the options of diffeqsolve for its own loop: the user's objects, with defaults for the
    others. Where errors control the steps, these end at kinks of motions and loads, and the solver
    checks the samples in between."""
    saveat = diffrax.SaveAt(subs=[diffrax.SubSaveAt(ts=times), diffrax.SubSaveAt(t1=True)])
    if isinstance(controller, CONSTANT):
        return {
            "solver": solver,
            "dt0": dt0,
            "saveat": saveat,
            "stepsize_controller": controller,
            "adjoint": adjoint or diffrax.DirectAdjoint(),
            "max_steps": max_steps,
        }
    rules: Any = Lasting(*(tolerances[name] for name in ("rtol", "atol", "norm", "dtmin")))
    if controller is None:
        controller = rules
    elif isinstance(controller, diffrax.AbstractAdaptiveStepSizeController):
        rules = controller
    if dt0 is None:
        t, span = times[0], times[-1] - times[0]
        f0, order = dynamics.rate(t, y0), solver.order(MOTION)
        f1 = dynamics.rate(t + TRIAL * span, y0 + TRIAL * span * f0)
        dt0 = first_length(rules, order, *jax.lax.stop_gradient((y0, f0, f1, TRIAL * span, span)))
    controller, more = _cut_at_kinks(dynamics, controller)
    return {
        "solver": Watched(solver, times, rules.rtol, rules.atol),
        "dt0": dt0,
        "saveat": saveat,
        "stepsize_controller": controller,
        "adjoint": adjoint or diffrax.RecursiveCheckpointAdjoint(),
        "max_steps": max_steps + more,
    }


def _cut_at_kinks(dynamics: Dynamics, controller: Any) -> tuple[Any, int]:
    """Return the controller, whose steps end at kinks of motions and loads, and the largest number
    of such kinks."""
    kinks = kinks_of(
        (*dynamics.motions, *(signal for load in dynamics.loads for signal in load.signals()))
    )
    if kinks is None or not isinstance(controller, diffrax.AbstractAdaptiveStepSizeController):
        return controller, 0
    return diffrax.ClipStepSizeController(controller, step_ts=jnp.asarray(kinks)), len(kinks)


def _tolerances(dynamics: Dynamics, times, initial, rtol) -> dict[str, Any]:
    """Return the allowed local error and the shortest step, which are constants in both modes of
    differentiation."""
    dynamics, times, initial, local = jax.lax.stop_gradient(
        (dynamics, times, initial, SAFETY * rtol)
    )
    local = jnp.maximum(local, FINEST[local.dtype.name])
    return {
        "rtol": local,
        "atol": local / 100 * dynamics.scales(times, initial),
        "norm": optimistix.max_norm,
        "dtmin": reachable(1e-13, times.dtype, 1) * (times[-1] - times[0]),
        "force_dtmin": False,
    }


def _status(result, form: Dynamics | Canonical, t, y, span) -> Array:
    """Return the status of diffrax's own loop: NONFINITE where it stopped because the rate is not
    finite, which diffrax reports as too short a step."""
    code = jnp.select(
        [result == of for of, _ in STATUSES],
        [status.value for _, status in STATUSES],
        Status.NOT_CONVERGED.value,
    )
    ahead = t + span * jnp.array([0.0, 1e-12, 1e-9, 1e-6])
    stuck = (code != Status.OK.value) & ~jnp.isfinite(
        jax.vmap(lambda t: form.rate(t, y))(ahead)
    ).all()
    return jnp.where(stuck, Status.NONFINITE.value, code)


# steps per sample, rejected ones included, for a recorded input with noise in every sample at rtol
# 1e-8
PER_SAMPLE = 30
# largest product of step and rate for which the classical Runge-Kutta method is stable; diffrax's
# explicit solvers are similar
STABLE = 2.8
KINDS = {  # argument: (class of diffrax, example for messages)
    "solver": (diffrax.AbstractSolver, "diffrax.Tsit5()"),
    "stepsize_controller": (diffrax.AbstractStepSizeController, "diffrax.ConstantStepSize()"),
    "adjoint": (diffrax.AbstractAdjoint, "diffrax.ForwardMode()"),
}


def most_steps(samples: int, least: int) -> int:
    """Return the number of steps allowed by default, for this number of samples."""
    return max(least, PER_SAMPLE * samples)


def check_steps(
    solver: diffrax.AbstractSolver | None,
    stepsize_controller: diffrax.AbstractStepSizeController | None,
    dt0: Any,
    rtol: Any,
    max_steps: Any,
    where: str,
    adjoint: diffrax.AbstractAdjoint | None = None,
) -> int | None:
    """Check that solver, controller and adjoint are diffrax objects, that Gauss has constant steps
    with dt0, and that rtol and dt0 are positive. Return max_steps as an integer, or None if it is
    not given."""
    with Problems() as problems:
        given = {"solver": solver, "stepsize_controller": stepsize_controller, "adjoint": adjoint}
        for name, (kind, example) in KINDS.items():
            wanted = f"a diffrax object, such as {example}"
            check_kind(given[name], (kind, type(None)), f"{where}.{name}", wanted, problems)
        if isinstance(adjoint, diffrax.RecursiveCheckpointAdjoint) and isinstance(
            stepsize_controller, CONSTANT
        ):
            problems.add(
                "WRONG_GRADIENT",
                f"{where}.adjoint",
                "is RecursiveCheckpointAdjoint, which with constant steps gives wrong gradients "
                "where samples lie on steps",
                value=adjoint,
                hint="Use diffrax.DirectAdjoint() or ForwardMode().",
            )
        if isinstance(solver, Gauss) and not isinstance(stepsize_controller, CONSTANT):
            problems.add(
                "NO_ERROR_ESTIMATE",
                f"{where}.solver",
                "is Gauss, which has no error estimate for a controller",
                value=solver,
                hint="Give stepsize_controller=diffrax.ConstantStepSize() and a dt0 of a tenth of "
                "the shortest period.",
            )
        if isinstance(stepsize_controller, diffrax.ConstantStepSize) and dt0 is None:
            problems.add(
                "NO_STEP", f"{where}.dt0", "is missing", hint="Constant steps need dt0=... seconds."
            )
        if dt0 is not None:
            positive_number(dt0, f"{where}.dt0", problems)
        positive_number(rtol, f"{where}.rtol", problems)
        steps = (
            None if max_steps is None else whole_number(max_steps, f"{where}.max_steps", problems)
        )
    return steps


def _fastest_rate(model: Model, initial: State | None) -> float:
    """Return the largest pole [rad/s] of small motions about the initial state, by default the
    reference pose at rest, y' = A y."""
    initial = model.reference if initial is None else initial
    A = (
        state_slopes(model, initial)
        if model.layout.nz or model.closures or model.forces
        else companion(*map(np.asarray, matrices(model, initial)))
    )
    return np.abs(np.linalg.eigvals(np.asarray(A))).max(initial=0.0)


def warn_of_slow_sampling(model: Model, initial: State | None) -> None:
    """Warn about controllers that take fewer than two samples in a period of the fastest pole of
    the model between samples."""
    sampled = {name: model[name].every for name in sampled_names(model)}
    if not sampled or not is_concrete(model, initial):
        return
    fastest = _fastest_rate(between_samples(model), initial)
    for name, every in sampled.items():
        if float(every) * fastest > np.pi:
            warn(
                "SLOW_SAMPLING",
                f"simulate: controller '{name}' samples each {float(every):.3g} s, the fastest "
                f"pole has {fastest:.4g} rad/s: sample each {np.pi / fastest:.2g} s or less",
            )


def warn_of_long_steps(
    model: Model, initial: State | None, dt: float, solver: diffrax.AbstractSolver | None
) -> None:
    """Warn about constant steps that are too long for the fastest small motion."""
    fastest = _fastest_rate(model, initial)
    if dt * fastest > STABLE and not isinstance(solver, diffrax.AbstractImplicitSolver):
        warn(
            "STEP_TOO_LONG",
            f"dt0 times the fastest rate, {fastest:.4g} rad/s, is {dt * fastest:.3g} > {STABLE}, "
            f"where RK4 becomes unstable. Take dt0 below {STABLE / fastest:.3g} s, leave the steps "
            "to the default controller, or use an implicit solver",
        )


def warn_of_what_steps_pass_over(
    model: Model, motions: Motions, loads: dict[str, Load], times, controller: Any, dt: Any
) -> None:
    """Warn if steps without error control are longer than the time of a motion or load from one
    kink or change to the next."""
    if controller is None or isinstance(controller, diffrax.AbstractAdaptiveStepSizeController):
        return
    run, steps = (
        concrete(times),
        concrete(
            dt
            if isinstance(controller, diffrax.ConstantStepSize)
            else getattr(controller, "ts", [0, np.inf])
        ),
    )
    if run is None or steps is None:
        return
    longest = steps if steps.ndim == 0 else np.max(np.diff(steps))
    for where, signal in signals_of_run(model, motions, loads):
        kinks = signal.kinks() if is_concrete(signal) else None
        if kinks is None:
            continue
        known = np.asarray(kinks)
        known = known[(known >= run[0]) & (known <= run[-1])]
        gaps = np.diff(known)
        short = (gaps > 1e-9 * (run[-1] - run[0])) & (gaps < (1 - 1e-6) * longest)
        if short.any():
            i = int(np.argmax(short))
            warn(
                "STEP_TOO_LONG",
                f"simulate: steps of {float(longest):.3g} s reach over what {where} does in "
                f"{gaps[i]:.3g} s from t = {time_text(known[i], run)} s on, and nothing controls "
                f"their error. Take steps below {gaps[short].min():.3g} s, or the default "
                "controller",
            )


def signals_of_run(model: Model, motions: Motions, loads: dict[str, Load]) -> list[tuple[str, Any]]:
    """Return the motions and the signals of the loads, each with its place in messages."""
    of_motions = [
        (f"motion['{name}']", motion)
        for name, motion in zip(model.layout.supports, motions, strict=False)
    ]
    return of_motions + [
        (f"loads['{name}']", signal) for name, load in loads.items() for signal in load.signals()
    ]
