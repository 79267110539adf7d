"""Fits of parameters to measurements: least squares with exact derivatives, by SciPy, optax or
optimistix.

    r = (reading(u) - measured)/noise,    minimize 1/2 r'r over u

u are the free parameters, transformed to be zero at the initial guess (`transforms`).
"""

import os
from collections.abc import Iterable
from functools import partial
from typing import Any

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix

from jaxbody.core.arguments import whole_number
from jaxbody.core.arrays import Array, Float, device_array, is_concrete
from jaxbody.core.compilation.compile_options import program
from jaxbody.core.errors import JaxbodyError, Problem, Problems, Status, warn
from jaxbody.core.progress_lines import working
from jaxbody.core.results import warn_if_failed
from jaxbody.fitting.checkpoints import resumed, save
from jaxbody.fitting.experiments.diagnoses import faults, likely_errors
from jaxbody.fitting.experiments.experiments import Experiment, Integration
from jaxbody.fitting.experiments.measurements import (
    Measurement,
    check_measurements,
    records_of,
)
from jaxbody.fitting.experiments.plausibilities import first_frequency
from jaxbody.fitting.experiments.unexplained_records import transients, unexplained
from jaxbody.fitting.fit_results import Fit
from jaxbody.fitting.noisy_inputs import noisy_inputs
from jaxbody.fitting.parameters.spaces import Space, model_of, space_of
from jaxbody.fitting.residuals import (
    EXACT,
    PRIORS,
    ReadingsAndResiduals,
    Task,
    check_start,
    first_noise,
    floor,
    integration_error,
    residual_and_jacobian,
    rms_residuals,
    with_estimated_noise,
)
from jaxbody.fitting.searches import AT_BOUND, Evaluations, search, solve
from jaxbody.fitting.statistics.losses import check_loss
from jaxbody.fitting.statistics.uncertainties import RANK, assess, decomposed
from jaxbody.model.models import Model
from jaxbody.model.preconditions import check_precision
from jaxbody.motion.integrations import check_steps
from jaxbody.suspension.suspensions import Suspension

# effect on the residuals up to which a parameter near a limit of its domain counts as at the limit,
# relative to the residuals or the largest effect of any direction of u
SMALL = 1e-3
ZERO = 2 * RANK  # the same for the part of the effect that other parameters cannot reproduce
SHORT = 0.25  # shortest record, relative to the first natural period
# largest number of times that the noise of each channel is estimated and the fit repeated
ROUNDS = 5


