"""The fit that planned measurements would give, before they are made.

    M = J'J + P^-1,    covariance of u = M^-1,    J = dr/du

J is the Jacobian of the residuals over their stated noise at the parameters of the model, P the
covariance of the priors; M is the Fisher information of normal noise.
"""

from collections.abc import Iterable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxbody.core.arrays import Array, Float, is_concrete
from jaxbody.core.errors import JaxbodyError, Problem, Problems, Status
from jaxbody.fitting.experiments.experiments import Integration
from jaxbody.fitting.experiments.measurements import Measurement, records_of, small_motions
from jaxbody.fitting.fit_results import Fit
from jaxbody.fitting.fitters import check_runs, placed
from jaxbody.fitting.parameters.spaces import Space, model_of, space_of
from jaxbody.fitting.residuals import Task, residual_and_jacobian
from jaxbody.fitting.statistics.uncertainties import assess
from jaxbody.model.models import Model
from jaxbody.model.preconditions import check_precision
from jaxbody.model.storage import with_attributes
from jaxbody.suspension.suspensions import Suspension

Plans = dict[str, Measurement]


def expected_fit(
    model: Model | Suspension,
    plans: Plans,
    *,
    free: Iterable[str] | str,
    priors: dict[str, tuple[Any, Any]] | None = None,
    rtol: float = 1e-8,
    max_steps: int | None = None,
    allow_float32: bool = False,
) -> Fit:
    """Return the fit that planned measurements would give: its intervals, correlations, and what
    stays undetermined.

    Args:
        model: the truth to expect, where the measurements are predicted and linearized.
        plans: {name: measurement} with the noise of every channel stated and without data, as
            Experiment(times, sensors=..., noise=...); data are ignored.
        free, priors, rtol, max_steps: as in `fit`.
        allow_float32: accept single precision, which loses half of the digits.

    The result is a `Fit`, whose residuals are zero and whose standard errors are those of the
    stated noise. It takes part in everything that fits do: bands, `choose`, `posterior`. Parameters
    that the plans do not determine are no failure here: they are listed, with infinite errors.

    Errors: NO_NOISE for a plan that does not state the noise of each channel, NONFINITE_START for
    one that cannot be predicted, FLOAT32, TRACED, and those of `fit` for measurements and paths.

    >>> car = jb.presets.quarter_car()
    >>> bump = jb.Experiment(
    ...     jnp.linspace(0, 2, 201),
    ...     sensors={"acc": jb.Acceleration("body", axis=[0, 0, 1])},
    ...     motion={"road": jb.Harmonic(frequency=1.5, translation=[0, 0, 0.01])},
    ...     initial=jb.equilibrium(car).state,
    ...     noise=0.05,
    ... )
    >>> fit = jb.expected_fit(car, {"bump": bump}, free=["suspension.stiffness", "tyre.stiffness"])
    >>> bool(fit.standard_errors["suspension.stiffness"] < fit.standard_errors["tyre.stiffness"])
    True
    """
    check_precision("expected_fit", model_of(model), allow_float32=allow_float32)
    check_runs(model_of(model), plans, "expected_fit.plans", plans=True)
    space = space_of(model, free, "expected_fit", runs=dict(plans), priors=priors)
    return expected(space, np.zeros(space.size), Integration(rtol, max_steps=max_steps))


def information(
    model: Model | Suspension,
    plans: Plans,
    *,
    free: Iterable[str] | str,
    priors: dict[str, tuple[Any, Any]] | None = None,
    rtol: float = 1e-8,
    max_steps: int | None = None,
) -> Float[Array, "n n"]:
    """Return the Fisher information M of the transformed parameters u, for use inside jit, grad and
    `tune`; arguments as in `expected_fit`.

    u is the logarithm of a positive parameter, so that M^-1 holds squares of relative errors.
    Error: NO_NOISE.

    >>> car = jb.presets.quarter_car()
    >>> hammer = jb.MeasuredResponse(
    ...     jnp.array([1.2]),
    ...     inputs={"f": jb.PointForce("body", direction=[0, 0, 1])},
    ...     outputs={"z": jb.Position("body", axis=[0, 0, 1])},
    ...     noise=1e-6,
    ... )
    >>> jb.fitting.information(car, {"hammer": hammer}, free=["suspension.stiffness"]).shape
    (1, 1)
    """
    space = space_of(model, free, "information", runs=dict(plans), priors=priors)
    u = jnp.zeros(space.size)
    J = residual_and_jacobian(planned(space, u, Integration(rtol, max_steps=max_steps)), u)[1]
    return J.T @ J


