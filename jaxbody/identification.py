"""From measured motions to parameters: least squares over experiments, with exact derivatives, by three families of methods.

    r = (reading(u) - measured)/noise,    minimize 1/2 r'r over u

An optax optimizer works on coordinates y whitened by the Jacobian, J = U S V', u = u_k + V S^-1 |U'r| y, in which the linearized optimum lies
one unit away, and is restarted from where it got to until the Gauss-Newton step says that it has arrived.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax
import optimistix
from jaxtyping import Array, Float, Int

from jaxbody import tables
from jaxbody.checks import check_precision
from jaxbody.errors import JaxbodyError, Problem, Problems, Status, is_concrete, warn
from jaxbody.experiments import Experiment, shared_structure
from jaxbody.models import Model
from jaxbody.naming import write
from jaxbody.parametrizations import Free, choose, limits_of
from jaxbody.results import Result, warn_if_failed
from jaxbody.sensors import Sensor, readings
from jaxbody.simulations import Trajectory, check_steps, integrate, motions_of
from jaxbody.statics import size_of
from jaxbody.uncertainties import Uncertainty, assess, known_directions

ARRIVED = 1e-7  # largest Gauss-Newton step in u at which a fit has arrived
WORTH = 0.01  # share of the expected fall of the cost that is worth having
ROUGH = (
    3e-4  # part of the residual that parameters still explain, relative to all of it, below which the roughness of the cost may hide a fall
)
FLAT = 0.02  # slope, relative to the first, at which coordinates are whitened anew
ENOUGH = 0.75  # share of the fall expected one unit away, after which coordinates are whitened anew
NEAR = 1e-4  # largest Gauss-Newton step in u from where such steps finish
FARTHEST = 0.7  # how far in u the unit of y may lead: a factor of two in what is positive
MOST_RESTARTS = 100
MOST_INNER = 80
PATIENCE = 25  # evaluations without a better one
SETTLED = 1e-9  # part of the residual that parameters still explain, relative to all of it, not worth another evaluation
AT_BOUND = 1e-6  # distance in u from a bound that counts as at it
PROPORTION = 0.01  # change of the estimated noise of one sensor against another's that is worth another round
ROUNDS = 5


Runs = dict[str, tuple[dict[str, Array], dict[str, Array]]]  # of each experiment readings and residuals, by sensor


class Task(eqx.Module):
    """A least-squares problem: `residual(u)` over all experiments, `scatter(u)` the model and experiments with u in them."""

    model: Model
    experiments: dict[str, Experiment]
    free: tuple[Free, ...]
    noise: dict[str, dict[str, Array]]
    rtol: Float[Array, ""]
    solver: diffrax.AbstractSolver
    stepsize_controller: diffrax.AbstractStepSizeController | None
    dt0: Float[Array, ""] | None
    max_steps: int = eqx.field(static=True)

    @property
    def size(self) -> int:
        return sum(f.form.size for f in self.free)

    def values(self, u: Float[Array, "n"]) -> list[Array]:
        """The leaf of each free parameter."""
        ends = np.cumsum([0] + [f.form.size for f in self.free])
        return [f.form.value(u[i:j]) for f, i, j in zip(self.free, ends[:-1], ends[1:], strict=True)]

    def scatter(self, u: Float[Array, "n"]) -> tuple[Model, dict[str, Experiment]]:
        values = list(zip(self.free, self.values(u), strict=True))
        model = write(self.model, {f.leaf: value for f, value in values if not f.run})
        runs = {
            name: write(experiment, {f.leaf: value for f, value in values if f.run == name})
            for name, experiment in self.experiments.items()
        }
        return model, runs

    def simulate(self, model: Model, experiment: Experiment) -> Trajectory:
        motions = motions_of(model, experiment.motion)
        return integrate(model, experiment.times, motions, tuple(experiment.loads.values()), experiment.initial, self.rtol, self.solver, self.stepsize_controller, diffrax.ForwardMode(), self.dt0, self.max_steps, diffrax.NoProgressMeter())  # fmt: skip

    def differences(self, model: Model, experiment: Experiment, noise: dict[str, Array]) -> tuple[dict[str, Array], dict[str, Array]]:
        """Readings, and residuals over noise (zero where a sample is missing), of one experiment."""
        found, residuals = readings(self.simulate(model, experiment), experiment.sensors), {}
        for name, sensor in experiment.sensors.items():
            residuals[name] = sensor.misfit(experiment.times, found[name], experiment.measured[name]) / sensor.spread(noise[name])
        return found, residuals

    def runs(self, u: Float[Array, "n"]) -> Runs:
        """`differences` of every experiment, those of equal structure side by side."""
        model, runs = self.scatter(u)
        found = {}
        for names in shared_structure(runs):
            if len(names) == 1:
                found[names[0]] = self.differences(model, runs[names[0]], self.noise[names[0]])
                continue
            group, noise = (jax.tree.map(lambda *x: jnp.stack(x), *(tree[name] for name in names)) for tree in (runs, self.noise))
            both = jax.vmap(self.differences, in_axes=(None, 0, 0))(model, group, noise)
            found |= {name: jax.tree.map(lambda x, i=i: x[i], both) for i, name in enumerate(names)}
        return found

    def residual(self, u: Float[Array, "n"]) -> Float[Array, "m"]:
        return _all_residuals(self.runs(u))


def _all_residuals(runs: Runs) -> Float[Array, "m"]:
    return jnp.concatenate([r.ravel() for _, residuals in runs.values() for r in residuals.values()])


@eqx.filter_jit
def _residual_and_jacobian(task: Task, u: Float[Array, "n"]) -> tuple[Array, Array, Runs]:
    """r, dr/du and what they come from, in one program: compiling costs more than running."""

    def evaluate(u):
        runs = task.runs(u)
        r = _all_residuals(runs)
        return r, (r, runs)

    J, (r, runs) = jax.jacfwd(evaluate, has_aux=True)(u)
    return r, J, runs


class Fit(Result):
    """A fit: `model` and `experiments` with the estimates in them, `estimates` and `standard_errors` by path (infinite where the data cannot tell),
    `covariance` of u, `singular_values` of the Jacobian with relative columns, `unidentified` in words, `predicted` {run: {sensor: array}},
    `noise` {run: {sensor: rms residual}} (of a pose two, in meters and radians), `correlation` (lag one) of the residuals, `cost` 1/2 r'r,
    `history` of costs, `failed` trials that could not be simulated, `at_bound` in words. `status` NOT_CONVERGED, NOT_IDENTIFIABLE, NEVER_MOVED
    or AT_BOUND where it is not good. Leading axes of a batch stay; standard errors are not there inside jit or vmap.

    >>> import inspect
    >>> inspect.signature(fit).return_annotation  # fit returns one
    'Fit'
    """

    model: Model
    experiments: dict[str, Experiment]
    u: Float[Array, "n"]
    cost: Float[Array, ""]
    status: Int[Array, ""]
    evaluations: int | Int[Array, ""]
    task: Task
    uncertainty: Uncertainty | None
    predicted: dict[str, dict[str, Array]]
    noise: dict[str, dict[str, Array]]
    history: list[float]
    failed: int
    at_bound: list[str]

    @property
    def paths(self) -> tuple[str, ...]:
        return tuple(f.leaf.path for f in self.task.free)

    @property
    def estimates(self) -> dict[str, Array]:
        """{path: value}."""
        values = lambda task, u: task.values(u)  # noqa: E731
        for _ in range(self.u.ndim - 1):
            values = eqx.filter_vmap(values)
        return dict(zip(self.paths, values(self.task, self.u), strict=True))

    def _assessed(self) -> Uncertainty:
        if self.uncertainty is None:
            raise JaxbodyError(Problem("TRACED", "fit", "has no standard errors inside jit or vmap", hint="Fit outside of it for them."))
        return self.uncertainty

    @property
    def standard_errors(self) -> dict[str, np.ndarray]:
        """{path: standard error}, infinite where the data cannot tell."""
        return self._assessed().standard_errors

    @property
    def covariance(self) -> np.ndarray:
        return self._assessed().covariance

    @property
    def singular_values(self) -> np.ndarray:
        return self._assessed().singular_values

    @property
    def unidentified(self) -> list[str]:
        """Directions that leave the readings as they are, in words."""
        return self._assessed().words

    @property
    def correlation(self) -> float:
        return self._assessed().correlation

    def explain(self) -> str:
        status = Status(int(self.status))
        if status in (Status.NOT_IDENTIFIABLE, Status.NEVER_MOVED):
            u = self._assessed()
            return f"rank {u.rank} of {len(u.singular_values)}: " + "; ".join(u.words)
        if status == Status.AT_BOUND:
            return ", ".join(self.at_bound) + "; no standard error there is to be trusted"
        if status == Status.NOT_CONVERGED:
            return f"after {int(self.evaluations)} evaluations; the best so far is kept; start nearer, or give more max_evaluations"
        return ""

    def to_xarray(self) -> Any:
        """An xarray.Dataset of estimates and standard errors by path."""
        from jaxbody.exports import fit_dataset

        return fit_dataset(self)

    def _tables(self) -> list[tables.Table]:
        if self.uncertainty is None or not is_concrete(self.u):
            return [tables.Table("Fit", ("", ""), [(path, value) for path, value in self.estimates.items()])]
        rows = []
        for path, value in self.estimates.items():
            error = np.asarray(self.standard_errors[path])
            for label, x, e in zip(_labels(path, np.asarray(value)), np.asarray(value).ravel(), error.ravel(), strict=True):
                rows.append(
                    (
                        label,
                        float(x),
                        float(e) if np.isfinite(e) else "not determined",
                        f"{100 * e / abs(x):.2g} %" if np.isfinite(e) and x else "",
                    )
                )
        fits = [
            (f"{run}.{name}", float(rms), unit.strip())
            for run, sensors in self.noise.items()
            for name, levels in sensors.items()
            for rms, unit in zip(np.ravel(levels), self.experiments[run].sensors[name].unit.split(","), strict=True)
        ]
        u = self.uncertainty
        notes = [f"{u.samples} samples, {int(self.evaluations)} evaluations; {self.report()}"]
        if u.correlated:
            notes.append(
                f"residuals are correlated (lag one {u.correlation:.2f}): the standard errors, which take them for white noise, are too small"
            )
        if status_words := ([] if int(self.status) in (Status.NOT_IDENTIFIABLE, Status.NEVER_MOVED) else u.words):
            notes += status_words
        return [
            tables.Table("Fit", ("parameter", "estimate", "standard error", "relative"), rows),
            tables.Table("", ("sensor", "rms residual", "unit"), fits, "\n".join(notes)),
        ]


def _labels(path: str, value: np.ndarray) -> list[str]:
    return [path] if value.ndim == 0 else [path + str(list(i)).replace(" ", "") for i in np.ndindex(value.shape)]


def fit(
    model: Model,
    experiments: dict[str, Experiment],
    *,
    free: Iterable[str] | str,
    method: Any = "least_squares",
    bounds: dict[str, tuple[Any, Any]] | None = None,
    rtol: float = 1e-8,
    solver: diffrax.AbstractSolver | None = None,
    stepsize_controller: diffrax.AbstractStepSizeController | None = None,
    dt0: float | None = None,
    max_steps: int = 10_000,
    max_evaluations: int = 2000,
    progress: bool = False,
    allow_float32: bool = False,
) -> Fit:
    """Least-squares estimates of free parameters from measured motions.

    free: paths or patterns, of the model ("*.stiffness", "plate.mass", "AB.a") or of an experiment ("run1.initial.v", "run1.base.frequency").
    method: any optax optimizer, restarted in whitened coordinates until it has arrived; "least_squares", SciPy's trust-region
    reflective method, which takes `bounds` {path: (lower, upper)}; or an optimistix least-squares solver, which may also run inside
    jit and vmap and be differentiated in forward mode.

    Stiffness, damping and mass stay positive, inertia definite, orientations unit. What the data cannot tell is said in words instead of numbers. Noise
    that an experiment does not state is estimated for each sensor from the residuals, and the fit repeated with it. A trial that cannot be
    simulated is a step rejected.

    rtol, solver, stepsize_controller, dt0: as in `simulate`. Constant steps are several times faster where many experiments run side by side or where
    an input has kinks at samples on which the steps lie; that they are short enough is then yours to see to.

    Errors: UNKNOWN_PATH, LISTED_TWICE, NOTHING_FREE, BAD_BOUNDS, START_OUTSIDE, START_ON_BOUND, NONFINITE_START, FLOAT32 and those of
    `simulate`; inside jit and vmap NO_NOISE, where noise would have to be estimated. Warns by status, and of FAILED_TRIALS.

    >>> model = Model(bodies={"mass": Body(mass=1.0, inertia=[1, 1, 1], position=[1, 0, 0])}, joints={"mass": Guide("world", axis=[1, 0, 0])},
    ...               elements={"spring": Spring(("mass", [0, 0, 0]), ("world", [0, 0, 0]), stiffness=30.0)})
    >>> times = jnp.linspace(0, 1, 6)
    >>> track = Experiment(times, sensors={"x": Position("mass", axis=[1, 0, 0])}, measured={"x": jnp.cos(2 * jnp.pi * times)})
    >>> round(float(fit(model, {"track": track}, free=["spring.stiffness"]).estimates["spring.stiffness"]), 5)  # (2 pi)^2
    39.47842
    """
    check_precision("fit", model, needs_float64=not allow_float32)
    check_steps(stepsize_controller, dt0, "fit")
    _check_runs(model, experiments)
    parameters = choose(model, experiments, [free] if isinstance(free, str) else list(free))
    search = _search(method, limits_of(parameters, bounds or {}, method))
    noise, estimated = _first_noise(experiments)
    step = None if dt0 is None else jnp.asarray(dt0, float)
    task = Task(model, dict(experiments), parameters, noise, jnp.asarray(rtol), solver, stepsize_controller, step, max_steps)  # fmt: skip
    u = jnp.zeros(task.size)
    if not is_concrete(model, experiments):
        return _fit_traced(task, u, method, max_evaluations, estimated)
    evaluate = Evaluations(task, max_evaluations, progress)
    _check_start(task, *evaluate(u))
    arrived = False
    for _ in range(ROUNDS if estimated else 1):
        u, arrived = search(evaluate, u)
        if not estimated:
            break
        evaluate.task, changed = _renoised(evaluate.task, evaluate.runs(u))
        if not changed:
            break
    result = _finish(evaluate, u, arrived, limits_of(parameters, bounds or {}, method))
    warn_if_failed(result)
    if evaluate.failed > evaluate.count / 2:
        warn("FAILED_TRIALS", f"{evaluate.failed} of {evaluate.count} trials of the fit could not be simulated")
    return result


class Evaluations:
    """Residual and Jacobian as functions of u, compiled once, counted, and never raising: a trial that fails has a residual of NaN."""

    def __init__(self, task: Task, most: int, progress: bool):
        self.task, self.most, self.progress = task, most, progress
        self.roughness = float(task.rtol * size_of(task.model))  # of readings, by the tolerance of the integration
        self.count, self.failed, self.history, self._last = 0, 0, [], None

    def __call__(self, u) -> tuple[np.ndarray, np.ndarray]:
        return self._at(u)[:2]

    def runs(self, u) -> Runs:
        return self._at(u)[2]

    def _at(self, u) -> tuple[np.ndarray, np.ndarray, Runs]:
        key = np.asarray(u).tobytes()
        if self._last is not None and self._last[0] == key and self._last[1] is self.task:
            return self._last[2]
        with jax.disable_jit(False):
            r, J, runs = _residual_and_jacobian(self.task, jnp.asarray(u))
        r, J = np.asarray(r), np.asarray(J)
        J = np.where(np.linalg.norm(J, axis=0) <= self.roughness * self._weight(), 0.0, J)  # a search would follow round-off anywhere
        bad = not (np.isfinite(r).all() and np.isfinite(J).all())
        r = np.full_like(r, np.nan) if bad else r
        self.count, self.failed = self.count + 1, self.failed + bad
        self.history.append(float(0.5 * r @ r))
        if self.progress:
            print(f"evaluation {self.count}: " + ("failed" if bad else f"cost {self.history[-1]:.9g}"), flush=True)
        self._last = (key, self.task, (r, J, runs))
        return r, J, runs

    def _weight(self) -> float:
        """The norm of all residuals if each were of unit length."""
        weights = [(e.measured[name].size, self.task.noise[run][name]) for run, e in self.task.experiments.items() for name in e.sensors]
        return float(np.sqrt(sum(n * np.mean(1 / np.asarray(level) ** 2) for n, level in weights)))

    @property
    def spent(self) -> bool:
        return self.count >= self.most


def _search(method: Any, limits: tuple[np.ndarray, np.ndarray]) -> Callable:
    """A method as a function of Evaluations and a start, which returns the best u and whether it has arrived."""
    if isinstance(method, str) and method == "least_squares":
        return lambda evaluate, u: _search_scipy(evaluate, u, limits)
    if isinstance(method, optimistix.AbstractLeastSquaresSolver):
        return lambda evaluate, u: _search_optimistix(evaluate, u, method)
    if hasattr(method, "init") and hasattr(method, "update"):
        return lambda evaluate, u: _settled(evaluate, *_search_optax(evaluate, u, method), limits)
    raise JaxbodyError(
        Problem(
            "UNKNOWN_METHOD",
            "fit.method",
            f"is {method!r:.60}",
            method,
            'an optax optimizer, "least_squares" or an optimistix least-squares solver',
        )
    )


class _Near(Exception):
    """The Gauss-Newton step from u is so short that it may finish the search."""

    def __init__(self, u: np.ndarray):
        self.u = u


def _search_scipy(evaluate: Evaluations, u, limits) -> tuple[Array, bool]:
    """Bounded least squares, to where Gauss-Newton steps finish; it takes a residual of NaN for a step too far."""
    from scipy.optimize import least_squares

    left = max(evaluate.most - evaluate.count, 1)
    size = np.linalg.norm(evaluate(u)[0]) or 1.0  # so that its first region of trust is one of u, not of noise

    def jacobian(u):
        towards, S, V = _whitened(evaluate(u))
        if np.abs(V @ (towards / S)).max(initial=0.0) <= NEAR and (limits[0] < u).all() and (u < limits[1]).all():
            raise _Near(u)
        return evaluate(u)[1] / size

    try:
        found = least_squares(lambda u: evaluate(u)[0] / size, np.asarray(u), jacobian, limits, x_scale="jac", xtol=1e-11, ftol=1e-15, gtol=1e-15, max_nfev=left)  # fmt: skip
    except _Near as near:
        return _settled(evaluate, near.u, True, limits)
    return _settled(evaluate, found.x, found.status > 0, limits)


def _settled(evaluate: Evaluations, u, arrived: bool, limits) -> tuple[Array, bool]:
    """Gauss-Newton steps from where costs, rough by the tolerance of the integration, tell no difference, as long as they get much shorter."""
    u = np.asarray(u)
    inside = np.all(np.abs(u - np.stack(limits)) > AT_BOUND, axis=0)
    towards, S, V = _whitened(evaluate(u), inside)
    while arrived and np.linalg.norm(towards) > SETTLED * np.linalg.norm(evaluate(u)[0]) and not evaluate.spent:
        new = u.copy()
        new[inside] -= V @ (towards / S)
        before, (towards, S, V) = np.linalg.norm(towards), _whitened(evaluate(new), inside)
        if not np.linalg.norm(towards) < before / 2 or (new < limits[0]).any() or (new > limits[1]).any():
            break
        u = new
    return jnp.asarray(u), arrived


def _whitened(found: tuple[np.ndarray, np.ndarray], columns=slice(None)) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """U'r, S and V of J = U S V', without directions that the data do not know: the Gauss-Newton step is -V S^-1 U'r."""
    r, J = found
    if not np.isfinite(r).all():
        return np.array([np.inf]), np.ones(1), np.zeros((J[:, columns].shape[1], 1))
    U, S, Vt = np.linalg.svd(J[:, columns], full_matrices=False)
    known = known_directions(S)
    return (U.T @ r)[known], S[known], Vt[known].T