def fit(
    model: Model | Suspension,
    experiments: dict[str, Measurement],
    *,
    free: Iterable[str] | str,
    method: Any = "least_squares",
    bounds: dict[str, tuple[Any, Any]] | None = None,
    priors: dict[str, tuple[Any, Any]] | None = None,
    loss: str | None = None,
    rtol: float = 1e-8,
    solver: diffrax.AbstractSolver | None = None,
    stepsize_controller: diffrax.AbstractStepSizeController | None = None,
    dt0: float | None = None,
    max_steps: int | None = None,
    max_evaluations: int = 2000,
    progress: bool | None = None,
    resume: Fit | str | os.PathLike | None = None,
    checkpoint: str | os.PathLike | None = None,
    allow_float32: bool = False,
) -> Fit:
    """Estimate free parameters from measurements by least squares.

    Args:
        model: the initial guess; the hard points of a `Suspension`, in meters, can be freed by
            their names, as in free=["lower outer"].
        experiments: {name: Experiment, MeasuredResponse, MeasuredModes, MeasuredStiffness
            or MeasuredCurves}.
        free: paths or patterns, of the model ("*.stiffness", "plate.mass", "AB.a") or of an
            experiment ("run1.initial.v", "run1.base.frequency"). "left.stiffness = right.stiffness"
            ties parameters, "left.a = right.a * [1, -1, 1]" with factors; "run1.acc.gain =
            run2.acc.gain" shares one parameter between experiments.
        method: "least_squares", SciPy's trust-region reflective method; any optax optimizer,
            restarted in whitened coordinates until it converges; or an optimistix least-squares
            solver, which also runs inside jit and vmap, differentiable in forward mode.
        bounds: {path or pattern: (lower, upper)} in the unit of the parameter, for "least_squares"
            only; by default none.
        priors: {path or pattern: (mean, standard deviation)} of normal distributions, for scalars
            and vectors; each counts as one more measurement. By default none.
        loss: None for least squares; "soft_l1" or "cauchy" for data with outliers (`losses`).
        rtol, solver, stepsize_controller, dt0: as in `simulate`.
        max_steps: largest number of integration steps of a run; by default 10,000, or 30 for each
            sample if that is more.
        max_evaluations: largest number of evaluations of residuals and Jacobian; of steps with an
            optax optimizer.
        progress: None shows progress on a terminal or in a notebook after five seconds, False is
            silent, True prints every evaluation.
        resume: an interrupted fit, or the path of its checkpoint, from which to continue.
        checkpoint: path of a file to which every improved trial is saved; by default none.
        allow_float32: accept single precision, which loses half of the digits.

    Stiffness, damping and mass stay positive, quaternions keep unit length, and an inertia stays
    that of positive masses. Parameters that the data do not determine are listed in words, without
    numbers. If an experiment does not state the noise of a channel, it is estimated from the
    residuals and the fit is repeated. A trial that cannot be simulated is a rejected step. Ctrl-C
    ends the fit with the best estimates so far and status INTERRUPTED.

    Constant integration steps are several times faster for many experiments in one batch, or for an
    input with kinks at samples that coincide with steps. They do not control the error: compare
    with a shorter dt0.

    Errors: WRONG_KIND, BAD_NAME, BAD_NUMBER, UNKNOWN_PATH, LISTED_TWICE, NOTHING_FREE, TIED_APART,
    BAD_TIE, BAD_BOUNDS, BAD_PRIOR, UNKNOWN_LOSS, START_OUTSIDE, START_ON_BOUND, BAD_DELAY,
    NONFINITE_START, NOT_SAVED, NO_CHECKPOINT, OTHER_FIT, FLOAT32 and those of `simulate`;
    TINY_START for a positive parameter that starts too small to have an effect; inside jit and vmap
    also NO_NOISE, because noise is not estimated there. Warns of any status other than OK, of
    CORRELATED_RESIDUALS, of FAILED_TRIALS, and of INITIAL_TRANSIENT if the prediction of a run
    begins far from its first samples.

    Status FAR_OFF: the fitted model does not explain a record. Residuals exceed half of its
    variation and are not white noise, or the record agrees with the prediction only with another
    sign, unit or channel; the report lists what `diagnose` finds. A search that did not converge
    has this status only in the second case.

    Status NOISY_INPUT: noise in the record of an imposed motion or load acts as a force that the
    model does not have, so that estimates are biased and intervals too narrow.

    >>> spring = jb.Spring(("mass", [0, 0, 0]), ("world", [0, 0, 0]), stiffness=30.0)
    >>> model = jb.Model(
    ...     bodies={"mass": jb.Body(mass=1.0, inertia=[1, 1, 1], position=[1, 0, 0])},
    ...     elements={"spring": spring},
    ...     joints={"mass": jb.Guide("world", axis=[1, 0, 0])},
    ... )
    >>> times = jnp.linspace(0, 1, 6)
    >>> track = jb.Experiment(
    ...     times,
    ...     sensors={"x": jb.Position("mass", axis=[1, 0, 0])},
    ...     measured={"x": jnp.cos(2 * jnp.pi * times)},
    ... )
    >>> round(
    ...     float(
    ...         jb.fit(model, {"track": track}, free=["spring.stiffness"]).estimates[
    ...             "spring.stiffness"
    ...         ]
    ...     ),
    ...     5,
    ... )  # (2 pi)^2
    39.47842
    """
    design, model = model, model_of(model)
    check_precision("fit", model, allow_float32=allow_float32)
    check_loss(loss, "fit.loss")
    with Problems() as problems:
        max_steps = problems.gather(
            lambda: check_steps(solver, stepsize_controller, dt0, rtol, max_steps, "fit")
        )
        max_evaluations = whole_number(max_evaluations, "fit.max_evaluations", problems)
        _check_method(method, bounds, problems)
    check_runs(model, experiments, "fit.experiments")
    space = space_of(design, free, "fit", runs=dict(experiments), bounds=bounds, priors=priors)
    noise, estimated = first_noise(experiments, absolute=bool(priors) or loss is not None)
    task = Task(space, noise, Integration(rtol, solver, stepsize_controller, dt0, max_steps), loss)
    u = np.zeros(space.size)
    if resume is not None:
        u, levels = resumed(resume, task)
        task = eqx.tree_at(lambda t: t.noise, task, levels)
    u = np.clip(u, *space.bounds)  # a tuned model may be outside by round-off
    if not is_concrete(model, experiments):
        return _fit_traced(task, u, method, max_evaluations, estimated)
    save_improved = (lambda u: None) if checkpoint is None else lambda u: save(checkpoint, task, u)
    status = Status.NOT_CONVERGED
    with working("fit", progress) as line:
        line("first evaluation, compiling")
        evaluate = Evaluations(
            partial(residual_and_jacobian, task),
            max_evaluations,
            floor=floor(task),
            progress=progress,
            improved=save_improved,
            line=line,
        )
        try:
            check_start(task, u, *evaluate(u)[:2])
            for _ in range((ROUNDS if not task.absolute else 2 * ROUNDS) if estimated else 1):
                u, converged = search(evaluate, task, u, method)
                status = Status.OK if converged else Status.NOT_CONVERGED
                if not estimated:
                    break
                task, changed = with_estimated_noise(task, evaluate(u)[2])
                if not changed:
                    break
                evaluate.replace_function(partial(residual_and_jacobian, task), floor(task))
        except KeyboardInterrupt:
            u, status = u if evaluate.best is None else evaluate.best, Status.INTERRUPTED
        result = _finish(evaluate, task, u, status)
    warn_if_failed(result)
    if result.ok and result.uncertainty is not None and result.uncertainty.correlated:
        warn("CORRELATED_RESIDUALS", result.uncertainty.about_noise()[0])
    if result.ok and result.remarks:
        warn("INITIAL_TRANSIENT", "; ".join(result.remarks))
    if evaluate.failed > evaluate.count / 2:
        warn(
            "FAILED_TRIALS",
            f"{evaluate.failed} of {evaluate.count} trials of the fit could not be simulated",
        )
    return result


