"""Fits from many initial guesses in batches, and the distinct optima that they reach."""

import contextlib
import dataclasses
import warnings
from collections.abc import Iterable
from typing import Any

import jax
import numpy as np
import optimistix

from jaxbody.core import tables
from jaxbody.core.arguments import positive_number, whole_number
from jaxbody.core.arrays import Array, Float, Int, device_array
from jaxbody.core.errors import Problems, Status, warn, warn_of
from jaxbody.core.progress_lines import Line, working
from jaxbody.core.results import Result
from jaxbody.core.workers.batches import batch_of, checked_chunks, computed_here, gathered
from jaxbody.core.workers.chunk_stores import hash_of
from jaxbody.core.workers.executors import crew_of
from jaxbody.fitting.experiments.measurements import Measurement
from jaxbody.fitting.fit_results import Fit
from jaxbody.fitting.fitters import fit
from jaxbody.fitting.parameters.spaces import around
from jaxbody.fitting.residuals import Task
from jaxbody.fitting.searches import solve
from jaxbody.model.models import Model

# largest differences of u, and of costs relative to 1 + cost, between results of one optimum
SAME = 1e-3
# largest difference of costs (negative log-likelihoods) at which another optimum explains the data
# about as well
CLOSE = 2.0
BATCH = 16  # starts computed together in one compiled program


class Multistart(Result):
    """The distinct optima, in order of their `cost` (n,), with `estimates` {path: (n, ...)} and
    `hits` (n,), the number of starts that reached each.

    `best`: the fit with the lowest cost; `starts`: number of all starts; `failures`: number of
    starts that did not converge.

    >>> import inspect
    >>> inspect.signature(jb.fitting.multistart).return_annotation.__name__
    'Multistart'
    """

    best: Fit
    cost: Float[np.ndarray, "n"]
    hits: Int[np.ndarray, "n"]
    estimates: dict[str, Array]
    starts: int
    failures: int
    status: Int[Array, ""]

    def explain(self) -> str:
        return self.best.explain()

    def _tables(self) -> list[tables.PrintedTable]:
        paths = {
            path: np.asarray(x).reshape(len(self.cost), -1) for path, x in self.estimates.items()
        }
        scalars = [path for path, x in paths.items() if x.shape[1] == 1]
        rows = [
            (str(i + 1), cost, str(count), *(float(paths[path][i, 0]) for path in scalars))
            for i, (cost, count) in enumerate(zip(self.cost, self.hits, strict=True))
        ]
        return [
            tables.PrintedTable(
                "Optima",
                ("", "cost", "starts", *scalars),
                rows,
                f"{self.starts} starts, {self.failures} of which did not converge; {self.report()}",
            )
        ]


