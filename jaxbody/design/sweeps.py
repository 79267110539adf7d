"""Sweeps: quantities of many models on a grid of parameters or at samples, as labeled arrays,
computed in chunks by one program.

The points of a sweep are never all in memory: `rows(first, last)` makes those of a chunk.
"""

import math
import sys
import warnings
from collections.abc import Callable, Iterable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxbody.core.arguments import check_key, checked_dict, whole_number
from jaxbody.core.arrays import float_array
from jaxbody.core.errors import JaxbodyError, Problem, Problems, import_extra
from jaxbody.core.progress_lines import working
from jaxbody.core.results import dataset
from jaxbody.core.workers.batches import (
    batch_of,
    checked_chunks,
    gathered,
    gathered_here,
    store_of,
    stored,
)
from jaxbody.core.workers.chunk_stores import STATUS, hash_of
from jaxbody.core.workers.executors import crew_of
from jaxbody.design.design_programs import Evaluate, evaluated, variables_over
from jaxbody.model.leaf_paths import replace
from jaxbody.model.models import Model
from jaxbody.model.preconditions import check_precision

LARGEST_CHUNK = 1024
MEMORY = 2**30  # bytes of temporary memory that a chunk may take
MANY = 2**16  # samples checked at a time
SAMPLERS = {"sobol": "Sobol", "latin": "LatinHypercube"}  # in scipy.stats.qmc


