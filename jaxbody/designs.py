"""Designs: what is free in a model tuned by gradients, one quantity the least that limits on others allow.

    minimize f(x),   lower <= c(x) <= upper,   x between bounds,   f and c any JAX functions of the model

One function of the model gives all quantities: they and their exact derivatives are one compiled program, for one start or for a batch of them.
"""

from __future__ import annotations

import inspect
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Array, Float, Int
from threadpoolctl import threadpool_limits

from jaxbody import tables
from jaxbody.checks import check_precision
from jaxbody.design_programs import Evaluate, Limits, Program, Quantities, check_slopes, check_start, limits_of, named
from jaxbody.design_spaces import Free, Space, at_value, drawn, space_of
from jaxbody.errors import JaxbodyError, Problem, Problems, Status, is_concrete
from jaxbody.models import Model
from jaxbody.naming import matching
from jaxbody.optimizers import ARRIVED, MET, METHODS, Multipliers, Rows, Search, hand_in_hand, multipliers, scales, search_with
from jaxbody.results import Result, warn_if_failed

MOST_NEIGHBORS = 6  # parameters of catalogues of which all combinations of neighbors are tried


class Runs(eqx.Module):
    """Every start: `objective`, `violation` (the largest, relative to its limit), `status`, `values` {path: (n, ...)} and `quantities` {name: (n, ...)}."""

    objective: Float[np.ndarray, "n"]
    violation: Float[np.ndarray, "n"]
    status: Int[np.ndarray, "n"]
    values: dict[str, Array]
    quantities: Quantities


class Tuning(Result):
    """A tuned design: `model`, `values` {path: value}, quantities `before` and `after` {name: value}, `active` limits and bounds in words,
    `multipliers` {name of a limited quantity or of a parameter at its bound: what one unit more of the limit adds to the objective}, `words` what one percent more of each buys, `history`
    (evaluations, 2) of the objective and the violation of limits, `evaluations`, and all starts in `runs`. `status` INFEASIBLE where limits are not met, `unmet` says which,
    and NOT_CONVERGED.

    >>> import inspect
    >>> inspect.signature(tune).return_annotation  # tune returns one
    'Tuning'
    """

    model: Model
    values: dict[str, Array]
    before: Quantities
    after: Quantities
    multipliers: dict[str, float]
    active: tuple[str, ...]
    words: tuple[str, ...]
    unmet: tuple[str, ...]
    history: Float[np.ndarray, "k 2"]
    evaluations: int
    runs: Runs
    status: Int[np.ndarray, ""]
    space: Space
    minimize: str = eqx.field(static=True)
    limits: Limits = eqx.field(static=True)

    def explain(self) -> str:
        if int(self.status) == Status.INFEASIBLE:
            return "nearest to all limits " + "; ".join(self.unmet)
        if int(self.status) == Status.NOT_CONVERGED:
            return f"after {self.evaluations} evaluations; the best so far is kept; give more max_iterations"
        return ""

    def to_xarray(self) -> Any:
        """An xarray.Dataset over `start`: objective, violation, status, and every quantity and parameter."""
        from jaxbody.exports import tuning_dataset

        return tuning_dataset(self)

    def _tables(self) -> list[tables.Table]:
        start = {group.path: group.form.start for group in self.space.groups}
        rows = [
            (label, *pair, "at its bound" if name in self.multipliers else "")
            for group in self.space.groups
            for name, label, *pair in _each(group.path, group.label, start[group.path], self.values[group.path])
        ]
        quantities = [
            (name, label, *pair, _limit(self.limits.get(name)), self.multipliers.get(label, ""))
            for name, before in self.before.items()
            for _, label, *pair in _each(name, name, before, self.after[name])
        ]
        note = "\n".join([*self.words, f"{self.evaluations} evaluations, best of {len(self.runs.status)} starts; {self.report()}"])
        heads = ("", "before", "after", "limit", f"{self.minimize} per unit of the limit")
        return [
            tables.Table(f"Design of least {self.minimize}", ("parameter", "before", "after", ""), rows),
            tables.Table("", heads, [row[1:] for row in quantities], note),
        ]


def _each(path: str, label: str, before: Any, after: Any) -> list[tuple[str, str, float, float]]:
    """Of a scalar or an array, a row for each number."""
    before, after = np.asarray(before), np.asarray(after)
    index = [""] if before.ndim == 0 else [str(list(i)).replace(" ", "") for i in np.ndindex(before.shape)]
    return [(path + i, label + i, float(a), float(b)) for i, a, b in zip(index, before.ravel(), after.ravel(), strict=True)]


