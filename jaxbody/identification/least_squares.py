"""Searches for the least sum of squares of any residual r(u) with its Jacobian, by SciPy, or by an optax optimizer in whitened coordinates.

An optax optimizer works on coordinates y whitened by the Jacobian, J = U S V', u = u_k + V S^-1 |U'r| y, in which the linearized optimum lies
one unit away, and is restarted from where it got to until the Gauss-Newton step says that it has arrived.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax

from jaxbody.statistics.uncertainties import known_directions

WORTH = 0.01  # share of the expected fall of the cost that is worth having
FLAT = 0.02  # slope, relative to the first, at which coordinates are whitened anew
ENOUGH = 0.75  # share of the fall expected one unit away, after which coordinates are whitened anew
NEAR = 1e-4  # largest Gauss-Newton step in u from where such steps finish
FARTHEST = 0.7  # how far in u the unit of y may lead: a factor of two in what is positive
MOST_RESTARTS = 100
MOST_INNER = 80
PATIENCE = 25  # evaluations without a better one
SETTLED = 1e-9  # part of the residual that parameters still explain, relative to all of it, not worth another evaluation
SHORTER = 0.9  # part of a Gauss-Newton step that the next one may have
REMEMBERED = 3  # steps that the next one learns from
ROWS = 512  # of a block whose triangle is made first
AT_BOUND = 1e-6  # distance in u from a bound that counts as at it

Bounds = tuple[np.ndarray, np.ndarray]


class Evaluations:
    """Residual and Jacobian of `function(u)` -> (r, J, more), counted, and never raising: a trial that fails has a residual of NaN.

    `floor`: the norm of a column of J that is round-off. `best`: the u of the least cost so far, also given to `better`; `line` is told each in words."""

    def __init__(
        self,
        function: Callable,
        most: int,
        *,
        floor: float = 0.0,
        progress: bool | None = False,
        better: Callable = lambda u: None,
        line: Callable[[str], None] = lambda words: None,
    ):
        self.function, self.most, self.floor, self.progress, self.better, self.line = function, most, floor, progress, better, line
        self.count, self.failed, self.history, self.best, self._least, self._last, self._turned = 0, 0, [], None, np.inf, None, None
        self.rounds: list[int] = []  # counts at which another function began

    def __call__(self, u) -> tuple[np.ndarray, np.ndarray]:
        return self._at(u)[:2]

    def triangle(self, u) -> tuple[np.ndarray, np.ndarray]:
        """(r, J) turned into as few rows as they have columns: lengths and angles of r and the columns of J stay, which is all that Gauss-Newton
        steps, costs and gradients at one u ask for."""
        found = self._at(u)
        if self._turned is None or self._turned[0] is not found:
            self._turned = (found, triangle(*found[:2]))
        return self._turned[1]

    def more(self, u) -> Any:
        return self._at(u)[2]

    def renew(self, function: Callable, floor: float) -> None:
        """Go on with another function."""
        self.rounds.append(self.count)
        self.function, self.floor, self.best, self._least, self._last = function, floor, None, np.inf, None

    def _at(self, u) -> tuple[np.ndarray, np.ndarray, Any]:
        key = np.asarray(u).tobytes()
        if self._last is not None and self._last[0] == key:
            return self._last[1]
        with jax.disable_jit(False):
            r, J, more = self.function(jnp.asarray(u))
        r, J = np.asarray(r), np.asarray(J)
        J = np.where(np.linalg.norm(J, axis=0) <= self.floor, 0.0, J)  # a search would follow round-off anywhere
        bad = not (np.isfinite(r).all() and np.isfinite(J).all())
        r = np.full_like(r, np.nan) if bad else r
        cost = float(0.5 * r @ r)
        self.count, self.failed = self.count + 1, self.failed + bad
        self.history.append(cost)
        if cost < self._least:
            self.best, self._least = np.asarray(u), cost
            self.better(self.best)
        words = f"evaluation {self.count}: " + ("failed" if bad else f"cost {cost:.9g}")
        if self.progress:
            print(words, flush=True)
        self.line(words)
        self._last = (key, (r, J, more))
        return r, J, more

    @property
    def spent(self) -> bool:
        return self.count >= self.most


def triangle(r: np.ndarray, J: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The last column of T, and those before it, of [J r] = Q T; first by blocks of rows, which stay in a cache."""
    T = np.concatenate([J, r[:, None]], 1)
    n, whole = T.shape[1], len(r) // ROWS * ROWS
    if len(T) < 4 * n:
        return r, J
    if not np.isfinite(T).all():
        return np.full(n, np.nan), np.full((n, n - 1), np.nan)
    blocks = np.reshape(np.linalg.qr(T[:whole].reshape(-1, ROWS, n), mode="r"), (-1, n))
    T = np.asarray(np.linalg.qr(np.concatenate([blocks, T[whole:]]), mode="r"))
    return T[:, -1], T[:, :-1]


class _Near(Exception):
    """The Gauss-Newton step from u is so short that it may finish the search."""

    def __init__(self, u: np.ndarray):
        self.u = u


def by_scipy(evaluate: Evaluations, u, limits: Bounds) -> tuple[np.ndarray, bool]:
    """Bounded least squares, to where Gauss-Newton steps finish; it takes a residual of NaN for a step too far."""
    from scipy.optimize import least_squares

    left = max(evaluate.most - evaluate.count, 1)
    size = np.linalg.norm(evaluate(u)[0]) or 1.0  # so that its first region of trust is one of u, not of noise

    def jacobian(u):
        towards, S, V = _whitened(evaluate.triangle(u))
        if np.abs(V @ (towards / S)).max(initial=0.0) <= NEAR and (limits[0] < u).all() and (u < limits[1]).all():
            raise _Near(u)
        return evaluate.triangle(u)[1] / size

    try:
        found = least_squares(lambda u: evaluate.triangle(u)[0] / size, np.asarray(u), jacobian, limits, x_scale="jac", xtol=1e-11, ftol=1e-15, gtol=1e-15, max_nfev=left)  # fmt: skip
    except _Near as near:
        return settled(evaluate, near.u, True, limits)
    return settled(evaluate, found.x, found.status > 0, limits)