def _check_method(method: Any, bounds: Any, problems: Problems) -> None:
    least_squares = isinstance(method, str) and method == "least_squares"
    if bounds and not least_squares:
        problems.add(
            "BAD_BOUNDS", "fit.bounds", 'are supported by method="least_squares" only', value=method
        )
    known = isinstance(method, optimistix.AbstractLeastSquaresSolver) or (
        hasattr(method, "init") and hasattr(method, "update")
    )
    if not (least_squares or known):
        problems.add(
            "UNKNOWN_METHOD",
            "fit.method",
            f"is {method!r:.60}",
            value=method,
            limit='an optax optimizer, "least_squares" or an optimistix least-squares solver',
        )


def _fit_traced(task: Task, u, method, max_steps: int, estimated: bool) -> Fit:
    """Fit inside jit, vmap or derivatives, where values are unknown. Errors: TRACED, NO_NOISE."""
    if not isinstance(method, optimistix.AbstractLeastSquaresSolver):
        raise JaxbodyError(
            Problem(
                "TRACED",
                "fit.method",
                "does not run inside jit, vmap or grad",
                method,
                hint="Inside them use optimistix.LevenbergMarquardt(rtol=1e-8, atol=1e-8).",
            )
        )
    if estimated:
        raise JaxbodyError(
            Problem(
                "NO_NOISE",
                "fit.experiments",
                "do not state the noise of all channels",
                hint="Give the noise of every measurement: it is estimated outside of "
                "jit, vmap and grad only.",
            )
        )
    u, status, steps = solve(task, u, method, max_steps)
    design, experiments = task.space.designed(u)
    r = task.residual(u)
    return Fit(
        model=model_of(design),
        suspension=design if isinstance(design, Suspension) else None,
        experiments=experiments,
        u=u,
        cost=0.5 * r @ r,
        status=status,
        evaluations=steps,
        task=task,
        uncertainty=None,
        predicted={},
        noise={},
        history=[],
        failed=0,
        at_bound=[],
    )