def _search_optimistix(evaluate: Evaluations, u, method) -> tuple[Array, bool]:
    u, status, steps = _solve(evaluate.task, u, method, max(evaluate.most - evaluate.count, 1))
    evaluate.count += int(steps)
    return u, int(status) == Status.OK


def _search_optax(evaluate: Evaluations, u, optimizer) -> tuple[Array, bool]:
    """The optimizer in whitened coordinates, restarted from the best point until the Gauss-Newton step is small.

    It runs operation by operation on concrete numbers: only the simulations are compiled, and they once. Within a hundredth of a standard
    error or so the integrator's tolerance makes the cost too rough to descend; Gauss-Newton steps, which do not look at it, finish."""
    optimizer = optax.with_extra_args_support(optimizer)
    u, reach = np.asarray(u), 1.0
    for _ in range(MOST_RESTARTS):
        r0, J0 = evaluate(u)
        U, S, Vt = np.linalg.svd(J0, full_matrices=False)
        known = known_directions(S)
        towards = U.T[known] @ r0
        gauss_newton = -Vt[known].T @ (towards / S[known])
        step = np.abs(gauss_newton).max(initial=0.0)
        if step <= ARRIVED:
            return jnp.asarray(u), True
        if evaluate.spent or reach < 1e-6:
            break
        if step < 0.1 and np.linalg.norm(towards) <= ROUGH * np.linalg.norm(r0):
            u = u + gauss_newton
            continue
        share = reach * min(1.0, FARTHEST / step)  # of the way to the linearized optimum that is one unit of y
        size = share * np.linalg.norm(towards)
        spread = Vt[known].T * (size / S[known])
        y = _descend(evaluate, optimizer, u, r0, spread, size, enough=-ENOUGH * (1 / share - 0.5))
        u, reach = (u, reach / 10) if y is None else (u + spread @ y, min(1.0, 10 * reach))
    return jnp.asarray(u), False