def multistart(
    model: Model,
    experiments: dict[str, Measurement],
    *,
    free: Iterable[str] | str,
    starts: int = 32,
    spread: float = 0.5,
    seed: int = 0,
    bounds: dict[str, tuple[Any, Any]] | None = None,
    max_evaluations: int = 200,
    workers: Any = None,
    out: Any = None,
    chunks: Iterable[int] | None = None,
    progress: bool | None = None,
    **options: Any,
) -> Multistart:
    """Fit from several initial guesses, to find the global optimum and any other optima.

    The first fit starts from the values of the model. The Levenberg-Marquardt method then starts
    from `starts` Sobol points, with the noise estimated by the first fit. If its best result is
    another optimum, a last fit starts there. Only the first and last fits enforce the bounds.

    Args:
        model, experiments, free: as in `fit`.
        starts: number of additional initial guesses.
        spread: half the range of the initial guesses around the values of the model, in the
            coordinates u of the fit, for parameters without finite bounds; for positive parameters
            0.5 is a factor of 1.65 in both directions.
        seed: random seed of the Sobol points.
        bounds: as in `fit`; where they are finite, the initial guesses lie between them.
        max_evaluations: largest number of steps from each initial guess.
        workers: None, a number of processes, or an executor, as in `sweep`; the results are
            the same.
        out: path of a Zarr store to which the ends of every 16 starts are written when they are
            done, as in `sweep`: the same call continues an interrupted one. By default none.
        chunks: indices of the chunks of 16 starts that this call computes, such as range(i, n, k)
            for job i of k; None: all.
        progress: as in `fit`.
        options: other options of `fit`.

    The starts are computed in batches of 16. Ctrl-C between batches returns the optima so far.
    Starts whose batch is LOST count as not converged.

    Errors: those of `fit`, BAD_NUMBER, BAD_CHUNK, BAD_WORKERS, NOT_SENT, OTHER_WORKER, OTHER_STORE,
    NOT_SAVED. Warns SEVERAL_OPTIMA if another optimum has a log-likelihood within 2 of the best,
    LOST and INTERRUPTED.

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
    ...     noise=0.01,
    ... )
    >>> several = jb.fitting.multistart(
    ...     model, {"track": track}, free=["spring.stiffness"], starts=4
    ... )
    >>> several.estimates["spring.stiffness"].round(4).tolist()
    [39.4784]
    """
    with Problems() as problems:
        starts = whole_number(starts, "multistart.starts", problems)
        seed = whole_number(seed, "multistart.seed", problems, least=0)
        positive_number(spread, "multistart.spread", problems)
        chunks = checked_chunks("multistart", workers, out, chunks, problems, fixed=True)
    with working("multistart", progress) as line:
        # its warnings are about an optimum that may not be the best
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            first = fit(model, experiments, free=free, bounds=bounds, progress=progress, **options)
        task = first.task
        points = around(task.space, starts, spread, seed)
        ends, costs, done = [np.asarray(first.u)], [float(first.cost)], 0
        if workers is None and out is None:
            searched = (
                (part["u"], part["end"], part["cost"])
                for part in computed_here(**_search(task, points, max_evaluations))
            )
        else:
            searched = [
                _searched_by_workers(task, points, max_evaluations, workers, out, chunks, line)
            ]
        with contextlib.suppress(KeyboardInterrupt):
            for u, status, cost in searched:
                done += int((status != Status.INTERRUPTED).sum())
                converged = (status == Status.OK) & np.isfinite(cost)
                ends += list(u[converged])
                costs += list(cost[converged])
                line(message := f"starts {done} of {starts}: least cost {min(costs):.9g}")
                if progress:
                    print(message, flush=True)
        groups = _grouped(np.array(ends), np.array(costs))
        lowest, best = groups[0][0], first
        if lowest == 0:
            for each in caught:
                warn_of(each.message)  # pyright: ignore
        else:
            best = fit(
                model,
                experiments,
                free=free,
                bounds=bounds,
                progress=progress,
                resume=dataclasses.replace(first, u=device_array(ends[lowest])),
                **options,
            )
    cost = np.array([costs[group[0]] for group in groups])
    if len(cost) > 1 and cost[1] - cost[0] < CLOSE:
        warn(
            "SEVERAL_OPTIMA",
            "another optimum explains the data about as well: costs "
            f"{cost[0]:.6g} and {cost[1]:.6g}",
        )
    values = jax.vmap(task.space.values)(
        device_array(np.array([ends[group[0]] for group in groups]))
    )
    return Multistart(
        best=best,
        cost=cost,
        hits=np.array([len(group) for group in groups]),
        estimates={path: values[path] for path in first.paths},
        starts=done + 1,
        failures=done + 1 - len(ends),
        status=best.status,
    )


Ends = tuple[np.ndarray, ...]  # u, status and cost at the ends of searches


def _searched_by_workers(
    task: Task, points: np.ndarray, max_steps: int, workers: Any, out: Any, chunks: Any, line: Line
) -> Ends:
    """Return u, status and cost at the ends of all searches; searches that were not carried out
    have the status LOST or INTERRUPTED."""
    with crew_of(workers, "multistart.workers") as crew:
        batch = batch_of(**_search(task, points, max_steps), where="multistart")
        results, status = gathered(
            batch,
            crew,
            "multistart",
            lambda done, _: line(f"starts {done} of {len(points)}"),
            out,
            chunks,
            plan={"starts from": hash_of(points)},
            inputs=["start"],
            dimension="start",
        )
    return results["u"], np.where(status == Status.OK, results["end"], status), results["cost"]


def _search(task: Task, points: np.ndarray, max_steps: int) -> dict[str, Any]:
    """Return the arguments of a batch of searches from these points; the batch gives u, status and
    cost at the end of each search."""

    def search(task, points):
        def one(start):
            u, status, _ = solve(
                task, start, optimistix.LevenbergMarquardt(rtol=1e-9, atol=1e-9), max_steps
            )
            r = task.residual(u)
            return {"u": u, "end": status, "cost": 0.5 * r @ r}

        return jax.vmap(one)(points)

    points = points.astype(np.asarray(device_array(points)).dtype)
    return dict(
        function=search,
        tree=task,
        rows=lambda i, j: [points[i:j]],
        count=len(points),
        width=BATCH,
        owner=_search,
        place=max_steps,
    )


def _grouped(ends: np.ndarray, costs: np.ndarray) -> list[list[int]]:
    """Return indices of results grouped by optimum, in order of cost."""
    groups: list[list[int]] = []
    for i in np.argsort(costs, kind="stable"):
        for group in groups:
            near = np.abs(ends[i] - ends[group[0]]).max() < SAME
            if near and abs(costs[i] - costs[group[0]]) < SAME * (1 + costs[group[0]]):
                group.append(int(i))
                break
        else:
            groups.append([int(i)])
    return groups
