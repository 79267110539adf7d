"""Posteriors of fits: draws of the free parameters and noise levels, given the data and priors, by
the no-U-turn sampler of blackjax.

    log p(y) = sum over samples of [-(r e^-s)^2/2 - s - log(sigma sqrt(2 pi))] + log prior(y)

y = (u, s): u are the transformed free parameters (`transforms`), s the logarithm of each noise
level that is not stated, relative to its estimate sigma; r are residuals over sigma. Sampling is in
coordinates z, y = y_m + L z, with y_m the most probable y and L L' the inverse of the Gauss-Newton
curvature there. The noise is white.
Source: M. Hoffman and A. Gelman, J. Machine Learning Research 15 (2014) 1593; A. Vehtari et al.,
Bayesian Analysis 16 (2021) 667 (r-hat and effective sizes).
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxbody.core import tables
from jaxbody.core.arguments import check_key, whole_number
from jaxbody.core.arrays import Array, Float, Int, device_array, indices
from jaxbody.core.compilation.compile_options import OPTIMIZED, program_with
from jaxbody.core.errors import JaxbodyError, Problem, Problems, Status, import_extra, warn
from jaxbody.core.progress_lines import working
from jaxbody.core.results import Labeled, Result, dataset, warn_if_failed
from jaxbody.fitting.experiments.measurements import records_of
from jaxbody.fitting.fit_results import LEVEL, Fit
from jaxbody.fitting.parameters.priors import Prior, priors_of
from jaxbody.fitting.parameters.spaces import Parameter, Space
from jaxbody.fitting.parameters.transforms import Fraction, Positive
from jaxbody.fitting.residuals import (
    EXACT,
    Task,
    floor,
    options_of,
    residual_and_jacobian,
    with_estimated_noise,
)
from jaxbody.fitting.statistics.uncertainties import check_level, decomposed, in_words
from jaxbody.geometry.fields import Kind
from jaxbody.model.leaf_paths import Leaf

PIECE = 50  # draws of each chain between two reports of progress
SPREAD = 1.5  # standard deviation of the first points of the chains, in z
TARGET = 0.8  # acceptance rate for which the step of the sampler is chosen
R_HAT, EFFECTIVE = 1.01, 400  # largest r-hat and smallest effective size of a good sample
LOOSE = 1e3  # largest standard deviation of a direction of u that counts as determined
# largest standard deviation of log(x) for a flat prior: beyond it the data allow x near zero, where
# such a prior has infinite weight
NEAR_ZERO = 1 / 3
STEPS, HALVINGS = 30, 12  # of the search for the most probable y
UNUSABLE = (Status.FAR_OFF, Status.NOT_CONVERGED, Status.INTERRUPTED)


class LogDensity(eqx.Module):
    """The logarithm of the posterior density of y, normalized if all `priors` are proper.

    `unknowns`: names, units and forms of y; `level_of`: for each residual the number of its noise
    level in s, the last one where the noise is stated; `present`: 1 for samples that are there;
    `constants`: log(sigma sqrt(2 pi)) of each residual."""

    task: Task
    unknowns: Space
    priors: tuple[Prior, ...]
    level_of: Int[Array, "m"]
    present: Float[Array, "m"]
    constants: Float[Array, "m"]

    def pointwise(self, y: Float[Array, "n"]) -> Float[Array, "m"]:
        """Return the log likelihood of each sample, 0 for missing ones."""
        s = self._scale(y)
        r, _, _ = residual_and_jacobian(self.task, y[: self.task.space.size])
        e = r[: len(s)] * jnp.exp(-s)
        return -0.5 * e**2 - self.present * (s + self.constants)

    def _scale(self, y: Array) -> Array:
        """Return s of each residual."""
        return jnp.append(y[self.task.space.size :], 0.0)[self.level_of]

    def scaled_priors(self, y: Float[Array, "n"]) -> Array:
        """Return the residuals of all priors in one vector."""
        return jnp.concatenate([prior.scaled(part) for prior, part in self._parts(y)])

    def _parts(self, y: Array) -> list[tuple[Prior, Array]]:
        slices = [own for _, own in self.unknowns.parts]
        return [(prior, y[own]) for prior, own in zip(self.priors, slices, strict=True)]

    def local(self, y: Float[Array, "n"]) -> tuple[Array, Array, Array]:
        """Return the value, its gradient, and the Jacobian of the residuals over their noise; -inf
        and zero where the value or gradient is not finite."""
        n, s = self.task.space.size, self._scale(y)
        r, J, _ = residual_and_jacobian(self.task, y[:n])
        r, J = r[: len(s)] * jnp.exp(-s), J[: len(s)] * jnp.exp(-s)[:, None]
        prior, slope = jax.value_and_grad(
            lambda y: sum(prior.log_density(part) for prior, part in self._parts(y))
        )(y)
        value = jnp.sum(-0.5 * r**2 - self.present * (s + self.constants)) + prior
        levels = jnp.zeros(len(y) - n + 1).at[self.level_of].add(r**2 - self.present)[:-1]
        gradient = slope + jnp.concatenate([-r @ J, levels])
        finite = jnp.isfinite(value) & jnp.all(jnp.isfinite(gradient))
        return jnp.where(finite, value, -jnp.inf), jnp.where(finite, gradient, 0.0), J

    def __call__(self, y: Float[Array, "n"]) -> Float[Array, ""]:
        """Return the value, differentiable once in reverse mode: its gradient comes from forward
        mode, in which motions have derivatives."""
        at = jax.lax.stop_gradient(y)
        value, gradient, _ = self.local(at)
        return value + gradient @ (y - at)


class Posterior(Labeled, Result):
    """Result of `posterior`: draws of the free parameters and noise levels of a `fit`.

    Dictionaries by path, in SI units, with unstated noise levels as "noise.channel": `values`
    {path: (chains, draws, *shape)}, `means`, `standard_errors` (standard deviations of the draws),
    `intervals(level)` (quantiles). `correlations` are those of all `labels`. For each label:
    `r_hat`, and the effective numbers of independent draws for the middle and the ends of
    intervals, `ess_bulk` and `ess_tail`. `log_density` of each draw; `divergences`: number of
    trajectories that the sampler could not follow; `rejected`: number that ended at a bound or
    where the model cannot be simulated; `acceptance`: mean rate of each chain. `y`: draws of u and
    s.

    `status`: OK, NOT_CONVERGED if r_hat > 1.01, an effective size < 400 or divergences, or
    INTERRUPTED.

    >>> import inspect
    >>> inspect.signature(jb.posterior).return_annotation.__name__  # the result of posterior
    'Posterior'
    """

    index = "draw"
    fit: Fit
    density: LogDensity
    most_probable: Float[np.ndarray, "n"]
    y: Float[np.ndarray, "chains draws n"]
    values: dict[str, np.ndarray]
    log_density: Float[np.ndarray, "chains draws"]
    r_hat: Float[np.ndarray, "n"]
    ess_bulk: Float[np.ndarray, "n"]
    ess_tail: Float[np.ndarray, "n"]
    divergences: int
    rejected: int
    acceptance: Float[np.ndarray, "chains"]
    status: Int[np.ndarray, ""]

    @property
    def labels(self) -> list[str]:
        return self.density.unknowns.labels

    @property
    def means(self) -> dict[str, Any]:
        return {path: x.mean((0, 1)) for path, x in self.values.items()}

    @property
    def standard_errors(self) -> dict[str, Any]:
        return {path: x.std((0, 1), ddof=1) for path, x in self.values.items()}

    def intervals(self, level: float = LEVEL) -> dict[str, tuple[Any, Any]]:
        """Return intervals {path: (lower, upper)} with the same probability on both sides. Error:
        BAD_LEVEL."""
        check_level(level, "posterior.intervals.level")
        ends = [(1 - level) / 2, (1 + level) / 2]
        return {path: tuple(np.quantile(x, ends, (0, 1))) for path, x in self.values.items()}

    @property
    def correlations(self) -> np.ndarray:
        return np.corrcoef(self.y.reshape(-1, self.y.shape[-1]).T)

    @property
    def information(self) -> np.ndarray:
        """The inverse of the covariance of the u of the model, as of a fit."""
        _, own = self.fit.task.space.of_model({})
        u = self.y[..., : len(own)].reshape(-1, len(own))
        return np.linalg.inv(np.atleast_2d(np.cov(u[:, own].T)))

    def numbers(self) -> dict[str, tuple[np.ndarray, str]]:
        """Return {path of a number, such as "AB.a[0]": (its draws (chains, draws), its unit)}."""
        space, numbers = self.density.unknowns, {}
        for parameter in space.parameters:
            x = self.values[parameter.path]
            labels = indices(x.shape[2:])
            columns = np.moveaxis(x.reshape(*x.shape[:2], -1), -1, 0)
            for label, column, unit in zip(labels, columns, space.units(parameter), strict=True):
                numbers[parameter.path + label] = (column, unit)
        return numbers

    def drawn(self, samples: int) -> np.ndarray:
        """Return u of at most `samples` draws, evenly spaced over all chains."""
        n = self.fit.task.space.size
        u = self.y[..., :n].reshape(-1, n)
        return u[np.linspace(0, len(u) - 1, min(samples, len(u))).astype(int)]

    def explain(self) -> str:
        worst = int(np.argmax(self.r_hat))
        least = int(np.argmin(np.minimum(self.ess_bulk, self.ess_tail)))
        return (
            f"r-hat {self.r_hat[worst]:.3f} of {self.labels[worst]}, effective size "
            f"{min(self.ess_bulk[least], self.ess_tail[least]):.0f} of {self.labels[least]}, "
            f"{tables.counted(self.divergences, 'divergence')}; draw more, or give narrower priors"
        )

    def to_xarray(self) -> Any:
        """Return an xarray.Dataset of the draws by path over chain and draw, which ArviZ reads.
        Error: MISSING_EXTRA."""
        variables = {}
        for parameter in self.density.unknowns.parameters:
            path, x = parameter.path, self.values[parameter.path]
            more = tuple(f"{path}_{i}" for i in range(x.ndim - 2))
            units = dict.fromkeys(self.density.unknowns.units(parameter))
            variables[path] = (("chain", "draw", *more), x, ", ".join(units))
        chains, draws = (np.arange(size) for size in self.y.shape[:2])
        return dataset(variables, {"chain": chains, "draw": draws}, "posterior")

    def _tables(self) -> list[tables.PrintedTable]:
        chains, draws = self.y.shape[:2]
        heads = ("parameter", "mean", "unit", "standard deviation", f"{100 * LEVEL:g} % interval")
        rows = []
        for label, (x, unit) in self.numbers().items():
            low, high = np.quantile(x, [(1 - LEVEL) / 2, (1 + LEVEL) / 2])
            ends = f"{low:.6g} to {high:.6g}"
            rows.append((label, float(x.mean()), unit, float(x.std(ddof=1)), ends))
        quality = [
            (label, round(float(r_hat), 4), int(bulk), int(tail))
            for label, r_hat, bulk, tail in zip(
                self.labels, self.r_hat, self.ess_bulk, self.ess_tail, strict=True
            )
        ]
        notes = [
            f"{tables.counted(chains, 'chain')} of {tables.counted(draws, 'draw')}, "
            f"{tables.counted(self.divergences, 'divergence')}, acceptance "
            f"{self.acceptance.mean():.2f}; {self.report()}",
            *_remarks(self.fit),
        ]
        if self.rejected:
            notes.append(f"{self.rejected} trajectories ended at a bound or without a prediction")
        return [
            tables.PrintedTable("Posterior", heads, rows, digits=6),
            tables.PrintedTable(
                "", ("number", "r-hat", "bulk size", "tail size"), quality, "\n".join(notes)
            ),
        ]


def _remarks(fit: Fit) -> list[str]:
    if not fit._assessed().correlated:
        return []
    return [
        f"the residuals of the fit are correlated (lag one {fit.correlation:.2f}), but the "
        "posterior is for white noise: its intervals may be too narrow"
    ]


def posterior(
    fit: Fit,
    *,
    draws: int = 1000,
    chains: int = 4,
    priors: dict[str, Any] | None = None,
    warmup: int = 500,
    key: Any = None,
    progress: bool | None = None,
) -> Posterior:
    """Draw from the posterior of a fit: the distribution of the free parameters and noise levels
    given the data and priors.

    Args:
        fit: the result of `fit`.
        draws: number of draws of each chain.
        chains: number of independent chains, computed in one batch; their agreement is the test of
            convergence.
        priors: {path or pattern: (mean, standard deviation) or LogNormal(median, deviation)};
            "noise.x" is the noise level of the channel "x". They replace those of the fit.
        warmup: number of first draws of each chain, which adapt the sampler and are left out.
        key: random key; None takes jax.random.key(0).
        progress: None shows progress on a terminal or in a notebook after five seconds, False is
            silent.

    Without a prior, positive numbers and noise levels are flat in their logarithm, others flat.
    Bounds of the fit hold; the draws of a parameter at its bound are less independent than others.
    The likelihood is that of white noise. Ctrl-C returns the draws that
    there are, with status INTERRUPTED.

    Errors: UNDETERMINED for a fit that did not converge, and for what neither data nor priors
    determine, by name; NO_NOISE for an exact fit without stated noise; BAD_OPTION for a robust
    loss; TRACED, BAD_NUMBER, BAD_PRIOR, UNKNOWN_PATH, WRONG_KIND, MISSING_EXTRA: install
    jaxbody[posterior]. Warns NOT_CONVERGED, INTERRUPTED and CORRELATED_RESIDUALS.

    >>> spring = jb.Spring(("mass", [0, 0, 0]), ("world", [0, 0, 0]), stiffness=30.0)
    >>> model = jb.Model(
    ...     bodies={"mass": jb.Body(mass=1.0, inertia=[1, 1, 1], position=[1, 0, 0])},
    ...     elements={"spring": spring},
    ...     joints={"mass": jb.Guide("world", axis=[1, 0, 0])},
    ... )
    >>> tests = {
    ...     f"test {i}": jb.MeasuredModes(frequency=[f], noise={"frequency": 0.02})
    ...     for i, f in enumerate([0.99, 1.02, 1.0])
    ... }
    >>> result = jb.fit(model, tests, free=["spring.stiffness"])
    >>> drawn = jb.posterior(result, draws=2000)
    >>> bool(abs(drawn.means["spring.stiffness"] - 39.7) < 1), drawn.y.shape
    (True, (4, 2000, 1))
    """
    uncertainty = fit._assessed()
    with Problems() as problems:
        draws = whole_number(draws, "posterior.draws", problems, least=4)
        chains = whole_number(chains, "posterior.chains", problems)
        warmup = whole_number(warmup, "posterior.warmup", problems, least=20)
        check_key(key, "posterior.key", problems)
        if fit.task.loss is not None:
            problems.add(
                "BAD_OPTION",
                "posterior.fit",
                f"has the loss {fit.task.loss!r}, which is no likelihood",
                value=fit.task.loss,
                hint="Fit by least squares.",
            )
        if (status := Status(int(fit.status))) in UNUSABLE:
            problems.add(
                "UNDETERMINED",
                "posterior.fit",
                f"has the status {status.name}",
                value=fit.status,
                hint="Start from a fit that converged.",
            )
    import_extra("blackjax", "posterior")
    import_extra("arviz_stats.base", "posterior")
    density, z_to_y = prepared(fit, priors)
    if uncertainty.correlated:
        warn("CORRELATED_RESIDUALS", _remarks(fit)[0])
    keys = jax.random.split(jax.random.key(0) if key is None else key, chains + 1)
    pieces, status = [], Status.OK
    with working("posterior", progress) as line:
        line("warm-up, compiling")
        try:
            states, tuning = warmed(
                density, z_to_y, _starts(density, z_to_y, keys), keys[1:], warmup
            )
            for i in range(0, draws, PIECE):
                line(f"{i} of {draws} draws")
                more = jax.random.split(jax.random.fold_in(keys[0], i), chains)
                states, piece = drawn_further(density, z_to_y, states, tuning, more, PIECE)
                pieces.append(jax.tree.map(np.asarray, piece))
        except KeyboardInterrupt:
            if not pieces:
                raise
            status = Status.INTERRUPTED
    z, log_density, diverged, rejected, acceptance = (
        np.concatenate(part, 1)[:, :draws] for part in zip(*pieces, strict=True)
    )
    center, L = map(np.asarray, z_to_y)
    y = center + z @ L.T
    r_hat, bulk, tail = diagnosed(y)
    good = r_hat.max() <= R_HAT and min(bulk.min(), tail.min()) >= EFFECTIVE
    if status == Status.OK and not (good and not diverged.any()):
        status = Status.NOT_CONVERGED
    unknowns = density.unknowns.parameters
    values = jax.jit(jax.vmap(jax.vmap(density.unknowns.values)))(device_array(y))  # sorts names
    return warn_if_failed(
        Posterior(
            fit=fit,
            density=density,
            most_probable=center,
            y=y,
            values={path: np.asarray(values[path]) for path in (x.path for x in unknowns)},
            log_density=log_density,
            r_hat=r_hat,
            ess_bulk=bulk,
            ess_tail=tail,
            divergences=int(diverged.sum()),
            rejected=int(rejected.sum()),
            acceptance=acceptance.mean(1),
            status=np.asarray(status.value),
        )
    )


def diagnosed(y: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the rank-normalized r-hat, the bulk and the tail effective size of each component of
    draws (chains, draws, n)."""
    array_stats = import_extra("arviz_stats.base", "posterior").array_stats
    axes = {"chain_axis": 0, "draw_axis": 1}
    return (
        array_stats.rhat(y, **axes, method="rank"),
        array_stats.ess(y, **axes, method="bulk"),
        array_stats.ess(y, **axes, method="tail", prob=(0.05, 0.95)),
    )


