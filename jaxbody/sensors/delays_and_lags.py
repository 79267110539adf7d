"""What an instrument makes of what it measures, sample by sample: a delay and a lag of first order, for records on any increasing times.

Between samples a record x is the polynomial through the twelve nearest ones. For a sine at a tenth of the sampling rate that is wrong by
2e-7 of its amplitude, five samples from the ends; at a fifth by 1e-3.
"""

from __future__ import annotations

from math import factorial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

POINTS = 12  # of the polynomial
NODES = (1 - np.cos(np.pi * np.arange(6) / 5)) / 2  # in a cell, where x is taken for the integral of the lag
SERIES, TERMS = 3.0, 28  # h/T below which moments come from their series, and its terms: 3^28/28! < 1e-16


def between(times: Float[Array, "n"], x: Float[Array, "n k"], cells: Int[Array, "m"], t: Float[Array, "m q"]) -> Float[Array, "m q k"]:
    """x at times t in (or about) cells, cell i from times[i] to times[i + 1], by Lagrange's formula."""
    n = len(times)
    points = min(POINTS, n)
    first = jnp.clip(cells - (points // 2 - 1), 0, n - points)
    near = first[:, None] + np.arange(points)
    nodes = times[near]
    span = nodes[:, -1:] - nodes[:, :1]
    apart = (nodes[:, :, None] - nodes[:, None]) / span[..., None]
    below = jnp.prod(jnp.where(np.eye(points, dtype=bool), 1.0, apart), -1)[:, None]
    away = (t[:, :, None] - nodes[:, None]) / span[..., None]
    left, right = [jnp.ones_like(t)], [jnp.ones_like(t)]  # products of what stands before and after each node
    for j in range(points - 1):
        left.append(left[-1] * away[..., j])
        right.append(right[-1] * away[..., points - 1 - j])
    weights = jnp.stack([a * b for a, b in zip(left, reversed(right), strict=True)], -1) / below
    return jnp.sum(weights[..., None] * x[near][:, None], 2)


def delayed(times: Float[Array, "n"], x: Float[Array, "n *r"], tau: Float[Array, ""]) -> Float[Array, "n *r"]:
    """x(t - tau), from the polynomials of the first and last cell at most one sample beyond the record."""
    t = jnp.clip(times - tau, 2 * times[0] - times[1], 2 * times[-1] - times[-2])
    cells = jnp.clip(jnp.searchsorted(times, t, side="right") - 1, 0, len(times) - 2)
    return between(times, x.reshape(len(times), -1), cells, t[:, None])[:, 0].reshape(x.shape)


def known(times: Float[Array, "n"], tau: Float[Array, ""]) -> Float[Array, "n"]:
    """1 where t - tau lies in the record, 0 where more than a sample outside, a straight line between: the weight of a delayed sample."""
    t = times - tau
    before, after = (times[0] - t) / (times[1] - times[0]), (t - times[-1]) / (times[-1] - times[-2])
    return jnp.clip(1 - jnp.maximum(before, after), 0.0, 1.0)


def lagged(times: Float[Array, "n"], x: Float[Array, "n *r"], T: Float[Array, ""], start: Float[Array, "*r"]) -> Float[Array, "n *r"]:
    """y of T y' + y = x, y(t_0) = start, exactly for the polynomials through x:

    y(t + h) = e^-z y(t) + sum_q W_q(z) x(t + s_q h),   W_q = z int_0^1 e^-z(1 - s) l_q(s) ds,   z = h/T
    """
    n = len(times)
    h = jnp.diff(times)
    inside = between(times, x.reshape(n, -1), jnp.arange(n - 1), times[:-1, None] + NODES * h[:, None])
    z = h / T
    given = jnp.sum(_weights(z)[..., None] * inside, 1)

    def step(y, cell):
        y = cell[0] * y + cell[1]
        return y, y

    y0 = jnp.broadcast_to(start, x.shape[1:]).reshape(-1)
    _, rest = jax.lax.scan(step, y0, (jnp.exp(-z), given), unroll=8)
    return jnp.concatenate([y0[None], rest]).reshape(x.shape)


def _weights(z: Float[Array, "m"]) -> Float[Array, "m q"]:
    """W_q(z), which integrate powers of s as their moments m_k = z int_0^1 e^-z(1 - s) s^k ds do: m_k = z e^-z sum z^n/(n! (n + k + 1))
    and m_k = 1 - k m_(k-1)/z, the one where the other loses digits."""
    near, far = jnp.minimum(z, SERIES), jnp.maximum(z, SERIES)
    series, recursion = [], [-jnp.expm1(-far)]
    for k in range(len(NODES)):
        total = jnp.zeros_like(z)
        for n in reversed(range(TERMS)):
            total = total * near + 1 / (factorial(n) * (n + k + 1))
        series.append(near * jnp.exp(-near) * total)
        recursion.append(1 - (k + 1) / far * recursion[-1])
    moments = jnp.where(z[:, None] < SERIES, jnp.stack(series, -1), jnp.stack(recursion[:-1], -1))
    powers = NODES[None] ** np.arange(len(NODES))[:, None]
    return jnp.sum(moments[:, None] * np.linalg.inv(powers), -1)
