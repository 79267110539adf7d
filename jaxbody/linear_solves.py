"""Small symmetric positive definite systems, without a call into LAPACK, which would break a compiled loop."""

from __future__ import annotations

import jax.numpy as jnp
import jax.scipy.linalg
from jaxtyping import Array, Float

LARGEST_UNROLLED = 30


def solve_spd(A: Float[Array, "n n"], b: Float[Array, "n"]) -> Float[Array, "n"]:
    """x with A x = b for symmetric positive definite A; NaN or inf where A is singular."""
    n = A.shape[-1]
    if n > LARGEST_UNROLLED:
        return jax.scipy.linalg.cho_solve(jax.scipy.linalg.cho_factor(A, lower=True), b)
    Ab = jnp.concatenate([A, b[:, None]], -1)
    for i in range(n):  # Gauss-Jordan: clear column i from all other rows
        row = Ab[i] / Ab[i, i]
        factors = Ab[:, i] * (jnp.arange(n) != i)
        Ab = jnp.where((jnp.arange(n) == i)[:, None], row, Ab - factors[:, None] * row)
    return Ab[:, -1]
