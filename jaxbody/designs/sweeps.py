"""Sweeps: quantities of many models on a grid of parameters or at samples, as labeled arrays, computed in chunks by one program."""

from __future__ import annotations

import sys
import weakref
from typing import Any

import equinox as eqx
import jax
import numpy as np

from jaxbody.compilation.compile_options import quick_options
from jaxbody.core.arguments import check_key, checked_dict, whole_number
from jaxbody.core.arrays import device_array, float_array
from jaxbody.core.datasets import dataset
from jaxbody.core.errors import Problems
from jaxbody.core.progress_lines import Line, working
from jaxbody.designs.programs import Evaluate, evaluated
from jaxbody.models.leaf_paths import replace
from jaxbody.models.models import Model
from jaxbody.models.preconditions import check_precision

LARGEST_CHUNK = 1024
MEMORY = 2**30  # bytes of temporary memory that a chunk may take
SAMPLERS = {"sobol": "Sobol", "latin": "LatinHypercube"}  # in scipy.stats.qmc

compiled: weakref.WeakKeyDictionary[Any, dict[Any, Any]] = weakref.WeakKeyDictionary()


def sweep(
    model: Model,
    evaluate: Evaluate,
    over: dict[str, Any],
    *,
    samples: int | None = None,
    sampler: str = "sobol",
    key: Any = None,
    chunk: int | None = None,
    progress: bool | None = None,
) -> Any:
    """Quantities of a model for many values of its parameters, as an xarray.Dataset.

    Args:
        model: the model.
        evaluate: model -> {name: number or array} by JAX functions, or one number, then called "objective". It is compiled once.
        over: {path or pattern: values}, a grid of all combinations with one axis each; or, with `samples`, {path or pattern: (low,
            high)}. All matches of a pattern get the same value.
        samples: number of points between low and high; None computes the grid.
        sampler: how scipy.stats.qmc spreads the samples: "sobol" (best with a power of two) or "latin" (hypercube).
        key: scrambles the samples; None takes jax.random.key(0).
        chunk: number of models evaluated at a time; None takes up to 1024 that fit in 1 GiB.
        progress: None shows progress after five seconds on a terminal or in a notebook, False is silent, True prints to stderr at once.

    Errors: those of `replace`, NON_FINITE, WRONG_KIND for a key, EMPTY_SWEEP, BAD_RANGE, BAD_SAMPLER, BAD_CHUNK, MISSING_EXTRA.

    >>> car = jb.presets.quarter_car()
    >>> def sag(model):
    ...     return {"sag": model["body"].mass * 9.81 / model["suspension"].stiffness}
    >>> quantities = sweep(car, sag, {"suspension.stiffness": [2e4, 4e4], "body.mass": [300.0, 350.0, 400.0]})
    >>> round(float(quantities["sag"].sel({"suspension.stiffness": 4e4, "body.mass": 400.0})), 4)
    0.0981
    """
    check_precision("sweep", model)
    with Problems() as problems:
        given = checked_dict(over, "sweep.over", "path: [values]", problems)
        samples = None if samples is None else whole_number(samples, "sweep.samples", problems)
        chunk = None if chunk is None else whole_number(chunk, "sweep.chunk", problems, code="BAD_CHUNK")
        check_key(key, "sweep.key", problems)
        columns = {path: problems.gather(lambda path=path: float_array(given[path], f"sweep['{path}']")) for path in given}
        columns = {path: values for path, values in columns.items() if values is not None}
        empty = not columns or any(values.ndim < 1 or not len(values) for values in columns.values())
        if empty and not problems.collected:
            problems.add(
                "EMPTY_SWEEP", "sweep.over", "has no values", value=over, limit="values for each path", hint="Give {path: [values]}."
            )
        for path, values in columns.items():
            if not np.isfinite(values).all():
                problems.add("NON_FINITE", f"sweep['{path}']", f"is {values[~np.isfinite(values)][0]}", value=values, limit="finite")
        if sampler not in SAMPLERS:
            problems.add("BAD_SAMPLER", "sweep.sampler", f"is {sampler!r}", value=sampler, limit=" ".join(SAMPLERS))
    if samples is not None:
        columns = _sampled(columns, samples, sampler, jax.random.key(0) if key is None else key)
        points = columns
    else:
        shape = tuple(len(values) for values in columns.values())
        index = np.indices(shape).reshape(len(shape), -1)
        points = {path: values[i] for (path, values), i in zip(columns.items(), index, strict=True)}
    for ends in (np.argmin, np.argmax):  # if the smallest and the largest values are valid, so are those between
        replace(model, {path: _end(values, ends) for path, values in points.items()})
    with working("sweep", progress) as line:
        quantities = _evaluated(model, evaluate, points, chunk, line, progress)
    return sweep_dataset(columns, quantities, on_grid=samples is None)


