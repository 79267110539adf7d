"""Sine and cosine by vector arithmetic: many values at once in lanes, where calls of the C library
would compute one after another.

    x = n pi/2 + r, |r| <= pi/4:    sin r = r + r^3 S(r^2),    cos r = 1 - r^2/2 + r^4 C(r^2),
    exchanged and signed by n mod 4

n pi/2 is subtracted in three parts. The first two have 33 bits, so that their products with n are
exact for |x| < 1.6e6; the rounding error of r is kept as a correction. Beyond that the error grows
as the rounding of x does. Source of the reduction: W. J. Cody, W. Waite, Software Manual for the
Elementary Functions (1980); the polynomials are minimax (Remez), within 4e-18.
"""

from typing import Any

import jax
import jax.numpy as jnp

from jaxbody.core.arrays import Array, Float

HALF_PI = (1.5707963267341256, 6.077100506303966e-11, 2.0222662487959506e-21)
S = [
    -0.16666666666666632, 0.008333333333322401, -0.0001984126982979792,
    2.7557313688378045e-06, -2.505075754440838e-08, 1.5896761631460063e-10,
]  # fmt: skip
C = [
    0.0416666666666666, -0.001388888888887411, 2.480158728947261e-05,
    -2.755731434942852e-07, 2.0875722861280806e-09, -1.1359625646983016e-11,
]  # fmt: skip


def root(x: Float[Array, "*n"], degree: int = 2) -> Float[Array, "*n"]:
    """Return the square root of x, or the root of another degree; zero, with a derivative of zero,
    for x <= 0."""
    positive = x > 0
    known = jnp.where(positive, x, 1.0)
    known = jnp.sqrt(known) if degree == 2 else known ** (1 / degree)
    return jnp.where(positive, known, jnp.where(jnp.isnan(x), x, 0.0))


def polynomial(coefficients: Any, x: Any) -> Any:
    """Return sum c_n x^n by Horner's rule."""
    total = coefficients[-1]
    for n in range(len(coefficients) - 2, -1, -1):
        total = total * x + coefficients[n]
    return total


@jax.custom_jvp
def sincos(x: Float[Array, "*n"]) -> tuple[Float[Array, "*n"], Float[Array, "*n"]]:
    """Return sin x and cos x, within 1 ulp; NaN where x is not finite. In float32 these are XLA's
    own functions.

    >>> s, c = sincos(jnp.array(1e5))
    >>> abs(float(s) - 0.035748797972016508) < 1e-17
    True
    """
    if x.dtype != jnp.float64:
        return jnp.sin(x), jnp.cos(x)
    n = jnp.round(x * (2 / jnp.pi))
    r, rest = x - n * HALF_PI[0], jnp.zeros_like(x)
    for part in HALF_PI[1:]:
        part, before = n * part, r
        r = before - part
        rest = rest + ((before - r) - part)
    # only exceeded where x is too large for the reduction
    r, rest = jnp.clip(r, -0.8, 0.8), jnp.clip(rest, -1e-15, 1e-15)
    z = r * r
    s = r + (rest * (1 - z / 2) + z * r * polynomial(S, z))
    half = z / 2
    w = 1 - half
    c = w + (((1 - w) - half) + (z * z * polynomial(C, z) - r * rest))
    turn = n - 4 * jnp.floor(n / 4)
    odd = (turn == 1) | (turn == 3)
    s, c = jnp.where(odd, c, s), jnp.where(odd, s, c)
    return jnp.where(turn >= 2, -s, s), jnp.where((turn == 1) | (turn == 2), -c, c)


@sincos.defjvp
def _sincos_jvp(primals, tangents):
    (x,), (dx,) = primals, tangents
    s, c = sincos(x)
    return (s, c), (c * dx, -s * dx)
