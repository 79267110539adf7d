"""Small systems of equations, solved without LAPACK, whose calls would split a compiled program;
independent rows of a matrix."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import lax

from jaxbody.core.arrays import Array, Bool, Float

LARGEST_UNROLLED = 30
DEPENDENT = 1e-8  # length over that of the longest row below which the remaining rows are dependent
# length of a row over the longest, after its components along the other rows are removed; shorter
# rows are not solved for
SHORTEST = 1e-8


def solve_spd(A: Float[Array, "n n"], b: Float[Array, "n"]) -> Float[Array, "n"]:
    """Return x with A x = b for symmetric positive definite A."""
    return solve_if_definite(A, b)[0]


def is_definite(A: Float[Array, "n n"]) -> Bool[Array, ""]:
    """Return whether the symmetric A is positive definite: all pivots of an elimination are
    positive. As a loop it compiles faster than `solve_if_definite`."""

    def clear(k, carry):
        A, definite = carry
        row = lax.dynamic_index_in_dim(A, k, keepdims=False)
        pivot = lax.dynamic_index_in_dim(row, k, keepdims=False)
        return A - row[:, None] * (row / pivot)[None], definite & (pivot > 0)

    return lax.fori_loop(0, len(A), clear, (A, jnp.array(True)))[1]


def solve_if_definite(
    A: Float[Array, "n n"], b: Float[Array, "n"]
) -> tuple[Float[Array, "n"], Bool[Array, ""]]:
    """Return x with A x = b, and whether the symmetric A is positive definite: all pivots of the
    elimination are positive."""
    n = A.shape[-1]
    if n > LARGEST_UNROLLED:
        factor = jnp.linalg.cholesky(A)
        return _by_cholesky(factor, b[:, None])[:, 0], jnp.isfinite(factor).all()
    x, pivots = _gauss_jordan(A, b[:, None])
    return x[:, 0], jnp.all(jnp.stack(pivots) > 0) if n else jnp.array(True)


def _gauss_jordan(
    A: Float[Array, "n n"], B: Float[Array, "n m"]
) -> tuple[Float[Array, "n m"], list[Array]]:
    """Return X with A X = B, and the pivots of the elimination: for each row i, the first column is
    cleared in all other rows and dropped."""
    AB, pivots = jnp.concatenate([A, B], -1), []
    for i in range(len(A)):
        pivots.append(AB[i, 0])
        row = AB[i, 1:] / AB[i, 0]
        AB = jnp.where((np.arange(len(A)) == i)[:, None], row, AB[:, 1:] - AB[:, :1] * row[None])
    return AB, pivots


def _by_cholesky(L: Float[Array, "n n"], b: Float[Array, "n m"]) -> Float[Array, "n m"]:
    """Return x with L L' x = b."""
    return lax.linalg.triangular_solve(
        L,
        lax.linalg.triangular_solve(L, b, left_side=True, lower=True),
        left_side=True,
        lower=True,
        transpose_a=True,
    )


def solve(A: Float[Array, "n n"], b: Float[Array, "n"]) -> Float[Array, "n"]:
    """Return x with A x = b, by elimination with partial pivoting; not finite where A is
    singular."""
    if not 0 < len(A) <= LARGEST_UNROLLED:
        return jnp.linalg.solve(A, b)
    known = lax.stop_gradient(A)
    return lax.custom_linear_solve(
        lambda x: times(A, x),
        b,
        lambda _, b: _eliminated(known, b),
        lambda _, b: _eliminated(known.T, b),
    )


def _eliminated(A: Float[Array, "n n"], b: Float[Array, "n"]) -> Float[Array, "n"]:
    """Return x with A x = b: each column is cleared in all rows but that of its pivot; rows are not
    exchanged."""
    n = len(A)

    def clear(k, carry):
        Ab, place = carry  # place[i]: the column whose pivot is in row i, n before there is one
        column = lax.dynamic_index_in_dim(Ab, k, 1, keepdims=False)
        best = jnp.argmax(jnp.where(place == n, jnp.abs(column), -1.0))
        row = lax.dynamic_index_in_dim(Ab, best, keepdims=False)
        row = row / lax.dynamic_index_in_dim(row, k, keepdims=False)
        chosen = np.arange(n) == best
        return jnp.where(chosen[:, None], row[None], Ab - column[:, None] * row[None]), jnp.where(
            chosen, k, place
        )

    start = jnp.concatenate([A, b[:, None]], 1), jnp.full(n, n)
    Ab, place = lax.fori_loop(0, n, clear, start)
    return jnp.sum(jnp.where(place[None] == np.arange(n)[:, None], Ab[None, :, n], 0.0), 1)