def _descend(evaluate: Evaluations, optimizer, u, r0, spread, size, enough: float) -> np.ndarray | None:
    """The best y that the optimizer comes to from 0, or None where it found nothing worth having."""

    def value_and_gradient(y):
        r, J = evaluate(u + spread @ np.asarray(y))
        if not np.isfinite(r).all():
            return jnp.asarray(1e6), jnp.zeros_like(y)
        # (r - r0)'(r + r0)/2 is the change of cost, without the cancellation of the difference of squares
        return jnp.asarray(0.5 * (r - r0) @ (r + r0) / size**2), jnp.asarray(spread.T @ (J.T @ r) / size**2)

    cost = jax.custom_vjp(lambda y: value_and_gradient(y)[0])
    cost.defvjp(value_and_gradient, lambda gradient, factor: (factor * gradient,))
    best, lowest, found_at, first = None, -WORTH / 2, evaluate.count, None
    with jax.disable_jit():
        y = jnp.zeros(spread.shape[1])
        state = optimizer.init(y)
        for _ in range(MOST_INNER):
            value, gradient = value_and_gradient(y)
            slope = float(np.linalg.norm(gradient))
            first = slope if first is None else first
            if float(value) < lowest:
                best, lowest, found_at = np.asarray(y), float(value), evaluate.count
            if lowest < enough or slope < FLAT * first or evaluate.count - found_at > PATIENCE or evaluate.spent:
                break
            change, state = optimizer.update(gradient, state, y, value=value, grad=gradient, value_fn=cost)
            y = optax.apply_updates(y, change)
    return best