def _end(values: np.ndarray, which: Any) -> np.ndarray | float:
    """The value that contains the smallest or the largest number."""
    return values[np.unravel_index(which(values), values.shape)[0]]


def _sampled(ranges: dict[str, Any], samples: int, sampler: str, key: Any) -> dict[str, np.ndarray]:
    import scipy.stats.qmc as qmc  # slow to import

    with Problems() as problems:
        for path, values in ranges.items():
            if len(values) != 2 or not (values[0] < values[1]).all():
                problems.add(
                    "BAD_RANGE", f"sweep['{path}']", f"is {values.tolist()}", value=values, limit="(low, high)", hint="Samples lie between."
                )
    sizes = [int(np.prod(values.shape[1:])) for values in ranges.values()]
    seed = np.random.default_rng(np.asarray(jax.random.key_data(key)).ravel())
    draw = getattr(qmc, SAMPLERS[sampler])(d=sum(sizes), seed=seed)
    unit = draw.random_base2(int(np.log2(samples))) if sampler == "sobol" and not samples & (samples - 1) else draw.random(samples)
    parts = np.split(unit, np.cumsum(sizes)[:-1], axis=1)
    return {
        path: low + (high - low) * part.reshape(samples, *low.shape)
        for (path, (low, high)), part in zip(ranges.items(), parts, strict=True)
    }


def _evaluated(
    model: Model, evaluate: Evaluate, points: dict[str, np.ndarray], chunk: int | None, line: Line, progress: bool | None
) -> dict[str, np.ndarray]:
    """The quantities at all points, computed chunk by chunk."""
    count = len(next(iter(points.values())))
    program, width = _program(model, evaluate, points, min(count, chunk or LARGEST_CHUNK), chunk is None)
    numbers = eqx.filter(model, eqx.is_array)
    parts = []
    for first in range(0, count, width):
        rows = np.minimum(np.arange(first, first + width), count - 1)  # the last chunk is padded with its last point
        quantities = program(numbers, {path: device_array(values[rows]) for path, values in points.items()})
        parts.append(jax.tree.map(lambda x, first=first: np.asarray(x)[: count - first], quantities))
        done = min(first + width, count)
        line(f"{done} of {count} models")
        if progress:
            print(f"\rsweep {done} of {count}", end="\n" if done == count else "", file=sys.stderr, flush=True)
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


def _program(model: Model, evaluate: Evaluate, points: dict[str, np.ndarray], width: int, may_shrink: bool):
    """The compiled program for chunks of `width` models and its width, which is smaller if the chunk would take too much memory."""
    numbers, rest = eqx.partition(model, eqx.is_array)
    shapes = tuple((path, values.shape[1:]) for path, values in points.items())
    known = compiled.setdefault(evaluate, {})
    place = jax.tree.structure(model), tuple((x.shape, x.dtype) for x in jax.tree.leaves(numbers)), shapes, width, may_shrink
    if place not in known:

        def one(numbers, values):
            return evaluated(evaluate, replace(eqx.combine(numbers, rest), values))

        def built(width):
            given = {path: jax.ShapeDtypeStruct((width, *shape), float) for path, shape in shapes}
            return jax.jit(jax.vmap(one, in_axes=(None, 0)), compiler_options=quick_options()).lower(numbers, given).compile()

        program = built(width)
        taken = getattr(program.memory_analysis(), "temp_size_in_bytes", 0)
        if may_shrink and taken > MEMORY and width > 1:
            width = max(1, int(width * MEMORY / taken))
            program = built(width)
        known[place] = program, width
    return known[place]


def sweep_dataset(columns: dict[str, Any], quantities: dict[str, Any], *, on_grid: bool) -> Any:
    """The dataset of a sweep: each quantity over the axes of the grid, or over `sample`."""
    axes = tuple(columns) if on_grid else ("sample",)
    lengths = tuple(len(values) for values in columns.values()) if on_grid else (len(next(iter(columns.values()))),)
    variables = {}
    for name, values in quantities.items():
        own = values.shape[1:]
        variables[name] = ((*axes, *(f"{name}_{i}" for i in range(len(own)))), values.reshape(*lengths, *own), "")
    coordinates = {}
    for path, values in columns.items():
        over = path if on_grid else "sample"
        flat = np.ndim(values) == 1
        coordinates[path] = (over, values) if flat else (over, np.arange(len(values)))
        if not flat:
            coordinates[f"{path} values"] = ((over, *(f"{path}_{i}" for i in range(np.ndim(values) - 1))), values)
    return dataset(variables, coordinates, "sweep")
