"""The motion of a base by integration of recorded accelerations, and of angular rates if there is a
gyro, with the drift removed.

    x(t) = x0 + v0 t + int int (a - b),   b = sum_k c_k B_k(t),
    c, x0, v0: least squares of x over the record

The error of x from a bias of the instrument grows with t^2. It cannot be distinguished from true
slow motion, so all slow motion is removed: that of the functions B_k, a polynomial, or all cosines
up to a cutoff frequency. The result is a C2 function of time, whose second derivative at the
samples is the corrected acceleration.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxbody.core import tables, units
from jaxbody.core.arrays import Array, Float, Int, checked, device_array, shaped
from jaxbody.core.errors import Problems, Status, warn
from jaxbody.core.results import Result
from jaxbody.core.tables import counted
from jaxbody.geometry import rotations
from jaxbody.model.inputs.motions import LARGEST_TURN, Sampled, unwound
from jaxbody.model.inputs.samples import integrals
from jaxbody.records.records import Record

NAMES = ("x", "y", "z", "about x", "about y", "about z")


class Recovered(Result):
    """A base motion from its accelerations: `motion` (a Motion); `removed` (n, 6), the part removed
    from the accelerations [m/s2] and rates [rad/s] at `times`; `words`, a description of it."""

    motion: Sampled
    times: Float[Array, "n"]
    removed: Float[Array, "n 6"]
    status: Int[Array, ""]
    words: tuple[str, ...] = eqx.field(static=True)

    def _tables(self) -> list[tables.PrintedTable]:
        mean, largest = (
            np.mean(self.removed, 0),
            np.abs(self.removed - np.mean(self.removed, 0)).max(0),
        )
        peak = np.abs(self.motion.values).max(0)
        rows = [
            (
                name,
                float(mean[i]),
                float(largest[i]),
                "m/s2" if i < 3 else "rad/s",
                float(peak[i]),
                "m" if i < 3 else "rad",
            )
            for i, name in enumerate(NAMES)
            if peak[i] > 0
        ]
        heads = ("component", "mean removed", "largest variation removed", "", "largest motion", "")
        return [tables.PrintedTable("Base motion", heads, rows, "\n".join(self.words))]


def base_motion(
    record: Record,
    acceleration: str,
    *,
    axis: Any = None,
    rates: str | None = None,
    axes: Any = None,
    at: Any = (0, 0, 0),
    gravity: Any = None,
    degree: int | None = 0,
    cutoff: float | None = None,
) -> Recovered:
    """Compute the motion of a support from the channel `acceleration` of an accelerometer on it,
    (n, 3) in its axes, or (n,) along `axis`.

    Args:
        record: the record that contains the channels
        acceleration: name of the accelerometer's channel [m/s2]
        axis: direction of a channel of one column, in world axes
        rates: name of a gyro's channel (n, 3) [rad/s]; None: the base does not turn
        axes: (3, 3), the instrument's axes as columns, in world axes with the base in its reference
            pose; None: the world's axes
        at: position of the instrument from the support's origin [m]; it has an effect only if the
            base turns
        gravity: in world axes [m/s2], if the accelerometer reads it (+g upward at rest), zeros if
            it does not; required with `rates`, because the base tilts
        degree: degree of the polynomial removed from the accelerations; 0: a constant bias; None:
            nothing is removed, and the base starts at rest in its reference pose
        cutoff: frequency [Hz] below which all motion is removed, real or not; None: no cutoff

    The base is in its reference pose on average. The same polynomial is removed from the rates, and
    one of the next degree from the accelerations, because a drifting angle tilts gravity. A base
    that keeps turning, such as a car in a bend, needs degree=None, as its mean rate is no bias; it
    may turn by up to a whole turn.

    Errors, all at once: UNKNOWN_CHANNEL, WRONG_DIMENSION, BAD_SHAPE, GAPS, BAD_OPTION,
    NO_GRAVITY, BAD_AXES, ORIENTATION_JUMP. Warns BASE_JUMP, GRAVITY where the median reading of
    the accelerometer is far from -gravity, and TURNS where the integral of the removed rates is
    more than 30 degrees.

    >>> times = jnp.arange(2000) / 100
    >>> record = jb.Record(times, {"acc": (0.2 - jnp.cos(2 * jnp.pi * times), "m/s2")})
    >>> motion = jb.inputs.base_motion(record, "acc", axis=[1, 0, 0]).motion
    >>> round(
    ...     float(motion(jnp.array(10.0))[0]) * 39.478, 2
    ... )  # cos(2 pi t)/(2 pi)^2, less its small slow part
    1.0
    """
    with Problems() as problems:
        f = _channel(record, acceleration, units.ACCELERATION, axis, problems)
        w = None if rates is None else _channel(record, rates, units.ANGULAR_RATE, None, problems)
        A = np.eye(3) if axes is None else _axes(axes, problems)
        r = shaped(at, (3,), "base_motion.at", problems)
        g = None if gravity is None else checked(gravity, ((3,),), "base_motion.gravity", problems)
        _check_options(record, degree, cutoff, problems)
        if w is not None and gravity is None:
            problems.add(
                "NO_GRAVITY",
                "base_motion.gravity",
                "is not stated; it is required with rates",
                limit="three numbers [m/s2]",
                hint="Give gravity=[0, 0, -9.81], or zeros if the accelerometer does not read it.",
            )
    t = record.times - record.times[0]
    turn, removed = np.zeros((len(t), 3)), np.zeros((len(t), 6))
    a = f @ A.T
    if w is not None:
        turn, removed[:, 3:] = _turned(t, w @ A.T, _slow(t, degree, cutoff))
        _warn_of_turns(t, removed[:, 3:])
        degree = None if degree is None else degree + 1  # a bias of the rates tilts gravity
        a = np.asarray(jax.vmap(lambda phi, f: rotations.exp(phi) @ f)(turn, a))
        if np.any(r):
            a = a - _swing(record.times, turn, r)
    if g is not None:
        _warn_of_gravity(f"Record['{acceleration}']", np.median(a, 0), np.asarray(g))
        a = a + g
    slow = _slow(t, degree, cutoff)
    x0, v0, removed[:, :3] = _drift(t, a, slow)
    motion = Sampled.from_accelerations(
        record.times,
        translation=a - removed[:, :3],
        initial_position=[*x0, 0, 0, 0],
        initial_velocity=[*v0, 0, 0, 0],
    )
    if w is not None:
        spline = Sampled(record.times, rotation=turn)
        merged = [
            jnp.concatenate([m[:, :3], s[:, 3:]], 1)
            for m, s in ((motion.values, spline.values), (motion.curvatures, spline.curvatures))
        ]
        motion = eqx.tree_at(lambda m: (m.values, m.curvatures), motion, merged)
    return Recovered(
        motion=motion,
        times=device_array(record.times),
        removed=device_array(removed),
        status=jnp.asarray(Status.OK),
        words=_words(t, degree, cutoff, slow, w is not None),
    )


def _channel(
    record: Record, name: str, dimension: units.Dimension, axis: Any, problems: Problems
) -> np.ndarray:
    """Return a channel as (n, 3), or zeros if it is not suitable, with a problem added."""
    where, zeros = f"Record['{name}']", np.zeros((len(record.times), 3))
    x = problems.gather(lambda: record[name])
    if x is None:
        return zeros
    if record.units[name] != (expected := units.si_words(dimension)):
        problems.add(
            "WRONG_DIMENSION",
            where,
            f"is in {record.units[name]}",
            value=record.units[name],
            limit=expected,
            hint="Name another channel.",
        )
    if record.sampling.missing or np.isnan(x).any():
        count = record.sampling.missing + int(np.isnan(x).any(tuple(range(1, x.ndim))).sum())
        problems.add(
            "GAPS",
            where,
            f"lacks {count} samples",
            value=count,
            limit="no gaps, because it is integrated",
            hint='Read the record with fill="spline", or take a part without gaps.',
        )
    if axis is not None and x.ndim == 1:
        direction = checked(axis, ((3,),), "base_motion.axis", problems)
        length = 0.0 if direction is None else float(np.linalg.norm(direction))
        if direction is not None and not length:
            problems.add(
                "ZERO_AXIS",
                "base_motion.axis",
                "has length zero",
                value=axis,
                limit="> 0",
                hint="Give a direction.",
            )
        return zeros if not length else x[:, None] * direction / length
    if x.shape != zeros.shape or axis is not None:
        problems.add(
            "BAD_SHAPE",
            where,
            f"has shape {x.shape}",
            value=x.shape,
            limit=f"{zeros.shape}, or one column and axis=",
            hint="Give axis= for one column, and leave it out for three.",
        )
        return zeros
    return x


def _axes(axes: Any, problems: Problems) -> np.ndarray:
    A = shaped(axes, (3, 3), "base_motion.axes", problems)
    if not problems.collected and (
        np.abs(A.T @ A - np.eye(3)).max() > 1e-6 or np.linalg.det(A) < 0
    ):
        problems.add(
            "BAD_AXES",
            "base_motion.axes",
            (
                f"is not a rotation: |A'A - 1| = {np.abs(A.T @ A - np.eye(3)).max():.2g}, "
                f"determinant {np.linalg.det(A):.3g}"
            ),
            value=A,
            limit="orthogonal, right-handed",
            hint="Columns: the instrument's axes.",
        )
    return np.asarray(A)


def _check_options(record: Record, degree: Any, cutoff: Any, problems: Problems) -> None:
    if not (degree is None or (isinstance(degree, int) and 0 <= degree <= 10)):
        problems.add(
            "BAD_OPTION",
            "base_motion.degree",
            f"is {degree!r}",
            value=degree,
            limit="0 to 10, or None",
            hint="0 is a constant bias.",
        )
    highest = record.sampling.rate / 10
    if cutoff is not None and not (
        isinstance(cutoff, int | float) and 0 < cutoff <= highest and degree is not None
    ):
        problems.add(
            "BAD_OPTION",
            "base_motion.cutoff",
            f"is {cutoff!r} Hz",
            value=cutoff,
            limit=f"0 to {highest:.4g} Hz, degree >= 0",
            hint=(
                "A cutoff also removes any constant, so keep degree=0."
                if degree is None
                else "In Hz, below the frequencies of interest."
            ),
        )


def _slow(t: np.ndarray, degree: int | None, cutoff: float | None) -> np.ndarray:
    """Return B_k at the samples (n, k): Legendre polynomials, and cosines of 1/2, 1, 3/2 ...
    periods over the record."""
    if degree is None:
        return np.zeros((len(t), 0))
    s = t / t[-1]
    highest = 0 if cutoff is None else int(cutoff * 2 * t[-1])
    return np.hstack(
        [
            np.polynomial.legendre.legvander(2 * s - 1, degree),
            np.cos(np.pi * s[:, None] * np.arange(1, highest + 1)),
        ]
    )


def _least(basis: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Return the least-squares coefficients of x in the columns of `basis`, which are scaled."""
    scale = np.linalg.norm(basis, axis=0)
    return np.linalg.lstsq(basis / scale, x, rcond=1e-13)[0] / scale[:, None]


