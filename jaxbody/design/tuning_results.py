"""Result of a tuning: parameters and quantities before and after, active constraints and their
shadow prices, and kinks, at which derivatives jump.

jump = [g(h) - g(-h)] - [g(2 h) - g(h)] - [g(-h) - g(-2 h)],
g a derivative: of the order of h^3 where it is smooth
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxbody.core import tables
from jaxbody.core.arrays import Array, Float, Int, device_array, indices
from jaxbody.core.compilation.compile_options import program
from jaxbody.core.errors import Status
from jaxbody.core.results import Labeled, Result, dataset
from jaxbody.design.design_programs import (
    NamedLimits,
    Program,
    Quantities,
    labels_of,
    variables_over,
)
from jaxbody.design.searches import ACTIVE, CONVERGED, MET, Multipliers, Search, multipliers
from jaxbody.fitting.experiments.measurements import Measurement
from jaxbody.fitting.parameters.spaces import Space, model_of
from jaxbody.fitting.parameters.transforms import Positive
from jaxbody.mechanics.equilibria import equilibrium_of
from jaxbody.model.models import Model, size_of
from jaxbody.suspension.suspensions import Suspension

OFFSETS = np.array([-2.0, -1.0, 1.0, 2.0])
NEAR = 1e-3  # h in u
CLOSE = 1e-4  # h of a deformation, relative to the size of the model
SUDDEN = 0.1  # smallest ratio of a jump to the derivative


def discontinuous(g: np.ndarray) -> np.ndarray:
    """Return whether a derivative jumps, from its values g at the four OFFSETS, along the first
    axis."""
    return np.isfinite(g).all(0) & (
        np.abs((g[2] - g[1]) - (g[3] - g[2]) - (g[1] - g[0])) > SUDDEN * np.abs(g).max(0)
    )


def jumping(
    slopes_at: Callable[[np.ndarray], np.ndarray], u: np.ndarray, along: np.ndarray
) -> np.ndarray:
    """Return which rows of the derivatives slopes_at(u) (m, n) jump near u along a direction."""
    size = np.linalg.norm(along)
    if not size:
        return np.zeros(0, bool)
    direction = along / size
    return discontinuous(
        np.stack([slopes_at(u + NEAR * offset * direction) @ direction for offset in OFFSETS])
    )


def at_kinks(model: Model) -> list[str]:
    """Return the names of the elements whose stiffness V''(e), or its derivative, jumps at the
    equilibrium, such as a stop that just touches."""
    status, slopes = _near_rest(model)
    if int(status) not in (Status.OK, Status.UNSTABLE, Status.SINGULAR_K):
        return []
    names = []
    for table, both in zip(model.elements, slopes, strict=True):
        jumps = [discontinuous(np.asarray(g).T) for g in both]
        names += [name for i, name in enumerate(table.names) if any(jump[i] for jump in jumps)]
    return names


@program
def _near_rest(model: Model):
    """Return the status of the equilibrium, and V'' and V''' near it for elements with one
    deformation."""
    eq = equilibrium_of(model, None, 200, None)
    steps = CLOSE * size_of(model) * OFFSETS

    def slopes(element, e):
        second = jax.grad(jax.grad(element.energy))
        return tuple(jax.vmap(f)(e + steps) for f in (second, jax.grad(second)))

    pairs = zip(model.elements, eq.deformations, strict=True)
    return eq.status, tuple(
        jax.vmap(slopes)(table.rows, e) if jnp.ndim(e) == 1 else () for table, e in pairs
    )


DUST = 1e-12  # values below this, relative to the value before, print as zero
FAR = 12.0  # distance in u, a factor of 160 000, that shows a parameter to be unbounded
BOUND, CHOSEN, UNBOUNDED = "at its bound", "from its catalogue", "unbounded"


class Runs(eqx.Module):
    """Results of all starts: `objective`, `violation` (the largest, relative to its limit),
    `status`, `values` {path: (n, ...)} and `quantities` {name: (n, ...)}."""

    objective: Float[np.ndarray, "n"]
    violation: Float[np.ndarray, "n"]
    status: Int[np.ndarray, "n"]
    values: dict[str, Array]
    quantities: Quantities


class Tuning(Labeled, Result):
    """A tuned design. `model`, `suspension` and `plans` if they were tuned; `values` {path: value};
    quantities `before` and `after` {name: value}; `active` constraints as text; `multipliers`
    {limited quantity or parameter at its bound: shadow price, d objective/d limit}; `words`, the
    effect of one percent more of each limit; `history` (evaluations, 2) of the objective and the
    violation of limits; `evaluations`; all starts in `runs`; `places` {parameter: "at its bound",
    "from its catalogue" or "unbounded"}; `units` {quantity: its SI unit}, of designs in files.
    `status` is INFEASIBLE if limits are violated, listed in
    `unmet`, or NOT_CONVERGED, with a `remedy`.

    >>> import inspect
    >>> inspect.signature(jb.tune).return_annotation.__name__  # tune returns one
    'Tuning'
    """

    index = "start"
    model: Model
    plans: dict[str, Measurement]
    values: dict[str, Array]
    before: Quantities
    after: Quantities
    multipliers: dict[str, float]
    active: tuple[str, ...]
    words: tuple[str, ...]
    places: dict[str, str] = eqx.field(static=True)
    units: dict[str, str] = eqx.field(static=True)
    unmet: tuple[str, ...]
    history: Float[np.ndarray, "k 2"]
    evaluations: int
    runs: Runs
    status: Int[np.ndarray, ""]
    space: Space
    minimize: str = eqx.field(static=True)
    limits: NamedLimits = eqx.field(static=True)
    remedy: str = eqx.field(static=True)
    suspension: Suspension | None = None

    def explain(self) -> str:
        if int(self.status) == Status.INFEASIBLE:
            return "with the smallest violation of the limits, " + "; ".join(self.unmet)
        if int(self.status) == Status.NOT_CONVERGED:
            unbounded = [name for name, where in self.places.items() if where == UNBOUNDED]
            if unbounded:
                return (
                    f"{', '.join(unbounded)} changed by more than a factor of {np.exp(FAR):.0f} "
                    "without reaching a limit; add bounds or limits"
                )
            return f"after {self.evaluations} evaluations; the best iterate is kept; {self.remedy}"
        return ""

    def to_xarray(self) -> Any:
        """Return an xarray.Dataset over `start` with objective, violation, status, and all
        quantities and parameters."""
        runs = self.runs
        variables = {
            **runs.values,
            **runs.quantities,
            "objective": runs.objective,
            "violation": runs.violation,
            "status": runs.status,
        }
        return dataset(
            variables_over(("start",), variables),
            {"start": np.arange(len(runs.status))},
            f"design with the least {self.minimize}",
        )

    def _tables(self) -> list[tables.PrintedTable]:
        rows = []
        for parameter in self.space.parameters:
            numbers = _each(
                parameter.path, parameter.name(2), parameter.form.start, self.values[parameter.path]
            )
            units = self.space.units(parameter)
            rows += [
                (label, *pair, unit, self.places.get(name, ""))
                for (name, label, *pair), unit in zip(numbers, units, strict=True)
            ]
        quantities = [
            (label, *pair, self.units.get(name, ""), _limit(self.limits.get(name)))
            for name, before in self.before.items()
            for _, label, *pair in _each(name, name, before, self.after[name])
        ]
        objective = self.units.get(self.minimize, "")
        prices = [
            (label, self.multipliers[label], f"{objective} per {unit}" if unit else objective)
            for label, *_, unit, _ in quantities
            if label in self.multipliers
        ]
        note = "\n".join(
            [
                *self.words,
                (
                    f"{self.evaluations} evaluations, best of {len(self.runs.status)} "
                    f"starts; {self.report()}"
                ),
            ]
        )
        tail = [
            tables.PrintedTable("", ("quantity", "before", "after", "unit", "limit"), quantities),
            tables.PrintedTable(
                "", ("limit", f"{self.minimize} per unit of the limit", "unit"), prices
            ),
        ][: 1 + bool(prices)]
        tail[-1].note = note
        return [
            tables.PrintedTable(
                f"Design that minimizes {self.minimize}",
                ("parameter", "before", "after", "unit", ""),
                rows,
            ),
            *tail,
        ]


def _each(path: str, label: str, before: Any, after: Any) -> list[tuple[str, str, float, float]]:
    """Return (path, label, before, after) for each number of a scalar or an array."""
    before, after = np.asarray(before), np.asarray(after)
    after = np.where(np.abs(after) < DUST * np.abs(before), 0.0, after)
    return [
        (path + i, label + i, float(a), float(b))
        for i, a, b in zip(indices(before.shape), before.ravel(), after.ravel(), strict=True)
    ]


def _limit(limit: tuple[float, float] | None) -> str:
    if limit is None:
        return ""
    lower, upper = limit
    if lower == upper:
        return f"= {lower:.6g}"
    return (
        f"<= {upper:.6g}"
        if lower == -np.inf
        else f">= {lower:.6g}"
        if upper == np.inf
        else f"{lower:.6g} to {upper:.6g}"
    )


def _places(space: Space, search: Search) -> dict[str, str]:
    """Return {parameter: "at its bound", "from its catalogue" or "unbounded"} for the parameters to
    which one of these applies. The step "x[2] - [1]" of an increasing row is named "x[2]"."""
    at = np.minimum(np.abs(search.u - search.low), np.abs(search.u - search.high)) <= ACTIVE
    positive = np.concatenate(
        [
            np.full(parameter.form.size, isinstance(parameter.form, Positive))
            for parameter in space.parameters
        ]
    )
    far = (np.abs(search.u) > FAR) & np.isinf(np.where(search.u < 0, search.low, search.high))
    words = np.select(
        [
            search.low == search.high,
            at | (far & (space.ended(search.u) != "") & ~positive),
            far & positive,
        ],
        [CHOSEN, BOUND, UNBOUNDED],
        "",
    )
    return {
        name.partition(" - [")[0]: str(word)
        for name, word in zip(space.labels, words, strict=True)
        if word
    }


def _status_and_multipliers(search: Search, space: Space) -> tuple[int, Multipliers | None]:
    """Return the status of a search and its multipliers, by the conditions of optimality rather
    than the optimizer's own report."""
    if not search.finite:
        return Status.NONFINITE.value, None
    lambdas = multipliers(search)
    if search.own_violation > 10 * MET:
        return Status.INFEASIBLE.value, lambdas
    converged = lambdas.remaining <= CONVERGED and UNBOUNDED not in _places(space, search).values()
    return (Status.OK.value if converged else Status.NOT_CONVERGED.value), lambdas


def _remedy(program: Program, best: Search, iterations: int, model: Model) -> str:
    """Return advice for a search that has not converged: bounds if a derivative jumps at its end,
    more iterations if it has used all, otherwise more starts or another method."""
    rows, labels = program.rows, labels_of(program.shapes)
    along = np.where(best.low < best.high, best.slopes[rows.objective], 0.0)
    jumps = jumping(
        lambda u: program(np.clip(u, best.low, best.high))[1][rows.requested], best.u, along
    )
    if jumps.any():
        names = ", ".join(
            dict.fromkeys(labels[i] for i, jump in zip(rows.requested, jumps, strict=True) if jump)
        )
        stops = [f"'{name}'" for name in at_kinks(model)]
        cause = (
            (
                f", because {', '.join(stops)} rests at a kink of its law, like a "
                "stop that just touches"
            )
            if stops
            else ""
        )
        return (
            f"derivatives of {names} jump there{cause}; this may be the optimum: check with bounds "
            "that exclude one side of the kink"
        )
    if best.iterations >= iterations:
        return "increase max_iterations"
    return (
        f"no further step improved the design, after {best.iterations} of {iterations} iterations; "
        "try more starts or another method"
    )


def tuning_of(
    program: Program, searches: list[Search], best: Search, before: np.ndarray, iterations: int
) -> Tuning:
    """Return the result of the searches from all starts.

    Args:
        program: the quantities and their derivatives.
        searches: all searches, after they have ended.
        best: the best of them.
        before: values at the first start.
        iterations: the largest number that each was allowed.
    """
    rows, space, quantities = program.rows, program.space, program.quantities
    U, values = (
        np.stack([getattr(search, name) for search in searches]) for name in ("u", "values")
    )
    design, plans, values_of, values_of_runs = placed(space, device_array(best.u), device_array(U))
    status, prices = _status_and_multipliers(best, space)
    constraints = (
        []
        if prices is None or status == Status.INFEASIBLE
        else _active_constraints(program, best, prices)
    )
    return Tuning(
        model=model_of(design),
        suspension=design if isinstance(design, Suspension) else None,
        plans=plans,
        values=values_of,
        before=quantities(before),
        after=quantities(best.values),
        multipliers={constraint.name: constraint.price for constraint in constraints},
        active=tuple(map(str, constraints)),
        words=tuple(
            constraint.effect(program.minimize, best.objective) for constraint in constraints
        ),
        places=_places(space, best),
        units=getattr(program.evaluate, "units", {}),
        unmet=_unmet(program, best.values),
        history=np.array(best.history).reshape(-1, 2),
        evaluations=program.count,
        runs=Runs(
            objective=values[:, rows.objective],
            violation=rows.violation(values, rows.scale(best.values)),
            status=np.array([_status_and_multipliers(search, space)[0] for search in searches]),
            values=values_of_runs,
            quantities=quantities(values),
        ),
        status=np.asarray(status),
        space=space,
        minimize=program.minimize,
        limits=program.limits,
        remedy=_remedy(program, best, iterations, model_of(design))
        if status == Status.NOT_CONVERGED
        else "",
    )


@program
def placed(space: Space, u: Float[Array, "n"], U: Float[Array, "b n"]):
    """Return the design and the plans at u and their parameter values, and the parameter values at
    each of U."""
    return *space.designed(u), space.values(u), jax.vmap(space.values)(U)


@dataclass(frozen=True)
class ActiveConstraint:
    """An active limit or bound with its shadow `price`, d objective/d limit."""

    name: str
    at: float
    price: float
    sign: str
    unit: str

    def __str__(self) -> str:
        return f"{self.name} {self.sign} {self.at:.6g} {self.unit}".rstrip()

    def effect(self, objective: str, f: float) -> str:
        """Return the effect of one percent more of the limit, as text."""
        if not self.at or not f:
            return f"{self}: one unit more changes {objective} by {self.price:.3g}"
        return (
            f"{self}: 1 % more ({0.01 * self.at:.3g}) changes {objective} by "
            f"{self.price * self.at / f:+.3g} %"
        )


def _active_constraints(
    program: Program, best: Search, prices: Multipliers
) -> list[ActiveConstraint]:
    rows, space, labels = program.rows, program.space, labels_of(program.shapes)
    units, constraints = getattr(program.evaluate, "units", {}), []
    for row, lower, upper, price in zip(
        rows.limited, rows.lower, rows.upper, prices.limits, strict=True
    ):
        if price:
            constraints.append(
                ActiveConstraint(
                    labels[row],
                    float(lower if price > 0 else upper),
                    float(price),
                    "=" if lower == upper else ">=" if price > 0 else "<=",
                    units.get(labels[row].partition("[")[0], ""),
                )
            )
    numbers, slopes = space.numbers(best.u)
    of_space = []
    for parameter in space.parameters:  # an inertia or a quaternion has fewer u than numbers
        each, count = space.units(parameter), len(parameter.form.labels())
        of_space += each if len(each) == count else [""] * count
    chosen = best.low == best.high
    for i, (x, slope, price) in enumerate(zip(numbers, slopes, prices.bounds, strict=True)):
        if price and not chosen[i]:
            sign = ">=" if price > 0 else "<="
            constraints.append(
                ActiveConstraint(space.labels[i], float(x), float(price / slope), sign, of_space[i])
            )
    return constraints


def _unmet(program: Program, values: np.ndarray) -> tuple[str, ...]:
    """Return which limits are violated and by how much, as text."""
    rows, labels, messages = program.rows, labels_of(program.shapes), []
    for row, lower, upper, scale in zip(
        rows.limited, rows.lower, rows.upper, rows.scale(values), strict=True
    ):
        x = values[row]
        if max(lower - x, x - upper) > 10 * MET * scale:
            end = lower if x < lower else upper
            messages.append(
                f"{labels[row]} is {x:.6g}, {'below' if x < lower else 'above'} {end:.6g} "
                f"by {abs(x - end):.3g}"
            )
    return tuple(messages)
