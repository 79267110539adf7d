"""Imposed motions: one function of time, Xi(t) = (translation of the support's origin, rotation vector), from its reference pose.

Velocity and acceleration are derivatives of that function, so they cannot disagree with it.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxbody.arrays import concrete, device_array, float_array
from jaxbody.errors import Problems

LARGEST_TURN = np.deg2rad(30)  # between samples


class Motion(eqx.Module):
    """An imposed motion: `motion(t)` is Xi = (xi, phi), translation [m] and rotation vector [rad] in world axes. Motions add."""

    def __call__(self, t: Float[Array, ""]) -> Float[Array, "6"]:
        raise TypeError("a motion says what it is by __call__(t)")  # pragma: no cover

    def covers(self) -> tuple[Any, Any]:
        """First and last time [s] at which the motion is known."""
        return -np.inf, np.inf

    def __add__(self, other: Motion) -> Sum:
        return Sum((self, other))


class AtRest(Motion):
    """Xi = 0."""

    def __call__(self, t: Float[Array, ""]) -> Float[Array, "6"]:
        return jnp.zeros(6, jnp.result_type(t, float))


class Harmonic(Motion):
    """Xi_i = a_i cos(2 pi f t + p_i).

    frequency f [Hz], one number or one per component; amplitudes `translation` [m] and `rotation` [rad];
    phases `translation_phase` and `rotation_phase` [rad]. Source: the paper's (78), with a phase per axis.

    >>> import jax.numpy as jnp
    >>> Harmonic(frequency=2.0, translation=[0.01, 0, 0])(jnp.array(0.25)).tolist()[0]
    -0.01
    """

    frequency: Float[Array, "*six"]
    translation: Float[Array, "3"]
    rotation: Float[Array, "3"]
    translation_phase: Float[Array, "3"]
    rotation_phase: Float[Array, "3"]

    def __init__(self, *, frequency, translation=(0, 0, 0), rotation=(0, 0, 0), translation_phase=0.0, rotation_phase=0.0):
        problems = Problems()
        given = dict(
            translation=translation, rotation=rotation, translation_phase=translation_phase, rotation_phase=rotation_phase
        )  # fmt: skip
        arrays = {}
        for name, value in given.items():
            array = float_array(value, f"Harmonic.{name}")
            if array.shape not in ((3,), ()) or (array.shape == () and "phase" not in name):
                problems.add(
                    "BAD_SHAPE",
                    f"Harmonic.{name}",
                    f"has shape {array.shape}",
                    value=value,
                    limit="(3,)",
                    hint="Give one number per axis x, y, z.",
                )
            else:
                arrays[name] = jnp.broadcast_to(device_array(array), (3,))
        f = float_array(frequency, "Harmonic.frequency")
        if f.shape not in ((), (6,)):
            problems.add("BAD_SHAPE", "Harmonic.frequency", f"has shape {f.shape}", value=frequency, limit="() or (6,)")
        for name, value in {**given, "frequency": f}.items():
            known = concrete(value)
            if known is not None and not np.isfinite(known).all():
                problems.add("NON_FINITE", f"Harmonic.{name}", f"is {value}", value=value, limit="finite")
        problems.raise_if_any()
        self.frequency = device_array(f)
        self.translation, self.rotation = arrays["translation"], arrays["rotation"]
        self.translation_phase, self.rotation_phase = arrays["translation_phase"], arrays["rotation_phase"]

    def __call__(self, t: Float[Array, ""]) -> Float[Array, "6"]:
        amplitude = jnp.concatenate([self.translation, self.rotation])
        phase = jnp.concatenate([self.translation_phase, self.rotation_phase])
        return amplitude * jnp.cos(2 * jnp.pi * self.frequency * t + phase)


class Sum(Motion):
    """Xi = the sum of the Xi of its terms: translations and rotation vectors add."""

    terms: tuple[Motion, ...]

    def __call__(self, t: Float[Array, ""]) -> Float[Array, "6"]:
        return sum((term(t) for term in self.terms[1:]), self.terms[0](t))

    def covers(self) -> tuple[Any, Any]:
        spans = [term.covers() for term in self.terms]
        return max(s[0] for s in spans), min(s[1] for s in spans)


class Function(Motion):
    """Any JAX function of time that returns Xi; a re-made function is compiled anew (make it a Motion with array leaves to avoid that)."""

    function: Callable[[Array], Array] = eqx.field(static=True)

    def __call__(self, t: Float[Array, ""]) -> Float[Array, "6"]:
        return self.function(t)


class Sampled(Motion):
    """A C2 cubic spline through samples: translation [m] and rotation vectors [rad] (or unit quaternions w, x, y, z) at increasing times [s].

    Between knots h = t_{i+1} - t_i apart, with a = (t_{i+1} - t)/h and b = (t - t_i)/h, values y and second derivatives m,

        Xi(t) = a y_i + b y_{i+1} + h^2/6 ((a^3 - a) m_i + (b^3 - b) m_{i+1}).

    Through positions the m follow from continuity of Xi', with the end slopes of the cubic through the four outermost samples.
    `Sampled.from_accelerations` takes the m themselves and integrates them from stated initial values: acceleration is then linear
    between samples, as in earthquake engineering. Asking outside the samples is an error.
    """

    times: Float[Array, "n"]
    values: Float[Array, "n 6"]
    curvatures: Float[Array, "n 6"]
    uniform: bool = eqx.field(static=True)

    def __init__(self, times, *, translation=None, rotation=None):
        times, values = _samples(times, {"translation": translation, "rotation": rotation}, minimum=4)
        self.times, self.values = device_array(times), device_array(values)
        self.uniform = _is_uniform(times)
        self.curvatures = _curvatures(self.times, self.values)

    @classmethod
    def from_accelerations(
        cls, times, *, translation=None, rotation=None, initial_position=(0, 0, 0, 0, 0, 0), initial_velocity=(0, 0, 0, 0, 0, 0)
    ) -> Sampled:
        """Xi'' linear between the samples `translation` [m/s2] and `rotation` (second derivative of the rotation vector [rad/s2];
        the angular acceleration where the turn keeps its axis), Xi and Xi' at the first sample as stated (6 numbers each)."""
        times, m = _samples(times, {"translation": translation, "rotation": rotation}, minimum=2, turns=False)
        self = object.__new__(cls)
        x0, v0 = (device_array(float_array(v)) for v in (initial_position, initial_velocity))
        t, m = device_array(times), device_array(m)
        h = jnp.diff(t)[:, None]
        velocity = v0 + jnp.concatenate([jnp.zeros((1, 6), m.dtype), jnp.cumsum(h * (m[1:] + m[:-1]) / 2, 0)])
        steps = h * velocity[:-1] + h**2 * (2 * m[:-1] + m[1:]) / 6
        values = x0 + jnp.concatenate([jnp.zeros((1, 6), m.dtype), jnp.cumsum(steps, 0)])
        for name, value in dict(times=t, values=values, curvatures=m, uniform=_is_uniform(times)).items():
            object.__setattr__(self, name, value)
        return self

    def covers(self) -> tuple[Any, Any]:
        return self.times[0], self.times[-1]

    def __call__(self, t: Float[Array, ""]) -> Float[Array, "6"]:
        n = self.times.shape[0]
        if self.uniform:
            i = jnp.floor((t - self.times[0]) / (self.times[-1] - self.times[0]) * (n - 1)).astype(int)
        else:
            i = jnp.searchsorted(self.times, jax.lax.stop_gradient(t), side="right", method="scan_unrolled") - 1
        i = jnp.clip(i, 0, n - 2)
        h = self.times[i + 1] - self.times[i]
        a, b = (self.times[i + 1] - t) / h, (t - self.times[i]) / h
        return (
            a * self.values[i] + b * self.values[i + 1] + h**2 / 6 * ((a**3 - a) * self.curvatures[i] + (b**3 - b) * self.curvatures[i + 1])
        )


