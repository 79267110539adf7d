"""Eigenvalues of many symmetric matrices at once, for batches in lanes; LAPACK would solve one
after another.

Householder's reflections   A <- H A H, H = 1 - beta v v', until A is tridiagonal
                            with d on and sqrt(e) beside the diagonal
QL without square roots     rotations with Wilkinson's shift sigma, from the end of d upwards, until
                            e vanishes
Sylvester's law of inertia  as many eigenvalues are below x as pivots
                            q_i = d_i - x - e_{i-1}/q_{i-1} are negative

Source: B. N. Parlett, The Symmetric Eigenvalue Problem (1998), 3.3, 7.4, 7.6, 8.14 and 8.15; the
second method is by Pal, Walker and Kahan.
"""

import jax.numpy as jnp
import numpy as np
from jax import lax

from jaxbody.core.arrays import Array, Float, Int
from jaxbody.numerics.xla_workarounds import any_of_batch

SWEEPS = 30  # most sweeps for each eigenvalue; three are usual


def eigenvalues(A: Float[Array, "n n"]) -> Float[Array, "n"]:
    """Return the eigenvalues in ascending order; NaN where A is not finite."""
    size = _size(A)
    return size * _ascending(_diagonalized(*_tridiagonal(A / size)))


def number_below(A: Float[Array, "n n"], x: Float[Array, "m"]) -> Int[Array, "m"]:
    """Return the number of eigenvalues below each x, by loops without LAPACK, which would split a
    compiled program."""
    size = _size(A)
    (d, e), x = _tridiagonal(A / size), x / size
    e_before = jnp.concatenate([jnp.zeros_like(e[:1]), e[:-1]])

    def pivot(i, state):
        q, count = state
        q = _at(d, i) - x - _at(e_before, i) / jnp.where(q == 0, jnp.finfo(d.dtype).tiny, q)
        return q, count + (q < 0).astype(count.dtype)

    return lax.fori_loop(0, len(A), pivot, (jnp.ones_like(x), jnp.zeros(x.shape, int)))[1]


def _size(A: Float[Array, "n n"]) -> Float[Array, ""]:
    size = jnp.max(jnp.abs(A), initial=0.0)
    return jnp.where(size > 0, size, 1.0)


def _tridiagonal(A: Float[Array, "n n"]) -> tuple[Float[Array, "n"], Float[Array, "n"]]:
    """Return d and e of the tridiagonal form; e ends with a zero."""
    row = np.arange(len(A))

    def reflect(k, A):
        x = jnp.where(row > k, _at(A, k), 0.0)
        first, length = _at(x, k + 1), jnp.sqrt(jnp.sum(x * x))
        v = jnp.where(row == k + 1, first + jnp.where(first < 0, -length, length), x)
        beta = _inverse_unless_zero(length * (length + jnp.abs(first)))  # 2/v'v
        p = beta * jnp.sum(A * v[None], 1)
        w = p - beta / 2 * jnp.sum(p * v) * v
        return A - v[:, None] * w[None] - w[:, None] * v[None]

    A = lax.fori_loop(0, len(A) - 2, reflect, A)
    return jnp.sum(jnp.where(row[:, None] == row, A, 0.0), 1), jnp.sum(
        jnp.where(row[:, None] + 1 == row, A * A, 0.0), 1
    )


def _diagonalized(d: Float[Array, "n"], e: Float[Array, "n"]) -> Float[Array, "n"]:
    """Return d, the eigenvalues, after sweeps until e vanishes. All matrices of a batch are swept
    until the last of them has converged."""
    n = len(d)

    def settled(d, e):
        """Return e with zeros for round-off, and the index of its first nonzero."""
        next_d = jnp.concatenate([d[1:], jnp.zeros_like(d[:1])])
        e = jnp.where(e <= jnp.finfo(d.dtype).eps ** 2 * jnp.abs(d * next_d), 0.0, e)
        left = any_of_batch(e > 0)
        return e, jnp.where(jnp.any(left), jnp.argmax(left), n)

    def sweep(state):
        d, e, first, count = state
        half = (_at(d, first + 1) - _at(d, first)) / 2
        root = jnp.sqrt(half * half + _at(e, first))
        sigma = _at(d, first) - _at(e, first) * _inverse_unless_zero(
            half + jnp.where(half < 0, -root, root)
        )

        def turn(k, state):
            d, e, c, s, gamma, p = state
            i = n - 2 - k
            r = p + _at(e, i)
            e = _put(e, s * r, i + 1)
            inverse = _inverse_unless_zero(r)
            c_before, c, s = c, jnp.where(r == 0, 1.0, p * inverse), _at(e, i) * inverse
            gamma_before, gamma = gamma, c * (_at(d, i) - sigma) - s * gamma
            d = _put(d, gamma_before + _at(d, i) - gamma, i + 1)
            return (
                d,
                e,
                c,
                s,
                gamma,
                jnp.where(c == 0, c_before * _at(e, i), gamma * gamma * _inverse_unless_zero(c)),
            )

        gamma = d[-1] - sigma
        turned = (d, e, jnp.ones_like(sigma), jnp.zeros_like(sigma), gamma, gamma * gamma)
        d, e, _, s, gamma, p = lax.fori_loop(0, n - 1 - first, turn, turned)
        d = _put(d, sigma + gamma, first)
        return (d, *settled(d, _put(e, s * p, first)), count + 1)

    start = (d, *settled(d, e), jnp.zeros((), int))
    d, e, _, _ = lax.while_loop(
        lambda state: (state[2] < n) & (state[3] < SWEEPS * n), sweep, start
    )
    return jnp.where(jnp.all(e == 0), d, jnp.nan)


def _ascending(d: Float[Array, "n"]) -> Float[Array, "n"]:
    """Return the numbers sorted, each placed by the number of smaller ones; NaN everywhere if one
    is NaN."""
    i = np.arange(len(d), dtype=d.dtype)
    before = (d[:, None] < d[None]) | ((d[:, None] == d[None]) & (i[:, None] < i))
    rank = jnp.sum(before.astype(d.dtype), 0)
    return jnp.sum(jnp.where(rank[None] == i[:, None], d, 0 * d), 1)


def _inverse_unless_zero(x: Array) -> Array:
    return jnp.where(x == 0, 0.0, 1 / jnp.where(x == 0, 1.0, x))


def _at(x: Array, i) -> Array:
    return lax.dynamic_index_in_dim(x, i, 0, keepdims=False)


def _put(x: Array, value: Array, i) -> Array:
    return lax.dynamic_update_index_in_dim(x, value, i, 0)
