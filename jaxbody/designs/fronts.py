"""Trade-offs: the designs in which no objective gets better without another getting worse, followed by gradients from one end to the other.

    minimize f_1(x),   f_2(x) <= b_2, ...   and all limits,   for bounds b along the front

Each point starts from the one before it; the multiplier of b, the slope of the front, says how far the next one lies.
"""

from __future__ import annotations

import itertools
import warnings
from collections.abc import Iterable
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxbody.core import tables
from jaxbody.core.arguments import whole_number
from jaxbody.core.datasets import dataset
from jaxbody.core.errors import Problems
from jaxbody.core.progress_lines import working
from jaxbody.core.results import Result, warn_if_failed
from jaxbody.designs.programs import Evaluate, Quantities
from jaxbody.designs.searches import MET
from jaxbody.designs.tuners import tune
from jaxbody.designs.tunings import Tuning
from jaxbody.models.models import Model

SAME, NOTABLE = 1e-6, 1e-3  # parts of the range of an objective


class Front(Result):
    """`objectives` {name: (n,)} along the front, `values` {path: (n, ...)} and all `quantities` {name: (n, ...)} of its designs, `slopes` (n, k - 1): what one unit more
    of each further objective adds to the first. `status` of each point, `designs` as `tune` gave them.

    >>> import inspect
    >>> inspect.signature(pareto).return_annotation  # pareto returns one
    'Front'
    """

    objectives: dict[str, Float[np.ndarray, "n"]]
    values: dict[str, Array]
    quantities: Quantities
    slopes: Float[np.ndarray, "n k"]
    status: Int[np.ndarray, "n"]
    designs: tuple[Tuning, ...]

    def to_xarray(self) -> Any:
        """An xarray.Dataset over `point`: every quantity, parameter and slope."""
        variables = {"status": (("point",), self.status, "")}
        for name, values in {**self.quantities, **self.values}.items():
            axes = tuple(f"{name}_{i}" for i in range(np.ndim(values) - 1))
            variables.setdefault(name, (("point", *axes), values, ""))
        for name, slope in zip(list(self.objectives)[1:], self.slopes.T, strict=True):
            variables[f"slope over {name}"] = (("point",), slope, "")
        return dataset(variables, {"point": np.arange(1, 1 + len(self.status))}, "front")

    def _tables(self) -> list[tables.PrintedTable]:
        names = tuple(self.objectives)
        columns = (*self.objectives.values(), *self.slopes.T)
        rows = [(str(i + 1), *("" if np.isnan(x) else x for x in numbers)) for i, numbers in enumerate(zip(*columns, strict=True))]
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
    **options: Any,
) -> Front:
    """The front of two or three objectives, quantities of `evaluate` as in `tune`, whose other options this takes too.

    Of two, from the design of least second objective to that of least first one, about equally far apart in both, relative to their ranges.
    Of three, such fronts of the first and the third for some bounds on the second, about `points` in all, without what another design beats or
    repeats. Warns by the worst status of a design. Errors: BAD_FRONT, those of `tune`.

    >>> car = jb.presets.quarter_car(damping=1500.0)
    >>> def trade(model):
    ...     c = model["suspension"].damping / 1500.0
    ...     return {"shake": c + 1 / c, "travel": 1 / c}
    >>> front = pareto(car, trade, minimize=["shake", "travel"], free=["suspension.damping"], bounds={"*.damping": (500.0, 5000.0)}, points=4)
    >>> [round(float(x), 3) for x in front.objectives["travel"][[0, -1]]]
    [0.3, 1.0]
    """
    names = [minimize] if isinstance(minimize, str) else list(minimize)
    problems = Problems()
    if len(set(names)) != len(names) or len(names) not in (2, 3):
        words = f"has the objectives {', '.join(map(str, names))}"
        problems.add("BAD_FRONT", "pareto.minimize", words, value=names, limit="two or three different names")
    points = whole_number(points, "pareto.points", problems, least=3, code="BAD_FRONT")
    problems.raise_if_any()

    counts = itertools.count(1)

    def least(start: Model, name: str, bounds: dict[str, float]) -> Tuning:
        line(f"design {next(counts)} of about {points + len(names)}")
        both = dict(limits or {})
        for other, bound in bounds.items():
            lower, upper = both.get(other, (None, None))
            both[other] = (lower, bound if upper is None else min(bound, upper))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # the front tells
            return tune(start, evaluate, minimize=name, free=free, limits=both, **(options if start is model else {**options, "starts": 1}))

    with working("pareto", options.get("progress")) as line:
        ends = [least(model, name, {}) for name in names]
        found = _along(names, ends, least, points) if len(names) == 2 else _over(names, ends, least, points)
    result = _front(names, found)
    warn_if_failed(result)
    return result