def as_motion(motion: Motion | Callable[[Array], Array]) -> Motion:
    """A motion stays one; a bare Python function of time becomes one."""
    return motion if isinstance(motion, Motion) else Function(motion)


def check_times(times, problems: Problems, where: str = "times", minimum: int = 1) -> np.ndarray | jax.Array | None:
    """Increasing, finite, one-dimensional times; what is wrong goes to `problems`."""
    times = float_array(times, where)
    known = concrete(times)
    if times.ndim != 1 or times.shape[0] < minimum:
        code = "NO_DATA" if times.size == 0 or times.ndim == 1 else "BAD_SHAPE"
        problems.add(code, where, f"has shape {times.shape}", value=times, limit=f"(n,) with n >= {minimum}")
        return None
    if known is None:
        return times
    if not np.isfinite(known).all():
        problems.add(
            "NAN_TIME", where, f"is {known[~np.isfinite(known)][0]} at index {np.flatnonzero(~np.isfinite(known))[0]}", limit="finite"
        )
        return None
    steps = np.diff(known)
    if (steps <= 0).any():
        i = int(np.flatnonzero(steps <= 0)[0])
        code, word = ("DUPLICATE_TIME", "repeats") if steps[i] == 0 else ("UNSORTED_TIME", "goes back")
        problems.add(
            code,
            where,
            f"{word} at index {i + 1}: {known[i]:.9g} s, then {known[i + 1]:.9g} s",
            value=i + 1,
            limit="increasing",
            hint="Sort the samples and drop duplicates.",
        )
        return None
    return times