def _limit(limit: tuple[float, float] | None) -> str:
    if limit is None:
        return ""
    lower, upper = limit
    if lower == upper:
        return f"= {lower:.6g}"
    return f"<= {upper:.6g}" if lower == -np.inf else f">= {lower:.6g}" if upper == np.inf else f"{lower:.6g} to {upper:.6g}"


def tune(
    model: Model,
    evaluate: Evaluate,
    *,
    free: Free | Iterable[Free],
    minimize: str = "objective",
    limits: dict[str, Any] | None = None,
    bounds: dict[str, tuple[Any, Any]] | None = None,
    catalogues: dict[str, Iterable[float]] | None = None,
    starts: int = 1,
    key: Any = None,
    method: Any = "slsqp",
    max_iterations: int = 200,
    tolerance: float = 1e-10,
    reverse: bool | None = None,
) -> Tuning:
    """The design of least f within limits, by exact gradients.

    evaluate: model -> {name: number or array}, any JAX functions of a model, or one number, then called "objective". minimize: the name of f. limits:
    {name: (lower, upper)}, either may be None, one number for equality; of an array for each of its numbers. free: paths or patterns, each
    parameter by itself; those of a tuple stay equal, ("spring fl.stiffness", "spring fr.stiffness"). bounds: {path or pattern: (lower, upper)}, never left. Stiffness,
    damping and mass move by factors, orientations by turns. catalogues: {path or pattern: values that there are}: all neighbors of
    the optimum among them are tried, the rest tuned again.

    starts: how many, the model as it is and others drawn between the bounds with `key`; all are evaluated side by side. method: "slsqp" or "trust-constr", SciPy's
    (restarted while that gains; where limits are not met, the least violation is sought first), or an optax optimizer for large or stochastic
    objectives without limits: there `evaluate` may take a key besides the model, a new one each time, and max_iterations steps are made. reverse: derivatives by reverse mode; without it,
    forward mode for up to thirty free numbers. A trial that is not finite is a step rejected; where derivatives do not exist, at modes that
    coincide, they are taken a little aside: smooth quantities (`objectives`) don't need that.

    Errors: UNKNOWN_PATH, UNKNOWN_NAME, LISTED_TWICE, NOTHING_FREE, START_APART, START_ON_BOUND, START_OUTSIDE, BAD_BOUNDS, BAD_LIMITS, NO_BOUNDS, BAD_CATALOGUE, BAD_METHOD, BAD_OBJECTIVE,
    NONFINITE_START, TRACED, FLOAT32. Warns INFEASIBLE, with what is not met, and NOT_CONVERGED.

    >>> car = jb.presets.quarter_car(damping=1500.0)
    >>> def sag(model):
    ...     return {"sag": model["body"].mass * 9.81 / model["suspension"].stiffness, "stiffness": model["suspension"].stiffness}
    >>> found = tune(car, sag, free=["suspension.stiffness"], minimize="stiffness", limits={"sag": (None, 0.1)})
    >>> round(float(found.values["suspension.stiffness"]), 1), found.active
    (36787.5, ('sag <= 0.1',))
    """
    check_precision("tune", model, needs_float64=True)
    if not is_concrete(model):
        raise JaxbodyError(Problem("TRACED", "tune.model", "is being traced", hint="Tune outside of jit, vmap and grad."))
    key = jax.random.key(0) if key is None else key
    limited = limits_of(limits or {})
    space, low, high = space_of(model, free, dict(bounds or {}), "tune")
    shelves = _shelves(space, catalogues or {}, low, high)
    _check_options(method, starts, limited, shelves)
    U = drawn(space, low, high, starts, key, "tune.bounds")
    stochastic = not isinstance(method, str) and len(inspect.signature(evaluate).parameters) > 1
    program = Program(space, evaluate, minimize, limited, width=starts, reverse=reverse, key=key if stochastic else None)
    with threadpool_limits(1, "blas"):  # matrices are small: threads of BLAS only wait for each other
        check_start(program, U)
        searches = [Search(u, low, high) for u in U]
        if isinstance(method, str):
            hand_in_hand(program, searches, search_with(method, program.rows, max_iterations, tolerance))
        else:
            _descend_all(program, searches, method, max_iterations, key)
        best = _best(program.rows, searches)
        if shelves:
            searches = _neighbors(program.space, best, shelves)
            hand_in_hand(program, searches, search_with(method, program.rows, max_iterations, tolerance))
            best = _best(program.rows, searches)
    if not best.finite:
        check_slopes(program, best)
    result = _finish(program, searches, best)
    warn_if_failed(result)
    return result