def independent_rows(matrix: np.ndarray, *, enough: float = 1.0) -> list[int]:
    """Return the indices of independent rows of a matrix, of which all other rows are linear
    combinations, in the order of elimination.

    Each step projects all rows onto the space orthogonal to the rows chosen before, and chooses the
    last one whose length is at least `enough` times the largest."""
    rest, chosen, longest = np.array(matrix), [], 0.0
    for _ in range(min(rest.shape)):
        sizes = np.linalg.norm(rest, axis=1)
        longest = max(longest, sizes.max())
        if sizes.max() <= DEPENDENT * longest:
            break
        row = int(np.flatnonzero(sizes >= enough * sizes.max())[-1])
        chosen.append(row)
        along = rest[row] / sizes[row]
        rest -= np.outer(rest @ along, along)
        rest[row] = 0.0
    return chosen


class SaddlePoint(NamedTuple):
    """The factored matrix [M J'; J 0], with symmetric positive definite M.

    Some rows of J may be linear combinations of others: J has `rank` independent ones, found by
    orthonormalizing its rows in the metric of M^-1, the longest remaining first. `inverse`: M^-1,
    and `of_rows`: S with A S A = A for A = J M^-1 J', both constant in derivatives, which follow
    from the equations that the solution fulfills."""

    M: Float[Array, "n n"]
    J: Float[Array, "m n"]
    inverse: Float[Array, "n n"]
    of_rows: Float[Array, "m m"]

    def solve(
        self, f: Float[Array, "n"], g: Float[Array, "m"]
    ) -> tuple[Float[Array, "n"], Float[Array, "m"]]:
        """Return x and l with M x + J' l = f and J x = g."""
        n = len(f)

        def product(xl):
            x, l = xl[:n], xl[n:]
            return jnp.concatenate([times(self.M, x) + times(self.J.T, l), times(self.J, x)])

        def solution(_, fg):
            x = times(self.inverse, fg[:n])
            l = times(self.of_rows, times(self.J, x) - fg[n:])
            return jnp.concatenate([x - times(self.inverse, times(self.J.T, l)), l])

        xl = lax.custom_linear_solve(product, jnp.concatenate([f, g]), solution, symmetric=True)
        return xl[:n], xl[n:]


def saddle_point(M: Float[Array, "n n"], J: Float[Array, "m n"], rank: int) -> SaddlePoint:
    """Return [M J'; J 0] of a J with at most `rank` independent rows."""
    fixed_M, fixed_J = lax.stop_gradient((M, J))
    inverse = inverse_spd(fixed_M)
    combined = _orthonormal_rows(fixed_J, jnp.sum(fixed_J[:, None] * inverse[None], -1), rank)
    return SaddlePoint(M, J, inverse, jnp.sum(combined[:, :, None] * combined[:, None], 0))


def _orthonormal_rows(
    J: Float[Array, "m n"], D: Float[Array, "m n"], rank: int
) -> Float[Array, "rank m"]:
    """Return the combinations C of rows that are orthonormal, C J (C D)' = 1, with D = J M^-1; zero
    for missing rows."""
    m, n = J.shape

    def one(carry, _):
        rows, first = carry
        sizes = jnp.sum(rows[:, :n] * rows[:, n : 2 * n], -1)
        chosen = (jnp.arange(m) == jnp.argmax(sizes))[:, None]
        row = jnp.sum(jnp.where(chosen, rows, 0.0), 0)
        size = jnp.max(sizes)
        first = jnp.maximum(first, size)
        good = size > SHORTEST**2 * first
        unit = jnp.where(good, row / jnp.sqrt(jnp.where(good, size, 1.0)), 0.0)
        along = jnp.sum(rows[:, :n] * unit[None, n : 2 * n], -1)
        return (jnp.where(chosen, 0.0, rows - along[:, None] * unit[None]), first), unit[2 * n :]

    start = jnp.concatenate([J, D, jnp.eye(m, dtype=J.dtype)], -1), jnp.zeros((), J.dtype)
    return lax.scan(one, start, length=rank)[1]


def inverse_spd(A: Float[Array, "n n"]) -> Float[Array, "n n"]:
    """Return the inverse of a symmetric positive definite matrix."""
    one = jnp.eye(len(A), dtype=A.dtype)
    if len(A) > LARGEST_UNROLLED:
        return _by_cholesky(jnp.linalg.cholesky(A), one)
    return _gauss_jordan(A, one)[0]


def times(A: Float[Array, "m n"], x: Float[Array, "n"]) -> Float[Array, "m"]:
    """Return A x, as a sum."""
    return jnp.sum(A * x[None], -1)