@eqx.filter_custom_jvp  # the task's solver and step controller may hold functions
def _residual(task: Task, size, u):
    """r/size, whose derivative in u is the J that comes with r: a loop linearized by itself would run twice."""
    return _residual_and_jacobian(task, u)[0] / size


@_residual.def_jvp
def _residual_jvp(primals, tangents):
    task, size, u = primals
    r, J, _ = _residual_and_jacobian(task, u)
    return r / size, J @ tangents[2] / size


@eqx.filter_jit
def _minimize(task: Task, u, method, most: int) -> tuple[Array, Array, Array]:
    """The optimum by optimistix, a status and the number of steps."""
    signal = sum(jnp.sum((_away(e, name) / e.sensors[name].spread(task.noise[run][name])) ** 2) for run, e in task.experiments.items() for name in e.sensors)  # fmt: skip
    size = jnp.sqrt(jnp.where(signal > 0, signal, 1.0))  # residuals over it are of the order of one, from where such methods set out
    found = optimistix.least_squares(lambda u, args: _residual(*args, u), method, u, (task, size), options={"jac": "fwd"}, max_steps=most, throw=False)  # fmt: skip
    failed = found.result != optimistix.RESULTS.successful
    return found.value, jnp.where(failed, Status.NOT_CONVERGED.value, Status.OK.value), found.stats["num_steps"]