def _shelves(space: Space, catalogues: dict[str, Any], low: np.ndarray, high: np.ndarray) -> dict[int, np.ndarray]:
    """{group: u of the values that there are}, and bounds drawn in to them."""
    problems, shelves = Problems(), {}
    owner = {leaf: i for i, group in enumerate(space.groups) for leaf in group.leaves}
    for pattern, leaves in matching(list(owner), catalogues, "tune.catalogues").items():
        values = np.sort(np.asarray(list(catalogues[pattern]), float))
        for i in dict.fromkeys(owner[leaf] for leaf in leaves):
            group, at = space.groups[i], space.ends[i]
            where = f"tune.catalogues['{group.path}']"
            if group.form.start.ndim or not len(values) or not np.isfinite(values).all() or (values <= 0).any():
                problems.add("BAD_CATALOGUE", where, f"is {values.tolist()}", value=values, limit="positive numbers, for one number")
                continue
            shelf = np.array([at_value(space, i, x)[0] for x in values])
            inside = (shelf >= low[at] - 1e-12) & (shelf <= high[at] + 1e-12)
            if not inside.any():
                problems.add("BAD_CATALOGUE", where, "has no value within the bounds", value=values, hint="Widen the bounds.")
                continue
            shelves[i] = shelf[inside]
            low[at], high[at] = min(shelf[inside].min(), 0.0), max(shelf[inside].max(), 0.0)
    problems.raise_if_any()
    return shelves


def _check_options(method: Any, starts: Any, limits: dict[str, Any], shelves: dict[int, Any]) -> None:
    problems = Problems()
    if isinstance(method, optax.GradientTransformation):
        if limits or shelves:
            problems.add("BAD_METHOD", "tune.method", "is of optax and keeps no limits", value=method, limit=" ".join(METHODS))
    elif method not in METHODS:
        problems.add("BAD_METHOD", "tune.method", f"is {method!r:.60}", value=method, limit=" ".join(METHODS) + " or an optax optimizer")
    if not isinstance(starts, int) or starts < 1:
        problems.add("BAD_STARTS", "tune.starts", f"is {starts!r}", value=starts, limit="a whole number >= 1")
    problems.raise_if_any()


def _neighbors(space: Space, best: Search, shelves: dict[int, np.ndarray]) -> list[Search]:
    """Starts at all combinations of neighbors in the catalogues; beyond a few parameters the nearer neighbor of the clearest is taken at once."""
    places = [space.ends[i].start for i in shelves]
    pairs = [shelf[np.argsort(np.abs(shelf - best.u[at]))[:2]] for at, shelf in zip(places, shelves.values(), strict=True)]
    clear = [abs(np.diff(np.abs(pair - best.u[at])).sum()) if len(pair) > 1 else np.inf for at, pair in zip(places, pairs, strict=True)]
    tried = np.argsort(clear)[:MOST_NEIGHBORS]
    choices = [pair if i in tried else pair[:1] for i, pair in enumerate(pairs)]
    searches = []
    for chosen in np.stack([x.ravel() for x in np.meshgrid(*choices, indexing="ij")], -1):
        u, low, high = best.u.copy(), best.low.copy(), best.high.copy()
        for x in (u, low, high):
            x[places] = chosen
        searches.append(Search(u, low, high))
    return searches


def _descend_all(program: Program, searches: list[Search], method: optax.GradientTransformation, steps: int, key: Any) -> None:
    """By an optax optimizer, all starts in one program; u is kept between bounds after each step."""
    U = jnp.asarray(np.stack([search.start for search in searches]))
    low, high = jnp.asarray(searches[0].low), jnp.asarray(searches[0].high)
    ends, history = _descend(program.space, program.evaluate, program.minimize, method, steps, program.key is not None, U, low, high, key)
    program.count += steps
    values, slopes = program(np.asarray(ends))
    for i, search in enumerate(searches):
        search.found(np.asarray(ends[i]), values[i], slopes[i])
        search.finite = bool(np.isfinite(values[i, program.rows.objective]))
        search.history = [(float(f), 0.0) for f in history[i]]
        search.size = abs(float(history[i, 0])) or 1.0


