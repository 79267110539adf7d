"""Profile likelihood: the least cost as a function of one parameter, and the confidence interval
from it, which may be skewed.

    tau(u) = sign(u - u0) sqrt(2 (cost(u) - cost(u0))/kappa),    |tau| <= t

u is the transformed parameter, u0 its estimate, and cost(u) the least cost with this u fixed. With
kappa = h s^2, where h is the curvature of the cost and s the standard error, tau is (u - u0)/s near
the optimum for any noise model. t is the quantile of Student's t.
Source: D. Bates and D. Watts, Nonlinear Regression Analysis (1988), section 6.1.
"""

from functools import partial
from typing import Any

import numpy as np

from jaxbody.core import tables
from jaxbody.core.errors import JaxbodyError, Problem, Status, unknown
from jaxbody.core.progress_lines import Line, working
from jaxbody.core.results import Result, warn_if_failed
from jaxbody.fitting.fit_results import Fit, widening
from jaxbody.fitting.parameters.transforms import Elementwise
from jaxbody.fitting.residuals import residual_and_jacobian
from jaxbody.fitting.searches import AT_BOUND, Evaluations, by_scipy
from jaxbody.fitting.statistics.uncertainties import check_level, quantile

STEPS = 4  # intended number of steps from the optimum to each end of the interval
GROWTH = 3.0  # largest ratio of a step to the one before
ROBUST_STEP = 0.1  # step of differences for the curvature of a robust loss, in standard errors
MAX_POINTS = 20  # on each side
MAX_EVALUATIONS = 60  # for one point
# decrease of the cost below that of the fit, relative to kappa, above which it is not round-off
LOWER = 1e-6


class Profile(Result):
    """The profile likelihood of the parameter `path`.

    At each of the `values`: `tau`, the signed root of the increase of the cost; the least `cost`;
    and `u`, all parameters. The `interval` at `level` ends where |tau| is `limit`, the quantile of
    Student's t for the `degrees_of_freedom`; it is infinite on a side where the cost does not
    increase enough, and one-sided at a bound. `status` is NOT_CONVERGED if the search for a point
    did not converge or its cost is lower than that of the fit."""

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
    unit: str = ""  # of the parameter

    def explain(self) -> str:
        return (
            "the cost is lower at a point of the profile than at the fit; fit again from there"
            if self.cost.min() < self.cost[self.tau == 0][0]
            else ""
        )

    def _tables(self) -> list[tables.PrintedTable]:
        rows = [
            (float(x), float(t), float(c))
            for x, t, c in zip(self.values, self.tau, self.cost, strict=True)
        ]
        low, high = self.interval
        notes = [
            f"{100 * self.level:g} % interval {low:.6g} to {high:.6g}, estimate "
            f"{self.estimate:.6g}; {self.report()}",
            *filter(None, [widening(self.degrees_of_freedom, self.level)]),
        ]
        heads = (f"value [{self.unit}]" if self.unit else "value", "tau", "cost")
        return [tables.PrintedTable(f"Profile of {self.path}", heads, rows, "\n".join(notes))]


def profile_likelihood(
    fit: Fit, path: str, *, level: float = 0.95, progress: bool | None = None
) -> Profile:
    """Compute the profile of one free parameter, from the optimum to both ends of its confidence
    interval.

    Args:
        fit: the result of `fit`.
        path: path of a scalar, "AB.stiffness", or of one number of a vector, "AB.a[0]".
        level: confidence level of the interval.
        progress: None shows progress on a terminal or in a notebook after five seconds, False
            is silent.

    For a parameter at its bound the profile has one side. Errors: UNKNOWN_PATH, WRONG_KIND for a
    number that does not vary independently of others, as in a matrix or a direction, BAD_LEVEL,
    TRACED. Warns NOT_CONVERGED.

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
    >>> result = jb.fitting.profile_likelihood(
    ...     jb.fit(model, {"track": track}, free=["spring.stiffness"]), "spring.stiffness"
    ... )
    >>> result.interval[0] < 4 * jnp.pi**2 < result.interval[1]
    True
    """
    check_level(level, "profile_likelihood.level")
    i, value, unit = _place(fit, path)
    with working("profile_likelihood", progress) as line:
        search = _ProfileSearch(fit, i, level)
        sides = [search.points(sign, line) for sign in (-1, 1)]
    points = [*sides[0][::-1], (np.asarray(fit.u), 0.0, float(fit.cost)), *sides[1]]
    u, tau, cost = (np.array(x) for x in zip(*points, strict=True))
    converged = search.converged and cost.min() >= float(fit.cost) - LOWER * search.kappa
    with np.errstate(over="ignore"):
        low, high = (
            value(search.end(side, sign)) for side, sign in zip(sides, (-1, 1), strict=True)
        )
        values = np.array([value(x) for x in u[:, i]])
    return warn_if_failed(
        Profile(
            path=path,
            estimate=value(fit.u[i]),
            level=level,
            limit=search.t,
            degrees_of_freedom=search.freedom,
            values=values,
            tau=tau,
            cost=cost,
            u=u,
            interval=(low, high),
            status=np.asarray(Status.OK if converged else Status.NOT_CONVERGED),
            unit=unit,
        )
    )


