"""Residuals of all measurements, divided by their noise, as a function of the transformed free
parameters u; their Jacobian by colors; estimates of the noise.

    r(u) = (reading(u) - measured)/noise

Columns of the Jacobian with nonzeros in different rows are evaluated together: all u of one color
share a tangent. Parameters of different measurements affect different residuals, and so do the
initial states of every other segment of a record. Source: A. Curtis, M. Powell, J. Reid, On the
estimation of sparse Jacobian matrices, J. Inst. Math. Appl. 13 (1974) 117.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxbody.core.arrays import Array, Bool, Float, Int, as_numpy, device_array, module_of
from jaxbody.core.compilation.compile_options import Options, program_with
from jaxbody.core.errors import JaxbodyError, Problem, Problems
from jaxbody.fitting.experiments.experiments import Experiment, Integration
from jaxbody.fitting.experiments.measurements import Measurement, small_motions
from jaxbody.fitting.parameters.spaces import Parameter, Space
from jaxbody.fitting.parameters.transforms import Positive
from jaxbody.fitting.statistics.losses import linearized, robust_level, root
from jaxbody.model.models import Model, options_of_motion, size_of
from jaxbody.sensors.sensors import Channel
from jaxbody.vibration.linearizations import Linearization

PRIORS = "priors"  # in place of a measurement's name for residuals of priors


def colors_of(space: Space) -> Int[np.ndarray, "n"]:
    """Return the color of each u. Parameters of different measurements share colors; parameters
    shared by measurements have colors of their own."""
    used = dict.fromkeys(space.runs, 0)
    colors = np.zeros(space.size, int)
    for parameter, part in space.parts:
        if parameter.run:
            i = np.arange(parameter.form.size)
            row = len(i) // _parts(parameter, space.runs[parameter.run])
            colors[part] = used[parameter.run] + i % row + row * (i // row % 2)
            used[parameter.run] = colors[part].max() + 1
    shared = np.concatenate(
        [np.zeros(0, int), *(np.r_[part] for parameter, part in space.parts if not parameter.run)]
    )
    colors[shared] = max(used.values(), default=0) + np.arange(len(shared))
    return colors


def moved_rows(space: Space, run: str, channel: str, size: int) -> Bool[Array, "{size} n"]:
    """Return which residuals of a channel depend on each u."""

    def rows_of(parameter: Parameter) -> Array:
        n = parameter.form.size
        if run == PRIORS:
            return jnp.full((size, n), channel == parameter.path)
        rows = space.runs[run].moved_rows(parameter.path, channel) if parameter.run == run else None
        if rows is None:
            return jnp.full((size, n), parameter.run in ("", run))
        return jnp.repeat(jnp.repeat(rows, size // rows.shape[0], 0), n // rows.shape[1], 1)

    return jnp.concatenate([rows_of(parameter) for parameter in space.parameters], 1)


def _parts(parameter: Parameter, run: Measurement) -> int:
    """Return the number of parts of a parameter that affect different rows, such as the initial
    states of segments."""
    masks = [run.moved_rows(parameter.path, channel) for channel in run.channels]
    return max(1 if rows is None else rows.shape[1] for rows in masks)


# residuals up to this many times the integration tolerance are integration error, not noise
EXACT = 100
# smallest effect of a parameter that is more than round-off, relative to integration errors
LEAST_EFFECT = 1e-6
VISIBLE = 10.0  # effect of the start that TINY_START recommends, relative to integration errors
# relative change of the ratio of two noise levels above which the fit is repeated
PROPORTION = 0.01

Levels = dict[str, dict[str, Array]]  # {measurement: {channel: noise}}
# {measurement: (readings, residuals)}, both by channel
ReadingsAndResiduals = dict[str, tuple[dict[str, Array], dict[str, Array]]]


class Task(eqx.Module):
    """A least-squares problem: `runs(u)`, readings and residuals of all measurements of a space;
    `residual(u)`, all residuals in one vector, minus an `offset` if there is one."""

    space: Space
    noise: Levels
    integration: Integration
    loss: str | None = eqx.field(static=True, default=None)
    offset: Float[Array, "m"] | None = None

    @property
    def experiments(self) -> dict[str, Measurement]:
        return self.space.runs

    @property
    def priors(self) -> dict[str, tuple[Array, Array]]:
        """Priors of the parameters, {path: (mean, standard deviation)}."""
        return {
            parameter.path: parameter.prior
            for parameter in self.space.parameters
            if parameter.prior is not None
        }

    @property
    def absolute(self) -> bool:
        """True if the optimum depends on the noise levels themselves, not only on their ratios."""
        return self.loss is not None or bool(self.priors)

    def readings_and_residuals(
        self,
        model: Model,
        lin: Linearization | None,
        experiment: Measurement,
        noise: dict[str, Array],
    ) -> tuple[dict[str, Array], dict[str, Array]]:
        """Return the readings of one measurement, and its residuals over noise, zero for missing
        samples."""
        readings = experiment.readings(model, self.integration, lin)
        residuals = {
            name: experiment.residual(name, readings[name]) / channel.spread(noise[name])
            for name, channel in experiment.channels.items()
        }
        return readings, residuals

    def runs(self, u: Float[Array, "n"]) -> ReadingsAndResiduals:
        """Return readings and residuals of every measurement; measurements of equal structure are
        evaluated in one batch."""
        model, runs = self.space.place(u)
        lin = (
            small_motions(model)
            if any(measurement.linear for measurement in runs.values())
            else None
        )
        results = {}
        for names in shared_structure(runs):
            if len(names) == 1:
                results[names[0]] = self.readings_and_residuals(
                    model, lin, runs[names[0]], self.noise[names[0]]
                )
                continue
            group, noise = (
                jax.tree.map(lambda *x: jnp.stack(x), *(tree[name] for name in names))
                for tree in (runs, self.noise)
            )
            both = jax.vmap(self.readings_and_residuals, in_axes=(None, None, 0, 0))(
                model, lin, group, noise
            )
            results |= {
                name: jax.tree.map(lambda x, i=i: x[i], both) for i, name in enumerate(names)
            }
        if self.priors:
            values = self.space.values(u)
            results[PRIORS] = (
                values,
                {
                    path: (values[path] - mean) / deviation
                    for path, (mean, deviation) in self.priors.items()
                },
            )
        return results

    def residual(self, u: Float[Array, "n"]) -> Float[Array, "m"]:
        return self.losses(self.runs(u))

    def losses(self, runs: ReadingsAndResiduals) -> Float[Array, "m"]:
        """Return all residuals in one vector, with the loss applied: in order of the names, as jit
        sorts dicts; those of priors are last."""
        r = jnp.concatenate(
            [
                root(runs[run][1][name].ravel(), None if run == PRIORS else self.loss)
                for run, name in _channels(runs)
            ]
        )
        return r if self.offset is None else r - self.offset

    def misfits(self, runs: ReadingsAndResiduals) -> Levels:
        """Return {measurement: {channel: readings minus measured values}}, in their units."""
        return {
            run: {
                name: np.asarray(runs[run][1][name])
                * channel.spread(np.asarray(self.noise[run][name]))
                for name, channel in e.channels.items()
            }
            for run, e in self.experiments.items()
        }

    def linearized(self, runs: ReadingsAndResiduals, J) -> tuple[np.ndarray, np.ndarray]:
        """Return residuals and Jacobian of the least-squares problem with the same optimum and
        covariance as the robust problem."""
        channels = _channels(runs)
        r = np.concatenate([np.ravel(runs[run][1][name]) for run, name in channels])
        present = np.concatenate(
            [self.experiments[run].present(name).ravel() for run, name in channels if run != PRIORS]
        )
        m = len(present)
        data_r, data_J = linearized(r[:m], J[:m], present, self.loss)
        return np.concatenate([data_r, r[m:]]), np.concatenate([data_J, J[m:]])


def _channels(runs: ReadingsAndResiduals) -> list[tuple[str, str]]:
    """Return (measurement, channel) in the order of the residuals: by name, priors last."""
    return [
        (run, name)
        for run in sorted(runs, key=lambda run: (run == PRIORS, run))
        for name in sorted(runs[run][1])
    ]


def options_of(task: Task, *_: Any) -> Options:
    """Return the compiler options of programs that simulate the runs of a task."""
    times = [run.times for run in task.experiments.values() if isinstance(run, Experiment)]
    return options_of_motion(task.space.model, *times)


@program_with(options_of)
def residual_and_jacobian(
    task: Task, u: Float[Array, "n"]
) -> tuple[Array, Array, ReadingsAndResiduals]:
    """Return r, dr/du and the readings and residuals by channel, from one program, because
    compiling takes longer than running."""

    def evaluate(u):
        runs = task.runs(u)
        return task.losses(runs), runs

    colors = colors_of(task.space)
    seeds = jnp.asarray(colors[:, None] == np.arange(colors.max(initial=-1) + 1), float)
    r, sums, runs = jax.vmap(
        lambda seed: jax.jvp(evaluate, (u,), (seed,), has_aux=True), 1, (None, 1, None)
    )(seeds)
    blocks = [
        moved_rows(task.space, run, name, runs[run][1][name].size) for run, name in _channels(runs)
    ]
    return r, jnp.where(jnp.concatenate(blocks), sums[:, colors], 0.0), runs


def shared_structure(experiments: dict[str, Measurement]) -> list[list[str]]:
    """Return groups of names of measurements with equal structure and shapes, which can be
    evaluated in one batch."""
    groups: dict[Any, list[str]] = {}
    for name, experiment in experiments.items():
        leaves, treedef = jax.tree.flatten(experiment)
        groups.setdefault((treedef, tuple(jnp.shape(leaf) for leaf in leaves)), []).append(name)
    return list(groups.values())


# a channel without samples has the rms 0/0
@np.errstate(divide="ignore", invalid="ignore")
def rms(channel: Channel, residuals: list, present: list) -> Array:
    """Return the root mean square over all records of a channel, one number for each of its
    units."""
    squares = sum(channel.pooled(as_numpy(r) ** 2) for r in residuals)
    return as_numpy(
        (squares / sum(channel.pooled(as_numpy(mask).astype(float)) for mask in present)) ** 0.5
    )


@np.errstate(divide="ignore", invalid="ignore")
def noise_level(channel: Channel, residuals: list, present: list, loss: str | None) -> Array:
    """Return the noise estimated from residuals: their rms, or with a robust loss an estimate that
    outliers do not increase."""
    if loss is None:
        return rms(channel, residuals, present)

    def clipped(s, c):
        capped = [
            module_of(r).clip(abs(r / channel.spread(s)), 0.0, c) for r in map(as_numpy, residuals)
        ]
        return rms(channel, capped, present) ** 2

    return robust_level(clipped, rms(channel, residuals, present))


def first_noise(experiments: dict[str, Measurement], absolute: bool) -> tuple[Levels, bool]:
    """Return the initial noise levels, and whether they must be estimated.

    Levels are those stated, or else the standard deviation of the channel over all runs. Estimates
    are needed if not all are stated and the level itself matters (`absolute`), or the ratios of
    several levels."""
    spread = {
        name: module_of(level).where(level > 0, level, 1.0)
        for name, level in _levels(experiments, residuals_of_means(experiments), None).items()
    }
    stated = [name in (e.noise or {}) for e in experiments.values() for name in e.channels]
    units = sum(np.size(level) for level in spread.values())
    estimated = not all(stated) and (absolute or units > 1 or any(stated))
    return _stated_or(spread, experiments), estimated


def _levels(
    experiments: dict[str, Measurement], misfits: Levels, loss: str | None
) -> dict[str, Array]:
    """Return {channel: its noise level over all runs}."""
    channels = {name: channel for e in experiments.values() for name, channel in e.channels.items()}
    levels = {}
    for name, channel in channels.items():
        runs = [run for run, e in experiments.items() if name in e.channels]
        levels[name] = noise_level(
            channel,
            [misfits[run][name] for run in runs],
            [experiments[run].present(name) for run in runs],
            loss,
        )
    return levels


def _stated_or(levels: dict[str, Array], experiments: dict[str, Measurement]) -> Levels:
    """Return the noise of every channel as stated, or else from `levels`."""
    return {
        run: {name: (e.noise or {}).get(name, levels[name]) for name in e.channels}
        for run, e in experiments.items()
    }  # pyright: ignore[reportReturnType]  `get` with a default gives no None


def residuals_of_means(experiments: dict[str, Measurement]) -> Levels:
    """Return {measurement: {channel: residuals}} of constant predictions, the mean of each
    record."""

    def of(experiment: Measurement, name: str) -> Array:
        measured = as_numpy(experiment.measured[name])
        xp, count = module_of(measured), (measured == measured).sum(0).astype(measured.dtype)
        # the mean of an empty record would cause a warning
        mean = xp.nansum(measured, 0) / xp.where(count > 0, count, 1.0)
        return experiment.channels[name].residual(xp.broadcast_to(mean, measured.shape), measured)

    return {run: {name: of(e, name) for name in e.channels} for run, e in experiments.items()}


def with_estimated_noise(task: Task, runs: ReadingsAndResiduals) -> tuple[Task, bool]:
    """Return the task with the noise estimated from the residuals, and whether the ratios of noise
    levels changed by more than PROPORTION."""
    levels = {
        name: as_numpy(np.maximum(level, 1e-12))
        for name, level in _levels(task.experiments, task.misfits(runs), task.loss).items()
    }
    new = _stated_or(levels, task.experiments)
    ratio, fitted = (
        np.concatenate(
            [
                np.ravel(of[run][name] / np.asarray(level))
                for run, before in task.noise.items()
                for name, level in before.items()
            ]
        )
        for of in (new, dict.fromkeys(new, levels))
    )
    if fitted.max() < 1e-9:  # an exact fit has no noise
        return task, False
    if task.absolute:
        ratio = np.append(ratio, 1.0)
    return eqx.tree_at(lambda t: t.noise, task, new), bool(
        ratio.max() / ratio.min() > 1 + PROPORTION
    )


def rms_residuals(task: Task, runs: ReadingsAndResiduals) -> Levels:
    """Return {measurement: {channel: rms residual}}; with a robust loss, an estimate that outliers
    do not increase."""
    misfits = task.misfits(runs)
    return {run: _levels({run: e}, misfits, task.loss) for run, e in task.experiments.items()}


def floor(task: Task) -> float:
    """Return the norm up to which a column of the Jacobian contains only integration error: an
    error of rtol times the size of the model in every residual."""
    counts_and_levels = [
        (e.measured[name].size, task.noise[run][name])
        for run, e in task.experiments.items()
        for name in e.channels
    ]
    squares = sum(n * np.mean(1 / np.asarray(level) ** 2) for n, level in counts_and_levels)
    return integration_error(task) * np.sqrt(squares)


def integration_error(task: Task) -> float:
    """Return the expected integration error, rtol times the size of the model [m]."""
    return float(task.integration.rtol) * float(size_of(task.space.model))


def check_start(task: Task, u: np.ndarray, r: np.ndarray, J: np.ndarray) -> None:
    """Check that the residuals are finite at the start, and that all positive parameters have an
    effect there. Errors: NONFINITE_START, with the first residual that is not finite,
    TINY_START."""
    if np.isfinite(r).all():
        _check_effects(task, u, ~J.any(0))
        return
    runs = residual_and_jacobian(task, device_array(u))[2]
    hint = "Start with parameters for which the model can be simulated."
    for run, (_, residuals) in runs.items():
        experiment = task.experiments[run]
        for name, values in residuals.items():
            bad = np.argwhere(~np.isfinite(np.asarray(values)))
            if len(bad):
                place, value = experiment.place(int(bad[0][0]))
                component = f", component {bad[0][1]}" if bad.shape[1] > 1 else ""
                why = experiment.explain(task.space.model, task.integration)
                if why.startswith("MAX_STEPS"):
                    hint = (
                        "Give a larger max_steps or rtol (in a file [fit] max_steps, in a command "
                        "--max-steps), or start nearer."
                    )
                raise JaxbodyError(
                    Problem(
                        "NONFINITE_START",
                        f"{run}.{name}",
                        f"is not finite from {place} on{component}, at the start of the fit: {why}",
                        value,
                        "finite",
                        hint,
                    )
                )
    raise JaxbodyError(
        Problem(
            "NONFINITE_START", "fit", "has derivatives that are not finite at the start", hint=hint
        )
    )


def _check_effects(task: Task, u: np.ndarray, silent: np.ndarray) -> None:
    """Check that no positive parameter starts so small that integration errors hide its effect.
    Error: TINY_START, which recommends a larger start that has an effect."""
    space, hidden = task.space, floor(task)
    units = [
        unit
        for p in space.parameters
        for unit in (space.units(p) if isinstance(p.form, Positive) else [None] * p.form.size)
    ]
    positive = np.array([unit is not None for unit in units], bool)
    if not (silent & positive).any():
        return

    def effects(u: np.ndarray) -> np.ndarray:
        return np.linalg.norm(np.asarray(residual_and_jacobian(task, device_array(u))[1]), axis=0)

    start = effects(u)
    small = silent & positive & (start > LEAST_EFFECT * hidden)
    # x = x0 exp(u)
    larger = u + np.where(small, np.log(VISIBLE * hidden / np.where(small, start, 1.0)), 0.0)
    small &= effects(larger) > hidden if small.any() else False
    with Problems() as problems:
        for i in np.flatnonzero(small):
            value = space.numbers(u)[0][i]
            least = 10 ** np.ceil(np.log10(space.numbers(larger)[0][i]))
            problems.add(
                "TINY_START",
                space.labels[i],
                f"starts at {value:.3g} {units[i]}, where its effect on the data is smaller "
                "than integration errors",
                value=value,
                limit=f"{least:.0e} {units[i]} or more",
                hint="Start at the size that you expect.",
            )
