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
from jaxbody.arrays import concrete
from jaxbody.checks import check_precision
from jaxbody.errors import JaxbodyError, Problem, Problems, Status, is_concrete
from jaxbody.experiments import Experiment, shared_structure
from jaxbody.models import Model
from jaxbody.naming import Leaf, leaves_of, matching, write
from jaxbody.parametrizations import Parametrization, Positive, Shifted, parametrize
from jaxbody.results import Result, warn_if_failed
from jaxbody.sensors import read
from jaxbody.simulations import MAX_STEPS, Trajectory, integrate, motions_of
from jaxbody.statics import size_of
from jaxbody.uncertainties import Uncertainty, assess

ARRIVED = 1e-7  # largest Gauss-Newton step in u at which a fit has arrived
NEAR = 1e-6  # the same where the optimizer finds nothing better: the noise of the simulated cost hides the rest
RANK = 1e-6  # singular values of the scaled Jacobian, relative to the largest, that count as zero
MOST_RESTARTS = 40
MOST_INNER = 80
PATIENCE = 10


class Free(eqx.Module):
    """A free parameter: the run it belongs to ("" for the model), where it is, and how it moves."""

    run: str = eqx.field(static=True)
    leaf: Leaf = eqx.field(static=True)
    form: Parametrization


class Task(eqx.Module):
    """A least-squares problem: `residual(u)` over all experiments, `scatter(u)` the model and experiments with u in them."""

    model: Model
    experiments: dict[str, Experiment]
    free: tuple[Free, ...]
    noise: dict[str, dict[str, Array]]
    rtol: float = eqx.field(static=True)
    solver: diffrax.AbstractSolver
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
        return integrate(model, experiment.times, motions, experiment.initial, self.rtol, self.solver, None, diffrax.ForwardMode(), None, self.max_steps, diffrax.NoProgressMeter())  # fmt: skip

    def differences(self, model: Model, experiment: Experiment, noise: dict[str, Array]) -> tuple[dict[str, Array], dict[str, Array]]:
        """Readings, and residuals over noise (zero where a sample is missing), of one experiment."""
        readings = self.simulate(model, experiment).at_samples(read, experiment.sensors)
        residuals = {}
        for name, sensor in experiment.sensors.items():
            measured = experiment.measured[name]
            r = sensor.residual(readings[name], jnp.where(jnp.isnan(measured), readings[name], measured))
            residuals[name] = r / noise[name]
        return readings, residuals

    def runs(self, u: Float[Array, "n"]) -> dict[str, tuple[dict[str, Array], dict[str, Array]]]:
        """`differences` of every experiment, those of equal structure side by side."""
        model, runs = self.scatter(u)
        found = {}
        for names in shared_structure(runs):
            stack = lambda *x: jnp.stack(x)  # noqa: E731
            group = jax.tree.map(stack, *(runs[name] for name in names))
            noise = jax.tree.map(stack, *(self.noise[name] for name in names))
            both = jax.vmap(self.differences, in_axes=(None, 0, 0))(model, group, noise)
            found |= {name: jax.tree.map(lambda x, i=i: x[i], both) for i, name in enumerate(names)}
        return found

    def residual(self, u: Float[Array, "n"]) -> Float[Array, "m"]:
        runs = self.runs(u)
        return jnp.concatenate([runs[run][1][name].ravel() for run in self.experiments for name in self.experiments[run].sensors])


@eqx.filter_jit
def _residual_and_jacobian(task: Task, u: Float[Array, "n"]) -> tuple[Array, Array]:
    def twice(u):
        r = task.residual(u)
        return r, r

    J, r = jax.jacfwd(twice, has_aux=True)(u)
    return r, J


@eqx.filter_jit
def _runs(task: Task, u: Float[Array, "n"]):
    return task.runs(u)


class Fit(Result):
    """A fit: `model` and `experiments` with the estimates in them, `estimates` and `standard_errors` by path (infinite where the data cannot tell),
    `covariance` of u, `singular_values` of the Jacobian with relative columns, `unidentified` in words, `predicted` {run: {sensor: array}},
    `noise` {run: {sensor: rms residual}}, `correlation` (lag one) of the residuals, `cost` 1/2 r'r, `history` of costs.
    `status` NOT_CONVERGED, NOT_IDENTIFIABLE, NEVER_MOVED or AT_BOUND where it is not good."""

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

    @property
    def paths(self) -> tuple[str, ...]:
        return tuple(f.leaf.path for f in self.task.free)

    @property
    def estimates(self) -> dict[str, Array]:
        """{path: value}."""
        return dict(zip(self.paths, self.task.values(self.u), strict=True))

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
            return "its standard error there is not to be trusted"
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
        fits = [(f"{run}.{name}", float(rms)) for run, sensors in self.noise.items() for name, rms in sensors.items()]
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
            tables.Table("", ("sensor", "rms residual"), fits, "\n".join(notes)),
        ]