def settled(evaluate: Evaluations, u, arrived: bool, limits: Bounds) -> tuple[np.ndarray, bool]:
    """Gauss-Newton steps from where costs, rough by the tolerance of the integration, tell no difference, as long as they get shorter."""
    u = np.asarray(u)
    inside = np.all(np.abs(u - np.stack(limits)) > AT_BOUND, axis=0)
    towards, S, V = _whitened(evaluate.triangle(u), inside)
    taken: list[tuple[np.ndarray, np.ndarray]] = []
    while arrived and np.linalg.norm(towards) > SETTLED * np.linalg.norm(evaluate(u)[0]) and not evaluate.spent:
        new = u.copy()
        taken = [*taken[-REMEMBERED:], (u[inside], -V @ (towards / S))]
        new[inside] = _accelerated(taken)
        before, (towards, S, V) = np.linalg.norm(towards), _whitened(evaluate.triangle(new), inside)
        if not np.linalg.norm(towards) < SHORTER * before or (new < limits[0]).any() or (new > limits[1]).any():
            break
        u = new
    return u, arrived


def _accelerated(taken: list[tuple[np.ndarray, np.ndarray]]) -> np.ndarray:
    """Where the last step leads, by what steps before it changed: where residuals are large, Gauss-Newton steps shrink by a factor each.

    u + d - (dU + dD) c, c the least squares of d - dD c (D. G. Anderson, J. ACM 12 (1965) 547)"""
    u, d = taken[-1]
    if len(taken) == 1:
        return u + d
    U, D = (np.array([b - a for a, b in pairwise(x)]).T for x in zip(*taken, strict=True))
    return u + d - (U + D) @ np.linalg.lstsq(D, d, rcond=1e-6)[0]


def _whitened(found: tuple[np.ndarray, np.ndarray], columns=slice(None)) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """U'r, S and V of J = U S V', without directions that the data do not know: the Gauss-Newton step is -V S^-1 U'r."""
    r, J = found
    if not np.isfinite(r).all():
        return np.array([np.inf]), np.ones(1), np.zeros((J[:, columns].shape[1], 1))
    U, S, Vt = np.linalg.svd(J[:, columns], full_matrices=False)
    known = known_directions(S)
    return (U.T @ r)[known], S[known], Vt[known].T


def by_optax(evaluate: Evaluations, u, optimizer, limits: Bounds) -> tuple[np.ndarray, bool]:
    """The optimizer in whitened coordinates, restarted from the best point until the Gauss-Newton step is small.

    It runs operation by operation on concrete numbers: only the simulations are compiled, and they once. Within a hundredth of a standard
    error or so the integrator's tolerance makes the cost too rough to descend; Gauss-Newton steps, which do not look at it, finish."""
    optimizer = optax.with_extra_args_support(optimizer)
    u, reach = np.asarray(u), 1.0
    for _ in range(MOST_RESTARTS):
        r0, _ = evaluate(u)
        towards, S, V = _whitened(evaluate.triangle(u))
        step = np.abs(V @ (towards / S)).max(initial=0.0)
        if step <= NEAR:
            return settled(evaluate, u, True, limits)
        if evaluate.spent or reach < 1e-6:
            break
        share = reach * min(1.0, FARTHEST / step)  # of the way to the linearized optimum that is one unit of y
        size = share * np.linalg.norm(towards)
        spread = V * (size / S)
        y = _descend(evaluate, optimizer, u, r0, spread, size, enough=-ENOUGH * (1 / share - 0.5))
        u, reach = (u, reach / 10) if y is None else (u + spread @ y, min(1.0, 10 * reach))
    return u, False


def _descend(evaluate: Evaluations, optimizer, u, r0, spread, size, enough: float) -> np.ndarray | None:
    """The best y that the optimizer comes to from 0, or None where it found nothing worth having."""

    def value_and_gradient(y):
        r, J = evaluate(u + spread @ np.asarray(y))
        if not np.isfinite(r).all():
            return jnp.asarray(1e6), jnp.zeros_like(y)
        # (r - r0)'(r + r0)/2 is the change of cost, without the cancellation of the difference of squares
        return jnp.asarray(0.5 * (r - r0) @ (r + r0) / size**2), jnp.asarray(spread.T @ (J.T @ r) / size**2)

    cost = jax.custom_vjp(lambda y: value_and_gradient(y)[0])
    cost.defvjp(value_and_gradient, lambda gradient, factor: (factor * gradient,))
    best, lowest, found_at, first = None, -WORTH / 2, evaluate.count, None
    with jax.disable_jit():
        y = jnp.zeros(spread.shape[1])
        state = optimizer.init(y)
        for _ in range(MOST_INNER):
            value, gradient = value_and_gradient(y)
            slope = float(np.linalg.norm(gradient))
            first = slope if first is None else first
            if float(value) < lowest:
                best, lowest, found_at = np.asarray(y), float(value), evaluate.count
            if lowest < enough or slope < FLAT * first or evaluate.count - found_at > PATIENCE or evaluate.spent:
                break
            change, state = optimizer.update(gradient, state, y, value=value, grad=gradient, value_fn=cost)
            y = optax.apply_updates(y, change)
    return best
