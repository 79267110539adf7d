"""Pareto fronts: designs in which no objective can be improved without degrading another, computed
by constrained minimization.

    minimize f_1(x),   f_2(x) <= b_2, ...   and all limits,   for bounds b along the front

Each point starts from the previous one; the multiplier of b is the slope of the front and
determines the next b.
"""

import itertools
import warnings
from collections.abc import Iterable
from typing import Any

import jax.numpy as jnp
import numpy as np

from jaxbody.core import tables
from jaxbody.core.arguments import whole_number
from jaxbody.core.arrays import Array, Float, Int
from jaxbody.core.errors import Problems
from jaxbody.core.progress_lines import working
from jaxbody.core.results import Labeled, Result, dataset, warn_if_failed
from jaxbody.design.design_programs import Evaluate, Quantities, variables_over
from jaxbody.design.searches import MET
from jaxbody.design.tuners import tune
from jaxbody.design.tuning_results import Tuning
from jaxbody.model.models import Model

SAME, NOTABLE = 1e-6, 1e-3  # negligible and notable differences, relative to the objective's range


class Front(Labeled, Result):
    """A Pareto front: `objectives` {name: (n,)} along the front, `values` {path: (n, ...)} and all
    `quantities` {name: (n, ...)} of its designs, `slopes` (n, k - 1), the derivatives of the first
    objective with respect to the others, `status` of each point, and `designs`, the results of
    `tune`.

    >>> import inspect
    >>> inspect.signature(jb.pareto).return_annotation.__name__  # pareto returns one
    'Front'
    """

    index = "point"
    objectives: dict[str, Float[np.ndarray, "n"]]
    values: dict[str, Array]
    quantities: Quantities
    slopes: Float[np.ndarray, "n k"]
    status: Int[np.ndarray, "n"]
    designs: tuple[Tuning, ...]

    def to_xarray(self) -> Any:
        """Return an xarray.Dataset over `point` with all quantities, parameters and slopes."""
        variables = {
            **self.values,
            **self.quantities,
            "status": self.status,
            **{
                f"slope over {name}": slope
                for name, slope in zip(list(self.objectives)[1:], self.slopes.T, strict=True)
            },
        }
        return dataset(
            variables_over(("point",), variables),
            {"point": np.arange(1, 1 + len(self.status))},
            "front",
        )

    def _tables(self) -> list[tables.PrintedTable]:
        names = tuple(self.objectives)
        points = zip(*self.objectives.values(), *self.slopes.T, strict=True)
        rows = [
            (str(i), *("" if np.isnan(x) else x for x in numbers))
            for i, numbers in enumerate(points, 1)
        ]
        heads = ("point", *names, *(f"d {names[0]}/d {name}" for name in names[1:]))
        return [tables.PrintedTable("Front of " + " and ".join(names), heads, rows, self.report())]


def pareto(
    model: Model,
    evaluate: Evaluate,
    *,
    minimize: Iterable[str],
    free: str | Iterable[str],
    points: int = 12,
    limits: dict[str, Any] | None = None,
    workers: Any = None,
    **options: Any,
) -> Front:
    """Compute the Pareto front of two or three objectives.

    Args:
        model, evaluate, free, limits: as in `tune`.
        minimize: names of two or three objectives.
        points: number of designs on the front.
        workers: as in `tune`, for the ends of the front if they have several `starts`. Designs
            between the ends start from their neighbors and are computed in this process.
        options: the other options of `tune`.

    For two objectives, the front runs from the design with the least second objective to that with
    the least first one, about equally spaced relative to their ranges. For three objectives, it
    consists of such fronts of the first and third for several bounds on the second, about `points`
    designs in all, without dominated or repeated designs. Warns with the worst status of all
    designs. Errors: BAD_FRONT, those of `tune`.

    >>> car = jb.presets.quarter_car(damping=1500.0)
    >>> def trade(model):
    ...     c = model["suspension"].damping / 1500.0
    ...     return {"shake": c + 1 / c, "travel": 1 / c}
    >>> bounds = {"*.damping": (500.0, 5000.0)}
    >>> front = jb.pareto(
    ...     car,
    ...     trade,
    ...     minimize=["shake", "travel"],
    ...     free=["suspension.damping"],
    ...     bounds=bounds,
    ...     points=4,
    ... )
    >>> [round(float(x), 3) for x in front.objectives["travel"][[0, -1]]]
    [0.3, 1.0]
    """
    names = [minimize] if isinstance(minimize, str) else list(minimize)
    with Problems() as problems:
        if len(set(names)) != len(names) or len(names) not in (2, 3):
            problems.add(
                "BAD_FRONT",
                "pareto.minimize",
                f"has the objectives {', '.join(map(str, names))}",
                value=names,
                limit="two or three different names",
            )
        points = whole_number(points, "pareto.points", problems, least=3, code="BAD_FRONT")

    counts = itertools.count(1)

    def least(start: Model, name: str, bounds: dict[str, float]) -> Tuning:
        line(f"design {next(counts)} of about {points + len(names)}")
        both = dict(limits or {})
        for other, bound in bounds.items():
            lower, upper = both.get(other, (None, None))
            both[other] = (lower, bound if upper is None else min(bound, upper))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # the front reports the status of each
            given: Any = options | (dict(workers=workers) if start is model else dict(starts=1))
            return tune(start, evaluate, minimize=name, free=free, limits=both, **given)

    with working("pareto", options.get("progress")) as line:
        ends = [least(model, name, {}) for name in names]
        designs = (
            _along(names, ends, least, points)
            if len(names) == 2
            else _over(names, ends, least, points)
        )
    slopes = [
        [
            design.multipliers.get(name, 0.0) if design.minimize == names[0] else np.nan
            for name in names[1:]
        ]
        for design in designs
    ]
    front = Front(
        objectives={name: np.array([_value(design, name) for design in designs]) for name in names},
        values={
            path: jnp.stack([design.values[path] for design in designs])
            for path in designs[0].values
        },
        quantities={
            name: np.stack([design.after[name] for design in designs]) for name in designs[0].after
        },
        slopes=np.array(slopes),
        status=np.array([int(design.status) for design in designs]),
        designs=tuple(designs),
    )
    return warn_if_failed(front)