def _labels(path: str, value: np.ndarray) -> list[str]:
    return [path] if value.ndim == 0 else [path + str(list(i)).replace(" ", "") for i in np.ndindex(value.shape)]


def fit(
    model: Model,
    experiments: dict[str, Experiment],
    *,
    free: Iterable[str],
    method: Any = "least_squares",
    bounds: dict[str, tuple[Any, Any]] | None = None,
    rtol: float = 1e-8,
    solver: diffrax.AbstractSolver | None = None,
    max_steps: int = MAX_STEPS,
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
    that an experiment does not state is estimated for each sensor from the residuals, and the fit repeated with it.

    Errors: UNKNOWN_PATH, LISTED_TWICE, BAD_BOUNDS, START_OUTSIDE, START_ON_BOUND, NONFINITE_START and those of `simulate`; warns by status.
    """
    check_precision("fit", model, needs_float64=not allow_float32)
    _check_runs(model, experiments)
    parameters = _free(model, experiments, list(free))
    limits = _limits(parameters, bounds or {}, method)
    noise, estimated = _first_noise(experiments)
    task = Task(model, dict(experiments), parameters, noise, rtol, solver or diffrax.Dopri8(), max_steps)
    u = jnp.zeros(task.size)
    if isinstance(method, optimistix.AbstractLeastSquaresSolver):
        return _fit_inside(task, u, method, max_evaluations)
    if not is_concrete(model, experiments):
        raise JaxbodyError(
            Problem(
                "TRACED",
                "fit.method",
                "works on numbers, not inside jit, vmap or grad",
                method,
                hint="Use optimistix.LevenbergMarquardt(rtol=1e-8, atol=1e-8) there.",
            )
        )
    evaluate = Evaluations(task, max_evaluations, progress)
    _check_start(task, *evaluate(u))
    search = _search(method, limits)
    for _ in range(5 if estimated else 1):
        u, arrived = search(evaluate, u)
        task, changed = _renoised(task, u) if estimated else (task, False)
        if not changed:
            break
        evaluate.task = task
    result = _finish(task, u, arrived, evaluate, limits)
    warn_if_failed(result)
    return result


class Evaluations:
    """Residual and Jacobian as functions of u, compiled once, counted, and never raising: a trial that fails is infinitely bad."""

    def __init__(self, task: Task, most: int, progress: bool):
        self.task, self.most, self.progress = task, most, progress
        self.count, self.history, self._last = 0, [], None

    def __call__(self, u) -> tuple[np.ndarray, np.ndarray]:
        key = np.asarray(u).tobytes()
        if self._last is not None and self._last[0] == key and self._last[1] is self.task:
            return self._last[2]
        with jax.disable_jit(False):
            r, J = (np.asarray(x) for x in _residual_and_jacobian(self.task, jnp.asarray(u)))
        self.count += 1
        self.history.append(float(0.5 * r @ r))
        if self.progress:
            print(f"evaluation {self.count}: cost {self.history[-1]:.9g}", flush=True)
        self._last = (key, self.task, (r, J))
        return r, J

    @property
    def spent(self) -> bool:
        return self.count >= self.most


def _search(method: Any, limits: tuple[np.ndarray, np.ndarray]) -> Callable:
    if isinstance(method, str) and method == "least_squares":
        return lambda evaluate, u: _search_scipy(evaluate, u, limits)
    if hasattr(method, "init") and hasattr(method, "update"):
        return lambda evaluate, u: _search_optax(evaluate, u, method)
    raise JaxbodyError(
        Problem(
            "UNKNOWN_METHOD",
            "fit.method",
            f"is {method!r:.60}",
            method,
            'an optax optimizer, "least_squares" or an optimistix least-squares solver',
        )
    )


def _search_scipy(evaluate: Evaluations, u, limits) -> tuple[Array, bool]:
    """Bounded least squares; a trial that fails counts as far away."""
    from scipy.optimize import least_squares

    worst = 1e3 * max(np.abs(evaluate(u)[0]).max(), 1e-300)

    def residual(u):
        r = evaluate(u)[0]
        return r if np.isfinite(r).all() else np.full_like(r, worst)

    found = least_squares(residual, np.asarray(u), lambda u: evaluate(u)[1], limits, x_scale="jac", xtol=1e-11, ftol=1e-15, gtol=1e-15, max_nfev=evaluate.most)  # fmt: skip
    return jnp.asarray(found.x), found.status > 0


def _search_optax(evaluate: Evaluations, u, optimizer) -> tuple[Array, bool]:
    """The optimizer in whitened coordinates, restarted from the best point until the Gauss-Newton step is small.

    It runs operation by operation on concrete numbers: only the simulations are compiled, and they once."""
    optimizer = optax.with_extra_args_support(optimizer)
    reach = 1.0
    for _ in range(MOST_RESTARTS):
        r0, J0 = evaluate(u)
        U, S, Vt = np.linalg.svd(J0, full_matrices=False)
        known = RANK * S.max(initial=0.0) < S
        towards = U.T @ r0
        step = np.abs(Vt[known].T @ (towards[known] / S[known])).max(initial=0.0)
        if step <= ARRIVED:
            return u, True
        size = reach * np.linalg.norm(towards[known])
        spread = Vt[known].T * (size / S[known])
        y = _descend(evaluate, optimizer, np.asarray(u), r0, spread, size)
        if y is None and step <= NEAR:
            return u, True
        if y is None:
            reach /= 10
        else:
            u, reach = jnp.asarray(np.asarray(u) + spread @ y), min(1.0, 10 * reach)
        if reach < 1e-6 or evaluate.spent:
            break
    return u, False


def _descend(evaluate: Evaluations, optimizer, u, r0, spread, size) -> np.ndarray | None:
    """The best y that the optimizer comes to from 0, or None where it found nothing better."""

    def value_and_gradient(y):
        r, J = evaluate(u + spread @ np.asarray(y))
        if not np.isfinite(r).all():
            return jnp.asarray(1e6), jnp.zeros_like(y)
        # (r - r0)'(r + r0)/2 is the change of cost, without the cancellation of the difference of squares
        return jnp.asarray(0.5 * (r - r0) @ (r + r0) / size**2), jnp.asarray(spread.T @ (J.T @ r) / size**2)

    cost = jax.custom_vjp(lambda y: value_and_gradient(y)[0])
    cost.defvjp(value_and_gradient, lambda gradient, factor: (factor * gradient,))
    best, lowest, since = None, 0.0, 0
    with jax.disable_jit():
        y = jnp.zeros(spread.shape[1])
        state = optimizer.init(y)
        first = None
        for _ in range(MOST_INNER):
            value, gradient = value_and_gradient(y)
            first = np.linalg.norm(gradient) if first is None else first
            better = float(value) < lowest
            best, lowest, since = (np.asarray(y), float(value), 0) if better else (best, lowest, since + 1)
            if np.linalg.norm(gradient) < 1e-4 * first or since >= PATIENCE or evaluate.spent:
                break
            change, state = optimizer.update(gradient, state, y, value=value, grad=gradient, value_fn=cost)
            y = optax.apply_updates(y, change)
    return best


def _fit_inside(task: Task, u, method, most: int) -> Fit:
    """By optimistix, in one program: inside jit and vmap too, differentiable in forward mode by the implicit function theorem."""

    @jax.custom_jvp
    def solve(task):
        frozen = jax.lax.stop_gradient(task)
        found = optimistix.least_squares(lambda u, _: frozen.residual(u), method, u, options={"jac": "fwd"}, max_steps=most, throw=False)
        failed = found.result != optimistix.RESULTS.successful
        return found.value, jnp.where(failed, Status.NOT_CONVERGED.value, Status.OK.value), found.stats["num_steps"]

    @solve.defjvp
    def solve_jvp(primals, tangents):
        u, status, steps = solve(primals[0])

        def gradient(task, u):
            r, J = _residual_and_jacobian(task, u)
            return J.T @ r

        _, change = jax.jvp(lambda task: gradient(task, u), primals, tangents)
        H = jax.jacfwd(lambda u: gradient(primals[0], u))(u)
        zero = np.zeros(jnp.shape(status), jax.dtypes.float0)
        return (u, status, steps), (
            -jnp.linalg.solve(jnp.where(status == 0, H, jnp.nan), change),
            zero,
            np.zeros(jnp.shape(steps), jax.dtypes.float0),
        )

    u, status, steps = solve(task)
    if not is_concrete(task, u):
        model, runs = task.scatter(u)
        r = task.residual(u)
        return Fit(model, runs, u, 0.5 * r @ r, status, steps, task, None, {}, {}, [])
    evaluate = Evaluations(task, most, False)
    evaluate.count = int(steps)
    result = _finish(task, u, int(status) == 0, evaluate, (np.full(task.size, -np.inf), np.full(task.size, np.inf)))
    warn_if_failed(result)
    return result


def _finish(task: Task, u, arrived: bool, evaluate: Evaluations, limits) -> Fit:
    r, J = evaluate(u)
    runs = _runs(task, u)
    residuals = {run: runs[run][1] for run in task.experiments}
    labels = [f.leaf.path + label for f in task.free for label in f.form.labels()]
    G = jax.jacfwd(task.values)(u)
    missing = {run: {name: np.isnan(np.asarray(m)) for name, m in e.measured.items()} for run, e in task.experiments.items()}
    uncertainty = assess(r, J, [np.asarray(g) for g in G], [f.leaf.path for f in task.free], labels, residuals, missing, RANK)
    at_bound = bool(np.any(np.isclose(u, limits[0], atol=1e-9)) or np.any(np.isclose(u, limits[1], atol=1e-9)))
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
        run: {name: task.noise[run][name] * _rms(residuals[run][name], missing[run][name]) for name in residuals[run]} for run in residuals
    }
    return Fit(model, experiments, u, jnp.asarray(0.5 * r @ r), jnp.asarray(status.value), evaluate.count, task, uncertainty, predicted, noise, evaluate.history)  # fmt: skip


def _rms(r, missing) -> Array:
    present = np.prod(r.shape) * (1 - np.mean(missing))
    return jnp.sqrt(jnp.sum(jnp.asarray(r) ** 2) / present)


def _first_noise(experiments: dict[str, Experiment]) -> tuple[dict[str, dict[str, Array]], bool]:
    """Stated noise; without it the standard deviation of each sensor's record, over all runs, and True: it is still to be estimated."""
    names = {name for e in experiments.values() for name in e.sensors}
    spread = {}
    for name in names:
        records = [e.measured[name] - jnp.nanmean(e.measured[name], axis=0) for e in experiments.values() if name in e.sensors]
        spread[name] = jnp.sqrt(jnp.nanmean(jnp.concatenate([r.ravel() for r in records]) ** 2))
        spread[name] = jnp.where(spread[name] > 0, spread[name], 1.0)
    noise = {run: {name: (e.noise or {}).get(name, spread[name]) for name in e.sensors} for run, e in experiments.items()}
    stated = all(name in (e.noise or {}) for e in experiments.values() for name in e.sensors)
    return noise, not stated and len(names) > 1


def _renoised(task: Task, u) -> tuple[Task, bool]:
    """The task with noise as the residuals have it, and whether that changed its proportions by more than 1 %."""
    runs = _runs(task, u)
    squares: dict[str, list] = {}
    for run, (_, residuals) in runs.items():
        for name, r in residuals.items():
            present = ~np.isnan(np.asarray(task.experiments[run].measured[name]))
            squares.setdefault(name, []).append(
                (float(np.sum((np.asarray(r) * np.asarray(task.noise[run][name])) ** 2)), r.size * present.mean())
            )
    rms = {name: np.sqrt(sum(s for s, _ in found) / sum(n for _, n in found)) for name, found in squares.items()}
    stated = {run: e.noise or {} for run, e in task.experiments.items()}
    new = {
        run: {name: stated[run].get(name, jnp.asarray(max(rms[name], 1e-12))) for name in sensors} for run, sensors in task.noise.items()
    }
    ratio = np.array([float(new[run][name] / task.noise[run][name]) for run in new for name in new[run]])
    fitted = np.array([float(rms[name] / task.noise[run][name]) for run in new for name in new[run]])
    if fitted.max() < 1e-9:  # an exact fit has no noise to weigh by
        return task, False
    return eqx.tree_at(lambda t: t.noise, task, new), bool(ratio.max() / ratio.min() > 1.01)


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


def _free(model: Model, experiments: dict[str, Experiment], patterns: list[str]) -> tuple[Free, ...]:
    """The free parameters that the patterns mean, each with its parametrization."""
    problems = Problems()
    roots = {"": model, **experiments}
    leaves = [(run, leaf) for run, tree in roots.items() for leaf in leaves_of(tree, f"{run}." if run else "")]
    owner = {leaf: run for run, leaf in leaves}
    chosen: list[Leaf] = []
    for pattern, found in matching(list(owner), patterns, "fit.free").items():
        for leaf in found:
            if leaf in chosen:
                problems.add("LISTED_TWICE", "fit.free", f"names {leaf.path} twice, by '{pattern}' too", value=pattern)
            else:
                chosen.append(leaf)
    if not chosen:
        problems.add("NOTHING_FREE", "fit.free", "is empty", limit="at least one path")
    arrays = {run: jax.tree.leaves(tree) for run, tree in roots.items()}
    size = size_of(model)
    free = []
    for leaf in chosen:
        form = parametrize(leaf.path, leaf.read(arrays[owner[leaf]]), model, size)
        if isinstance(form, Problem):
            problems.found.append(form)
        else:
            free.append(Free(owner[leaf], leaf, form))
    problems.raise_if_any()
    return tuple(free)


def _limits(free: tuple[Free, ...], bounds: dict[str, tuple[Any, Any]], method: Any) -> tuple[np.ndarray, np.ndarray]:
    """Bounds of u, from bounds of values."""
    problems = Problems()
    low, high = [np.full(f.form.size, -np.inf) for f in free], [np.full(f.form.size, np.inf) for f in free]
    if bounds and method != "least_squares":
        problems.add("BAD_BOUNDS", "fit.bounds", 'are kept by method="least_squares" only', value=method)
    by_path = {leaf.path: i for i, leaf in enumerate(f.leaf for f in free)}
    for pattern, leaves in matching([f.leaf for f in free], bounds, "fit.bounds").items():
        for leaf in leaves:
            i = by_path[leaf.path]
            form, where = free[i].form, f"fit.bounds['{leaf.path}']"
            start = concrete(form.start)
            ends = [np.broadcast_to(np.asarray(b, float), form.start.shape) for b in bounds[pattern]]
            if not isinstance(form, Positive | Shifted):
                problems.add("BAD_BOUNDS", where, "has no bounds of its own", hint="Bound scalars and vectors only.")
            elif (ends[0] >= ends[1]).any():
                problems.add(
                    "BAD_BOUNDS",
                    where,
                    f"has lower {bounds[pattern][0]} >= upper {bounds[pattern][1]}",
                    value=bounds[pattern],
                    limit="lower < upper",
                )
            elif start is not None and ((start < ends[0]) | (start > ends[1])).any():
                distance = np.maximum(ends[0] - start, start - ends[1]).max()
                problems.add(
                    "START_OUTSIDE",
                    where,
                    f"does not hold the start {start}, by {distance:.4g}",
                    value=start,
                    limit=f"{bounds[pattern][0]} to {bounds[pattern][1]}",
                    hint="Move the start or the bound.",
                )
            elif isinstance(form, Positive):
                with np.errstate(divide="ignore"):
                    low[i], high[i] = (np.log(np.maximum(end, 0.0) / start).ravel() for end in ends)
            else:
                low[i], high[i] = (((end - start) / float(form.scale)).ravel() for end in ends)
    problems.raise_if_any()
    return np.concatenate(low), np.concatenate(high)


def _check_start(task: Task, r: np.ndarray, J: np.ndarray) -> None:
    """The residual must be finite at the start; else say where it is not."""
    if np.isfinite(r).all() and np.isfinite(J).all():
        return
    runs = _runs(task, jnp.zeros(task.size))
    for run, (_, residuals) in runs.items():
        for name, values in residuals.items():
            bad = np.argwhere(~np.isfinite(np.asarray(values)))
            if len(bad):
                trajectory = task.simulate(task.model, task.experiments[run])
                time = float(task.experiments[run].times[bad[0][0]])
                raise JaxbodyError(
                    Problem(
                        "NONFINITE_START",
                        f"{run}.{name}",
                        f"is not finite from t = {time:.6g} s, component {bad[0][1:].tolist()}, at the start of the fit: {trajectory.report()}",
                        time,
                        "finite",
                        "Start from parameters that can be simulated.",
                    )
                )
    raise JaxbodyError(
        Problem("NONFINITE_START", "fit", "has derivatives that are not finite at the start", hint="Start from other parameters.")
    )
