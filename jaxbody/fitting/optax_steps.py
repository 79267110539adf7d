"""Minimization of the sum of squares of a residual r(u) with its Jacobian by an optax optimizer, in
whitened coordinates.

The optimizer works in coordinates y whitened by the Jacobian, J = U S V', u = u_k + V S^-1 |U'r| y,
in which the linearized optimum lies at a distance of one. It is restarted from its best point until
the Gauss-Newton step is small.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import numpy as np
import optax

from jaxbody.core.arrays import Array, Float, module_of
from jaxbody.core.compilation.compile_options import program, program_with
from jaxbody.fitting.least_squares import NEAR, Bounds, Evaluations, gauss_newton, whitened
from jaxbody.fitting.residuals import Task, options_of, residual_and_jacobian

# smallest decrease of the cost that counts as an improvement, relative to the expected decrease
SIGNIFICANT = 0.01
FLAT = 0.02  # gradient norm, relative to the first, below which the coordinates are whitened again
# decrease of the cost, relative to the expected one, after which the coordinates are whitened again
SUFFICIENT = 0.75
FARTHEST = 0.7  # largest change of u for one unit of y: a factor of two for a positive parameter
MAX_RESTARTS = 100
MAX_INNER = 80
PATIENCE = 25  # evaluations without an improvement
FAILED = 1e6  # cost of a trial that cannot be simulated, where the expected decrease is 1/2


class WhitenedCoordinates(NamedTuple):
    """u = origin + unwhiten y; costs are counted from |r0|^2/2 at the origin, in units
    of size^2."""

    origin: Float[Array, "n"]
    unwhiten: Float[Array, "n m"]
    r0: Float[Array, "r"]
    size: Float[Array, ""]

    def value_and_gradient(self, r, J) -> tuple[Array, Array]:
        """The cost, by (r - r0)'(r + r0)/2 without cancellation, and its gradient W'J'r."""
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
    """y and the state of the optimizer after one step from y, where the cost has this value
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
    """The state of the optimizer at y."""
    return optimizer.init(y)


def by_optax(
    evaluate: Evaluations, task: Task, u, optimizer: Any, limits: Bounds
) -> tuple[np.ndarray, bool]:
    """The optimizer in whitened coordinates, restarted from the best point until the Gauss-Newton
    step is small.

    Within about a hundredth of a standard error, integration errors make the cost too rough to
    descend; there Gauss-Newton steps take over, which do not use the cost."""
    u, reach = np.asarray(u), 1.0
    for _ in range(MAX_RESTARTS):
        r0 = evaluate(u)[0]
        projected, S, V = whitened(evaluate.triangle(u))
        step = np.abs(V @ (projected / S)).max(initial=0.0)
        if step <= NEAR:
            return gauss_newton(evaluate, u, True, limits)
        if evaluate.exhausted or reach < 1e-6:
            break
        # of the distance to the linearized optimum that is one unit of y
        fraction = reach * min(1.0, FARTHEST / step)
        size = fraction * np.linalg.norm(projected)
        at = WhitenedCoordinates(u, V * (size / S), r0, np.asarray(size))
        y = _descend(evaluate, task, optimizer, at, sufficient=-SUFFICIENT * (1 / fraction - 0.5))
        u, reach = (u, reach / 10) if y is None else (u + at.unwhiten @ y, min(1.0, 10 * reach))
    return u, False


def _descend(
    evaluate: Evaluations, task: Task, optimizer: Any, at: WhitenedCoordinates, sufficient: float
) -> np.ndarray | None:
    """The best y of the optimizer from 0, or None without a significant decrease of the cost."""
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