@eqx.filter_jit
def _solve(task: Task, u, method, most: int) -> tuple[Array, Array, Array]:
    """`_minimize`, in one program inside jit and vmap too, differentiable in forward mode by the implicit function theorem."""
    numbers, rest = eqx.partition(method, eqx.is_array)
    arrays, static = eqx.partition(task, eqx.is_array)

    @jax.custom_jvp
    def solve(arrays, u, numbers):
        return _minimize(eqx.combine(jax.lax.stop_gradient(arrays), static), u, eqx.combine(numbers, rest), most)

    @solve.defjvp
    def solve_jvp(primals, tangents):
        arrays = primals[0]
        u, status, steps = solve(*primals)

        def gradient(along):
            """Of the cost, u moved and the task moved along its tangent; one program for both derivatives."""
            moved = jax.tree.map(lambda x, dx: x if dx.dtype == jax.dtypes.float0 else x + along[-1] * dx, arrays, tangents[0])
            r, J, _ = _residual_and_jacobian(eqx.combine(moved, static), u + along[:-1])
            return J.T @ r

        slopes = jax.jacfwd(gradient)(jnp.zeros(task.size + 1))
        H, change = slopes[:, :-1], slopes[:, -1]
        still = [np.zeros(jnp.shape(x), jax.dtypes.float0) for x in (status, steps)]
        return (u, status, steps), (-jnp.linalg.solve(jnp.where(status == 0, H, jnp.nan), change), *still)

    return solve(arrays, u, numbers)