def sweep(
    model: Model,
    evaluate: Evaluate,
    over: dict[str, Any],
    *,
    samples: int | None = None,
    sampler: str = "sobol",
    key: Any = None,
    chunk: int | None = None,
    workers: Any = None,
    out: Any = None,
    chunks: Iterable[int] | None = None,
    progress: bool | None = None,
) -> Any:
    """Compute quantities of a model for many values of its parameters, as an xarray.Dataset.

    Args:
        model: the model.
        evaluate: model -> {name: number or array} by JAX functions, or one number, then called
            "objective". It is compiled once.
        over: {path or pattern: values}, a grid of all combinations with one axis each; or, with
            `samples`, {path or pattern: (low, high)}. All matches of a pattern get the same value.
        samples: number of points between low and high; None computes the grid.
        sampler: how scipy.stats.qmc spreads the samples: "sobol" (best with a power of two) or
            "latin" (hypercube).
        key: random key that scrambles the samples; None takes jax.random.key(0).
        chunk: number of models evaluated at a time, and with `workers` or `out` sent and stored at
            a time; None takes up to 1024 that fit in 1 GiB, and sends at most 256
            parts, or parts with results of 64 MB.
        workers: None computes in this process, on all of its devices; a number starts that many
            processes of one thread each (needs jaxbody[cluster]); or an executor of processes, such
            as Dask's `client.get_executor(pure=False)`. The numbers are the same.
        out: path of a Zarr store (needs jaxbody[cluster]), to which each chunk is written when it
            is done. The same call continues an interrupted one. The result is then read from the
            store as it is used; its dimension is `design`, along which the last path varies
            fastest.
        chunks: numbers of the chunks that this call computes, such as range(i, n, k) for job i of
            k, with `chunk` and `out`; None: all.
        progress: None shows progress after five seconds on a terminal or in a notebook, False is
            silent, True prints to stderr at once.

    Chunks of a worker that ends are computed again. A chunk that fails three times has NaN and
    status LOST: with `workers` or `out` there is a variable `status`, INTERRUPTED where nothing is
    computed yet. Ctrl-C returns what is done.

    Errors: those of `replace`, NON_FINITE, WRONG_KIND for a key, EMPTY_SWEEP, BAD_RANGE,
    BAD_SAMPLER, BAD_CHUNK, MISSING_EXTRA, BAD_WORKERS, NOT_SENT, OTHER_WORKER, OTHER_STORE,
    NOT_SAVED, BAD_NAME. Warns LOST and INTERRUPTED.

    >>> car = jb.presets.quarter_car()
    >>> def sag(model):
    ...     return {"sag": model["body"].mass * 9.81 / model["suspension"].stiffness}
    >>> quantities = jb.sweep(
    ...     car, sag, {"suspension.stiffness": [2e4, 4e4], "body.mass": [300.0, 350.0, 400.0]}
    ... )
    >>> round(float(quantities["sag"].sel({"suspension.stiffness": 4e4, "body.mass": 400.0})), 4)
    0.0981
    """
    check_precision("sweep", model)
    with Problems() as problems:
        given = checked_dict(over, "sweep.over", "path: [values]", problems)
        samples = None if samples is None else whole_number(samples, "sweep.samples", problems)
        chunk = (
            None
            if chunk is None
            else whole_number(chunk, "sweep.chunk", problems, code="BAD_CHUNK")
        )
        check_key(key, "sweep.key", problems)
        columns = {
            path: problems.gather(lambda path=path: float_array(given[path], f"sweep['{path}']"))
            for path in given
        }
        columns = {path: values for path, values in columns.items() if values is not None}
        if not problems.collected and (
            not columns or any(values.ndim < 1 or not len(values) for values in columns.values())
        ):
            problems.add(
                "EMPTY_SWEEP",
                "sweep.over",
                "has no values",
                value=over,
                limit="values for each path",
                hint="Give {path: [values]}.",
            )
        for path, values in columns.items():
            if not np.isfinite(values).all():
                problems.add(
                    "NON_FINITE",
                    f"sweep['{path}']",
                    f"is {values[~np.isfinite(values)][0]}",
                    value=values,
                    limit="finite",
                )
        if sampler not in SAMPLERS:
            problems.add(
                "BAD_SAMPLER",
                "sweep.sampler",
                f"is {sampler!r}",
                value=sampler,
                limit=" ".join(SAMPLERS),
            )
        chunks = checked_chunks("sweep", workers, out, chunks, problems, fixed=chunk is not None)
    key = jax.random.key(0) if key is None else key
    rows, count = (
        _grid(columns) if samples is None else (_samples(columns, samples, sampler, key), samples)
    )
    try:
        _check(model, columns)
    except JaxbodyError:
        if samples is None:
            raise
        # a range that begins at zero may have valid samples although its end is invalid
        _check(model, _extremes(columns, rows, count))
    points: Any = dict(
        function=_quantities_of(evaluate, list(columns)),
        tree=model,
        rows=rows,
        count=count,
        width=chunk or LARGEST_CHUNK,
        memory=MEMORY if chunk is None else None,
        owner=evaluate,
        place=("sweep", *columns),
    )
    with working("sweep", progress) as line:

        def report(done: int, workers: int) -> None:
            line(f"{done} of {count} models" + (f", {workers} workers" if workers > 1 else ""))
            if progress:
                print(
                    f"\rsweep {done} of {count}",
                    end="\n" if done == count else "",
                    file=sys.stderr,
                    flush=True,
                )

        if workers is None and out is None and jax.local_device_count() == 1:
            quantities = gathered_here(report, **points)
        else:
            with crew_of(workers, "sweep.workers") as crew:
                batch = batch_of(**points, where="sweep.evaluate")
                if STATUS in batch.program.results:
                    raise JaxbodyError(
                        Problem(
                            "BAD_NAME",
                            "sweep.evaluate",
                            f"returns a quantity {STATUS!r}",
                            STATUS,
                            "another name",
                            "Rename it: status says which models were computed.",
                        )
                    )
                if out is not None:
                    import_extra("xarray", "sweep.out")
                    random = np.asarray(jax.random.key_data(key))
                    store = store_of(
                        batch,
                        out,
                        {"over": hash_of(*columns, *columns.values(), samples, sampler, random)},
                        list(columns),
                        "design",
                    )
                    stored(batch, store, chunks, crew, "sweep", report)
                    return store.opened("sweep")
                quantities, status = gathered(batch, crew, "sweep", report)
            quantities |= {} if workers is None else {STATUS: status}
    if samples is not None:
        columns = dict(zip(columns, rows(0, count), strict=True))
    return sweep_dataset(columns, quantities, on_grid=samples is None)


def _check(model: Model, columns: dict[str, np.ndarray]) -> None:
    """Check the smallest and the largest values of all paths, between which all others are valid
    too. Errors: those of `replace`."""
    for which in (np.argmin, np.argmax):
        replace(model, {path: _end(values, which) for path, values in columns.items()})


def _end(values: np.ndarray, which: Any) -> np.ndarray | float:
    """Return the entry of `values` that contains the smallest or the largest number."""
    return values[np.unravel_index(which(values), values.shape)[0]]