def _drift(
    t: np.ndarray, a: np.ndarray, slow: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return x0, v0 and b that minimize the sum of squares of x."""
    if not slow.shape[1]:
        return np.zeros(3), np.zeros(3), np.zeros_like(a)
    mean = a.mean(0)
    basis = np.hstack([np.ones((len(t), 1)), t[:, None], integrals(t, slow)[1]])
    c = _least(basis, integrals(t, a - mean)[1])
    return -c[0], -c[1], mean + slow @ c[2:]


def _turned(t: np.ndarray, w: np.ndarray, slow: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return rotation vectors at the samples, integrated from rates in body axes after removal of
    their drift, and this drift.

    R_{i+1} = R_i exp(h (w_i + w_{i+1})/2 + h^2/12 w_i x w_{i+1}), w linear between samples; the
    mean rotation vector is zero.
    """
    basis = np.hstack([np.ones((len(t), 1)), integrals(t, slow)[0]])
    drift, start = np.zeros_like(w), np.zeros(3)
    if slow.shape[1]:
        for i in range(4):  # first for small rotations, whose order has no effect
            c = _least(basis, _integrated_turns(t, w - drift, start) if i else integrals(t, w)[0])
            drift, start = drift + slow @ c[1:], start - c[0]
    return _integrated_turns(t, w - drift, start), drift


def _integrated_turns(t: np.ndarray, w: np.ndarray, start: np.ndarray) -> np.ndarray:
    h = np.diff(t)[:, None]
    return np.asarray(
        _product(h * (w[1:] + w[:-1]) / 2 + h**2 / 12 * np.cross(w[:-1], w[1:]), start)
    )


@jax.jit
def _product(steps: Float[Array, "n 3"], start: Float[Array, "3"]) -> Float[Array, "m 3"]:
    def step(q, turn):
        q = rotations.normalize(rotations.multiply(q, rotations.exp_quaternion(turn)))
        return q, q

    first = rotations.exp_quaternion(start)
    q = jnp.concatenate([first[None], jax.lax.scan(step, first, steps)[1]])
    return unwound(jax.vmap(rotations.log_quaternion)(q))


def _warn_of_turns(t: np.ndarray, drift: np.ndarray) -> None:
    """Warn TURNS if the drift of the rates is so large that the base may have turned."""
    turned = integrals(t, drift)[0]
    angle, i = np.abs(turned).max(), np.abs(turned).max(0).argmax()
    if angle > LARGEST_TURN:
        warn(
            "TURNS",
            f"base_motion removes {np.rad2deg(angle):.4g} degrees {NAMES[3 + i]} over "
            f"{t[-1]:.4g} s from the rates, {np.rad2deg(drift[:, i].mean()):.3g} deg/s on average, "
            "as their bias. If the base turned, subtract the bias that they show at rest, and give "
            "degree=None.",
        )


def _warn_of_gravity(where: str, reading: np.ndarray, gravity: np.ndarray) -> None:
    """Warn GRAVITY if the median of the specific force, in world axes, is far from -gravity, its
    value for a base that stays about one place."""
    g, size = np.linalg.norm(gravity), np.linalg.norm(reading)
    if g and np.linalg.norm(reading + gravity) > g / 2:
        if size < g / 2:
            hint = "Was gravity taken out already? Then give gravity=[0, 0, 0]."
        elif np.linalg.norm(reading - gravity) < g / 2:
            hint = (
                "Its sign is reversed, or an axis: give axes= of the instrument as it is mounted, "
                "or change the sign of the channel."
            )
        else:
            hint = "Check axes=, gravity= and the unit of the channel."
    elif not g and abs(size - units.GRAVITY) < 0.1:
        hint = "It seems to read gravity: give gravity=[0, 0, -9.81]."
    else:
        return
    text = ["[" + ", ".join(f"{x:.3g}" for x in v) + "]" for v in (reading, 0.0 - gravity)]
    warn(
        "GRAVITY",
        f"{where} has the median {text[0]} m/s2 in world axes, not {text[1]}, as at rest with "
        f"this gravity. {hint}",
    )


def _swing(times: np.ndarray, turn: np.ndarray, r: np.ndarray) -> np.ndarray:
    """Return the acceleration [m/s2] of the vector R r at the samples, for rotation vectors `turn`
    through which a spline is laid."""
    motion = Sampled(times, rotation=turn)
    second = jax.jacfwd(jax.jacfwd(lambda t: rotations.exp(motion(t)[3:]) @ jnp.asarray(r)))
    return np.asarray(jax.jit(jax.vmap(second))(device_array(times)))


def _words(
    t: np.ndarray, degree: int | None, cutoff: float | None, slow: np.ndarray, turns: bool
) -> tuple[str, ...]:
    if degree is None:
        return ("nothing removed: at rest in the reference pose when the record begins",)
    kind = ("a constant", "a line")[degree] if degree < 2 else f"a polynomial of degree {degree}"
    below = f" and all below {cutoff:g} Hz" if cutoff else ""
    what = (
        f"removed from the accelerations: {kind}{below}, "
        f"{counted(slow.shape[1], 'function')} over {t[-1]:.4g} s, including "
        "real motion of that kind"
    )
    return (what, "from the rates: the same, one degree less") if turns else (what,)
