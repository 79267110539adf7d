"""SO(3): exponential, logarithm and unit quaternions, with exact derivatives up to the fourth at
zero rotation.

A rotation vector is phi, theta = |phi|; a quaternion is (w, x, y, z). Near theta = 0 every
coefficient is a power series in theta^2, because `where(theta < tiny, 1, sin(theta) / theta)`
has wrong second derivatives for rotations of 1e-11 to 1e-8. All functions are jitted, for the
reason given in geometry/vectors.py.
"""

from math import factorial

import jax
import jax.numpy as jnp
import numpy as np

from jaxbody.core.arrays import Array, Float
from jaxbody.geometry.vectors import cross, dot, product, skew, to_rank
from jaxbody.numerics.elementary_functions import polynomial, sincos

TERMS = 12  # of the power series in theta^2 < 1: 1e-16 up to the fourth derivative
SINC = [(-1) ** n / factorial(2 * n + 1) for n in range(TERMS)]  # sin(t)/t
COSC = [(-1) ** n / factorial(2 * n + 2) for n in range(TERMS)]  # (1 - cos(t))/t^2
COS = [(-1) ** n / factorial(2 * n) for n in range(TERMS)]
ATANC = [(-1) ** n / (2 * n + 1) for n in range(16)]  # atan(y)/y
# (1 - (t/2) cot(t/2)) / t^2 = sum of |B_2n| t^(2n-2) / (2n)!
BERNOULLI = [
    1 / 6,
    1 / 30,
    1 / 42,
    1 / 30,
    5 / 66,
    691 / 2730,
    7 / 6,
    3617 / 510,
    43867 / 798,
    174611 / 330,
    854513 / 138,
    236364091 / 2730,
]
COTC = [b / factorial(2 * n + 2) for n, b in enumerate(BERNOULLI)]


def _branches(x: Array, limit: float = 1.0) -> tuple[Array, Array, Array, Array]:
    """Return, for x = t^2: whether x is below the limit, so that a power series is used; x if it
    is, else 0; and x and t if it is not, else 1."""
    small = x < limit
    far = jnp.where(small, 1.0, x)
    return small, jnp.where(small, x, 0.0), far, jnp.sqrt(far)


@jax.jit
def _coefficients(x: Array) -> tuple[Array, Array]:
    """Return sin(t)/t and (1 - cos(t))/t^2 as functions of x = t^2."""
    small, near, far, t = _branches(x)
    sin, cos = sincos(t)
    return (
        jnp.where(small, polynomial(SINC, near), sin / t),
        jnp.where(small, polynomial(COSC, near), (1 - cos) / far),
    )


@jax.jit
def exp(phi: Float[Array, "*n 3"]) -> Float[Array, "*n 3 3"]:
    """Return the rotation matrix of a rotation vector, exp([phi]) = I + sin(t)/t [phi] + (1 -
    cos(t))/t^2 [phi]^2."""
    a, b = _coefficients(dot(phi, phi))
    P = skew(phi)
    return (
        to_rank(np.eye(3, dtype=P.dtype), P.ndim)
        + a[..., None, None] * P
        + b[..., None, None] * product(P, P)
    )


@jax.jit
def about(n: Float[Array, "*n 3"], angle: Float[Array, "*n"]) -> Float[Array, "*n 3 3"]:
    """Return the rotation matrix of a turn about a unit vector, I + sin(angle) [n] + (1 -
    cos(angle)) [n]^2."""
    N = skew(n)
    return (
        to_rank(np.eye(3, dtype=N.dtype), N.ndim)
        + jnp.sin(angle)[..., None, None] * N
        + (1 - jnp.cos(angle))[..., None, None] * product(N, N)
    )


