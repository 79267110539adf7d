"""Coverage: how often confidence intervals contain the true parameters, from fits of many simulated
records.

    minimize |r(u) - r(u*) - e|^2 over u,    e normal and independent

r are the residuals of a fit over the noise, u the transformed parameters (`transforms`), and u* the
estimates, taken as the true values. Each replicate fits a record simulated with u* and new noise e.
"""

import dataclasses
from collections.abc import Iterable
from functools import partial
from typing import Any

import equinox as eqx
import jax
import numpy as np
import optimistix

from jaxbody.core import tables
from jaxbody.core.arguments import check_key, whole_number
from jaxbody.core.arrays import Float, Int, device_array
from jaxbody.core.errors import Problems, Status
from jaxbody.core.progress_lines import working
from jaxbody.core.results import Result, warn_if_failed
from jaxbody.core.workers.batches import batch_of, checked_chunks, gathered
from jaxbody.core.workers.chunk_programs import ChunkProgram
from jaxbody.core.workers.chunk_stores import hash_of
from jaxbody.core.workers.executors import crew_of
from jaxbody.fitting.experiments.measurements import records_of
from jaxbody.fitting.fit_results import Fit, interval_of_u
from jaxbody.fitting.residuals import residual_and_jacobian
from jaxbody.fitting.searches import solve
from jaxbody.fitting.statistics.noises import ResidualSeries
from jaxbody.fitting.statistics.uncertainties import assess, check_level, decomposed

BATCH = 16  # replicates computed together in one compiled program
CLOSE = 1e-6  # tolerance of the search of a replicate; `assessed` takes one more step


class Coverage(Result):
    """Result of `interval_coverage`, for each of n `parameters`.

    `contained`: share of the replicates whose interval at `level` contains the true value, with its
    `standard_error`; `bias`: mean error of the estimates over their standard deviation `deviation`;
    `ratio`: this deviation over the standard error stated by the fit.

    `u` (N, n): estimates of the replicates in the coordinates of the fit, zero at its initial
    guess, with the ends `lower` and `upper` of their intervals; `truth` (n,): the u of the fit;
    `stated` (n,): its standard errors; `status` (N,): status of each replicate.

    >>> import inspect
    >>> inspect.signature(jb.fitting.interval_coverage).return_annotation.__name__
    'Coverage'
    """

    parameters: tuple[str, ...] = eqx.field(static=True)
    level: float
    u: Float[np.ndarray, "N n"]
    lower: Float[np.ndarray, "N n"]
    upper: Float[np.ndarray, "N n"]
    truth: Float[np.ndarray, "n"]
    stated: Float[np.ndarray, "n"]
    status: Int[np.ndarray, "N"]

    @property
    def contained(self) -> Float[np.ndarray, "n"]:
        inside = (self.lower <= self.truth) & (self.truth <= self.upper)
        return inside[self.ok].mean(0) if self.ok.any() else np.full(len(self.truth), np.nan)

    @property
    def standard_error(self) -> Float[np.ndarray, "n"]:
        """The standard error of `contained` if the true share is `level`."""
        return np.full(
            len(self.truth), np.sqrt(self.level * (1 - self.level) / max(self.ok.sum(), 1))
        )

    @property
    def deviation(self) -> Float[np.ndarray, "n"]:
        """Standard deviations of u over the replicates."""
        return (
            self.u[self.ok].std(0, ddof=1)
            if self.ok.sum() > 1
            else np.full(len(self.truth), np.nan)
        )

    @property
    @np.errstate(divide="ignore", invalid="ignore")  # records without noise have no deviation
    def bias(self) -> Float[np.ndarray, "n"]:
        return (
            (self.u[self.ok].mean(0) - self.truth) / self.deviation
            if self.ok.any()
            else self.deviation
        )

    @property
    @np.errstate(divide="ignore", invalid="ignore")
    def ratio(self) -> Float[np.ndarray, "n"]:
        return self.deviation / self.stated

    def _tables(self) -> list[tables.PrintedTable]:
        columns = (self.parameters, self.contained, self.standard_error, self.bias, self.ratio)
        rows = [
            (name, f"{100 * share:.1f} +- {100 * error:.1f}", float(bias), float(ratio))
            for name, share, error, bias, ratio in zip(*columns, strict=True)
        ]
        heads = ("parameter", "contained, %", "bias over deviation", "deviation over stated")
        return [
            tables.PrintedTable(
                f"Coverage of {100 * self.level:g} % intervals",
                heads,
                rows,
                f"{len(self.status)} replicates: {self.report()}",
            )
        ]