def planned(space: Space, u: Float[Array, "n"], integration: Integration) -> Task:
    """Return the least-squares problem of plans whose readings are those predicted at u. Errors:
    NO_NOISE, NONFINITE_START."""
    with Problems() as problems:
        for run, plan in space.runs.items():
            for name in set(plan.channels) - set(plan.noise or {}):
                problems.add(
                    "NO_NOISE",
                    f"plans['{run}']",
                    f"does not state the noise of '{name}'",
                    value=name,
                    hint=f'Give noise={{"{name}": standard deviation}}: it decides how much a '
                    "measurement tells.",
                )

    def predicted(u):
        model, runs = space.place(u)
        lin = small_motions(model) if any(plan.linear for plan in runs.values()) else None
        return {run: plan.readings(model, integration, lin) for run, plan in runs.items()}

    def measured(readings: Any) -> Task:
        runs = {
            run: with_attributes(plan, {"measured": readings[run]})
            for run, plan in space.runs.items()
        }
        noise: Any = {run: dict(plan.noise or {}) for run, plan in runs.items()}
        return Task(eqx.tree_at(lambda s: s.runs, space, runs), noise, integration)

    if not is_concrete(space, u):
        return measured(predicted(u))
    # by the program that is needed anyway, as compiling takes longer than running
    nothing = jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), jax.eval_shape(predicted, u))
    readings = residual_and_jacobian(measured(nothing), u)[2]
    for run, plan in space.runs.items():
        if not all(np.isfinite(np.asarray(x)).all() for x in readings[run][0].values()):
            raise JaxbodyError(
                Problem(
                    "NONFINITE_START",
                    f"plans['{run}']",
                    f"has no finite prediction: {plan.explain(space.place(u)[0], integration)}",
                    hint="Give a model that can be computed.",
                )
            )
    return measured({run: readings[run][0] for run in space.runs})


def check_derivatives(task: Task, J: np.ndarray) -> None:
    """Check that the Jacobian of plans is finite. Error: NONFINITE_START."""
    for record in records_of(task.space.runs):
        if not np.isfinite(J[record.rows]).all():
            raise JaxbodyError(
                Problem(
                    "NONFINITE_START",
                    f"plans['{record.run}']",
                    f"has no finite derivatives of {record.name} with respect to the parameters",
                    hint="Is there a motion that nothing resists? Hold it by a joint or a spring.",
                )
            )


def expected(space: Space, u: np.ndarray, integration: Integration) -> Fit:
    """Return the fit to expect at u from the runs of a space, which are plans."""
    task = planned(space, jnp.asarray(u), integration)
    _, J, runs = residual_and_jacobian(task, jnp.asarray(u))
    check_derivatives(task, np.asarray(J))
    design, experiments, slopes = placed(task.space, jnp.asarray(u))
    paths = [parameter.path for parameter in space.parameters]
    uncertainty = assess(
        np.zeros(len(J)),
        np.asarray(J),
        [np.asarray(slopes[path]) for path in paths],
        paths,
        space.names,
        [record._replace(series=False, known=True) for record in records_of(task.space.runs)],
    )
    return Fit(
        model=model_of(design),
        suspension=design if isinstance(design, Suspension) else None,
        experiments=experiments,
        u=u,
        cost=np.zeros(()),
        status=np.asarray(
            Status.NEVER_MOVED
            if uncertainty.ineffective
            else Status.NOT_IDENTIFIABLE
            if uncertainty.rank < space.size
            else Status.OK
        ),
        evaluations=1,
        task=task,
        uncertainty=uncertainty,
        predicted={run: runs[run][0] for run in task.experiments},
        noise=task.noise,
        history=[],
        failed=0,
        at_bound=[],
        remarks=("expected of plans, without data",),
    )
