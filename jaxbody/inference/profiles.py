"""Profile likelihood: how the cost rises along one parameter while all others follow, and the interval that this gives where it is skewed.

    tau(u) = sign(u - u0) sqrt(2 (cost(u) - cost(u0))/kappa),    |tau| <= t

cost(u) is the least with that u fixed, kappa = h s^2 (curvature h of the cost, standard error s) makes tau (u - u0)/s near the optimum whatever
the noise; t is Student's. Source: D. Bates and D. Watts, Nonlinear Regression Analysis (1988), section 6.1.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import jax
import numpy as np

from jaxbody.core import tables
from jaxbody.core.errors import JaxbodyError, Problem, Status, unknown
from jaxbody.core.progress_lines import Line, working
from jaxbody.core.results import Result, warn_if_failed
from jaxbody.identification.fits import Fit
from jaxbody.identification.intervals import widening
from jaxbody.identification.least_squares import AT_BOUND, Evaluations, by_scipy
from jaxbody.identification.residuals import residual_and_jacobian
from jaxbody.parameters.transforms import Elementwise
from jaxbody.statistics.quantiles import check_level, quantile

STEPS = 4  # to the end of the interval, on each side
FARTHEST = 3.0  # times the step before that the next may be
ROBUST_STEP = 0.1  # standard errors
MOST_POINTS = 20  # on each side
MOST_EVALUATIONS = 60  # for one point
LOWER = 1e-6  # share of kappa by which a cost below that of the fit is more than rounding


class Profile(Result):
    """A profile of `path`: at its `values` the signed root of the rise of the cost `tau`, the least `cost`, and `u`, all parameters; `interval` at `level`, where |tau| is `limit`,
    Student's t of so many `degrees_of_freedom`, infinite on a side where the cost never rises enough, one-sided at a bound. `status` NOT_CONVERGED where a point was not found, or one better
    than the fit was.
    """

    path: str
    estimate: float
    level: float
    limit: float
    degrees_of_freedom: float
    values: np.ndarray
    tau: np.ndarray
    cost: np.ndarray
    u: np.ndarray
    interval: tuple[float, float]
    status: np.ndarray

    def explain(self) -> str:
        return "a lower cost than that of the fit was found; start it from there" if self.cost.min() < self.cost[self.tau == 0][0] else ""

    def _tables(self) -> list[tables.PrintedTable]:
        rows = [(float(x), float(t), float(c)) for x, t, c in zip(self.values, self.tau, self.cost, strict=True)]
        low, high = self.interval
        note = f"{100 * self.level:g} % interval {low:.6g} to {high:.6g}, estimate {self.estimate:.6g}; {self.report()}"
        note = "\n".join([note, *filter(None, [widening(self.degrees_of_freedom, self.level)])])
        return [tables.PrintedTable(f"Profile of {self.path}", ("value", "tau", "cost"), rows, note)]


def profile(fit: Fit, path: str, *, level: float = 0.95, progress: bool | None = None) -> Profile:
    """The profile of one number among the free parameters, "AB.stiffness" or "AB.a[0]", from the optimum to both ends of its interval.

    At a bound it goes to the one side that there is. progress: a line after five seconds on a terminal or in a notebook; False is silent. Errors: UNKNOWN_PATH, WRONG_KIND of what has no scale of its own, BAD_LEVEL, TRACED. Warns by status.

    >>> spring = Spring(("mass", [0, 0, 0]), ("world", [0, 0, 0]), stiffness=30.0)
    >>> model = Model(bodies={"mass": Body(mass=1.0, inertia=[1, 1, 1], position=[1, 0, 0])}, elements={"spring": spring},
    ...               joints={"mass": Guide("world", axis=[1, 0, 0])})
    >>> times, noise = jnp.linspace(0, 1, 21), 0.05 * jax.random.normal(jax.random.key(0), (21,))
    >>> track = Experiment(times, sensors={"x": Position("mass", axis=[1, 0, 0])}, measured={"x": jnp.cos(2 * jnp.pi * times) + noise})
    >>> found = profile(fit(model, {"track": track}, free=["spring.stiffness"]), "spring.stiffness")
    >>> found.interval[0] < 4 * jnp.pi**2 < found.interval[1]
    True
    """
    check_level(level, "profile.level")
    i, value = _place(fit, path)
    optimum = (np.asarray(fit.u), 0.0, float(fit.cost))
    with working("profile", progress) as line:
        walk = _Walk(fit, i, level)
        sides = [walk.to(sign, line) for sign in (-1, 1)]
    points = [*sides[0][::-1], optimum, *sides[1]]
    u, tau, cost = (np.array(x) for x in zip(*points, strict=True))
    ends = [walk.end(side, sign) for side, sign in zip(sides, (-1, 1), strict=True)]
    lower = cost.min() < float(fit.cost) - LOWER * walk.kappa
    status = np.asarray(Status.OK if walk.arrived and not lower else Status.NOT_CONVERGED)
    with np.errstate(over="ignore"):
        low, high = (value(end) for end in ends)
        values = np.array([value(x) for x in u[:, i]])
    found = Profile(path, value(fit.u[i]), level, walk.t, walk.freedom, values, tau, cost, u, (low, high), status)
    warn_if_failed(found)
    return found


def _place(fit: Fit, path: str) -> tuple[int, Any]:
    """Which u it is, and its value as a function of u."""
    fit._assessed()
    first = 0
    for f in fit.task.free:
        labels = [f.path + label for label in f.form.labels()]
        if path in labels and not isinstance(f.form, Elementwise):
            told, hint = "moves with others, not along a scale of its own", "Stiffness, damping, mass and vectors have profiles."
            raise JaxbodyError(Problem("WRONG_KIND", "profile.path", f"'{path}' {told}", path, hint=hint))
        if path in labels:
            return first + labels.index(path), partial(_value, f.form, labels.index(path))
        first += f.form.size
    known = tuple(f.path + label for f in fit.task.free for label in f.form.labels())
    found = unknown(path, "profile.path", known)
    raise JaxbodyError(Problem("UNKNOWN_PATH", "profile.path", found.message, path, hint=found.hint))


def _value(form: Elementwise, k: int, u: float) -> float:
    """The number k of a leaf, without a compiled program."""
    return float(jax.tree.map(np.asarray, form).value(np.full(form.size, u)).ravel()[k])


class _Walk:
    """Along u_i from the optimum, the others re-optimized from where the points before lead."""

    def __init__(self, fit: Fit, i: int, level: float):
        self.fit, self.i, worth = fit, i, fit._assessed()
        self.evaluate = partial(residual_and_jacobian, fit.task)
        self.limits = fit.limits or (np.full(len(fit.u), -np.inf), np.full(len(fit.u), np.inf))
        pressed = worth.pressed.get(i)
        if pressed is None:
            (self.error,), (freedom,) = worth.spread(np.eye(len(fit.u))[[i]])
            self.curvature = self._curvature()
        else:
            _, self.curvature, self.error, freedom = pressed
        self.freedom = float(freedom)
        self.t = float(quantile(level, freedom, sides=2 if pressed is None else 1))
        self.kappa = self.curvature * self.error**2 if np.isfinite(self.error) else 1.0
        self.arrived = True

    def _curvature(self) -> float:
        """Of the cost, the others that are at no bound following: Gauss and Newton's; of a robust loss, which far outliers bend the other way, by
        differences of its gradient."""
        fit, i = self.fit, self.i
        _, J, runs = self.evaluate(fit.u)
        _, J = fit.task.linearized(runs, np.asarray(J))
        others = np.all(np.abs(np.asarray(fit.u) - np.stack(self.limits)) >= AT_BOUND, axis=0) & (np.arange(len(fit.u)) != i)
        along = np.eye(len(fit.u))[i]
        along[others] = -np.linalg.lstsq(J[:, others], J[:, i], rcond=1e-9)[0]
        if fit.task.loss is None or not np.isfinite(self.error):
            return float((J @ along) @ (J @ along))
        step = ROBUST_STEP * self.error * along
        slopes = [along @ (np.asarray(J).T @ np.asarray(r)) for r, J, _ in (self.evaluate(fit.u + step), self.evaluate(fit.u - step))]
        return float(slopes[0] - slopes[1]) / (2 * ROBUST_STEP * self.error)

    def to(self, sign: int, line: Line) -> list[tuple[np.ndarray, float, float]]:
        """Points on one side, outwards, to a little beyond the end of the interval or to a bound."""
        points = [(np.asarray(self.fit.u), 0.0, float(self.fit.cost))]
        step = self.t / STEPS * (self.error if np.isfinite(self.error) else 1.0)
        bound = self.limits[0 if sign < 0 else 1][self.i]
        while len(points) <= MOST_POINTS and abs(points[-1][1]) < self.t:
            last = points[-1][0][self.i]
            if abs(last - bound) <= AT_BOUND:
                break
            u, cost = self._at(sign * min(sign * (last + sign * step), sign * bound), points)
            if u is None:
                self.arrived = False
                break
            tau = sign * np.sqrt(2 * max(cost - float(self.fit.cost), 0.0) / self.kappa)
            rise = abs(tau) - abs(points[-1][1])
            step *= min(FARTHEST, self.t / STEPS / rise) if rise > 0 else FARTHEST
            points.append((u, tau, cost))
            line(f"point {len(points) - 1} {'below' if sign < 0 else 'above'} the estimate, tau {tau:.3g} of {sign * self.t:.3g}")
        return points[1:]

    def _at(self, x: float, points) -> tuple[np.ndarray | None, float]:
        """The optimum with u_i = x; none where no trial could be simulated."""
        rest = np.arange(len(points[-1][0])) != self.i
        start = points[-1][0].copy()
        if len(points) > 1:
            before, now = points[-2][0], points[-1][0]
            start = now + (now - before) * (x - now[self.i]) / (now[self.i] - before[self.i])
        start[self.i] = x
        low, high = (limit[rest] for limit in self.limits)
        start[rest] = np.clip(start[rest], low, high)

        def function(v):
            u = start.copy()
            u[rest] = v
            r, J, _ = self.evaluate(u)
            return r, np.asarray(J)[:, rest], None

        evaluate = Evaluations(function, MOST_EVALUATIONS)
        r, _ = evaluate(start[rest])
        if not np.isfinite(r).all():
            return None, np.inf
        u = start.copy()
        if rest.any():
            u[rest], arrived = by_scipy(evaluate, start[rest], (low, high))
            self.arrived &= bool(arrived)
        r, _ = evaluate(u[rest])
        return u, 0.5 * float(r @ r)

    def end(self, side: list, sign: int) -> float:
        """u_i where |tau| reaches t, by a monotone cubic through the points; the bound, or infinite, where it never does."""
        from scipy.interpolate import PchipInterpolator

        here = float(self.fit.u[self.i])
        x, tau = np.array([here, *(u[self.i] for u, _, _ in side)]), np.abs([0.0, *(t for _, t, _ in side)])
        up = np.concatenate([[True], np.diff(np.maximum.accumulate(tau)) > 0])
        if tau[-1] >= self.t:
            return float(PchipInterpolator(tau[up], x[up])(self.t))
        bound = float(self.limits[0 if sign < 0 else 1][self.i])
        return bound if abs(x[-1] - bound) <= AT_BOUND else sign * np.inf