PointsOf = Callable[[int, int], list[np.ndarray]]


def _grid(columns: dict[str, np.ndarray]) -> tuple[PointsOf, int]:
    """Return a function of (first, last) for the points of a grid, whose last axis varies fastest,
    and the number of points."""
    shape = tuple(len(values) for values in columns.values())

    def rows(first: int, last: int) -> list[np.ndarray]:
        index = np.unravel_index(np.arange(first, last), shape)
        return [
            values[i].astype(jnp.result_type(float))
            for values, i in zip(columns.values(), index, strict=True)
        ]

    return rows, math.prod(shape)


def _samples(ranges: dict[str, Any], samples: int, sampler: str, key: Any) -> PointsOf:
    """Return a function of (first, last) for samples between the ends of ranges. Error:
    BAD_RANGE."""
    import scipy.stats.qmc as qmc  # slow to import

    with Problems() as problems:
        for path, values in ranges.items():
            if len(values) != 2 or not (values[0] < values[1]).all():
                problems.add(
                    "BAD_RANGE",
                    f"sweep['{path}']",
                    f"is {values.tolist()}",
                    value=values,
                    limit="(low, high)",
                    hint="Samples lie between.",
                )
    sizes = [int(np.prod(values.shape[1:])) for values in ranges.values()]
    seed = np.random.default_rng(np.asarray(jax.random.key_data(key)).ravel())
    draw = getattr(qmc, SAMPLERS[sampler])(d=sum(sizes), seed=seed)
    whole = draw.random(samples) if sampler == "latin" else None  # it cannot be drawn in parts

    def rows(first: int, last: int) -> list[np.ndarray]:
        unit = _sequence(draw, first, last) if whole is None else whole[first:last]
        parts = np.split(unit, np.cumsum(sizes)[:-1], axis=1)
        return [
            (low + (high - low) * part.reshape(last - first, *low.shape)).astype(
                jnp.result_type(float)
            )
            for (low, high), part in zip(ranges.values(), parts, strict=True)
        ]

    return rows


def _sequence(draw: Any, first: int, last: int) -> np.ndarray:
    """Return points `first` to `last` of a Sobol sequence."""
    if draw.num_generated > first:
        draw.reset()
    if draw.num_generated < first:
        draw.fast_forward(first - draw.num_generated)
    with warnings.catch_warnings():
        warnings.simplefilter(
            "ignore", UserWarning
        )  # SciPy warns unless the number is a power of two
        return draw.random(last - first)


def _extremes(columns: dict[str, Any], rows: PointsOf, count: int) -> dict[str, np.ndarray]:
    """Return some values of each path, with the smallest and the largest number of all samples
    among them."""
    extremes = []
    for first in range(0, count, MANY):
        values = rows(first, min(first + MANY, count))
        extremes += [[_end(x, which) for x in values] for which in (np.argmin, np.argmax)]
    return dict(zip(columns, map(np.array, zip(*extremes, strict=True)), strict=True))


def _quantities_of(evaluate: Evaluate, paths: list[str]) -> Callable[..., Any]:
    """Return a function of a model and, for each path, its values in several variants of the model;
    it returns the quantities of all variants."""

    def of_one(model, *values):
        return evaluated(evaluate, replace(model, dict(zip(paths, values, strict=True))))

    return lambda model, *values: jax.vmap(partial(of_one, model))(*values)


def sweep_dataset(columns: dict[str, Any], quantities: dict[str, Any], *, on_grid: bool) -> Any:
    """Return the dataset of a sweep: each quantity over the axes of the grid, or over `sample`."""
    axes = tuple(columns) if on_grid else ("sample",)
    lengths = tuple(len(values) for values in columns.values())
    lengths = lengths if on_grid else lengths[:1]  # samples: all columns are of one length
    variables = variables_over(
        axes, {name: x.reshape(*lengths, *x.shape[1:]) for name, x in quantities.items()}
    )
    coordinates = {}
    for path, values in columns.items():
        over = path if on_grid else "sample"
        flat = np.ndim(values) == 1
        coordinates[path] = (over, values) if flat else (over, np.arange(len(values)))
        if not flat:
            coordinates[f"{path} values"] = (
                (over, *(f"{path}_{i}" for i in range(np.ndim(values) - 1))),
                values,
            )
    return dataset(variables, coordinates, "sweep")