@jax.jit
def left_jacobian(phi: Float[Array, "*n 3"]) -> Float[Array, "*n 3 3"]:
    """Return J with angular velocity = J(phi) dphi/dt for R = exp([phi]), in world axes."""
    x = dot(phi, phi)
    _, b = _coefficients(x)
    small, near, far, t = _branches(x)
    third = [(-1) ** n / factorial(2 * n + 3) for n in range(TERMS)]  # (t - sin(t))/t^3
    c = jnp.where(small, polynomial(third, near), (t - sincos(t)[0]) / (far * t))
    P = skew(phi)
    return (
        to_rank(np.eye(3, dtype=P.dtype), P.ndim)
        + b[..., None, None] * P
        + c[..., None, None] * product(P, P)
    )


@jax.jit
def exp_quaternion(phi: Float[Array, "*n 3"]) -> Float[Array, "*n 4"]:
    """Return the unit quaternion (cos(t/2), sin(t/2)/t phi) of a rotation vector."""
    small, near, _, t = _branches(dot(phi, phi) / 4)
    w = jnp.where(small, polynomial(COS, near), jnp.cos(t))
    s = jnp.where(small, polynomial(SINC, near), jnp.sin(t) / t)
    return jnp.concatenate([w[..., None], s[..., None] * phi / 2], -1)


@jax.jit
def log_quaternion(q: Float[Array, "*n 4"]) -> Float[Array, "*n 3"]:
    """Return the rotation vector with |phi| <= pi of a unit quaternion, 4 atan(y)/y (x, y, z)/(1 +
    w), y = tan(t/4)."""
    q = jnp.where(q[..., :1] < 0, -q, q)
    y = q[..., 1:] / (1 + q[..., :1])
    # angles below 1.03: sixteen terms of the series give 1e-18
    small, near, _, t = _branches(dot(y, y), 0.07)
    f = jnp.where(small, polynomial(ATANC, near), jnp.arctan(t) / t)
    return 4 * f[..., None] * y


@jax.jit
def log(R: Float[Array, "*n 3 3"]) -> Float[Array, "*n 3"]:
    """Return the rotation vector with |phi| <= pi of a rotation matrix."""
    return log_quaternion(from_matrix(R))


@jax.jit
def log_below_half_turn(R: Float[Array, "*n 3 3"]) -> Float[Array, "*n 3"]:
    """Return `log` for turns of less than pi, three times as fast. The error grows as 1/(pi -
    |phi|); at half a turn the result is NaN."""
    return log_quaternion(normalize(away_from_half_turn(R)))


@jax.jit
def away_from_half_turn(R: Float[Array, "*n 3 3"]) -> Float[Array, "*n 4"]:
    """Return (1 + tr R, skew part of R), which equals 4 w (w, x, y, z) for the unit quaternion; it
    is zero at half a turn."""
    trace = R[..., 0, 0] + R[..., 1, 1] + R[..., 2, 2]
    return jnp.stack(
        [
            1 + trace,
            R[..., 2, 1] - R[..., 1, 2],
            R[..., 0, 2] - R[..., 2, 0],
            R[..., 1, 0] - R[..., 0, 1],
        ],
        -1,
    )


@jax.jit
def cotc(x: Float[Array, "*n"]) -> Float[Array, "*n"]:
    """Return (1 - (t/2) cot(t/2))/t^2 as a function of x = t^2."""
    small, near, far, t = _branches(x)
    return jnp.where(small, polynomial(COTC, near), (1 - t / 2 / jnp.tan(t / 2)) / far)


@jax.jit
def inverse_left_jacobian(
    phi: Float[Array, "*n 3"], a: Float[Array, "*n 3"]
) -> Float[Array, "*n 3"]:
    """Return J^-1 a for the J of `left_jacobian`: a - phi x a/2 + (1 - (t/2) cot(t/2))/t^2 phi x
    (phi x a)."""
    turned = cross(phi, a)
    return a - turned / 2 + cotc(dot(phi, phi))[..., None] * cross(phi, turned)