def _finish(evaluate: Evaluations, task: Task, u, status: Status) -> Fit:
    r, J, runs = evaluate(u)
    space, limits = task.space, task.space.bounds
    design, experiments, slopes = placed(space, device_array(u))
    model = model_of(design)
    inside = np.all(np.abs(np.asarray(u) - np.stack(limits)) >= AT_BOUND, axis=0)
    paths, exact = [parameter.path for parameter in space.parameters], EXACT * floor(task)
    ends = _ends(task, np.asarray(u), r, J)
    uncertainty = assess(
        *task.linearized(runs, J),
        [np.asarray(slopes[path]) for path in paths],
        paths,
        space.names,
        records_of(space.runs),
        inside=inside,
        ended=ends != "",
        exact=exact,
    )
    at_bound = [
        f"{label} ({side})"
        for side, limit in zip(("lower", "upper"), limits, strict=True)
        for label, near in zip(space.names, np.abs(np.asarray(u) - limit) < AT_BOUND, strict=True)
        if near
    ]
    at_bound += [f"{label} ({end})" for label, end in zip(space.names, ends, strict=True) if end]
    predicted = {run: runs[run][0] for run in task.experiments}
    checked = np.isfinite(r).all() and np.linalg.norm(r) > floor(task)
    errors, certain = _unexplained(task, model, experiments, runs) if checked else ([], False)
    if (errors and status == Status.OK) or (certain and status != Status.INTERRUPTED):
        status = Status.FAR_OFF
    if status == Status.OK:
        rank = uncertainty.rank + np.count_nonzero(ends != "")
        conditions = (
            (uncertainty.ineffective, Status.NEVER_MOVED),
            (rank < space.size, Status.NOT_IDENTIFIABLE),
            (at_bound, Status.AT_BOUND),
        )
        status = next((code for condition, code in conditions if condition), Status.OK)
    remarks = [*errors]
    if status == Status.OK or (status == Status.FAR_OFF and not certain):
        noisy = noisy_inputs(task, device_array(u), runs)
        status = Status.NOISY_INPUT if noisy else status
        remarks += noisy
    if status not in (Status.OK, Status.AT_BOUND, Status.INTERRUPTED):
        remarks += _remedies(evaluate, task, status)
    if np.linalg.norm(r) > exact:
        remarks += transients(model, experiments, predicted, task.noise, task.integration)
    return Fit(
        model=model,
        suspension=design if isinstance(design, Suspension) else None,
        experiments=experiments,
        u=device_array(u),
        cost=device_array(0.5 * r @ r),
        status=jnp.asarray(np.asarray(status.value), int),
        evaluations=evaluate.count,
        task=task,
        uncertainty=uncertainty,
        predicted=predicted,
        noise=rms_residuals(task, runs),
        history=evaluate.history,
        failed=evaluate.failed,
        at_bound=at_bound,
        rounds=tuple(evaluate.rounds),
        remarks=tuple(remarks),
    )


