"""Minimization of the sum of squares of a residual r(u) with its Jacobian by SciPy, ended by
Gauss-Newton steps."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from typing import Any

import jax
import numpy as np

from jaxbody.core.arrays import device_array
from jaxbody.fitting.statistics.uncertainties import known_directions

NEAR = 1e-4  # largest Gauss-Newton step in u from which Gauss-Newton steps finish the search
# norm of the part of the residual that the parameters still explain, relative to the whole
CONVERGED = 1e-9
SHORTER = 0.9  # largest ratio of a Gauss-Newton step to the step before it
REMEMBERED = 3  # earlier steps used to accelerate the next one
ROWS = 512  # rows of a block of the QR decomposition
AT_BOUND = 1e-6  # largest distance in u from a bound that counts as at the bound

Bounds = tuple[np.ndarray, np.ndarray]


class Evaluations:
    """Residual and Jacobian of `function(u)` -> (r, J, auxiliary), with a count of evaluations. A
    trial that fails has residuals of NaN.

    `floor`: largest norm of a column of J that is round-off, which is set to zero. `best`: the
    u of the least cost so far, also passed to `improved`. `line` receives a message after
    every evaluation."""

    def __init__(
        self,
        function: Callable,
        max_evaluations: int,
        *,
        floor: float = 0.0,
        progress: bool | None = False,
        improved: Callable = lambda u: None,
        line: Callable[[str], None] = lambda message: None,
    ):
        self.function, self.max_evaluations, self.floor, self.progress = (
            function,
            max_evaluations,
            floor,
            progress,
        )
        self.improved, self.line, self.count, self.failed, self.history, self.best = (
            improved,
            line,
            0,
            0,
            [],
            None,
        )
        self._least, self._last, self._last_triangle = np.inf, None, None
        self.rounds: list[int] = []  # counts at which the function was replaced

    def __call__(self, u) -> tuple[np.ndarray, np.ndarray, Any]:
        """r, J and what else the function returns."""
        key = np.asarray(u).tobytes()
        if self._last is not None and self._last[0] == key:
            return self._last[1]
        with jax.disable_jit(False):
            r, J, auxiliary = self.function(device_array(u))
        r, J = np.asarray(r), np.asarray(J)
        # a search would follow round-off
        J = np.where(np.linalg.norm(J, axis=0) <= self.floor, 0.0, J)
        failed = not (np.isfinite(r).all() and np.isfinite(J).all())
        r = np.full_like(r, np.nan) if failed else r
        cost = float(0.5 * r @ r)
        self.count, self.failed = self.count + 1, self.failed + failed
        self.history.append(cost)
        if cost < self._least:
            self.best, self._least = np.asarray(u), cost
            self.improved(self.best)
        message = f"evaluation {self.count}: " + ("failed" if failed else f"cost {cost:.9g}")
        if self.progress:
            print(message, flush=True)
        self.line(message)
        self._last = key, (r, J, auxiliary)
        return self._last[1]

    def triangle(self, u) -> tuple[np.ndarray, np.ndarray]:
        """(r, J) reduced by a QR decomposition to as many rows as [J r] has columns. Scalar
        products of r and the columns of J, and so Gauss-Newton steps, cost and gradient at u,
        are preserved."""
        result = self(u)
        if self._last_triangle is None or self._last_triangle[0] is not result:
            self._last_triangle = (result, triangle(*result[:2]))
        return self._last_triangle[1]

    def replace_function(self, function: Callable, floor: float) -> None:
        """Continue with another function."""
        self.rounds.append(self.count)
        self.function, self.floor, self.best, self._least, self._last = (
            function,
            floor,
            None,
            np.inf,
            None,
        )

    @property
    def exhausted(self) -> bool:
        return self.count >= self.max_evaluations


def triangle(r: np.ndarray, J: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The last column of the triangle T of [J r] = Q T, and its other columns; computed for blocks
    of rows that fit into the cache, then for all."""
    T = np.concatenate([J, r[:, None]], 1)
    n, whole = T.shape[1], len(r) // ROWS * ROWS
    if len(T) < 4 * n:
        return r, J
    if not np.isfinite(T).all():
        return np.full(n, np.nan), np.full((n, n - 1), np.nan)
    blocks = np.reshape(np.linalg.qr(T[:whole].reshape(-1, ROWS, n), mode="r"), (-1, n))
    T = np.asarray(np.linalg.qr(np.concatenate([blocks, T[whole:]]), mode="r"))
    return T[:, -1], T[:, :-1]