@jax.jit
def multiply(p: Float[Array, "*#n 4"], q: Float[Array, "*#n 4"]) -> Float[Array, "*#n 4"]:
    """Return the quaternion product p q: the rotation q followed by p."""
    pw, pv, qw, qv = p[..., :1], p[..., 1:], q[..., :1], q[..., 1:]
    return jnp.concatenate(
        [pw * qw - jnp.sum(pv * qv, -1, keepdims=True), pw * qv + qw * pv + cross(pv, qv)], -1
    )


@jax.jit
def normalize(q: Float[Array, "*n 4"]) -> Float[Array, "*n 4"]:
    """Return q/|q|."""
    return q / jnp.sqrt(jnp.sum(q * q, -1, keepdims=True))


@jax.jit
def matrix(q: Float[Array, "*n 4"]) -> Float[Array, "*n 3 3"]:
    """Return the rotation matrix of a quaternion (w, u) of any length, I + 2 (w [u] +
    [u]^2)/|q|^2."""
    w, x, y, z = (q[..., i] for i in range(4))
    s = 2.0 / jnp.sum(q * q, -1)
    x2, y2, z2 = s * x, s * y, s * z
    xx, yy, zz, xy, xz, yz, wx, wy, wz = (
        x2 * x,
        y2 * y,
        z2 * z,
        x2 * y,
        x2 * z,
        y2 * z,
        x2 * w,
        y2 * w,
        z2 * w,
    )
    rows = (
        (1 - (yy + zz), xy - wz, xz + wy),
        (xy + wz, 1 - (xx + zz), yz - wx),
        (xz - wy, yz + wx, 1 - (xx + yy)),
    )
    return jnp.stack([jnp.stack(row, -1) for row in rows], -2)


@jax.jit
def from_matrix(R: Float[Array, "*n 3 3"]) -> Float[Array, "*n 4"]:
    """Return the unit quaternion of a rotation matrix, from its largest component (Shepperd, J.
    Guidance and Control 1 (1978) 223)."""
    a, b, c = R[..., 0, 0], R[..., 1, 1], R[..., 2, 2]
    four_squares = jnp.stack([1 + a + b + c, 1 + a - b - c, 1 - a + b - c, 1 - a - b + c], -1)
    largest = jnp.argmax(four_squares, -1)[..., None] == to_rank(np.arange(4), four_squares.ndim)
    root = jnp.sqrt(jnp.sum(jnp.where(largest, four_squares, 0.0), -1))
    x, y, z = R[..., 2, 1] - R[..., 1, 2], R[..., 0, 2] - R[..., 2, 0], R[..., 1, 0] - R[..., 0, 1]
    p, q, r = R[..., 0, 1] + R[..., 1, 0], R[..., 0, 2] + R[..., 2, 0], R[..., 1, 2] + R[..., 2, 1]
    w2, x2, y2, z2 = (four_squares[..., i] for i in range(4))
    rows = [[w2, x, y, z], [x, x2, p, q], [y, p, y2, r], [z, q, r, z2]]
    # four times the outer product of q with itself
    table = jnp.stack([jnp.stack(row, -1) for row in rows], -2)
    return jnp.sum(jnp.where(largest[..., :, None], table, 0.0), -2) / (2 * root[..., None])


@jax.jit
def quaternion_rate(q: Float[Array, "*n 4"], omega: Float[Array, "*n 3"]) -> Float[Array, "*n 4"]:
    """Return dq/dt = 1/2 (0, omega) q for an angular velocity in world axes."""
    return multiply(jnp.concatenate([jnp.zeros_like(omega[..., :1]), 0.5 * omega], -1), q)


@jax.jit
def quaternion_rate_body(
    q: Float[Array, "*n 4"], omega: Float[Array, "*n 3"]
) -> Float[Array, "*n 4"]:
    """Return dq/dt = 1/2 q (0, omega) for an angular velocity in body axes."""
    return multiply(q, jnp.concatenate([jnp.zeros_like(omega[..., :1]), 0.5 * omega], -1))