def prepared(fit: Fit, priors: Any) -> tuple[LogDensity, tuple[Array, Array]]:
    """Return the log density, and the coordinates of the sampler: the most probable y and L.
    Errors: UNDETERMINED, NO_NOISE, BAD_PRIOR."""
    r, _, runs = residual_and_jacobian(fit.task, fit.u)
    task, _ = with_estimated_noise(fit.task, runs)
    levels, level_of, present, deviations = _noise_levels(task)
    unknowns = Space(task.space.model, (*task.space.parameters, *levels))
    if levels and float(jnp.linalg.norm(r)) <= EXACT * floor(fit.task):
        raise JaxbodyError(
            Problem(
                "NO_NOISE",
                "posterior.fit",
                "fits exactly, and the noise is not stated",
                hint="Give the noise of every measurement.",
            )
        )
    density = LogDensity(
        task,
        unknowns,
        priors_of(unknowns.parameters, priors, "posterior.priors"),
        jnp.asarray(level_of),
        device_array(present),
        device_array(np.log(deviations) + 0.5 * np.log(2 * np.pi)),
    )
    start = np.concatenate([np.asarray(fit.u), np.zeros(len(levels))])
    y, L = _most_probable(density, start)
    return density, (device_array(y), device_array(L))


def _noise_levels(
    task: Task,
) -> tuple[list[Parameter], np.ndarray, np.ndarray, np.ndarray]:
    """Return the noise levels that are not stated, as parameters; and for each residual the number
    of its level, whether its sample is present, and its noise."""
    runs = task.experiments
    levels: dict[str, Parameter] = {}
    deviations, present = [], []
    for run, experiment in sorted(runs.items()):
        for name, channel in sorted(experiment.channels.items()):
            there, level = experiment.present(name), np.asarray(task.noise[run][name])
            present.append(np.ravel(there))
            deviations.append(np.broadcast_to(channel.spread(level), there.shape).ravel())
            if name in (experiment.noise or {}):
                continue
            units = [unit.strip() for unit in channel.unit.split(",")]
            parts = channel.parts or (units if len(units) > 1 else [""])
            for i, (part, unit, size) in enumerate(
                zip(parts, units, np.broadcast_to(level, len(units)), strict=True)
            ):
                path = f"noise.{name} {part}".rstrip()
                form = Positive(device_array(size))
                place = ("", Leaf(path, 0, None, 0, Kind(unit, "positive")))
                levels[f"{name} {i}"] = Parameter((place,), (1.0,), form, *form.unbounded())
    count = sum(map(len, present))
    level_of = np.full(count, len(levels))
    groups = list(levels)
    for record in records_of(runs):
        if record.channel not in (runs[record.run].noise or {}):
            level_of[record.rows] = groups.index(record.group)
    return (
        list(levels.values()),
        level_of,
        np.concatenate(present).astype(float),
        np.concatenate(deviations),
    )


