"""Products of 3-vectors and 3 x 3 matrices as sums, which are faster than matrix products
(numerics/xla_workarounds.py).

They are jitted, so that JAX traces and differentiates each of them once for all uses with arrays of
the same shapes."""

from typing import Any

import jax
import jax.numpy as jnp

from jaxbody.core.arrays import Array, Float

# squared length that counts as zero: below it the fifth power of 1/sqrt x in higher derivatives
# would overflow, and inf * 0 is NaN
NOTHING = 1e-80


@jax.jit
def dot(a: Float[Array, "*#n k"], b: Float[Array, "*#n k"]) -> Float[Array, "*#n"]:
    """Return a . b over the last axis."""
    return jnp.sum(a * b, -1)


@jax.jit
def cross(a: Float[Array, "*#n 3"], b: Float[Array, "*#n 3"]) -> Float[Array, "*#n 3"]:
    """Return a x b over the last axis."""
    return _next(a) * _previous(b) - _previous(a) * _next(b)


def _next(a: Array) -> Array:
    """Return (y, z, x)."""
    return jnp.concatenate([a[..., 1:], a[..., :1]], -1)


def _previous(a: Array) -> Array:
    """Return (z, x, y)."""
    return jnp.concatenate([a[..., 2:], a[..., :2]], -1)


@jax.jit
def rotate(R: Float[Array, "*#n 3 3"], a: Float[Array, "*#n 3"]) -> Float[Array, "*#n 3"]:
    """Return R a."""
    return jnp.sum(R * a[..., None, :], -1)


@jax.jit
def rotate_back(R: Float[Array, "*#n 3 3"], a: Float[Array, "*#n 3"]) -> Float[Array, "*#n 3"]:
    """Return R' a."""
    return jnp.sum(R * a[..., :, None], -2)


@jax.jit
def product(A: Float[Array, "*#n 3 3"], B: Float[Array, "*#n 3 3"]) -> Float[Array, "*#n 3 3"]:
    """Return A B."""
    return jnp.sum(A[..., :, :, None] * B[..., None, :, :], -2)


@jax.jit
def axial(A: Float[Array, "3 3"]) -> Float[Array, "3"]:
    """Return the vector a of the skew part [a] of a matrix: for a rotation, its axis times the sine
    of its angle."""
    return jnp.array([A[2, 1] - A[1, 2], A[0, 2] - A[2, 0], A[1, 0] - A[0, 1]]) / 2


@jax.jit
def skew(a: Float[Array, "*#n 3"]) -> Float[Array, "*#n 3 3"]:
    """Return [a], the matrix with [a] b = a x b."""
    x, y, z = a[..., 0], a[..., 1], a[..., 2]
    o = jnp.zeros_like(x)
    return jnp.stack(
        [jnp.stack([o, -z, y], -1), jnp.stack([z, o, -x], -1), jnp.stack([-y, x, o], -1)], -2
    )


def inverse_length(d: Float[Array, "*n k"]) -> Float[Array, "*n"]:
    """Return 1/|d| over the last axis, zero with zero derivatives where |d| is below 1e-40."""
    square = dot(d, d)
    some = square > NOTHING
    return jnp.where(some, jax.lax.rsqrt(jnp.where(some, square, 1.0)), 0.0)


def to_rank(a: Any, rank: int) -> Any:
    """Return a with axes of length one added at the front, up to `rank` axes, for arithmetic with
    the rows of a table."""
    return a.reshape((1,) * (rank - a.ndim) + a.shape)


@jax.jit
def inverse_of_three(A: Float[Array, "*#n 3 3"]) -> Float[Array, "*#n 3 3"]:
    """Return the inverse of symmetric A = [a, b, c]: [b x c, c x a, a x b] / (a . b x c)."""
    a, b, c = A[..., 0, :], A[..., 1, :], A[..., 2, :]
    rows = cross(b, c), cross(c, a), cross(a, b)
    return jnp.stack(rows, -2) / dot(a, rows[0])[..., None, None]


def length_and_direction(d: Float[Array, "3"]) -> tuple[Float[Array, ""], Float[Array, "3"]]:
    """Return |d| and d/|d|, both zero with zero derivatives at d = 0."""
    inverse = inverse_length(d)
    return dot(d, d) * inverse, d * inverse
