"""Searches from many starts in lockstep: each is SciPy's optimizer with exact derivatives, and
their evaluations form one batch.

    minimize f(u),   low <= u <= high,   c_min <= c(u) <= c_max

Searches are threads that run one at a time until each waits for an evaluation; then all evaluations
are computed in one batch.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from jaxbody.core.arrays import Float
from jaxbody.core.workers.chunk_programs import ChunkProgram
from jaxbody.design.interior_points import minimize_by_ipopt

ACTIVE = 1e-5  # a limit or bound is active within this scaled distance
MET = 1e-8  # negligible scaled violation
# largest remaining gradient of the scaled objective, per unit of u, at convergence
CONVERGED = 1e-4
OFFSET = 1e-6  # distance in u at which derivatives are taken where they do not exist
PENALTY = 1e3  # scaled objective of a trial that is not finite
MOST_RESTARTS = 4
METHODS = ("slsqp", "trust-constr", "ipopt")

DesignVector = Float[np.ndarray, "n"]


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
        """The rows of the objective and of the limited quantities."""
        return np.r_[self.objective, self.limited].astype(int)

    def violation(self, values: np.ndarray, scale: np.ndarray) -> Any:
        """The largest scaled violation."""
        c = values[..., self.limited]
        return np.max(np.maximum(self.lower - c, c - self.upper) / scale, axis=-1, initial=0.0)


def one_thread() -> threadpool_limits:
    """A context in which BLAS has one thread, because several would only wait for each other with
    these small matrices."""
    import scipy.optimize  # noqa: F401  # libraries loaded later would not be limited

    return threadpool_limits(1, "blas")


# of a search, what the next steps need
ENDS = ("u", "values", "slopes", "finite", "size", "iterations")


class Stopped(Exception):
    """Ends a search because another one failed."""


@dataclass
class Search:
    """One start between bounds, the best `u` reached from it with its `values` and `slopes`, and
    the `history` of objective and violation.

    Its problem is scaled: the objective by its `size` at the start, limited quantities by the sizes
    of their limits."""

    start: DesignVector
    low: DesignVector
    high: DesignVector
    rows: Rows
    finite: bool = False
    size: float = 1.0  # of the objective
    history: list[tuple[float, float]] = field(default_factory=list)
    iterations: int = 0
    error: BaseException | None = None
    done: bool = False
    answer: tuple[DesignVector, np.ndarray] | None = None
    go: threading.Semaphore = field(default_factory=lambda: threading.Semaphore(0))
    back: threading.Semaphore = field(default_factory=lambda: threading.Semaphore(0))
    u: DesignVector = field(init=False)
    values: DesignVector = field(init=False)
    slopes: np.ndarray = field(init=False)
    requested: DesignVector = field(init=False)
    scale: np.ndarray = field(init=False)  # of the limited quantities
    last: tuple[bytes, Any] = (b"", None)

    def __post_init__(self):
        self.u = self.requested = self.start

    def keep(self, u: DesignVector, values: np.ndarray, slopes: np.ndarray) -> None:
        self.u, self.values, self.slopes = u, values, slopes

    def ask(self, u: DesignVector) -> tuple[np.ndarray, np.ndarray]:
        self.requested = np.array(u)
        self.back.release()
        self.go.acquire()
        if self.answer is None:
            raise Stopped
        return self.answer

    def begin(self) -> None:
        """Evaluate the start."""
        self.keep(self.start, *self._evaluated(self.start))
        self.finite = self._finite(self.values, self.slopes)
        self.size = float(abs(self.values[self.rows.objective])) or 1.0
        self.scale = scales(self.rows, self.values)
        self.last_finite = self.values, self.slopes  # of the last finite trial

    @property
    def violation(self) -> float:
        """The largest scaled violation at the best u."""
        return float(self.rows.violation(self.values, self.scale))

    @property
    def limits(self) -> tuple[np.ndarray, np.ndarray]:
        """The scaled limits."""
        return self.rows.lower / self.scale, self.rows.upper / self.scale

    def _finite(self, *arrays: np.ndarray) -> bool:
        return all(np.isfinite(x[self.rows.requested]).all() for x in arrays)

    def _evaluated(self, u: DesignVector) -> tuple[np.ndarray, np.ndarray]:
        """Values and derivatives; where derivatives do not exist, those of a point nearby."""
        values, slopes = self.ask(u)
        if self._finite(values) and not self._finite(slopes):
            step = OFFSET * np.cos(1.0 + np.arange(len(u)))
            slopes = self.ask(
                np.clip(np.where(u + step > self.high, u - step, u + step), self.low, self.high)
            )[1]
        return values, slopes

    def at(self, u: DesignVector) -> tuple[float, DesignVector, np.ndarray, np.ndarray]:
        """f, its gradient, the limited c and their Jacobian, scaled. A trial that is not finite
        gets the last finite values plus a penalty."""
        key = u.tobytes()
        if self.last[0] != key:
            inside, penalty, f, c = (
                np.clip(u, self.low, self.high),
                0.0,
                self.rows.objective,
                self.rows.limited,
            )
            values, slopes = self._evaluated(inside)
            if self._finite(values, slopes):
                self.last_finite = values, slopes
                self._keep_better(inside, values, slopes)
            else:
                values, slopes = self.last_finite
                penalty = PENALTY * (1 + abs(values[f]) / self.size)
            scaled = (
                float(values[f] / self.size + penalty),
                slopes[f] / self.size,
                values[c] / self.scale,
                slopes[c] / self.scale[:, None],
            )
            self.last = key, scaled
        return self.last[1]

    def _keep_better(self, u: DesignVector, values: np.ndarray, slopes: np.ndarray) -> None:
        """Add to the history, and keep u if it is better than the best so far: smaller violation
        or, if both are feasible, lower objective."""
        f, violation, before = (
            self.rows.objective,
            float(self.rows.violation(values, self.scale)),
            self.violation,
        )
        self.history.append((float(values[f]), violation))
        if values[f] < self.values[f] if max(before, violation) <= MET else violation < before:
            self.keep(u, values, slopes)


def run_in_lockstep(
    evaluate: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]],
    searches: list[Search],
    run: Callable[[Search], None],
) -> None:
    """Call `run(search)` for each search; their requests go to `evaluate` (b, n) -> values (b, m),
    Jacobians (b, m, n) as one batch."""

    def act(search: Search) -> None:
        search.go.acquire()
        try:
            run(search)
        except Stopped:
            pass
        except BaseException as error:
            search.error = error
        search.done = True
        search.back.release()

    threads = [threading.Thread(target=act, args=(search,), daemon=True) for search in searches]
    for thread in threads:
        thread.start()
    batch = np.stack([search.start for search in searches])
    try:
        while True:
            for search in searches:
                if not search.done:
                    search.go.release()
                    search.back.acquire()
                if search.error is not None:
                    raise search.error
            waiting = [(i, search) for i, search in enumerate(searches) if not search.done]
            if not waiting:
                return
            for i, search in waiting:
                batch[i] = search.requested
            values, slopes = evaluate(batch)
            for i, search in waiting:
                search.answer = values[i], slopes[i]
    finally:
        for search in searches:
            while not search.done:
                search.answer = None
                search.go.release()
                search.back.acquire()
        for thread in threads:
            thread.join()


def scales(rows: Rows, values: np.ndarray) -> np.ndarray:
    """The size of each limit; for a limit of zero, the size of the limited quantity."""
    finite = [np.where(np.isfinite(end), np.abs(end), 0.0) for end in (rows.lower, rows.upper)]
    size = np.maximum(*finite)
    return np.where(size > 0, size, np.maximum(np.abs(values[rows.limited]), 1e-12))


def run(search: Search, method: str, iterations: int, tolerance: float) -> None:
    """The method, restarted while it improves; if limits are violated, the violation is
    minimized first."""
    search.begin()
    free = (search.low < search.high).any()  # otherwise all parameters come from catalogues
    for attempt in range(MOST_RESTARTS if search.finite and free else 0):
        if search.iterations >= iterations:
            return
        before = search.values[search.rows.objective]
        search.iterations += _minimize(search, method, iterations - search.iterations, tolerance)
        if search.violation > MET:
            if not _restored(search, iterations - search.iterations):
                return
        elif (
            attempt
            and before - search.values[search.rows.objective] <= 10 * tolerance * search.size
        ):
            return


def _minimize(search: Search, method: str, iterations: int, tolerance: float) -> int:
    import scipy.optimize  # slow to import

    lower, upper = search.limits
    if method == "ipopt":
        return minimize_by_ipopt(
            search.at, search.u, (search.low, search.high), (lower, upper), iterations, tolerance
        )
    bounds = scipy.optimize.Bounds(search.low, search.high, keep_feasible=True)  # pyright: ignore
    common: dict[str, Any] = dict(jac=lambda u: search.at(u)[1], bounds=bounds)
    limits: Any = ()
    if method == "slsqp":
        same = lower == upper
        below, above = np.isfinite(lower) & ~same, np.isfinite(upper) & ~same

        def inequality(k):
            return lambda u: np.concatenate([search.at(u)[k][below], -search.at(u)[k][above]])

        ends = np.concatenate([lower[below], -upper[above]])
        limits = []
        if len(ends):
            limits.append(
                dict(type="ineq", fun=lambda u: inequality(2)(u) - ends, jac=inequality(3))
            )
        if same.any():
            limits.append(
                dict(
                    type="eq",
                    fun=lambda u: search.at(u)[2][same] - lower[same],
                    jac=lambda u: search.at(u)[3][same],
                )
            )
        options = dict(maxiter=iterations, ftol=tolerance)
    else:
        if len(lower):
            limits = scipy.optimize.NonlinearConstraint(
                lambda u: search.at(u)[2],
                lower,
                upper,
                jac=lambda u: search.at(u)[3],  # pyright: ignore[reportArgumentType]  SciPy takes functions, too
                hess=scipy.optimize.BFGS(),
            )
        inside = np.isfinite(
            np.r_[lower[lower != upper], upper[lower != upper], search.low, search.high]
        ).any()
        # a larger gtol would end the search at a large barrier parameter
        gtol = 1e-14 if inside else tolerance**0.8
        options = dict(maxiter=iterations, gtol=gtol, xtol=tolerance, barrier_tol=tolerance**0.8)
        common["hess"] = scipy.optimize.BFGS()
    solution = scipy.optimize.minimize(
        lambda u: search.at(u)[0],
        search.u,
        constraints=limits,
        method=method,
        options=options,
        **common,
    )
    return int(solution.nit)


def _restored(search: Search, iterations: int) -> bool:
    """Minimize the sum of squared violations; returns whether the limits can be met."""
    import scipy.optimize

    lower, upper = search.limits
    if iterations <= 0:
        return False

    def squares(u):
        _, _, c, A = search.at(u)
        excess = np.maximum(c - upper, 0) - np.maximum(lower - c, 0)
        return float(excess @ excess), 2 * excess @ A

    bounds = list(zip(search.low, search.high, strict=True))
    options = dict(maxiter=iterations, ftol=1e-16, gtol=1e-10)
    solution = scipy.optimize.minimize(
        squares, search.u, jac=True, bounds=bounds, method="L-BFGS-B", options=options
    )
    search.iterations += int(solution.nit)
    return search.violation <= MET


@dataclass(frozen=True)
class Multipliers:
    """Lagrange multipliers d objective/d limit, in their units, and the remaining
    scaled gradient."""

    limits: np.ndarray
    bounds: DesignVector
    remaining: float


def multipliers(search: Search) -> Multipliers:
    """grad f = sum of lambda grad c over the active limits and bounds, lambda with the sign of
    their side, by least squares."""
    import scipy.optimize

    rows, values, slopes, u, low, high = (
        search.rows,
        search.values,
        search.slopes,
        search.u,
        search.low,
        search.high,
    )
    scale, size = scales(rows, values), max(abs(values[rows.objective]), search.size)
    c, A, g = (
        values[rows.limited] / scale,
        slopes[rows.limited] / scale[:, None],
        slopes[rows.objective] / size,
    )
    at_lower, at_upper = c - rows.lower / scale <= ACTIVE, rows.upper / scale - c <= ACTIVE
    n = len(u)
    sides = [
        (A[at_lower], np.flatnonzero(at_lower), 1.0, 0),
        (-A[at_upper], np.flatnonzero(at_upper), -1.0, 0),
    ]
    for nearest, sign in ((u - low <= ACTIVE, 1.0), (high - u <= ACTIVE, -1.0)):
        sides.append((sign * np.eye(n)[nearest], np.flatnonzero(nearest), sign, 1))
    normals = np.concatenate([side[0] for side in sides])
    weights, _ = scipy.optimize.nnls(normals.T, g) if len(normals) else (np.zeros(0), 0.0)
    lambdas = np.zeros(len(rows.limited)), np.zeros(n)
    first = 0
    for rows_of, where, sign, kind in sides:
        np.add.at(lambdas[kind], where, sign * weights[first : first + len(rows_of)])
        first += len(rows_of)
    remaining = float(np.abs(g - weights @ normals).max(initial=0.0))
    return Multipliers(lambdas[0] * size / scale, lambdas[1] * size, remaining)


def searched(
    program: ChunkProgram,
    shared: Sequence[Any],
    rows: Sequence[np.ndarray],
    of: Rows,
    method: str,
    iterations: int,
    tolerance: float,
) -> dict[str, np.ndarray]:
    """In a worker: the ends of searches from rows (start, low, high), with values and slopes by
    a program."""
    count = 0

    def evaluate(U):
        nonlocal count
        count += 1
        results = program(shared, [U])
        return results["values"], results["slopes"]

    searches = [Search(u, low, high, of) for u, low, high in zip(*rows, strict=True)]
    with one_thread():
        run_in_lockstep(
            evaluate, searches, lambda search: run(search, method, iterations, tolerance)
        )
    history = np.full((len(searches), max(len(search.history) for search in searches), 2), np.nan)
    for search, line in zip(searches, history, strict=True):
        line[: len(search.history)] = np.reshape(search.history, (-1, 2))
    ends = {name: np.array([getattr(search, name) for search in searches]) for name in ENDS}
    return ends | {"history": history, "count": np.full(len(searches), count)}


def end_at(search: Search, results: dict[str, np.ndarray], row: int) -> None:
    """End a search as `searched` has ended it in another process."""
    search.keep(*(results[name][row] for name in ("u", "values", "slopes")))
    search.finite, search.size, search.iterations = (
        bool(results["finite"][row]),
        float(results["size"][row]),
        int(results["iterations"][row]),
    )
    search.history = [(float(f), float(v)) for f, v in results["history"][row] if not np.isnan(v)]