def _value(design: Tuning, name: str) -> float:
    return float(design.after[name])


def _slack(x: float) -> float:
    """A bound that its own design still keeps."""
    return x + MET * abs(x)


def _along(names: list[str], ends: list[Tuning], least: Any, points: int) -> list[Tuning]:
    """From the end of least second objective, by steps of equal length on the tangent."""
    one, other = names
    low, high = _value(ends[1], other), _value(ends[0], other)
    first = least(ends[1].model, one, {other: _slack(low)})  # of those of least second objective the best
    first = first if first.ok else ends[1]  # there may be but one, which limits that meet in a point do not tell
    width = high - low
    height = _value(first, one) - _value(ends[0], one)
    if width <= MET * abs(high) or height <= MET * abs(_value(first, one)):
        return [ends[0]]  # no conflict: one design is best in both
    found, bound = [first], low
    for left in range(points - 1, 1, -1):
        rest = np.hypot((high - bound) / width, (_value(found[-1], one) - _value(ends[0], one)) / height)
        slope = found[-1].multipliers.get(other, 0.0) * width / height
        step = rest / left / np.hypot(1.0, slope)
        bound = bound + width * min(max(step, 0.2 / points / points), (high - bound) / width / left * 2)
        found.append(least(found[-1].model, one, {other: bound}))
    return [*found, ends[0]]


def _over(names: list[str], ends: list[Tuning], least: Any, points: int) -> list[Tuning]:
    """For each of some bounds on the second the front of the first and the third; then without what another design beats."""
    one, second, third = names
    count = max(3, round(points**0.5))
    at = [_value(end, second) for end in ends]
    found = list(ends)
    for bound in np.linspace(min(at), max(at), count + 1)[1:]:

        def within(start: Model, name: str, bounds: dict[str, float], bound=bound) -> Tuning:
            return least(start, name, {**bounds, second: _slack(float(bound))})

        sides = [within(ends[0].model, one, {}), within(ends[2].model, third, {})]
        found += _along([one, third], sides, within, count)
    found = [design for design in found if design.ok]
    values = np.array([[_value(design, name) for name in names] for design in found])
    size = np.ptp(values, axis=0)
    gain = (values[:, None] - values[None]) / np.where(size > 0, size, 1.0)  # of the second of each pair over the first
    beaten = (gain >= -SAME).all(-1) & (gain > NOTABLE).any(-1)
    twice = np.triu((np.abs(gain) < NOTABLE).all(-1), 1).any(0)
    return [design for design, worse, again in zip(found, beaten.any(1), twice, strict=True) if not worse and not again]


def _front(names: list[str], found: list[Tuning]) -> Front:
    objectives = {name: np.array([_value(design, name) for design in found]) for name in names}
    slopes = np.array(
        [[design.multipliers.get(name, 0.0) if design.minimize == names[0] else np.nan for name in names[1:]] for design in found]
    )
    values = {path: jnp.stack([design.values[path] for design in found]) for path in found[0].values}
    quantities = {name: np.stack([design.after[name] for design in found]) for name in found[0].after}
    return Front(objectives, values, quantities, slopes, np.array([int(design.status) for design in found]), tuple(found))