class _NearOptimum(Exception):
    """Raised where the Gauss-Newton step from u is so short that such steps can finish
    the search."""

    def __init__(self, u: np.ndarray):
        self.u = u


def by_scipy(evaluate: Evaluations, u, limits: Bounds) -> tuple[np.ndarray, bool]:
    """Bounded least squares until Gauss-Newton steps can finish the search; a residual of NaN is a
    rejected step."""
    from scipy.optimize import least_squares

    evaluations_left = max(evaluate.max_evaluations - evaluate.count, 1)
    # the first trust region then depends on u and not on the noise level
    size = np.linalg.norm(evaluate(u)[0]) or 1.0

    def jacobian(u):
        projected, S, V = whitened(evaluate.triangle(u))
        if (
            np.abs(V @ (projected / S)).max(initial=0.0) <= NEAR
            and (limits[0] < u).all()
            and (u < limits[1]).all()
        ):
            raise _NearOptimum(u)
        return evaluate.triangle(u)[1] / size

    try:
        result = least_squares(
            lambda u: evaluate.triangle(u)[0] / size, np.asarray(u),
            jacobian,  # pyright: ignore[reportArgumentType]  SciPy takes functions, too
            limits,
            x_scale="jac", xtol=1e-11, ftol=1e-15, gtol=1e-15, max_nfev=evaluations_left,
        )  # fmt: skip
    except _NearOptimum as near:
        return gauss_newton(evaluate, near.u, True, limits)
    return gauss_newton(evaluate, result.x, result.status > 0, limits)


def gauss_newton(
    evaluate: Evaluations, u, converged: bool, limits: Bounds
) -> tuple[np.ndarray, bool]:
    """Gauss-Newton steps as long as each is shorter than the one before; near the optimum,
    integration errors hide changes of the cost."""
    u = np.asarray(u)
    inside = np.all(np.abs(u - np.stack(limits)) > AT_BOUND, axis=0)
    projected, S, V = whitened(evaluate.triangle(u), inside)
    steps: list[tuple[np.ndarray, np.ndarray]] = []
    while (
        converged
        and np.linalg.norm(projected) > CONVERGED * np.linalg.norm(evaluate(u)[0])
        and not evaluate.exhausted
    ):
        new = u.copy()
        steps = [*steps[-REMEMBERED:], (u[inside], -V @ (projected / S))]
        new[inside] = _accelerated(steps)
        before, (projected, S, V) = (
            np.linalg.norm(projected),
            whitened(evaluate.triangle(new), inside),
        )
        if (
            not np.linalg.norm(projected) < SHORTER * before
            or (new < limits[0]).any()
            or (new > limits[1]).any()
        ):
            break
        u = new
    return u, converged


def _accelerated(steps: list[tuple[np.ndarray, np.ndarray]]) -> np.ndarray:
    """The next u by Anderson acceleration: with large residuals, Gauss-Newton steps converge
    only linearly.

    u + d - (dU + dD) c, where c minimizes |d - dD c| (D. G. Anderson, J. ACM 12 (1965) 547)"""
    u, d = steps[-1]
    if len(steps) == 1:
        return u + d
    U, D = (np.array([b - a for a, b in pairwise(x)]).T for x in zip(*steps, strict=True))
    return u + d - (U + D) @ np.linalg.lstsq(D, d, rcond=1e-6)[0]


def whitened(
    triangle: tuple[np.ndarray, np.ndarray], columns: Any = slice(None)
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """U'r, S and V of J = U S V', without the directions that the data do not determine: the
    Gauss-Newton step is -V S^-1 U'r."""
    r, J = triangle
    if not np.isfinite(r).all():
        return np.array([np.inf]), np.ones(1), np.zeros((J[:, columns].shape[1], 1))
    U, S, Vt = np.linalg.svd(J[:, columns], full_matrices=False)
    known = known_directions(S)
    return (U.T @ r)[known], S[known], Vt[known].T
