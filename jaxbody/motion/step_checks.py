"""Checks of the steps of an integration: objects of diffrax, steps too long for the motion, for
what acts on it or for a sampled controller."""

from typing import Any

import diffrax
import numpy as np

from jaxbody.core.arguments import check_kind, positive_number, whole_number
from jaxbody.core.arrays import concrete, is_concrete, time_text
from jaxbody.core.errors import Problems, warn
from jaxbody.mechanics.closed_loops import state_slopes
from jaxbody.mechanics.hessians import matrices
from jaxbody.model.element_states import between_samples
from jaxbody.model.forces.controllers import sampled_names
from jaxbody.model.inputs.loads import Load
from jaxbody.model.joints.kinematics import Motions
from jaxbody.model.models import Model
from jaxbody.model.states import State
from jaxbody.motion.integrations import CONSTANT
from jaxbody.numerics.eigenproblems import companion
from jaxbody.numerics.gauss_collocations import Gauss

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