def _fit_traced(task: Task, u, method, most: int, estimated: bool) -> Fit:
    """Inside jit, vmap and derivatives, where nothing can be looked at."""
    if not isinstance(method, optimistix.AbstractLeastSquaresSolver):
        hint = "Use optimistix.LevenbergMarquardt(rtol=1e-8, atol=1e-8) there."
        raise JaxbodyError(Problem("TRACED", "fit.method", "works on numbers, not inside jit, vmap or grad", method, hint=hint))
    if estimated:
        hint = "Give every Experiment its noise: how the sensors weigh against each other is estimated outside of jit, vmap and grad only."
        raise JaxbodyError(Problem("NO_NOISE", "fit.experiments", "do not state the noise of all sensors", hint=hint))
    u, status, steps = _solve(task, u, method, most)
    model, experiments = task.scatter(u)
    r = task.residual(u)
    return Fit(model, experiments, u, 0.5 * r @ r, status, steps, task, None, {}, {}, [], 0, [])


def _finish(evaluate: Evaluations, u, arrived: bool, limits) -> Fit:
    task = evaluate.task
    r, J = evaluate(u)
    runs = evaluate.runs(u)
    residuals = {run: runs[run][1] for run in task.experiments}
    present = {run: _present(experiment) for run, experiment in task.experiments.items()}
    labels = [f.leaf.path + label for f in task.free for label in f.form.labels()]
    G = jax.jacfwd(task.values)(u)
    uncertainty = assess(r, J, [np.asarray(g) for g in G], [f.leaf.path for f in task.free], labels, residuals, present)
    at_bound = [
        f"{label} ({side})"
        for side, limit in zip(("lower", "upper"), limits, strict=True)
        for label, near in zip(labels, np.abs(np.asarray(u) - limit) < AT_BOUND, strict=True)
        if near
    ]
    status = Status.OK
    if not arrived:
        status = Status.NOT_CONVERGED
    elif uncertainty.still:
        status = Status.NEVER_MOVED
    elif uncertainty.rank < task.size:
        status = Status.NOT_IDENTIFIABLE
    elif at_bound:
        status = Status.AT_BOUND
    model, experiments = task.scatter(u)
    predicted = {run: runs[run][0] for run in task.experiments}
    noise = {
        run: {name: task.noise[run][name] * _rms(e.sensors[name], [residuals[run][name]], [present[run][name]]) for name in e.sensors}
        for run, e in task.experiments.items()
    }
    return Fit(model, experiments, u, jnp.asarray(0.5 * r @ r), jnp.asarray(status.value), evaluate.count, task, uncertainty, predicted, noise, evaluate.history, evaluate.failed, at_bound)  # fmt: skip


