"""Searches for the least sum of squares of a residual r(u) with its Jacobian, by SciPy, by an optax
optimizer or by optimistix. Each starts from one u and returns the best u and whether it converged.

SciPy and optax use one program for r and J, whose evaluations are counted; Gauss-Newton steps
finish the search. An optax optimizer works in coordinates y whitened by the Jacobian, J = U S V',
u = u_k + V S^-1 |U'r| y, in which the linearized optimum lies at a distance of one. It is restarted
from its best point until the Gauss-Newton step is small. A search by optimistix is one program,
also inside jit and vmap, differentiable in forward mode by the implicit function theorem.
"""

from collections.abc import Callable
from itertools import pairwise
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax
import optimistix

from jaxbody.core.arrays import Array, Float, device_array, module_of
from jaxbody.core.compilation.compile_options import program, program_with
from jaxbody.core.errors import Status
from jaxbody.fitting.residuals import (
    Task,
    options_of,
    residual_and_jacobian,
    residuals_of_means,
)
from jaxbody.fitting.statistics.uncertainties import decomposed

NEAR = 1e-4  # length of the Gauss-Newton step in u below which such steps finish the search
# norm of the part of the residual that the parameters can still reduce, relative to the whole
CONVERGED = 1e-9
SHORTER = 0.9  # largest ratio of a Gauss-Newton step to the step before it
REMEMBERED = 3  # earlier steps used to accelerate the next one
ROWS = 512  # rows of a block of the QR decomposition
AT_BOUND = 1e-6  # largest distance in u from a bound that counts as at the bound
# smallest decrease of the cost that counts as an improvement, relative to the expected decrease
SIGNIFICANT = 0.01
FLAT = 0.02  # gradient norm, relative to the first, below which the coordinates are whitened again
# decrease of the cost, relative to the expected one, after which the coordinates are whitened again
SUFFICIENT = 0.75
FARTHEST = 0.7  # largest change of u for one unit of y: a factor of two for a positive parameter
MAX_RESTARTS = 100
MAX_INNER = 80
PATIENCE = 25  # evaluations without an improvement
FAILED = 1e6  # cost of a trial that cannot be simulated; the expected decrease is 1/2

Bounds = tuple[np.ndarray, np.ndarray]


class Evaluations:
    """Residual and Jacobian of `function(u)` -> (r, J, auxiliary), with a count of evaluations. A
    trial that fails has residuals of NaN.

    `floor`: norm of a column of J up to which it is round-off and set to zero. `best`: the u of the
    lowest cost so far, also passed to `improved`. `line` is called with a message after every
    evaluation."""

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
        """Return r, J and the auxiliary result of the function."""
        key = np.asarray(u).tobytes()
        if self._last is not None and self._last[0] == key:
            return self._last[1]
        with jax.disable_jit(False):
            r, J, auxiliary = self.function(device_array(u))
        r, J = np.asarray(r), np.asarray(J)
        # without this, a search would follow round-off
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
        """Return (r, J) reduced by a QR decomposition to as many rows as [J r] has columns. Scalar
        products of r and the columns of J are preserved, and so are Gauss-Newton steps, cost and
        gradient at u."""
        result = self(u)
        if self._last_triangle is None or self._last_triangle[0] is not result:
            self._last_triangle = (result, triangle(*result[:2]))
        return self._last_triangle[1]

    def replace_function(self, function: Callable, floor: float) -> None:
        """Replace the function to be minimized and start a new round: the best point so far is
        discarded, counts and history are kept."""
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
    """Return the last column of the triangle T of [J r] = Q T, and its other columns, computed for
    blocks of rows that fit into the cache, then for all."""
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
    """Minimize bounded least squares with SciPy until Gauss-Newton steps can finish the search; a
    residual of NaN is a rejected step."""
    from scipy.optimize import least_squares

    # before the next line, which may count an evaluation
    left = max(evaluate.max_evaluations - evaluate.count, 1)
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
            x_scale="jac", xtol=1e-11, ftol=1e-15, gtol=1e-15,
            max_nfev=left,
        )  # fmt: skip
    except _NearOptimum as near:
        return gauss_newton(evaluate, near.u, True, limits)
    return gauss_newton(evaluate, result.x, result.status > 0, limits)


