"""Delay and first-order lag of an instrument, for records at any increasing times.

Between samples a record x is the polynomial through the twelve nearest ones. For a sine at a tenth
of the sampling rate the error is 2e-7 of its amplitude, five samples or more from the ends; at a
fifth of the rate it is 1e-3.
"""

from __future__ import annotations

from math import factorial

import jax
import jax.numpy as jnp
import numpy as np

from jaxbody.core.arrays import Array, Float, Int

POINTS = 12  # of the polynomial
# in a cell: where the integral of the lag samples x
NODES = (1 - np.cos(np.pi * np.arange(6) / 5)) / 2
# h/T below which moments come from their series, and its terms: 3^28/28! < 1e-16
SERIES, TERMS = 3.0, 28


def between(
    times: Float[Array, "n"], x: Float[Array, "n k"], cells: Int[Array, "m"], t: Float[Array, "m q"]
) -> Float[Array, "m q k"]:
    """x at times t in (or near) cells, cell i from times[i] to times[i + 1], by
    Lagrange's formula."""
    n = len(times)
    points = min(POINTS, n)
    first = jnp.clip(cells - (points // 2 - 1), 0, n - points)
    near = first[:, None] + np.arange(points, dtype=first.dtype)[None]
    nodes = times[near]
    span = nodes[:, -1:] - nodes[:, :1]
    apart = (nodes[:, :, None] - nodes[:, None]) / span[..., None]
    below = jnp.prod(jnp.where(np.eye(points, dtype=bool)[None], 1.0, apart), -1)[:, None]
    away = (t[:, :, None] - nodes[:, None]) / span[..., None]
    # products of the factors before and after each node
    left, right = [jnp.ones_like(t)], [jnp.ones_like(t)]
    for j in range(points - 1):
        left.append(left[-1] * away[..., j])
        right.append(right[-1] * away[..., points - 1 - j])
    weights = jnp.stack([a * b for a, b in zip(left, reversed(right), strict=True)], -1) / below
    return jnp.sum(weights[..., None] * x[near][:, None], 2)


def delayed(
    times: Float[Array, "n"], x: Float[Array, "n *r"], tau: Float[Array, ""]
) -> Float[Array, "n *r"]:
    """x(t - tau); the polynomials of the first and last cell extrapolate by at most one sample."""
    t = jnp.clip(times - tau, 2 * times[0] - times[1], 2 * times[-1] - times[-2])
    cells = jnp.clip(jnp.searchsorted(times, t, side="right") - 1, 0, len(times) - 2)
    return between(times, x.reshape(len(times), -1), cells, t[:, None])[:, 0].reshape(x.shape)


def known(times: Float[Array, "n"], tau: Float[Array, ""]) -> Float[Array, "n"]:
    """The weight of a delayed sample: 1 where t - tau lies in the record, 0 more than a sample
    outside, linear between."""
    t = times - tau
    before, after = (
        (times[0] - t) / (times[1] - times[0]),
        (t - times[-1]) / (times[-1] - times[-2]),
    )
    return jnp.clip(1 - jnp.maximum(before, after), 0.0, 1.0)


def lagged(
    times: Float[Array, "n"],
    x: Float[Array, "n *r"],
    T: Float[Array, ""],
    start: Float[Array, "*r"],
) -> Float[Array, "n *r"]:
    """The solution y of T y' + y = x, y(t_0) = start, which is exact for the polynomials through x:

    y(t + h) = e^-z y(t) + sum_q W_q(z) x(t + s_q h),   W_q = z int_0^1 e^-z(1 - s) l_q(s) ds,
    z = h/T
    """
    n = len(times)
    h = jnp.diff(times)
    inside = between(
        times, x.reshape(n, -1), jnp.arange(n - 1), times[:-1, None] + NODES[None] * h[:, None]
    )
    z = h / T
    drive = jnp.sum(_weights(z)[..., None] * inside, 1)

    def step(y, cell):
        y = cell[0] * y + cell[1]
        return y, y

    y0 = jnp.broadcast_to(start, x.shape[1:]).reshape(-1)
    _, rest = jax.lax.scan(step, y0, (jnp.exp(-z), drive), unroll=8)
    return jnp.concatenate([y0[None], rest]).reshape(x.shape)


def _weights(z: Float[Array, "m"]) -> Float[Array, "m q"]:
    """W_q(z), exact for powers s^k, whose moments are m_k = z int_0^1 e^-z(1 - s) s^k ds. For small
    z these come from their series m_k = z e^-z sum z^n/(n! (n + k + 1)), for larger z from the
    recursion m_k = 1 - k m_(k-1)/z, because each would lose digits where the other is used."""
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
    return jnp.sum(moments[:, None] * np.linalg.inv(powers)[None], -1)