def _samples(times, given: dict[str, Any], minimum: int, turns: bool = True):
    """Check samples of translation and rotation; (times, (n, 6) values)."""
    problems = Problems()
    times = check_times(times, problems, "Sampled.times", minimum)
    problems.raise_if_any()
    assert times is not None
    n = times.shape[0]
    columns = []
    for name, value in given.items():
        where = f"Sampled.{name}"
        array = np.zeros((n, 3)) if value is None else float_array(value, where)
        if array.shape not in ((n, 3), (n, 4)[: 2 if name == "rotation" and turns else 0]):
            hint = "The array looks transposed." if array.ndim == 2 and array.shape[1] == n else "One row per time."
            problems.add("BAD_SHAPE", where, f"has shape {array.shape}", value=array.shape, limit=f"({n}, 3)", hint=hint)
            continue
        known = concrete(array)
        if known is not None and not np.isfinite(known).all():
            row = int(np.argwhere(~np.isfinite(known))[0][0])
            problems.add(
                "NON_FINITE",
                where,
                f"is not finite at row {row}",
                value=known[row],
                limit="finite",
                hint="Cut the record or fill the gap first.",
            )
            continue
        if name == "rotation" and turns and known is not None:
            array = _continuous(known, problems, where)
        columns.append(array)
    problems.raise_if_any()
    return times, (np if all(isinstance(c, np.ndarray) for c in columns) else jnp).concatenate(columns, 1)


def _continuous(samples: np.ndarray, problems: Problems, where: str) -> np.ndarray:
    """Rotation vectors that follow one another without jumps of a whole turn; neighbours must be less than 30 degrees apart."""
    if samples.shape[1] == 4:
        norms = np.linalg.norm(samples, axis=1)
        if (abs(norms - 1) > 1e-3).any():
            row = int(np.argmax(abs(norms - 1)))
            problems.add(
                "BAD_QUATERNION",
                where,
                f"has length {norms[row]:.6g} at row {row}",
                value=samples[row],
                limit="1 within 1e-3",
                hint="Order w, x, y, z.",
            )
            return np.zeros((len(samples), 3))
        w, v = samples[:, :1], samples[:, 1:]
        v, w = np.where(w < 0, -v, v), abs(w)
        s = np.linalg.norm(v, axis=1, keepdims=True)
        samples = v * np.where(s > 0, 2 * np.arctan2(s, w) / np.where(s > 0, s, 1), 2)
    out = samples.copy()
    for i in range(1, len(out)):
        angle = np.linalg.norm(out[i])
        if angle > 0:  # the same rotation, any number of turns away
            turns = np.round((out[i - 1] @ out[i] / angle - angle) / (2 * np.pi))
            out[i] *= 1 + 2 * np.pi * turns / angle
    steps = np.linalg.norm(np.diff(out, axis=0), axis=1)
    if (steps > LARGEST_TURN).any():
        row = int(np.argmax(steps > LARGEST_TURN))
        problems.add(
            "ORIENTATION_JUMP",
            where,
            f"turns by {np.rad2deg(steps[row]):.3g} degrees between rows {row} and {row + 1}",
            value=row,
            limit="30 degrees",
            hint="Sample faster, or turn the reference pose so that the motion stays clear of whole turns about a changing axis.",
        )
    return out


def _is_uniform(times) -> bool:
    known = concrete(times)
    if known is None:
        return False
    n = len(known)
    grid = known[0] + (known[-1] - known[0]) * np.arange(n) / (n - 1)
    return bool(np.abs(known - grid).max() < 1e-9 * (known[-1] - known[0]) / (n - 1))


def _curvatures(t: Float[Array, "n"], y: Float[Array, "n k"]) -> Float[Array, "n k"]:
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