def gauss_newton(
    evaluate: Evaluations, u, converged: bool, limits: Bounds
) -> tuple[np.ndarray, bool]:
    """Take Gauss-Newton steps as long as each is shorter than the one before; near the optimum,
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
    """Return the next u by Anderson acceleration: with large residuals, Gauss-Newton steps converge
    only linearly.

        u + d - (dU + dD) c, where c minimizes |d - dD c| (D. G. Anderson, J. ACM 12 (1965) 547)
    """
    u, d = steps[-1]
    if len(steps) == 1:
        return u + d
    U, D = (np.array([b - a for a, b in pairwise(x)]).T for x in zip(*steps, strict=True))
    return u + d - (U + D) @ np.linalg.lstsq(D, d, rcond=1e-6)[0]


def whitened(
    triangle: tuple[np.ndarray, np.ndarray], columns: Any = slice(None)
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return U'r, S and V of J = U S V', without the directions that the data do not determine: the
    Gauss-Newton step is -V S^-1 U'r."""
    r, J = triangle
    if not np.isfinite(r).all():
        return np.array([np.inf]), np.ones(1), np.zeros((J[:, columns].shape[1], 1))
    U, S, Vt, known = decomposed(J[:, columns])
    return (U.T @ r)[known], S[known], Vt[known].T


class WhitenedCoordinates(NamedTuple):
    """Whitened coordinates y, with u = origin + unwhiten y. Costs are relative to |r0|^2/2, the
    cost at the origin, and in units of size^2."""

    origin: Float[Array, "n"]
    unwhiten: Float[Array, "n m"]
    r0: Float[Array, "r"]
    size: Float[Array, ""]

    def value_and_gradient(self, r, J) -> tuple[Array, Array]:
        """Return the cost, computed as (r - r0)'(r + r0)/2 to avoid cancellation, and its gradient
        W'J'r with W = `unwhiten`."""
        xp = module_of(r)
        failed = ~(xp.isfinite(r).all() & xp.isfinite(J).all())
        value, gradient = (
            0.5 * (r - self.r0) @ (r + self.r0) / self.size**2,
            self.unwhiten.T @ (J.T @ r) / self.size**2,
        )
        return xp.where(failed, FAILED, value), xp.where(failed, 0.0, gradient)


@program_with(options_of)
def _step(
    task: Task,
    optimizer: Any,
    at: WhitenedCoordinates,
    y: Float[Array, "m"],
    state: Any,
    value: Array,
    gradient: Array,
) -> tuple[Any, Any]:
    """Return y and the state of the optimizer after one step from y, where the cost has this value
    and gradient."""

    def value_and_gradient(y):
        return at.value_and_gradient(*residual_and_jacobian(task, at.origin + at.unwhiten @ y)[:2])

    # the Jacobian comes with r, in forward mode; line searches differentiate in reverse
    @jax.custom_jvp
    def cost(y):
        return value_and_gradient(y)[0]

    @cost.defjvp
    def slope(primals, tangents):
        value, gradient = value_and_gradient(*primals)
        return value, gradient @ tangents[0]

    optimizer = optax.with_extra_args_support(optimizer)
    change, state = optimizer.update(gradient, state, y, value=value, grad=gradient, value_fn=cost)
    return optax.apply_updates(y, change), state


@program
def _begin(optimizer: Any, y: Float[Array, "m"]) -> Any:
    """Return the state of the optimizer at y."""
    return optimizer.init(y)


def by_optax(evaluate: Evaluations, task: Task, u, optimizer: Any) -> tuple[np.ndarray, bool]:
    """Run the optimizer in whitened coordinates, restarted from the best point until the
    Gauss-Newton step is small.

    Within about a hundredth of a standard error, integration errors make the cost too rough for a
    descent; there Gauss-Newton steps, which do not use the cost, finish the search."""
    u, reach = np.asarray(u), 1.0
    for _ in range(MAX_RESTARTS):
        r0 = evaluate(u)[0]
        projected, S, V = whitened(evaluate.triangle(u))
        step = np.abs(V @ (projected / S)).max(initial=0.0)
        if step <= NEAR:
            return gauss_newton(evaluate, u, True, task.space.bounds)
        if evaluate.exhausted or reach < 1e-6:
            break
        # share of the distance to the linearized optimum that corresponds to one unit of y
        fraction = reach * min(1.0, FARTHEST / step)
        size = fraction * np.linalg.norm(projected)
        at = WhitenedCoordinates(u, V * (size / S), r0, np.asarray(size))
        y = _descend(evaluate, task, optimizer, at, sufficient=-SUFFICIENT * (1 / fraction - 0.5))
        u, reach = (u, reach / 10) if y is None else (u + at.unwhiten @ y, min(1.0, 10 * reach))
    return u, False