def _place(fit: Fit, path: str) -> tuple[int, Any, str]:
    """Return the index of the parameter in u, its value as a function of that u, and its unit.
    Errors: UNKNOWN_PATH, WRONG_KIND."""
    fit._assessed()
    for parameter, part in fit.task.space.parts:
        labels = [parameter.path + label for label in parameter.form.labels()]
        if path in labels and not isinstance(parameter.form, Elementwise):
            raise JaxbodyError(
                Problem(
                    "WRONG_KIND",
                    "profile_likelihood.path",
                    f"'{path}' does not vary independently",
                    path,
                    hint="Give a scalar, such as a stiffness, or a number of a vector.",
                )
            )
        if path in labels:
            number = labels.index(path)
            return (
                part.start + number,
                partial(_value, parameter.form, number),
                fit.task.space.units(parameter)[number],
            )
    problem = unknown(path, "profile_likelihood.path", tuple(fit.task.space.labels))
    raise JaxbodyError(
        Problem("UNKNOWN_PATH", "profile_likelihood.path", problem.message, path, hint=problem.hint)
    )


def _value(form, k: int, u) -> float:
    """Return number k of a parameter whose transformed variables all have the value u, without
    compiling a program."""
    return float(form.numbers(np.full(form.size, u))[0][k])


class _ProfileSearch:
    """Search for points of the profile at increasing distances of u_i from its optimum. At each
    point, the search for the other parameters starts from an extrapolation of the last two."""

    def __init__(self, fit: Fit, i: int, level: float):
        self.fit, self.i, uncertainty = fit, i, fit._assessed()
        self.evaluate = partial(residual_and_jacobian, fit.task)
        self.limits = fit.task.space.bounds
        at_bound = uncertainty.at_bounds.get(i)
        if at_bound is None:
            (self.error,), (freedom,) = uncertainty.spread(np.eye(len(fit.u))[[i]])
            self.curvature = self._curvature()
        else:
            _, self.curvature, self.error, freedom = at_bound
        self.freedom = float(freedom)
        self.t = float(quantile(level, freedom, sides=2 if at_bound is None else 1))
        self.kappa = self.curvature * self.error**2 if np.isfinite(self.error) else 1.0
        self.converged = True

    def _curvature(self) -> float:
        """Return the curvature of the cost along u_i, with the parameters inside their bounds
        adjusted: by Gauss-Newton; for a robust loss, whose curvature outliers reduce, by
        differences of the gradient."""
        fit, i = self.fit, self.i
        _, J, runs = self.evaluate(fit.u)
        _, J = fit.task.linearized(runs, np.asarray(J))
        others = np.all(np.abs(np.asarray(fit.u) - np.stack(self.limits)) >= AT_BOUND, axis=0) & (
            np.arange(len(fit.u)) != i
        )
        along = np.eye(len(fit.u))[i]
        along[others] = -np.linalg.lstsq(J[:, others], J[:, i], rcond=1e-9)[0]
        if fit.task.loss is None or not np.isfinite(self.error):
            return float((J @ along) @ (J @ along))
        step = ROBUST_STEP * self.error * along
        slopes = [
            along @ (np.asarray(J).T @ np.asarray(r))
            for r, J, _ in (self.evaluate(fit.u + step), self.evaluate(fit.u - step))
        ]
        return float(slopes[0] - slopes[1]) / (2 * ROBUST_STEP * self.error)

    def points(self, sign: int, line: Line) -> list[tuple[np.ndarray, float, float]]:
        """Return (u, tau, cost) of points on one side, from the optimum to just beyond the end of
        the interval or to a bound."""
        points = [(np.asarray(self.fit.u), 0.0, float(self.fit.cost))]
        step = self.t / STEPS * (self.error if np.isfinite(self.error) else 1.0)
        bound = self.limits[0 if sign < 0 else 1][self.i]
        while len(points) <= MAX_POINTS and abs(points[-1][1]) < self.t:
            last = points[-1][0][self.i]
            if abs(last - bound) <= AT_BOUND:
                break
            u, cost = self._at(sign * min(sign * (last + sign * step), sign * bound), points)
            if u is None:
                self.converged = False
                break
            tau = sign * np.sqrt(2 * max(cost - float(self.fit.cost), 0.0) / self.kappa)
            rise = abs(tau) - abs(points[-1][1])
            step *= min(GROWTH, self.t / STEPS / rise) if rise > 0 else GROWTH
            points.append((u, tau, cost))
            line(
                f"point {len(points) - 1} {'below' if sign < 0 else 'above'} the estimate, tau "
                f"{tau:.3g} of {sign * self.t:.3g}"
            )
        return points[1:]

    def _at(self, x: float, points) -> tuple[np.ndarray | None, float]:
        """Return u and cost of the optimum with u_i = x; None if the model cannot be simulated at
        the initial guess."""
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

        evaluate = Evaluations(function, MAX_EVALUATIONS)
        r = evaluate(start[rest])[0]
        if not np.isfinite(r).all():
            return None, np.inf
        u = start.copy()
        if rest.any():
            u[rest], converged = by_scipy(evaluate, start[rest], (low, high))
            self.converged &= bool(converged)
        r = evaluate(u[rest])[0]
        return u, 0.5 * float(r @ r)

    def end(self, side: list, sign: int) -> float:
        """Return u_i where |tau| is t, by monotone cubic interpolation; if |tau| stays below t, the
        bound or infinity."""
        from scipy.interpolate import PchipInterpolator

        optimum = float(self.fit.u[self.i])
        x, tau = (
            np.array([optimum, *(u[self.i] for u, _, _ in side)]),
            np.abs([0.0, *(t for _, t, _ in side)]),
        )
        increasing = np.concatenate([[True], np.diff(np.maximum.accumulate(tau)) > 0])
        if tau[-1] >= self.t:
            return float(PchipInterpolator(tau[increasing], x[increasing])(self.t))
        bound = float(self.limits[0 if sign < 0 else 1][self.i])
        return bound if abs(x[-1] - bound) <= AT_BOUND else sign * np.inf
