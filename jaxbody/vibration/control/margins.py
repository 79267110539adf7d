"""Margins of a loop L(s) = c (s - A)^-1 b + d with negative feedback: how much its gain, phase and
delay may change before it is unstable, and the peak of its sensitivity.

Gain and phase margins are at the frequencies where L is real, and where |L| = 1. These are zeros on
the imaginary axis of L(s) - L(-s) and of L(-s) L(s) - 1, generalized eigenvalues of

    [[A, 0, b], [0, -A', c'], [c, b', 0]]  and  [[A, 0, b], [-c'c, -A', -c'd], [d c, b', d^2 - 1]],

refined by Newton's method, whose last steps carry the derivatives. Sampled loops are those of the
frequency v with z = (1 + i v T/2)/(1 - i v T/2), so that w T/2 = atan(v T/2).
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from equinox import field

from jaxbody.core import tables
from jaxbody.core.arguments import positive_number
from jaxbody.core.arrays import Array, Float, Int
from jaxbody.core.compilation.compile_options import program
from jaxbody.core.errors import Problems, Status
from jaxbody.core.results import Result, warn_if_failed

NEAR = 1e-4  # relative distance of a root from the imaginary axis that rounding may cause
GRID, ZOOMS = 256, 9  # points in which a peak is sought, and how often it is looked at closer
STABLE = 1e-9  # growth, relative to the fastest pole, that counts as none


class Margins(Result):
    """Margins of one loop or of several `loops`, in rows: `gain`, the least factor above 1 that
    makes a loop unstable, `lower_gain`, the largest below 1, `phase` [rad], `delay` [s], and
    `sensitivity`, the peak of 1/|1 + L|, at the `frequencies` [Hz], in this order.

    A margin without limit is infinite (`lower_gain`: 0) and its frequency NaN; the frequency is
    infinite where the limit is that of L for high frequencies. `status`: UNSTABLE if the closed
    loop grows; the margins are then those of |L| = 1 and real L all the same."""

    gain: Float[Array, "*n"]
    lower_gain: Float[Array, "*n"]
    phase: Float[Array, "*n"]
    delay: Float[Array, "*n"]
    sensitivity: Float[Array, "*n"]
    frequencies: Float[Array, "*n 5"]
    status: Int[Array, "*n"]
    loops: tuple[str, ...] = field(static=True)

    def _tables(self) -> list[tables.PrintedTable]:
        each = (self.gain, self.lower_gain, self.phase, self.delay, self.sensitivity)
        rows, f = np.stack(each, -1).reshape(-1, 5), self.frequencies.reshape(-1, 5)
        lines = [
            (
                loop,
                *(
                    f"{x:.6g}" + f" at {at:.4g} Hz" * bool(at == at)
                    for x, at in zip(*pair, strict=True)
                ),
            )
            for loop, *pair in zip(self.loops, rows, f, strict=True)
        ]
        heads = ("loop", "gain", "lower gain", "phase [rad]", "delay [s]", "sensitivity")
        return [tables.PrintedTable("Margins", heads, lines, self.failure)]


def loop_margins(
    A: Float[Array, "n n"],
    b: Float[Array, "n"],
    c: Float[Array, "n"],
    d: Any = 0.0,
    *,
    every: Any = None,
) -> Margins:
    """Compute gain, phase and delay margins and peak sensitivity of a loop, closed by u = -y,

        L(s) = c (s - A)^-1 b + d.

    No grid limits their accuracy; first derivatives are exact.

    Args:
        A, b, c, d: the loop from u to y, of x' = A x + b u, or sampled x_next = A x + b u.
        every: time between samples [s]; by default continuous.

    Errors: BAD_NUMBER; warns UNSTABLE.

    >>> margins = jb.control.loop_margins(  # 4/(s + 1)^3
    ...     jnp.array([[-1.0, 1, 0], [0, -1, 1], [0, 0, -1]]),
    ...     jnp.array([0.0, 0, 4]),
    ...     jnp.array([1.0, 0, 0]),
    ... )
    >>> round(float(margins.gain), 9)
    2.0
    """
    with Problems() as problems:
        every = every if every is None else positive_number(every, "loop_margins.every", problems)
    return warn_if_failed(_loop_margins(A, b, c, d, every))


@program
def _loop_margins(A, b, c, d, every) -> Margins:
    return Margins(*of_loop(A, b, c, d, every), ("",))  # pyright: ignore[reportCallIssue]


def of_loop(A, b, c, d, every) -> tuple[Array, ...]:
    """Return the fields of Margins of one loop."""
    eye, zero, d = np.eye(len(A)), jnp.zeros_like(A), jnp.asarray(d, A.dtype)
    if every is not None:
        E = jnp.linalg.inv(A + eye)
        d, b, c, A = d - c @ E @ b, 2 / every * E @ b, 2 * c @ E, 2 / every * (A - eye) @ E

    size = jnp.sqrt((jnp.linalg.norm(c) + 1e-300) / (jnp.linalg.norm(b) + 1e-300))
    b, c = b * jax.lax.stop_gradient(size), c / jax.lax.stop_gradient(size)

    def loop(w):
        resolvent = jax.lax.complex(-A, w * eye)
        left, right, direct = (x.astype(resolvent.dtype) for x in (c, b, d))
        return left @ jnp.linalg.solve(resolvent, right) + direct

    def sensitivity(w):
        return -jnp.log(jnp.abs(1 + loop(w)))

    B, C = b[:, None], c[:, None]
    real = jnp.block([[A, zero, B], [zero, -A.T, C], [c, b, jnp.zeros(1)]])
    unit = jnp.block([[A, zero, B], [-C * c[None], -A.T, -d * C], [d * c, b, d[None] ** 2 - 1]])
    w_real, on_real = _on_axis(real, lambda w: jnp.imag(loop(w)))
    w_unit, on_unit = _on_axis(unit, lambda w: jnp.log(jnp.abs(loop(w))))

    # L at zero, where it is finite, and at infinity
    held = jax.lax.stop_gradient(A @ jnp.linalg.solve(A, b) - b)
    known = jnp.stack([jnp.linalg.norm(held) <= 1e-9 * jnp.linalg.norm(b), jnp.array(True)])
    start = d - c @ jnp.linalg.solve(jnp.where(known[0], A, eye), b)
    ends, w_ends = jnp.stack([start, d]), jnp.array([0.0, jnp.inf])
    factor = -1 / jnp.concatenate([jax.vmap(loop)(w_real).real, jnp.where(ends == 0, 1.0, ends)])
    crosses = jnp.concatenate([on_real, known & (ends != 0)]) & (factor > 0)
    w_factor, angle = jnp.concatenate([w_real, w_ends]), jnp.angle(-jax.vmap(loop)(w_unit))

    fixed = jax.lax.stop_gradient((A, A - B * c[None] / (1 + d)))
    free, closed = (jnp.linalg.eigvals(x) for x in fixed)
    w_peak = _peak(sensitivity, jnp.concatenate([free, closed]))
    peak = jnp.exp(sensitivity(jax.lax.stop_gradient(w_peak)))
    peaks = jnp.append(jnp.where(known, 1 / jnp.abs(1 + ends), 0.0), peak)
    values, frequencies = zip(
        _least(factor, w_factor, crosses & (factor > 1)),
        _least(1 / factor, w_factor, crosses & (factor < 1)),
        _least(jnp.abs(angle), w_unit, on_unit),
        _least(jnp.mod(angle, 2 * jnp.pi) / _measured(w_unit, every), w_unit, on_unit),
        _least(1 / peaks, jnp.append(w_ends, w_peak), peaks > 0),
        strict=True,
    )
    grows = jnp.max(closed.real) > STABLE * jnp.max(jnp.abs(closed))
    return (
        values[0],
        1 / values[1],
        *values[2:4],
        1 / values[4],
        _measured(jnp.stack(frequencies), every) / (2 * jnp.pi),
        jnp.where(grows, Status.UNSTABLE.value, Status.OK.value),
    )


def _measured(w: Array, every: Any) -> Array:
    """Return the frequencies [rad/s] of a sampled loop, from those of its transform."""
    return w if every is None else 2 / every * jnp.arctan(w * every / 2)


def _least(values: Array, w: Array, known: Array) -> tuple[Array, Array]:
    """Return the least of the known values, infinite if there is none, and its frequency."""
    values = jnp.where(known, values, jnp.inf)
    return jnp.min(values), jnp.where(known.any(), w[jnp.argmin(values)], jnp.nan)


def _on_axis(M: Array, g: Callable[[Array], Array]) -> tuple[Array, Array]:
    """Return the roots w of g(w) = 0 at imaginary generalized eigenvalues of M, with 1 in place of
    the others, and which of them are roots."""
    M, E = jax.lax.stop_gradient(M), np.diag(np.arange(len(M)) < len(M) - 1).astype(M.dtype)
    rate = jnp.linalg.norm(M[: len(M) // 2, : len(M) // 2]) + 1e-300
    s = jnp.linalg.eigvals(jnp.linalg.solve(M - rate * E, E))
    s = rate.astype(s.dtype) + 1 / s

    def newton(w):
        value, slope = jax.vmap(lambda w: jax.jvp(g, (w,), (jnp.ones_like(w),)))(w)
        return w - value / slope

    w = jax.lax.stop_gradient(newton(newton(newton(jnp.abs(s.imag)))))
    valid = jnp.isfinite(w) & (w > 0) & (jnp.hypot(s.real, jnp.abs(s.imag) - w) <= NEAR * w)
    return jnp.where(valid, newton(newton(jnp.where(valid, w, 1.0))), 1.0), valid


def _peak(g: Callable[[Array], Array], s: Array) -> Array:
    """Return the frequency of the largest g, sought at the poles s and on a grid around them, then
    ever closer to the best, with its derivative."""
    own = jnp.maximum(jnp.abs(s), 1e-9 * jnp.max(jnp.abs(s)) + 1e-300)
    low, high = jnp.log(jnp.min(own) / 10), jnp.log(jnp.max(own) * 10)

    def best(w):
        value = jax.vmap(lambda w: jax.lax.stop_gradient(g(w)))(w)
        return w[jnp.argmax(jnp.where(jnp.isfinite(value), value, -jnp.inf))]

    w = best(jnp.concatenate([jnp.exp(jnp.linspace(low, high, GRID)), own, jnp.abs(jnp.imag(s))]))
    for k in range(ZOOMS):
        w = best(w * (1 + 2 * (high - low) / GRID / 8**k * np.linspace(-1, 1, 33)))
    slope, bend = jax.jvp(jax.grad(g), (w,), (jnp.ones_like(w),))
    return jnp.where(jnp.abs(slope) < NEAR * jnp.abs(w * bend), w - slope / bend, w)