def _descend(
    evaluate: Evaluations, task: Task, optimizer: Any, at: WhitenedCoordinates, sufficient: float
) -> np.ndarray | None:
    """Return the best y of the optimizer from y = 0, or None without a significant decrease of the
    cost."""
    y = np.zeros(at.unwhiten.shape[1], at.r0.dtype)
    state = _begin(optimizer, y)
    best, lowest, improved_at, first = None, -SIGNIFICANT / 2, evaluate.count, None
    for _ in range(MAX_INNER):
        r, J, _ = evaluate(at.origin + at.unwhiten @ y)
        value, gradient = at.value_and_gradient(r, J)
        slope = float(np.linalg.norm(gradient))
        first = slope if first is None else first
        if value < lowest:
            best, lowest, improved_at = y, float(value), evaluate.count
        if (
            lowest < sufficient
            or slope < FLAT * first
            or evaluate.count - improved_at > PATIENCE
            or evaluate.exhausted
        ):
            break
        y, state = _step(task, optimizer, at, y, state, value, gradient)
        y = np.asarray(y)
    return best


# not jax.custom_jvp: the task's solver and step controller may contain functions
@eqx.filter_custom_jvp
def _residual(task: Task, size, u):
    """Return r/size, differentiated by the Jacobian that is evaluated together with r, because JAX
    would otherwise run the simulation twice."""
    return residual_and_jacobian(task, u)[0] / size


@_residual.def_jvp
def _residual_jvp(primals, tangents):
    task, size, u = primals
    r, J, _ = residual_and_jacobian(task, u)
    return r / size, J @ tangents[2] / size


def _minimize(task: Task, u, method, max_steps: int) -> tuple[Array, Array, Array]:
    """Return the optimum by optimistix, a status and the number of steps."""
    signal = sum(
        jnp.sum((r / task.experiments[run].channels[name].spread(task.noise[run][name])) ** 2)
        for run, residuals in residuals_of_means(task.experiments).items()
        for name, r in residuals.items()
    )
    # scales the residuals to the order of one, which such methods expect
    size = jnp.sqrt(jnp.where(signal > 0, signal, 1.0))
    result = optimistix.least_squares(
        lambda u, args: _residual(*args, u),
        method,
        u,
        (task, size),
        options={"jac": "fwd"},
        max_steps=max_steps,
        throw=False,
    )
    converged = result.result == optimistix.RESULTS.successful
    status = jnp.where(converged, Status.OK.value, Status.NOT_CONVERGED.value)
    return result.value, status, result.stats["num_steps"]


@program_with(options_of)
def solve(task: Task, u, method, max_steps: int) -> tuple[Array, Array, Array]:
    """Return the result of `_minimize` as one program with a derivative, also inside jit and
    vmap: the derivative of the optimum u,

        H du = -dg

    for the change dg of the gradient of the cost at fixed u, with the exact Hessian H of
    the cost."""
    numbers, rest = eqx.partition(method, eqx.is_array)
    arrays, static = eqx.partition(task, eqx.is_array)

    @jax.custom_jvp
    def optimum(arrays, u, numbers):
        return _minimize(
            eqx.combine(jax.lax.stop_gradient(arrays), static),
            u,
            eqx.combine(numbers, rest),
            max_steps,
        )

    @optimum.defjvp
    def optimum_jvp(primals, tangents):
        arrays = primals[0]
        u, status, steps = optimum(*primals)

        def gradient(along):
            """Return the gradient of the cost after steps of u and of the task along its tangent;
            one program for both derivatives."""
            moved = jax.tree.map(
                lambda x, dx: x if dx.dtype == jax.dtypes.float0 else x + along[-1] * dx,
                arrays,
                tangents[0],
            )
            r, J, _ = residual_and_jacobian(eqx.combine(moved, static), u + along[:-1])
            return J.T @ r

        slopes = jax.jacfwd(gradient)(jnp.zeros(task.space.size + 1))
        H, change = slopes[:, :-1], slopes[:, -1]
        zeros: list[Any] = [np.zeros(jnp.shape(x), jax.dtypes.float0) for x in (status, steps)]
        return (u, status, steps), (
            -jnp.linalg.solve(jnp.where(status == 0, H, jnp.nan), change),
            zeros[0],
            zeros[1],
        )

    return optimum(arrays, u, numbers)


def search(
    evaluate: Evaluations, task: Task, u: np.ndarray, method: Any
) -> tuple[np.ndarray, bool]:
    """Return the best u by the method, and whether it converged."""
    if isinstance(method, str):
        return by_scipy(evaluate, u, task.space.bounds)
    if not isinstance(method, optimistix.AbstractLeastSquaresSolver):
        return by_optax(evaluate, task, u, method)
    best, status, steps = solve(task, u, method, max(evaluate.max_evaluations - evaluate.count, 1))
    evaluate.count += int(steps)
    return np.asarray(best), int(status) == Status.OK