def _present(experiment: Experiment) -> dict[str, np.ndarray]:
    """Which components of the residuals have their samples."""
    return {name: ~sensor.missing(np.asarray(experiment.measured[name])) for name, sensor in experiment.sensors.items()}


def _rms(sensor: Sensor, residuals: list, present: list) -> Array:
    """Root mean square over all records of a sensor, one number or one for each of its units."""
    squares = sum(sensor.pooled(jnp.asarray(r) ** 2) for r in residuals)
    return jnp.sqrt(squares / sum(sensor.pooled(jnp.asarray(there, float)) for there in present))


def _first_noise(experiments: dict[str, Experiment]) -> tuple[dict[str, dict[str, Array]], bool]:
    """Stated noise; without it the standard deviation of each sensor's record, over all runs, and True where it is still to be estimated."""
    sensors = {name: sensor for e in experiments.values() for name, sensor in e.sensors.items()}
    spread = {}
    for name, sensor in sensors.items():
        runs = [e for e in experiments.values() if name in e.sensors]
        spread[name] = _rms(sensor, [_away(e, name) for e in runs], [~sensor.missing(e.measured[name]) for e in runs])
        spread[name] = jnp.where(spread[name] > 0, spread[name], 1.0)
    noise = {run: {name: (e.noise or {}).get(name, spread[name]) for name in e.sensors} for run, e in experiments.items()}
    stated = [name in (e.noise or {}) for e in experiments.values() for name in e.sensors]
    units = sum(np.size(level) for level in spread.values())
    return noise, not all(stated) and (units > 1 or any(stated))