@eqx.filter_jit
def _descend(space: Space, evaluate: Evaluate, minimize: str, method, steps: int, stochastic: bool, U, low, high, key):
    optimizer = optax.with_extra_args_support(method)

    def one(u, key):
        def value(u, key):
            return named(evaluate(space.place(u), key) if stochastic else evaluate(space.place(u)))[minimize]

        def step(carry, key):
            u, state = carry
            f, g = jax.value_and_grad(value)(u, key)
            g = jnp.where(jnp.isfinite(g), g, 0.0)
            change, state = optimizer.update(g, state, u, value=f, grad=g, value_fn=lambda u: value(u, key))
            tried = jnp.clip(u + change, low, high)
            return (jnp.where(jnp.isfinite(tried), tried, u), state), f

        (u, _), history = jax.lax.scan(step, (u, optimizer.init(u)), jax.random.split(key, steps))
        return u, history

    return jax.vmap(one)(U, jax.random.split(key, len(U)))


def _best(rows: Rows, searches: list[Search]) -> Search:
    """Of those within limits the lowest, else the one nearest to them."""

    def rank(search: Search):
        if not search.finite:
            return 2, 0.0
        violation = rows.violation(search.values, scales(rows, search.values))
        return (0, search.values[rows.objective]) if violation <= 10 * MET else (1, violation)

    return min(searches, key=rank)


def _judged(search: Search, rows: Rows) -> tuple[int, Multipliers | None]:
    """How a search ended, by the conditions of the optimum and not by what the optimizer says."""
    if not search.finite:
        return Status.NONFINITE.value, None
    found = multipliers(search, rows)
    if rows.violation(search.values, scales(rows, search.values)) > 10 * MET:
        return Status.INFEASIBLE.value, found
    return (Status.OK.value if found.left <= ARRIVED else Status.NOT_CONVERGED.value), found


def _finish(program: Program, searches: list[Search], best: Search) -> Tuning:
    rows, space, quantities = program.rows, program.space, program.quantities
    U, values = (np.stack([getattr(search, name) for search in searches]) for name in ("u", "values"))
    codes = np.array([_judged(search, rows)[0] for search in searches])
    violation = rows.violation(values, scales(rows, best.values))
    runs = Runs(values[:, rows.objective], violation, codes, jax.vmap(space.values)(jnp.asarray(U)), quantities(values))
    status, prices = _judged(best, rows)
    told = [] if prices is None or status == Status.INFEASIBLE else _held(program, best, prices)
    u = jnp.asarray(best.u)
    return Tuning(
        space.place(u), space.values(u), quantities(program.origin), quantities(best.values), {held.name: held.price for held in told},
        tuple(map(str, told)), tuple(held.worth(program.minimize, best.values[rows.objective]) for held in told), _unmet(program, best.values),
        np.array(best.history).reshape(-1, 2), program.count, runs, np.asarray(status), space, program.minimize, program.limits,
    )  # fmt: skip


@dataclass(frozen=True)
class Held:
    """A limit or bound that holds the optimum back: d objective/d limit is its `price`."""

    name: str
    at: float
    price: float
    sign: str

    def __str__(self) -> str:
        return f"{self.name} {self.sign} {self.at:.6g}"

    def worth(self, objective: str, f: float) -> str:
        """What one percent more of the limit buys."""
        if not self.at or not f:
            return f"{self} : one unit more changes {objective} by {self.price:.3g}"
        return f"{self}: 1 % more ({0.01 * self.at:.3g}) changes {objective} by {self.price * self.at / f:+.3g} %"


def _held(program: Program, best: Search, prices: Multipliers) -> list[Held]:
    rows, space, labels = program.rows, program.space, program.labels()
    found = []
    for row, lower, upper, price in zip(rows.limited, rows.lower, rows.upper, prices.limits, strict=True):
        if price:
            sign = "=" if lower == upper else ">=" if price > 0 else "<="
            found.append(Held(labels[row], float(lower if price > 0 else upper), float(price), sign))
    numbers, slopes = space.numbers(best.u)
    for name, x, slope, price in zip(space.labels(), numbers, slopes, prices.bounds, strict=True):
        if price:
            found.append(Held(name, float(x), float(price / slope), ">=" if price > 0 else "<="))
    return found


def _unmet(program: Program, values: np.ndarray) -> tuple[str, ...]:
    """Limits that are not kept, and by how much."""
    rows, labels, told = program.rows, program.labels(), []
    for row, lower, upper, scale in zip(rows.limited, rows.lower, rows.upper, scales(rows, values), strict=True):
        x = values[row]
        if max(lower - x, x - upper) > 10 * MET * scale:
            end = lower if x < lower else upper
            told.append(f"{labels[row]} is {x:.6g}, {'below' if x < lower else 'above'} {end:.6g} by {abs(x - end):.3g}")
    return tuple(told)