def interval_coverage(
    fit: Fit,
    *,
    replicates: int = 200,
    level: float = 0.95,
    key: Any = None,
    max_evaluations: int = 200,
    workers: Any = None,
    out: Any = None,
    chunks: Iterable[int] | None = None,
    progress: bool | None = None,
) -> Coverage:
    """Compute how often the intervals of a fit would contain the true parameters if the model were
    right and its estimates the truth.

    Records are simulated with the estimates and new white noise; its level is the stated one, or
    else that of the residuals. Each record is fitted by the Levenberg-Marquardt method, which
    starts from the estimates; noise levels and intervals are estimated as in `fit`. Intervals that
    are too narrow, because the problem is nonlinear or samples are few, contain the true value less
    often than `level`.

    Args:
        fit: the result of `fit`, with status OK.
        replicates: number of records; a share of 95 % of 200 has a standard error of 1.5 %.
        level: confidence level of the intervals.
        key: random key of the noise; None takes jax.random.key(0).
        max_evaluations: largest number of steps of each fit.
        workers: None, a number of processes, or an executor, as in `sweep`; the results are
            the same.
        out: path of a Zarr store to which every 16 replicates are written when they are done, as in
            `sweep`: the same call continues an interrupted one. By default none.
        chunks: indices of the chunks of 16 replicates that this call computes, such as
            range(i, n, k) for job i of k; None: all.
        progress: None shows a line after five seconds on a terminal or in a notebook, False
            is silent.

    Bounds are ignored in the replicates. Ctrl-C returns the replicates that are done.

    Errors: UNDETERMINED for a fit with another status than OK, BAD_OPTION for one with a robust
    loss, TRACED, BAD_NUMBER, BAD_LEVEL, WRONG_KIND for a key, BAD_CHUNK, BAD_WORKERS, NOT_SENT,
    OTHER_WORKER, OTHER_STORE, NOT_SAVED. Warns of replicates that do not converge, are LOST or are
    INTERRUPTED; these are not counted.

    >>> spring = jb.Spring(("mass", [0, 0, 0]), ("world", [0, 0, 0]), stiffness=30.0)
    >>> model = jb.Model(
    ...     bodies={"mass": jb.Body(mass=1.0, inertia=[1, 1, 1], position=[1, 0, 0])},
    ...     elements={"spring": spring},
    ...     joints={"mass": jb.Guide("world", axis=[1, 0, 0])},
    ... )
    >>> times, noise = jnp.linspace(0, 1, 21), 0.05 * jax.random.normal(jax.random.key(0), (21,))
    >>> track = jb.Experiment(
    ...     times,
    ...     sensors={"x": jb.Position("mass", axis=[1, 0, 0])},
    ...     measured={"x": jnp.cos(2 * jnp.pi * times) + noise},
    ... )
    >>> result = jb.fitting.interval_coverage(
    ...     jb.fit(model, {"track": track}, free=["spring.stiffness"]), replicates=64
    ... )
    >>> bool(abs(result.contained[0] - 0.95) < 3 * result.standard_error[0]), result.parameters
    (True, ('spring.stiffness',))
    """
    check_level(level, "interval_coverage.level")
    uncertainty = fit._assessed()
    with Problems() as problems:
        replicates = whole_number(replicates, "interval_coverage.replicates", problems, least=2)
        max_evaluations = whole_number(
            max_evaluations, "interval_coverage.max_evaluations", problems
        )
        check_key(key, "interval_coverage.key", problems)
        chunks = checked_chunks("interval_coverage", workers, out, chunks, problems, fixed=True)
        if not fit.ok:
            problems.add(
                "UNDETERMINED",
                "interval_coverage.fit",
                f"has the status {Status(int(fit.status)).name}",
                value=fit.status,
                hint="Free only what the data determine, and let no bound be active.",
            )
        if fit.task.loss is not None:
            problems.add(
                "BAD_OPTION",
                "interval_coverage.fit",
                f"has the loss {fit.task.loss!r}, for which the noise is not known",
                value=fit.task.loss,
                hint="Fit by least squares.",
            )
    key = jax.random.key(0) if key is None else key
    keys, u = np.asarray(jax.random.key_data(jax.random.split(key, replicates))), np.asarray(fit.u)
    with (
        working("interval_coverage", progress) as line,
        crew_of(workers, "interval_coverage.workers") as crew,
    ):
        line("compiling")
        batch = _batch(
            fit,
            crew,
            level=level,
            keys=keys,
            kind=jax.random.key_impl(key),
            max_steps=max_evaluations,
        )
        results, status = gathered(
            batch,
            crew,
            "interval_coverage",
            lambda done, _: line(f"{done} of {replicates} replicates"),
            out,
            chunks,
            plan={"noise": hash_of(keys), "level": level},
            inputs=["key"],
            dimension="replicate",
        )
    return warn_if_failed(
        Coverage(
            parameters=tuple(fit.task.space.labels),
            level=level,
            u=results["u"],
            lower=results["lower"],
            upper=results["upper"],
            truth=u,
            stated=uncertainty.spread(np.eye(len(u)))[0],
            status=np.where(status == Status.OK, results["end"], status),
        )
    )


