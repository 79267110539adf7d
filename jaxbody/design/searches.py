"""Searches: optimizers of SciPy with exact derivatives, from one start each.

minimize f(u),   low <= u <= high,   c_min <= c(u) <= c_max
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from jaxbody.core.arrays import Float
from jaxbody.core.workers.chunk_programs import ChunkProgram

# u -> f, its gradient, c, its Jacobian
At = Callable[[np.ndarray], tuple[float, np.ndarray, np.ndarray, np.ndarray]]

ACTIVE = 1e-5  # a limit or bound is active within this scaled distance
MET = 1e-8  # negligible scaled violation
# largest remaining gradient of the scaled objective, per unit of u, at convergence
CONVERGED = 1e-4
OFFSET = 1e-6  # distance in u at which derivatives are taken where they do not exist
PENALTY = 1e3  # scaled objective of a trial that is not finite
MOST_RESTARTS = 4
METHODS = ("slsqp", "trust-constr")

DesignVector = Float[np.ndarray, "n"]
# u -> the values of all quantities and their Jacobian
ValuesAndSlopes = Callable[[DesignVector], tuple[np.ndarray, np.ndarray]]


@dataclass(frozen=True)
class Rows:
    """The row of the objective among the values, and the rows of the limited quantities with
    their limits."""

    objective: int
    limited: np.ndarray
    lower: np.ndarray
    upper: np.ndarray

    @property
    def requested(self) -> np.ndarray:
        """The rows of the objective and of the limited quantities, each once."""
        return np.array(list(dict.fromkeys([self.objective, *self.limited])), int)

    def finite(self, *arrays: np.ndarray) -> bool:
        """Return whether all numbers of the requested rows are finite."""
        return all(np.isfinite(x[self.requested]).all() for x in arrays)

    def scale(self, values: np.ndarray) -> np.ndarray:
        """Return the size of each limit; for a limit of zero, the size of the limited quantity."""
        size = np.maximum(
            *(np.where(np.isfinite(end), np.abs(end), 0.0) for end in (self.lower, self.upper))
        )
        return np.where(size > 0, size, np.maximum(np.abs(values[self.limited]), 1e-12))

    def violation(self, values: np.ndarray, scale: np.ndarray) -> Any:
        """Return the largest scaled violation of the limits."""
        c = values[..., self.limited]
        return np.max(np.maximum(self.lower - c, c - self.upper) / scale, axis=-1, initial=0.0)


def one_thread() -> threadpool_limits:
    """Return a context in which BLAS has one thread, because several threads would only wait for
    each other with these small matrices."""
    import scipy.optimize  # noqa: F401  # libraries loaded later would not be limited

    return threadpool_limits(1, "blas")


@dataclass
class Search:
    """A search from one `start` between bounds: the best `u` reached, with its `values` and
    `slopes`, and the `history` of objective and violation.

    Its problem is scaled: the objective by its `size` at the start, limited quantities by the sizes
    of their limits."""

    start: DesignVector
    low: DesignVector
    high: DesignVector
    rows: Rows
    finite: bool = False
    size: float = 1.0  # of the objective at the start
    history: list[tuple[float, float]] = field(default_factory=list)
    iterations: int = 0
    evaluations: int = 0
    u: DesignVector = field(init=False)
    values: DesignVector = field(init=False)
    slopes: np.ndarray = field(init=False)
    scale: np.ndarray = field(init=False)  # of the limited quantities

    def keep(self, u: DesignVector, values: np.ndarray, slopes: np.ndarray) -> None:
        self.u, self.values, self.slopes = u, values, slopes

    @property
    def objective(self) -> float:
        """The objective at the best u."""
        return float(self.values[self.rows.objective])

    @property
    def violation(self) -> float:
        """The largest scaled violation at the best u."""
        return float(self.rows.violation(self.values, self.scale))

    @property
    def own_violation(self) -> float:
        """The largest violation at the best u, scaled by the sizes of the limited quantities
        there."""
        return float(self.rows.violation(self.values, self.rows.scale(self.values)))

    @property
    def limits(self) -> tuple[np.ndarray, np.ndarray]:
        """The scaled limits."""
        return self.rows.lower / self.scale, self.rows.upper / self.scale

    def note(self, u: DesignVector, values: np.ndarray, slopes: np.ndarray) -> None:
        """Add an evaluation to the history, and keep u if it is better than the best so far:
        smaller violation or, if both are feasible, lower objective."""
        f = float(values[self.rows.objective])
        violation, before = float(self.rows.violation(values, self.scale)), self.violation
        self.history.append((f, violation))
        if f < self.objective if max(before, violation) <= MET else violation < before:
            self.keep(u, values, slopes)


class ScaledProblem:
    """The functions that a search minimizes and limits, evaluated once at each u."""

    def __init__(self, search: Search, evaluate: ValuesAndSlopes):
        self.search, self.evaluate = search, evaluate
        self.last: tuple[bytes, Any] = b"", None
        self.last_finite = values, slopes = self._evaluated(search.start)
        search.keep(search.start, values, slopes)
        search.finite = search.rows.finite(values, slopes)
        search.size = abs(search.objective) or 1.0
        search.scale = search.rows.scale(values)

    def _evaluated(self, u: DesignVector) -> tuple[np.ndarray, np.ndarray]:
        """Return values and derivatives at u; where derivatives do not exist, those of a nearby
        point."""
        search = self.search
        search.evaluations += 1
        values, slopes = self.evaluate(u)
        if search.rows.finite(values) and not search.rows.finite(slopes):
            search.evaluations += 1
            step = OFFSET * np.cos(1.0 + np.arange(len(u)))
            near = np.where(u + step > search.high, u - step, u + step)
            slopes = self.evaluate(np.clip(near, search.low, search.high))[1]
        return values, slopes

    def at(self, u: DesignVector) -> tuple[float, DesignVector, np.ndarray, np.ndarray]:
        """Return f, its gradient, the limited quantities c and their Jacobian, all scaled. A trial
        that is not finite gets the last finite values plus a penalty."""
        if self.last[0] == u.tobytes():
            return self.last[1]
        search, rows, penalty = self.search, self.search.rows, 0.0
        inside = np.clip(u, search.low, search.high)
        values, slopes = self._evaluated(inside)
        if rows.finite(values, slopes):
            self.last_finite = values, slopes
            search.note(inside, values, slopes)
        else:
            values, slopes = self.last_finite
            penalty = PENALTY * (1 + abs(values[rows.objective]) / search.size)
        scaled = (
            float(values[rows.objective] / search.size + penalty),
            slopes[rows.objective] / search.size,
            values[rows.limited] / search.scale,
            slopes[rows.limited] / search.scale[:, None],
        )
        self.last = u.tobytes(), scaled
        return scaled


def run(
    search: Search, evaluate: ValuesAndSlopes, method: str, iterations: int, tolerance: float
) -> None:
    """Run the optimizer, restarted while it improves; if limits are violated, minimize the
    violation first."""
    at = ScaledProblem(search, evaluate).at
    free = (search.low < search.high).any()  # otherwise all parameters come from catalogues
    for attempt in range(MOST_RESTARTS if search.finite and free else 0):
        if search.iterations >= iterations:
            return
        before = search.objective
        search.iterations += _minimize(
            search, at, method, iterations - search.iterations, tolerance
        )
        if search.violation > MET:
            if not _restored(search, at, iterations - search.iterations):
                return
        elif attempt and before - search.objective <= 10 * tolerance * search.size:
            return


def _minimize(search: Search, at: At, method: str, iterations: int, tolerance: float) -> int:
    import scipy.optimize  # slow to import

    lower, upper = search.limits
    same = lower == upper
    if method == "slsqp":

        def constraint(kind: str, which: np.ndarray, sign: int, end: np.ndarray) -> dict[str, Any]:
            return dict(
                type=kind,
                fun=lambda u: sign * (at(u)[2] - end)[which],
                jac=lambda u: sign * at(u)[3][which],
            )

        limits: Any = [
            constraint("eq", same, 1, lower),
            constraint("ineq", np.isfinite(lower) & ~same, 1, lower),
            constraint("ineq", np.isfinite(upper) & ~same, -1, upper),
        ]
        options: dict[str, Any] = dict(options=dict(maxiter=iterations, ftol=tolerance))
    else:
        limits = scipy.optimize.NonlinearConstraint(
            lambda u: at(u)[2],
            lower,
            upper,
            jac=lambda u: at(u)[3],  # pyright: ignore[reportArgumentType]  SciPy takes functions, too
            hess=scipy.optimize.BFGS(),
        )
        inside = np.isfinite(np.r_[lower[~same], upper[~same], search.low, search.high]).any()
        # a larger gtol would end the search at a large barrier parameter
        gtol = 1e-14 if inside else tolerance**0.8
        options = dict(
            hess=scipy.optimize.BFGS(),
            options=dict(maxiter=iterations, gtol=gtol, xtol=tolerance, barrier_tol=tolerance**0.8),
        )
    solution = scipy.optimize.minimize(
        lambda u: at(u)[0],
        search.u,
        jac=lambda u: at(u)[1],
        bounds=scipy.optimize.Bounds(search.low, search.high, keep_feasible=True),  # pyright: ignore
        constraints=limits if len(lower) else (),
        method=method,
        **options,
    )
    return int(solution.nit)


def _restored(search: Search, at: At, iterations: int) -> bool:
    """Minimize the sum of squared violations and return whether the limits can be met."""
    import scipy.optimize

    lower, upper = search.limits
    if iterations <= 0:
        return False

    def squares(u):
        _, _, c, A = at(u)
        excess = np.maximum(c - upper, 0) - np.maximum(lower - c, 0)
        return float(excess @ excess), 2 * excess @ A

    solution = scipy.optimize.minimize(
        squares,
        search.u,
        jac=True,
        bounds=scipy.optimize.Bounds(search.low, search.high),  # pyright: ignore
        method="L-BFGS-B",
        options=dict(maxiter=iterations, ftol=1e-16, gtol=1e-10),
    )
    search.iterations += int(solution.nit)
    return search.violation <= MET


def run_in_worker(
    program: ChunkProgram, shared: Sequence[Any], searches: Sequence[Any], **options: Any
) -> dict[str, Any]:
    """Run the only search of a chunk in a worker, with values and slopes from a compiled program,
    and return {"search": the search}."""
    (search,) = searches

    def evaluate(u):
        results = program(shared, [u[None]])
        return results["values"][0], results["slopes"][0]

    with one_thread():
        run(search, evaluate, **options)
    return {"search": search}


@dataclass(frozen=True)
class Multipliers:
    """Lagrange multipliers d objective/d limit, in their units, and the remaining
    scaled gradient."""

    limits: np.ndarray
    bounds: DesignVector
    remaining: float


def multipliers(search: Search) -> Multipliers:
    """Return the multipliers lambda by least squares: grad f = sum of lambda grad c over the active
    limits and bounds, each lambda with the sign of its side."""
    import scipy.optimize

    rows, values, slopes, u = search.rows, search.values, search.slopes, search.u
    scale, size = rows.scale(values), max(abs(search.objective), search.size)
    c, A, g = (
        values[rows.limited] / scale,
        slopes[rows.limited] / scale[:, None],
        slopes[rows.objective] / size,
    )
    m, n = A.shape
    # from the lower and upper ends of limits, and from those of bounds
    distances = np.r_[
        c - rows.lower / scale, rows.upper / scale - c, u - search.low, search.high - u
    ]
    normals = np.concatenate([A, -A, np.eye(n), -np.eye(n)])
    active, weights = distances <= ACTIVE, np.zeros(2 * (m + n))
    if active.any():
        weights[active] = scipy.optimize.nnls(normals[active].T, g)[0]
    of_lower, of_upper, of_low, of_high = np.split(weights, [m, 2 * m, 2 * m + n])
    remaining = float(np.abs(g - weights @ normals).max(initial=0.0))
    return Multipliers((of_lower - of_upper) * size / scale, (of_low - of_high) * size, remaining)
