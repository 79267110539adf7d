"""Collocation at Gauss points: a symplectic integrator, whose energy error does not grow over
many periods."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from diffrax import RESULTS, AbstractSolver, AbstractTerm, ThirdOrderHermitePolynomialInterpolation

from jaxbody.core.arrays import Array, Float
from jaxbody.core.errors import JaxbodyError, Problem

MOST_ITERATIONS = 100
# number of changes that are kept: each is compared with the one four iterations before, because
# positions and velocities alternate and in mixed units every other change is larger
LOOKED_BACK = 5
CONTRACTED = 1e-6  # largest ratio of the last change to the first that counts as converged
SQRT3, SQRT15 = 3**0.5, 15**0.5
GAUSS = {
    1: ([[1 / 2]], [1.0], [1 / 2]),
    2: (
        [[1 / 4, 1 / 4 - SQRT3 / 6], [1 / 4 + SQRT3 / 6, 1 / 4]],
        [1 / 2, 1 / 2],
        [1 / 2 - SQRT3 / 6, 1 / 2 + SQRT3 / 6],
    ),
    3: (
        [
            [5 / 36, 2 / 9 - SQRT15 / 15, 5 / 36 - SQRT15 / 30],
            [5 / 36 + SQRT15 / 24, 2 / 9, 5 / 36 - SQRT15 / 24],
            [5 / 36 + SQRT15 / 30, 2 / 9 + SQRT15 / 15, 5 / 36],
        ],
        [5 / 18, 4 / 9, 5 / 18],
        [1 / 2 - SQRT15 / 10, 1 / 2, 1 / 2 + SQRT15 / 10],
    ),
}  # A, b, c of 1, 2, 3 stages


class Gauss(AbstractSolver):
    """A solver for `simulate` with constant steps and a bounded energy error: without damping and
    excitation no trend over 1e5 periods.

        k_i = f(t + c_i h, y + h sum_j A_ij k_j),   y_new = y + h sum_i b_i k_i,
        order 2 * stages; 1 stage is the implicit midpoint rule

    `simulate` gives it Hamilton's equations, y = (q, p) with quaternions and their momenta
    (`canonical_equations`). For these it is symplectic and symmetric in time, so that the energy
    error stays bounded in chaotic motion too, over any number of turns. Quadratic invariants are
    kept to rounding: the length of quaternions, the energy of linear systems, momentum and angular
    momentum without external loads.

    Stages are iterated until their changes are round-off, which requires steps of less than 2 over
    the fastest rate [rad/s]; the status is NOT_CONVERGED where they do not converge. For vibrations
    start with 3 stages and steps of a tenth of the shortest period, or of a twentieth for bodies
    that turn over. Violent motion needs steps much shorter than the time in which the ends of a
    spring pass each other. For stiff models use diffrax.Kvaerno5() instead. Forward and reverse
    derivatives are supported.

    Error: BAD_VALUE unless stages is 1, 2 or 3.
    Source: Hairer, Lubich, Wanner, Geometric Numerical Integration, II.1.3, IV.2.1, VI.4, IX.8.

    >>> solver = jb.Gauss(stages=3)
    >>> # steps = dict(stepsize_controller=diffrax.ConstantStepSize(), dt0=period / 10)
    >>> # simulate(model, times, solver=solver, **steps)
    """

    stages: int = eqx.field(static=True, default=2)

    term_structure = AbstractTerm
    interpolation_cls = ThirdOrderHermitePolynomialInterpolation

    def __check_init__(self):
        if self.stages not in GAUSS:
            raise JaxbodyError(
                Problem(
                    "BAD_VALUE",
                    "Gauss.stages",
                    f"is {self.stages!r:.60}",
                    value=self.stages,
                    limit="1, 2 or 3",
                )
            )

    def order(self, terms) -> int:
        return 2 * self.stages

    def init(self, terms, t0, t1, y0, args) -> None:
        return None

    def step(self, terms, t0, t1, y0, args, solver_state, made_jump):
        A, b, c = (np.asarray(x) for x in GAUSS[self.stages])
        h = t1 - t0

        def slope(t, y):
            return terms.vf(t, y, args)

        def slopes(k: Float[Array, "stages ny"]) -> Float[Array, "stages ny"]:
            return jax.vmap(slope)(t0 + jnp.asarray(c, y0.dtype) * h, y0[None] + h * weighted(A, k))

        first = slope(t0, y0)
        k, settled = fixed_point(slopes, jnp.broadcast_to(first, (self.stages, *first.shape)))
        y1 = y0 + h * weighted(b, k)
        dense = dict(y0=y0, y1=y1, k0=h * first, k1=h * slope(t1, y1))
        result = RESULTS.where(settled, RESULTS.successful, RESULTS.nonlinear_divergence)  # pyright: ignore[reportArgumentType]  equinox's members
        return y1, None, dense, None, result

    def func(self, terms, t0, y0, args):
        return terms.vf(t0, y0, args)


def weighted(A: np.ndarray, k: Float[Array, "stages ny"]) -> Array:
    """Return A k, computed as a sum."""
    return jnp.sum(jnp.asarray(A, k.dtype)[..., None] * k[(None,) * (np.ndim(A) - 1)], -2)


def fixed_point(function, guess: Array) -> tuple[Array, Array]:
    """Solve x = function(x) by iteration until changes no longer decrease, and return x and whether
    they have decreased enough; derivatives by the implicit function theorem."""

    def change(x):
        return function(x) - x

    def search(_, x):
        def going(carry):
            _, sizes, n = carry
            return (n < len(sizes)) | (
                (sizes[0] > 0) & (sizes[0] < sizes[-1]) & (n < MOST_ITERATIONS)
            )

        def next_one(carry):
            x, sizes, n = carry
            new = function(x)
            return new, (jnp.max(jnp.abs(new - x)), *sizes[:-1]), n + 1

        return jax.lax.while_loop(
            going, next_one, (x, (jnp.asarray(jnp.inf, x.dtype),) * LOOKED_BACK, 0)
        )[0]

    def solve_linear(linear, right):
        matrix = jax.jacfwd(linear)(jnp.zeros_like(right)).reshape(right.size, right.size)
        return jnp.linalg.solve(matrix, right.ravel()).reshape(right.shape)

    x = jax.lax.custom_root(change, guess, search, solve_linear)
    left, first = (jnp.max(jnp.abs(jax.lax.stop_gradient(change(x)))) for x in (x, guess))
    return x, left <= CONTRACTED * first
