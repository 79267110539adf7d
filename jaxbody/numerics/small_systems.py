"""Small systems of equations: symmetric ones, solved without LAPACK, whose calls would split a compiled loop, and which rows depend."""

from __future__ import annotations

import jax.numpy as jnp
import jax.scipy.linalg
import numpy as np
from jax import lax

from jaxbody.core.arrays import Array, Bool, Float
from jaxbody.numerics.xla_workarounds import kept

LARGEST_UNROLLED = 30
DEPENDENT = 1e-8  # of the longest row


def solve_spd(A: Float[Array, "n n"], b: Float[Array, "n"]) -> Float[Array, "n"]:
    """x with A x = b for symmetric positive definite A."""
    return solve_if_definite(A, b)[0]


def is_definite(A: Float[Array, "n n"]) -> Bool[Array, ""]:
    """Whether the symmetric A is positive definite: all pivots of an elimination are positive. As a loop it compiles faster than
    `solve_if_definite`."""

    def clear(k, carry):
        A, definite = carry
        row = lax.dynamic_index_in_dim(A, k, keepdims=False)
        pivot = lax.dynamic_index_in_dim(row, k, keepdims=False)
        return A - kept(row)[:, None] * kept(row / pivot)[None], definite & (pivot > 0)

    return lax.fori_loop(0, len(A), clear, (A, jnp.array(True)))[1]


def solve_if_definite(A: Float[Array, "n n"], b: Float[Array, "n"]) -> tuple[Float[Array, "n"], Bool[Array, ""]]:
    """x with A x = b, and whether the symmetric A is positive definite: all pivots of the elimination are positive."""
    n = A.shape[-1]
    if n > LARGEST_UNROLLED:
        factor = jnp.linalg.cholesky(A)
        return jax.scipy.linalg.cho_solve((factor, True), b), jnp.isfinite(factor).all()
    Ab = jnp.concatenate([A, b[:, None]], -1)
    pivots = []
    for i in range(n):  # Gauss-Jordan: eliminate the first column from all rows but i, and drop it
        pivots.append(Ab[i, 0])
        row = Ab[i, 1:] / Ab[i, 0]
        Ab = jnp.where((np.arange(n) == i)[:, None], row, Ab[:, 1:] - Ab[:, :1] * row[None])
    return kept(Ab[:, 0]), jnp.all(jnp.stack(pivots) > 0) if n else jnp.array(True)


def independent_rows(matrix: np.ndarray, *, enough: float = 1.0) -> list[int]:
    """The rows of a matrix of which the others are sums, in the order of elimination: each time the last one that is not shorter than
    `enough` of the longest, after the parts along those before are taken off."""
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