@program_with(lambda density, *_: options_of(density.task))
def _locally(density: LogDensity, y: Array) -> tuple[Array, Array, Array, Array]:
    return *density.local(y), jax.jacfwd(density.scaled_priors)(y)


def _most_probable(density: LogDensity, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the most probable y and L, whose product with its transpose is the inverse of the
    Gauss-Newton curvature there, by damped Gauss-Newton steps. Error: UNDETERMINED."""
    evaluate = lambda y: [np.asarray(x) for x in _locally(density, device_array(y))]  # noqa: E731
    value, gradient, J, G = evaluate(y)
    for _ in range(STEPS):
        L = _root(density, J, G)
        slope = L.T @ gradient
        if slope @ slope < 1e-10:
            break
        for halving in 0.5 ** np.arange(HALVINGS):
            new = evaluate(y + halving * (L @ slope))
            if new[0] > value:
                break
        else:
            break
        y, (value, gradient, J, G) = y + halving * (L @ slope), new
    return y, _root(density, J, G)


def _root(density: LogDensity, J: np.ndarray, G: np.ndarray) -> np.ndarray:
    """Return L. Error: UNDETERMINED for directions that neither data nor priors determine."""
    n, m, space = J.shape[1], G.shape[1], density.unknowns
    U, S, Vt, known = decomposed(J)
    level_of, present = np.asarray(density.level_of), np.asarray(density.present) > 0
    counts = np.bincount(level_of[present], minlength=m - n + 1)[: m - n]
    rows = np.zeros((len(J) + m - n, m))  # those of the data, without what they do not determine
    rows[: len(J), :n] = (U * S)[:, known] @ Vt[known]
    rows[len(J) :, n:] = np.diag(np.sqrt(2.0 * counts))
    _, S, Vt, _ = decomposed(np.concatenate([rows, G]))
    null = Vt[S * LOOSE < 1]
    words = in_words(null.T, space.names, []) if len(null) else []
    L = Vt.T / np.maximum(S, 1 / LOOSE)
    deviation = np.linalg.norm(L, axis=1)
    flat = [prior.mean is None and not prior.proper for prior in density.priors]
    for (parameter, own), free in zip(space.parts, flat, strict=True):
        if free and not words and isinstance(parameter.form, Positive | Fraction):
            words += [
                f"{label} may be near the end of its domain, where a flat prior of its logarithm "
                "has infinite weight"
                for label, wide in zip(space.labels[own], deviation[own] > NEAR_ZERO, strict=True)
                if wide
            ]
    for k in np.flatnonzero(counts <= 0):
        words.append(space.labels[n + k])
    if words:
        raise JaxbodyError(
            Problem(
                "UNDETERMINED",
                "posterior.fit",
                f"and priors do not determine the posterior: {'; '.join(words)}",
                hint="Give priors={path: (mean, standard deviation)}, or fix a parameter.",
            )
        )
    return L


def _starts(density: LogDensity, z_to_y: tuple[Array, Array], keys: Array) -> Array:
    """Return first points z of the chains, widely spread; zero where the model cannot be
    simulated."""
    z = SPREAD * jax.random.normal(keys[0], (len(keys) - 1, len(z_to_y[0])))
    found = [np.isfinite(_locally(density, z_to_y[0] + z_to_y[1] @ each)[0]) for each in z]
    return jnp.where(jnp.asarray(found)[:, None], z, 0.0)


def _in_z(density: LogDensity, z_to_y: tuple[Array, Array]) -> Any:
    center, L = z_to_y
    return lambda z: density(center + L @ z)


@program_with(OPTIMIZED)
def warmed(
    density: LogDensity, z_to_y: tuple[Array, Array], starts: Array, keys: Array, steps: int
) -> Any:
    """Return the state of each chain after `steps` draws, and the sampler's step and masses,
    adapted in them."""
    blackjax = import_extra("blackjax", "posterior")
    adaptation = blackjax.window_adaptation(
        blackjax.nuts,
        _in_z(density, z_to_y),
        target_acceptance_rate=TARGET,
        initial_step_size=0.5,
        adaptation_info_fn=lambda *_: None,
    )
    (states, tuning), _ = jax.vmap(lambda z, key: adaptation.run(key, z, num_steps=steps))(
        starts, keys
    )
    return states, tuning


@program_with(OPTIMIZED)
def drawn_further(
    density: LogDensity, z_to_y: tuple[Array, Array], states: Any, tuning: Any, keys: Array, n: int
) -> tuple[Any, tuple[Array, ...]]:
    """Return the states after n draws of each chain, and for each draw z, its log density, whether
    its trajectory diverged or left what can be computed, and its acceptance rate."""
    blackjax = import_extra("blackjax", "posterior")
    function = _in_z(density, z_to_y)

    def one(state: Any, tuning: Any, key: Array) -> Any:
        sampler = blackjax.nuts(function, **tuning)

        def draw(state: Any, key: Array) -> Any:
            state, info = sampler.step(key, state)
            ends = (info.trajectory_leftmost_state, info.trajectory_rightmost_state)
            computed = jnp.isfinite(ends[0].logdensity) & jnp.isfinite(ends[1].logdensity)
            diverged = info.is_divergent
            return state, (
                state.position,
                state.logdensity,
                diverged & computed,
                diverged & ~computed,
                info.acceptance_rate,
            )

        return jax.lax.scan(draw, state, jax.random.split(key, n))

    return jax.vmap(one)(states, tuning, keys)