def _unexplained(
    task: Task, model: Model, experiments: dict[str, Measurement], runs: ReadingsAndResiduals
) -> tuple[list[str], bool]:
    """Return sentences on records that the fitted model does not explain and on likely errors of
    measurements, and whether one of these errors is certain, so that further evaluations are
    useless.

    The errors are found by comparison with the fitted model or with the initial guess, which may be
    closer to the truth."""
    sentences = [
        *unexplained(
            experiments, task.misfits(runs), task.loss is not None, integration_error(task)
        )
    ]
    fitted = [
        error
        for run, e in experiments.items()
        for error in likely_errors(model, run, e, runs[run][0])[1]
    ]
    if not sentences and not faults(fitted):
        return [], False
    first = residual_and_jacobian(task, device_array(np.zeros(task.space.size)))[2]
    start = [
        error
        for run, e in task.experiments.items()
        for error in likely_errors(task.space.model, run, e, first[run][0])[1]
    ]
    other_than_offset = [
        [error for error in faults(errors) if error[0] != "OFFSET"] for errors in (start, fitted)
    ]  # a wrong unit causes an offset, too
    likely = next(
        filter(None, (*other_than_offset, faults(start), faults(fitted), start, fitted)), []
    )
    return sentences + [message for _, message in likely], bool(faults(likely))


@program
def placed(
    space: Space, u: Float[Array, "n"]
) -> tuple[Model | Suspension, dict[str, Measurement], dict[str, Array]]:
    """Return the model or suspension and the runs at u, and the derivatives of the values of each
    parameter with respect to u."""
    return *space.designed(u), jax.jacfwd(space.values)(u)


def _ends(task: Task, u: np.ndarray, r: np.ndarray, J: np.ndarray) -> np.ndarray:
    """Return for each component of u the limit of the domain that its parameter is close to, "zero"
    or "one", if moving closer to this limit does not affect the readings; otherwise ""."""
    ends = task.space.ended(u)
    _, S, Vt, _ = decomposed(J)
    size = max(np.linalg.norm(r), S.max()) or 1.0
    alone = 1 / np.linalg.norm(Vt.T / np.maximum(S, 0.1 * ZERO * size), axis=1)
    return np.where((alone <= ZERO * size) & (np.linalg.norm(J, axis=0) <= SMALL * size), ends, "")


def _remedies(evaluate: Evaluations, task: Task, status: Status) -> tuple[str, ...]:
    """Return remedies for records that are too short, or else for a search that did not
    converge."""
    durations = {
        name: float(np.ptp(run.times))
        for name, run in task.experiments.items()
        if isinstance(run, Experiment)
    }
    period = 1 / first_frequency(task.space.model) if durations else np.nan
    short = [
        f"'{name}' lasts {duration:.3g} s"
        for name, duration in durations.items()
        if duration < SHORT * period
    ]
    if short:
        return (
            f"{', '.join(short)}, a small part of the first natural period of {period:.3g} s: "
            "record longer, or free fewer parameters",
        )
    if status != Status.NOT_CONVERGED:
        return ()
    remedy = "more max_evaluations" if evaluate.exhausted else "another method"
    return (f"give a better initial guess, or {remedy}",)


def check_runs(
    model: Model, experiments: dict[str, Measurement], where: str, *, plans: bool = False
) -> None:
    """Check names of measurements, and that these match the model; `plans` may have no data."""
    problems = check_measurements(experiments, where, plans=plans)
    for name in experiments:
        reserved = {
            "a body": model.layout.bodies,
            "a support": model.layout.supports,
            "an element": model.element_names,
        }
        owner = next((kind for kind, names in reserved.items() if name in names), None)
        marks = "".join(mark for mark in ".*?[]" if isinstance(name, str) and mark in name)
        message = (
            "is not a string"
            if not isinstance(name, str)
            else f"is the name of {owner} of the model"
            if owner
            else "is reserved"
            if name in ("world", "gravity", PRIORS)
            else f"has {' '.join(marks)} in it"
            if marks
            else ""
        )
        if message:
            problems.add(
                "BAD_NAME",
                f"experiments[{name!r}]",
                message,
                value=name,
                hint="Choose another name, without . * ? [ ], because the paths of an experiment "
                "begin with its name.",
            )
    problems.raise_if_any()
    for name, experiment in experiments.items():
        problems.gather(partial(experiment.check, model, name))
    problems.raise_if_any()
