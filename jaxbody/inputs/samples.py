"""Samples in time: cells, slopes and curvatures of cubic splines, and the kinks of functions of time."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxbody.core.arrays import Array, Float, concrete


def kinks_of(functions: Iterable[Any]) -> Array | None:
    """The kinks of several functions of time, in order."""
    known = [kinks for function in functions if (kinks := function.kinks()) is not None]
    return jnp.sort(jnp.concatenate(known)) if known else None


def cell(times: Float[Array, "n"], uniform: bool, t: Float[Array, ""]):
    """The index i of the sample before t, the distance to the next one, and the weights a, b of both."""
    n = times.shape[0]
    if uniform:
        i = jnp.floor((t - times[0]) / (times[-1] - times[0]) * (n - 1)).astype(int)
    else:
        i = jnp.searchsorted(times, jax.lax.stop_gradient(t), side="right", method="scan_unrolled") - 1
    i = jnp.clip(i, 0, n - 2)
    h = times[i + 1] - times[i]
    return i, h, (times[i + 1] - t) / h, (t - times[i]) / h


def is_uniform(times) -> bool:
    """Whether times are equally spaced; False where they are traced."""
    known = concrete(times)
    if known is None:
        return False
    n = len(known)
    grid = known[0] + (known[-1] - known[0]) * np.arange(n) / (n - 1)
    return bool(np.abs(known - grid).max() < 1e-9 * (known[-1] - known[0]) / (n - 1))


@jax.jit
def curvatures(t: Float[Array, "n"], y: Float[Array, "n k"]) -> Float[Array, "n k"]:
    """Second derivatives at the knots: h_{i-1} m_{i-1} + 2 (h_{i-1} + h_i) m_i + h_i m_{i+1} = 6 (d_i - d_{i-1}), d the slopes of the
    chords; at the ends 2 h m_0 + h m_1 = 6 (d_0 - s_0), s the slope of the cubic through four samples."""
    h = jnp.diff(t)
    d = jnp.diff(y, axis=0) / h[:, None]
    zero = jnp.zeros(1, t.dtype)
    diagonal = 2 * (jnp.concatenate([zero, h]) + jnp.concatenate([h, zero]))
    right = 6 * jnp.concatenate([d[:1] - _end_slope(t[:4], y[:4]), jnp.diff(d, axis=0), _end_slope(t[::-1][:4], y[::-1][:4]) - d[-1:]])
    return jax.lax.linalg.tridiagonal_solve(jnp.concatenate([zero, h]), diagonal, jnp.concatenate([h, zero]), right)


def _end_slope(t: Float[Array, "4"], y: Float[Array, "4 k"]) -> Float[Array, "1 k"]:
    """Slope at t_0 of the cubic through four points, by Newton's divided differences."""
    d1 = jnp.diff(y, axis=0) / jnp.diff(t)[:, None]
    d2 = jnp.diff(d1, axis=0) / (t[2:] - t[:-2])[:, None]
    d3 = jnp.diff(d2, axis=0) / (t[3] - t[0])
    a, b = t[0] - t[1], t[0] - t[2]
    return d1[:1] + a * d2[:1] + a * b * d3