def _value(design: Tuning, name: str) -> float:
    return float(design.after[name])


def _slack(x: float) -> float:
    """Return a bound slightly above a value, so that the design with this value is feasible in
    spite of tolerances."""
    return x + MET * abs(x)


def _along(names: list[str], ends: list[Tuning], least: Any, points: int) -> list[Tuning]:
    """Return designs along the front of two objectives, from the end with the least second
    objective, by tangent steps of equal length."""
    one, other = names
    low, high = _value(ends[1], other), _value(ends[0], other)
    # the best of the designs with the least second objective
    first = least(ends[1].model, one, {other: _slack(low)})
    first = first if first.ok else ends[1]  # there may be only one such design
    width = high - low
    height = _value(first, one) - _value(ends[0], one)
    if width <= MET * abs(high) or height <= MET * abs(_value(first, one)):
        return [ends[0]]  # no conflict: one design is best in both
    designs, bound = [first], low
    for remaining in range(points - 1, 1, -1):
        length = np.hypot(
            (high - bound) / width, (_value(designs[-1], one) - _value(ends[0], one)) / height
        )
        slope = designs[-1].multipliers.get(other, 0.0) * width / height
        step = length / remaining / np.hypot(1.0, slope)
        bound = bound + width * min(
            max(step, 0.2 / points / points), (high - bound) / width / remaining * 2
        )
        designs.append(least(designs[-1].model, one, {other: bound}))
    return [*designs, ends[0]]


def _over(names: list[str], ends: list[Tuning], least: Any, points: int) -> list[Tuning]:
    """Return the designs of fronts of the first and third objective for several bounds on the
    second, without dominated or repeated designs."""
    one, second, third = names
    count = max(3, round(points**0.5))
    at = [_value(end, second) for end in ends]
    designs = list(ends)
    for bound in np.linspace(min(at), max(at), count + 1)[1:]:

        def within(start: Model, name: str, bounds: dict[str, float], bound=bound) -> Tuning:
            return least(start, name, {**bounds, second: _slack(float(bound))})

        extremes = [within(ends[0].model, one, {}), within(ends[2].model, third, {})]
        designs += _along([one, third], extremes, within, count)
    designs = [design for design in designs if design.ok]
    values = np.array([[_value(design, name) for name in names] for design in designs])
    size = np.ptp(values, axis=0)
    # gain[i, j]: improvement of design j over design i
    gain = (values[:, None] - values[None]) / np.where(size > 0, size, 1.0)
    dominated = np.all(gain >= -SAME, -1) & np.any(gain > NOTABLE, -1)
    repeated = np.any(np.triu(np.all(np.abs(gain) < NOTABLE, -1), 1), 0)
    return [
        design
        for design, worse, duplicate in zip(designs, np.any(dominated, 1), repeated, strict=True)
        if not worse and not duplicate
    ]