def _away(experiment: Experiment, name: str) -> Array:
    """Residuals of what would read the mean of a record at all times."""
    measured = experiment.measured[name]
    return experiment.sensors[name].residual(jnp.broadcast_to(jnp.nanmean(measured, axis=0), measured.shape), measured)


def _renoised(task: Task, runs: Runs) -> tuple[Task, bool]:
    """The task with noise as the residuals have it, and whether that changed its proportions by more than PROPORTION."""
    found: dict[str, tuple[Sensor, list, list]] = {}
    for run, experiment in task.experiments.items():
        for name, there in _present(experiment).items():
            sensor = experiment.sensors[name]
            _, residuals, present = found.setdefault(name, (sensor, [], []))
            residuals.append(runs[run][1][name] * sensor.spread(task.noise[run][name]))
            present.append(there)
    rms = {name: jnp.maximum(_rms(*parts), 1e-12) for name, parts in found.items()}
    new = {run: {name: (e.noise or {}).get(name, rms[name]) for name in e.sensors} for run, e in task.experiments.items()}
    places = [(run, name) for run in new for name in new[run]]
    ratio, fitted = (
        np.concatenate([np.ravel(level(*place) / task.noise[place[0]][place[1]]) for place in places])
        for level in (lambda run, name: new[run][name], lambda _, name: rms[name])
    )
    if fitted.max() < 1e-9:  # an exact fit has no noise to weigh by
        return task, False
    return eqx.tree_at(lambda t: t.noise, task, new), bool(ratio.max() / ratio.min() > 1 + PROPORTION)


def _check_runs(model: Model, experiments: dict[str, Experiment]) -> None:
    problems = Problems()
    if not experiments:
        problems.add("NO_DATA", "fit.experiments", "is empty", limit="at least one Experiment")
    for name, experiment in experiments.items():
        if name in (*model.names, "world", "gravity") or set(name) & set(".*?[]"):
            problems.add("BAD_NAME", f"experiments['{name}']", "is the name of something else, or has one of . * ? [ ]", value=name)
        elif not isinstance(experiment, Experiment):
            problems.add("WRONG_KIND", f"experiments['{name}']", f"is a {type(experiment).__name__}", value=experiment, limit="Experiment")
    problems.raise_if_any()
    for name, experiment in experiments.items():
        experiment.check(model, name)


def _check_start(task: Task, r: np.ndarray, J: np.ndarray) -> None:
    """The residual must be finite at the start; else say where it is not."""
    if np.isfinite(r).all():
        return
    runs = _residual_and_jacobian(task, jnp.zeros(task.size))[2]
    for run, (_, residuals) in runs.items():
        for name, values in residuals.items():
            bad = np.argwhere(~np.isfinite(np.asarray(values)))
            if len(bad):
                told = task.simulate(task.model, task.experiments[run]).report()
                time = float(task.experiments[run].times[bad[0][0]])
                where = f", component {bad[0][1]}" if bad.shape[1] > 1 else ""
                told = f"is not finite from t = {time:.6g} s on{where}, at the start of the fit: {told}"
                raise JaxbodyError(
                    Problem("NONFINITE_START", f"{run}.{name}", told, time, "finite", "Start from parameters that can be simulated.")
                )
    raise JaxbodyError(
        Problem("NONFINITE_START", "fit", "has derivatives that are not finite at the start", hint="Start from other parameters.")
    )
