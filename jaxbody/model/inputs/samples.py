"""Functions through samples in time: checked rows, straight lines and cubic splines between them,
integrals of piecewise linear functions, and where records have kinks or become active."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxbody.core.arrays import Array, Float, concrete, float_array, module_of
from jaxbody.core.errors import Problems

# relative to the largest change of slope, or curvature: smaller ones count as none
STRAIGHT = 1e-9
FEW_SAMPLES = 4  # least number in a half of a record that is halved repeatedly
# relative to the range of a record: a spline is smooth where jumps of its third derivative add less
FINE = 1e-6
UNEVEN = 16  # ratio of the largest curvatures of two halves; a parabola through zero has 9


def checked_rows(
    value: Any, n: int | None, widths: tuple[int | str | None, ...], where: str, problems: Problems
) -> Any:
    """Return finite numbers, one row for each of n times, or for any number of times if n is None;
    None if they are not, with a problem added.

    `widths` of a row: a number, "k" for any number, None for one number instead of a row."""
    array = problems.gather(lambda: float_array(value, where))
    if array is None:
        return None
    width = {1: {None}, 2: {"k", array.shape[-1]}}.get(array.ndim, set()) if array.ndim else set()
    if not width & set(widths) or n not in (None, array.shape[0]):
        problems.add(
            "BAD_SHAPE",
            where,
            f"has shape {array.shape}",
            value=array.shape,
            limit=" or ".join(
                f"({n or 'n'},)" if width is None else f"({n or 'n'}, {width})" for width in widths
            ),
            hint=(
                "The array looks transposed."
                if array.ndim == 2 and array.shape[0] in widths
                else "One row per time."
            ),
        )
        return None
    known = concrete(array)
    if known is not None and not np.isfinite(known).all():
        row = int(np.argwhere(~np.isfinite(known))[0][0])
        problems.add(
            "NON_FINITE",
            where,
            f"is {known[row].tolist()} at row {row}",
            value=known[row],
            limit="finite",
            hint="Cut the record or fill the gap first.",
        )
        return None
    return array


def interpolated(samples: Any, t: Float[Array, ""]) -> Array:
    """Return the straight line a y_i + b y_{i+1} between `samples.values` y, plus h^2/6 ((a^3 - a)
    m_i + (b^3 - b) m_{i+1}) if they have `curvatures` m."""
    i, h, a, b = cell(samples.times, samples.uniform, t)
    y, m = samples.values, samples.curvatures
    line = a * y[i] + b * y[i + 1]
    return line if m is None else line + h**2 / 6 * ((a**3 - a) * m[i] + (b**3 - b) * m[i + 1])


def integrals(
    t: Float[Array, "n"], a: Float[Array, "n k"], x0: Any = 0.0, v0: Any = 0.0
) -> tuple[Any, Any]:
    """Return the integral v of a function that is linear between samples a, and the integral x of
    v, from their values v0 and x0 at the first time."""
    xp = module_of(a)
    h = xp.diff(t)[:, None]

    def summed(steps):
        return xp.concatenate([xp.zeros_like(steps[:1]), xp.cumsum(steps, 0)])

    v = v0 + summed(h * (a[1:] + a[:-1]) / 2)
    return v, x0 + summed(h * v[:-1] + h**2 * (2 * a[:-1] + a[1:]) / 6)


def cell(times: Float[Array, "n"], uniform: bool, t: Float[Array, ""]):
    """Return the index i of the sample before t, the distance h to the next one, and the weights a,
    b of both."""
    n = times.shape[0]
    if uniform:
        i = jnp.floor((t - times[0]) / (times[-1] - times[0]) * (n - 1)).astype(int)
    else:
        i = (
            jnp.searchsorted(times, jax.lax.stop_gradient(t), side="right", method="scan_unrolled")
            - 1
        )
    i = jnp.clip(i, 0, n - 2)
    h = times[i + 1] - times[i]
    return i, h, (times[i + 1] - t) / h, (t - times[i]) / h


def is_uniform(times) -> bool:
    """Return whether times are equally spaced; False if they are traced."""
    known = concrete(times)
    if known is None:
        return False
    n = len(known)
    grid = known[0] + (known[-1] - known[0]) * np.arange(n) / (n - 1)
    return bool(np.abs(known - grid).max() < 1e-9 * (known[-1] - known[0]) / (n - 1))


def kinks_between_lines(t: Float[Array, "n"], y: Float[Array, "n *k"]) -> Float[Array, "n"]:
    """Return the samples at which straight lines through samples have a kink; inf in place of the
    others."""
    y = y.reshape(len(y), -1)
    change = jnp.abs(jnp.diff(jnp.diff(y, axis=0) / jnp.diff(t)[:, None], axis=0))
    ends = jnp.ones(1, bool)
    bends = jnp.concatenate(
        [ends, jnp.any(change > STRAIGHT * jnp.max(change, 0, keepdims=True, initial=0), 1), ends]
    )
    return jnp.where(bends, t, jnp.inf)


def kinks_between_cubics(
    t: Float[Array, "n"], y: Float[Array, "n *k"], curvature: Float[Array, "n *k"]
) -> Float[Array, "_"]:
    """Return the samples at which the third derivative of a cubic spline jumps, and those at which
    a smooth record becomes far more or far less active; inf in place of the others. A method of
    high order takes up to ten steps to pass such a jump, half of which are rejected.

        h^3/6 |jump of d3y/dt3| > FINE (max y - min y)
    """
    y, m = (x.reshape(len(t), -1) for x in (y, curvature))
    jump, h = (
        jnp.diff(jnp.diff(m, axis=0) / jnp.diff(t)[:, None], axis=0),
        (t[2:] - t[:-2])[:, None] / 2,
    )
    rough = jnp.any(h**3 / 6 * jnp.abs(jump) > FINE * jnp.ptp(y, 0, keepdims=True), 1)
    return jnp.concatenate([jnp.where(rough, t[1:-1], jnp.inf), changes_of_activity(t, curvature)])


def changes_of_activity(t: Float[Array, "n"], curvature: Float[Array, "n *k"]) -> Float[Array, "_"]:
    """Return the samples at which a smooth record becomes far more or far less active; inf in place
    of the others. An integration step that ends there cannot miss a shock after a quiet part.

    The record is halved, each half again, and so on down to a few samples: the sample in the middle
    is returned if the largest curvatures of its two sides differ by more than the factor UNEVEN.
    The intervals between such samples become shorter towards a shock."""
    size = jnp.abs(curvature.reshape(len(t), -1))
    size = size + STRAIGHT * jnp.max(size, 0, keepdims=True)
    kinks, width = [], FEW_SAMPLES
    while width < len(t):
        halves = -(-len(t) // (2 * width))
        padded = jnp.concatenate(
            [size, jnp.broadcast_to(size[-1:], (2 * width * halves - len(t), size.shape[1]))]
        )
        left, right = jnp.moveaxis(jnp.max(padded.reshape(halves, 2, width, -1), 2), 1, 0)
        middle = np.minimum(width * (2 * np.arange(halves) + 1), len(t) - 1)
        uneven = jnp.any((left > UNEVEN * right) | (right > UNEVEN * left), 1)
        kinks.append(jnp.where(uneven, t[middle], jnp.inf))
        width *= 2
    return jnp.concatenate(kinks) if kinks else t[:0]


@jax.jit
def curvatures(t: Float[Array, "n"], y: Float[Array, "n *k"]) -> Float[Array, "n *k"]:
    """Return the second derivatives at the knots: h_{i-1} m_{i-1} + 2 (h_{i-1} + h_i) m_i + h_i
    m_{i+1} = 6 (d_i - d_{i-1}), d the slopes of the chords; at the ends 2 h m_0 + h m_1 = 6 (d_0 -
    s_0), s the slope of the cubic through four samples."""
    h, shape, y = jnp.diff(t), y.shape, y.reshape(len(y), -1)
    d = jnp.diff(y, axis=0) / h[:, None]
    zero = jnp.zeros(1, t.dtype)
    diagonal = 2 * (jnp.concatenate([zero, h]) + jnp.concatenate([h, zero]))
    right = 6 * jnp.concatenate(
        [
            d[:1] - _end_slope(t[:4], y[:4]),
            jnp.diff(d, axis=0),
            _end_slope(t[::-1][:4], y[::-1][:4]) - d[-1:],
        ]
    )
    return jax.lax.linalg.tridiagonal_solve(
        jnp.concatenate([zero, h]), diagonal, jnp.concatenate([h, zero]), right
    ).reshape(shape)


def _end_slope(t: Float[Array, "4"], y: Float[Array, "4 k"]) -> Float[Array, "1 k"]:
    """Return the slope at t_0 of the cubic through four points, by Newton's divided differences."""
    d1 = jnp.diff(y, axis=0) / jnp.diff(t)[:, None]
    d2 = jnp.diff(d1, axis=0) / (t[2:] - t[:-2])[:, None]
    d3 = jnp.diff(d2, axis=0) / (t[3] - t[0])
    a, b = t[0] - t[1], t[0] - t[2]
    return d1[:1] + a * d2[:1] + a * b * d3