def _batch(
    fit: Fit, crew: Any, *, level: float, keys: np.ndarray, kind: Any, max_steps: int
) -> Any:
    """Return the batch of all replicates, for `crew` to compute: a compiled program fits them, and
    NumPy computes their intervals in the same process."""
    records, space = records_of(fit.task.experiments), fit.task.space
    stated = {
        record.name: record.channel in (fit.task.experiments[record.run].noise or {})
        for record in records
    }
    r, J, _ = residual_and_jacobian(fit.task, fit.u)
    levels = _levels(np.asarray(r), np.asarray(J), records, stated, space.prior_rows)

    def fitted(tree, keys):
        task, start, r, level = tree

        def one(data):
            e = level * jax.random.normal(jax.random.wrap_key_data(data, impl=kind), r.shape)
            replicate = eqx.tree_at(
                lambda task: task.offset, task, r + e, is_leaf=lambda x: x is None
            )
            u, end, _ = solve(
                replicate, start, optimistix.LevenbergMarquardt(rtol=CLOSE, atol=CLOSE), max_steps
            )
            r_end, J, _ = residual_and_jacobian(replicate, u)
            return {"u": u, "end": end, "r": r_end, "J": J}

        return jax.vmap(one)(keys)

    batch = batch_of(
        fitted,
        (fit.task, fit.u, r, device_array(levels)),
        lambda i, j: [keys[i:j]],
        len(keys),
        width=BATCH,
        where="interval_coverage",
        owner=assessed,
        place=(max_steps, kind),
    )
    real = batch.program.results["u"][1]
    types = {name: ((space.size,), real) for name in ("u", "lower", "upper")} | {
        "end": batch.program.results["end"]
    }
    return dataclasses.replace(
        batch,
        function=partial(assessed, names=space.names, records=records, stated=stated, level=level),
        types=types,
    )


def _levels(
    r: np.ndarray,
    J: np.ndarray,
    records: list[ResidualSeries],
    stated: dict[str, bool],
    priors: int,
) -> np.ndarray:
    """Return the standard deviation of each residual: 1 where the noise is stated and for priors,
    which come last; otherwise the unbiased estimate of its group; 0 for missing samples."""
    U, _, _, known = decomposed(J)
    level = np.zeros(len(r))
    level[len(r) - priors :] = 1.0
    for rows in _groups(records).values():
        level[rows] = np.sqrt(
            np.sum(r[rows] ** 2) / max(len(rows) - float(np.sum(U[rows][:, known] ** 2)), 1.0)
        )
    for record in records:
        if stated[record.name]:
            level[record.rows] = 1.0
    return level


def _groups(records: list[ResidualSeries]) -> dict[str, np.ndarray]:
    """Return {group: rows of all its records}; records of a group share one noise level."""
    return {
        group: np.concatenate([record.rows for record in records if record.group == group])
        for group in dict.fromkeys(record.group for record in records)
    }


def assessed(
    program: ChunkProgram,
    shared: list[np.ndarray],
    rows: list[np.ndarray],
    *,
    names: list[str],
    records: list[ResidualSeries],
    stated: dict[str, bool],
    level: float,
) -> dict[str, np.ndarray]:
    """Fit replicates by `program`, in a worker process; return {"u": estimates, "lower" and
    "upper": ends of their intervals, "end": status}.

    As in a fit, each group of records without stated noise is weighted by the inverse rms of its
    residuals; one more Gauss-Newton step is taken with these weights."""
    ended = program(shared, rows)
    groups = _groups([record for record in records if not stated[record.name]])
    estimates = []
    for u, end, r, J in zip(*(ended[name] for name in ("u", "end", "r", "J")), strict=True):
        if end != Status.OK:
            estimates.append((u, *np.full((2, len(u)), np.nan)))
            continue
        weights = np.ones(len(r))
        for own in groups.values():
            weights[own] = 1 / np.sqrt(np.mean(r[own] ** 2))
        r, J = r * weights, J * weights[:, None]
        step = np.linalg.lstsq(J, -r, rcond=None)[0]
        low, high = interval_of_u(u + step, assess(r + J @ step, J, [], [], names, records), level)
        estimates.append((u + step, low, high))
    u, lower, upper = map(np.array, zip(*estimates, strict=True))
    return {"u": u, "lower": lower, "upper": upper, "end": ended["end"]}
