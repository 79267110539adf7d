"""Imposed motions: one function of time, Xi(t) = (translation of the support's origin, rotation vector), from its reference pose.

Velocity and acceleration are derivatives of this function, and so always consistent with it.
"""

from __future__ import annotations

import functools
from abc import abstractmethod
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxbody.core.arguments import check_returned, is_own, kind_of, warn_of_degrees
from jaxbody.core.arrays import (
    Array,
    Float,
    check_times,
    checked,
    concrete,
    device_array,
    finite_rows,
    float_array,
    functions_as_nodes,
    shaped,
)
from jaxbody.core.errors import JaxbodyError, Problem, Problems, warn
from jaxbody.geometry import rotations
from jaxbody.geometry.fields import field
from jaxbody.inputs.samples import cell, curvatures, is_uniform, kinks_of
from jaxbody.numerics.elementary_functions import sincos

JUMP = 20  # standard deviations of the steps from sample to sample
LARGEST_TURN = np.deg2rad(30)  # from sample to sample


class Motion(eqx.Module):
    """An imposed motion: `motion(t)` is Xi = (xi, phi), translation [m] and rotation vector [rad] in world axes. Motions can be added to
    each other and to functions of time.

    >>> (Harmonic(frequency=1.0, translation=[0.1, 0, 0]) + AtRest())(jnp.array(0.0)).tolist()
    [0.1, 0.0, 0.0, 0.0, 0.0, 0.0]
    """

    @abstractmethod
    def __call__(self, t: Float[Array, ""]) -> Float[Array, "6"]: ...

    def covers(self) -> tuple[Any, Any]:
        """First and last time [s] at which the motion is known."""
        return -np.inf, np.inf

    def kinks(self) -> Array | None:
        """Times [s] at which the motion is not smooth, where integration steps should end; None if there are none."""

    def __add__(self, other: Motion | Callable[[Array], Array]) -> MotionSum:
        return MotionSum((self, as_motion(other)))

    def __radd__(self, other: Any) -> Motion:
        return self if other == 0 else MotionSum((as_motion(other), self))  # sum() starts from 0


class AtRest(Motion):
    """Xi = 0.

    >>> AtRest()(jnp.array(1.0)).tolist()
    [0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
    """

    def __call__(self, t: Float[Array, ""]) -> Float[Array, "6"]:
        return jnp.zeros(6, jnp.result_type(t, float))


class Harmonic(Motion):
    """Xi_i = a_i cos(2 pi f t + p_i).

    Args:
        frequency: f [Hz], one number or one per component
        translation: amplitudes [m]
        rotation: amplitudes [rad]
        translation_phase: p_i [rad], one number or one per axis
        rotation_phase: p_i [rad], one number or one per axis

    Warns UNIT for amplitudes of more than one turn. Source: the paper's (78), with a phase per axis.

    >>> import jax.numpy as jnp
    >>> Harmonic(frequency=2.0, translation=[0.01, 0, 0])(jnp.array(0.25)).tolist()[0]
    -0.01
    """

    frequency: Float[Array, "*six"] = field("Hz")
    translation: Float[Array, "3"] = field("m")
    rotation: Float[Array, "3"] = field("rad")
    translation_phase: Float[Array, "3"] = field("rad")
    rotation_phase: Float[Array, "3"] = field("rad")

    def __init__(self, *, frequency, translation=(0, 0, 0), rotation=(0, 0, 0), translation_phase=0.0, rotation_phase=0.0):
        with Problems() as problems:
            f = checked(frequency, ((), (6,)), "Harmonic.frequency", problems)
            arrays = {}
            for name, value in dict(translation=translation, rotation=rotation).items():
                arrays[name] = shaped(value, (3,), f"Harmonic.{name}", problems)
            for name, value in dict(translation_phase=translation_phase, rotation_phase=rotation_phase).items():
                arrays[name] = checked(value, ((), (3,)), f"Harmonic.{name}", problems)
        self.frequency = device_array(f)
        for name, array in arrays.items():
            setattr(self, name, device_array(array * np.ones(3)))
        warn_of_degrees(rotation, "Harmonic.rotation")

    def __call__(self, t: Float[Array, ""]) -> Float[Array, "6"]:
        amplitude = jnp.concatenate([self.translation, self.rotation])
        phase = jnp.concatenate([self.translation_phase, self.rotation_phase])
        s, c = sincos(2 * jnp.pi * self.frequency * t)  # one sine and cosine where the frequency is one number
        return amplitude * jnp.cos(phase) * c - amplitude * jnp.sin(phase) * s


class MotionSum(Motion):
    """Xi = the sum of the Xi of its terms: translations and rotation vectors add."""

    terms: tuple[Motion, ...] = field()

    def __call__(self, t: Float[Array, ""]) -> Float[Array, "6"]:
        return sum((term(t) for term in self.terms[1:]), self.terms[0](t))

    def covers(self) -> tuple[Any, Any]:
        spans = [term.covers() for term in self.terms]
        return max(s[0] for s in spans), min(s[1] for s in spans)

    def kinks(self) -> Array | None:
        return kinks_of(self.terms)


class Delayed(Motion):
    """Xi(t) = motion(t - delay): the same motion `delay` [s] later, such as that of a rear wheel that follows the front wheel on the same
    road.

    >>> import jax.numpy as jnp
    >>> motion = Delayed(Harmonic(frequency=2.0, translation=[0.01, 0, 0]), 0.25)
    >>> motion(jnp.array(0.25)).tolist()[0]
    0.01
    """

    motion: Motion = field()
    delay: Float[Array, ""] = field("s")

    def __init__(self, motion, delay):
        with Problems() as problems:
            delay = shaped(delay, (), "Delayed.delay", problems)
        self.motion, self.delay = as_motion(motion), device_array(delay)

    def __call__(self, t: Float[Array, ""]) -> Float[Array, "6"]:
        return self.motion(t - self.delay)

    def covers(self) -> tuple[Any, Any]:
        first, last = self.motion.covers()
        return first + self.delay, last + self.delay

    def kinks(self) -> Array | None:
        known = self.motion.kinks()
        return None if known is None else known + self.delay


class MotionFunction(Motion):
    """Any JAX function of time that returns Xi. Each new function object is compiled again; a Motion with array leaves avoids that."""

    function: Callable[[Array], Array] = eqx.field(static=True)

    def __call__(self, t: Float[Array, ""]) -> Float[Array, "6"]:
        return self.function(t)


class Sampled(Motion):
    """A C2 cubic spline through samples of translation [m] and rotation vectors [rad] (or unit quaternions w, x, y, z) at times [s].

    Between samples h = t_{i+1} - t_i apart, with a = (t_{i+1} - t)/h and b = (t - t_i)/h, values y and second derivatives m,

        Xi(t) = a y_i + b y_{i+1} + h^2/6 ((a^3 - a) m_i + (b^3 - b) m_{i+1}).

    The m follow from continuity of Xi', with the end slopes of the cubic through the four outermost samples. `Sampled.from_accelerations`
    takes the m and integrates them from given initial values: acceleration is then linear between samples, as in earthquake
    engineering. Times outside the samples are an error. Warns BASE_JUMP for a step of more than 20 standard deviations of the steps.

    >>> times = jnp.linspace(0, 1, 11)
    >>> drift = Sampled(times, translation=jnp.stack([times**2, 0 * times, 0 * times], 1))
    >>> round(float(drift(jnp.array(0.55))[0]), 9)
    0.3025
    """

    times: Float[Array, "n"] = field("s")
    values: Float[Array, "n 6"] = field("m, rad")
    curvatures: Float[Array, "n 6"] = field("m/s2, rad/s2")
    uniform: bool = field(static=True)
    rough: bool = field(static=True)  # from accelerations with noise

    def __init__(self, times, *, translation=None, rotation=None):
        times, values = _samples(times, translation, rotation, Problems(), minimum=4)
        self.times, self.values = device_array(times), device_array(values)
        self.uniform, self.rough = is_uniform(times), False
        self.curvatures = curvatures(self.times, self.values)

    @classmethod
    def from_accelerations(
        cls, times, *, translation=None, rotation=None, initial_position=(0, 0, 0, 0, 0, 0), initial_velocity=(0, 0, 0, 0, 0, 0)
    ) -> Sampled:
        """The motion whose Xi'' is linear between samples.

        Args:
            times: times of the samples [s], increasing
            translation: accelerations [m/s2]
            rotation: second derivative of the rotation vector [rad/s2], which is the angular acceleration where the axis is constant
            initial_position: Xi at the first sample, 6 numbers [m, rad]
            initial_velocity: Xi' at the first sample, 6 numbers [m/s, rad/s]
        """
        problems = Problems()
        x0 = shaped(initial_position, (6,), "Sampled.initial_position", problems)
        v0 = shaped(initial_velocity, (6,), "Sampled.initial_velocity", problems)
        times, m = _samples(times, translation, rotation, problems, minimum=2, turns=False)
        self = object.__new__(cls)
        t, m = device_array(times), device_array(m)
        h = jnp.diff(t)[:, None]
        velocity = v0[None] + jnp.concatenate([jnp.zeros((1, 6), m.dtype), jnp.cumsum(h * (m[1:] + m[:-1]) / 2, 0)])
        steps = h * velocity[:-1] + h**2 * (2 * m[:-1] + m[1:]) / 6
        values = x0[None] + jnp.concatenate([jnp.zeros((1, 6), m.dtype), jnp.cumsum(steps, 0)])
        for name, value in dict(times=t, values=values, curvatures=m, uniform=is_uniform(times), rough=True).items():
            object.__setattr__(self, name, value)
        return self

    def covers(self) -> tuple[Any, Any]:
        return self.times[0], self.times[-1]

    def kinks(self) -> Array | None:
        return self.times if self.rough else None

    def __call__(self, t: Float[Array, ""]) -> Float[Array, "6"]:
        i, h, a, b = cell(self.times, self.uniform, t)
        return (
            a * self.values[i] + b * self.values[i + 1] + h**2 / 6 * ((a**3 - a) * self.curvatures[i] + (b**3 - b) * self.curvatures[i + 1])
        )


def as_motion(motion: Any, where: str = "motion") -> Motion:
    """The Motion for a motion or for a Python function of time."""
    if not callable(motion) or isinstance(motion, type):
        hint = "Give a Motion or a function t -> Xi, 6 numbers."
        raise JaxbodyError(Problem("WRONG_KIND", where, f"is {kind_of(motion)}", motion, "a Motion, such as jb.Harmonic(...)", hint))
    return motion if isinstance(motion, Motion) else MotionFunction(motion)  # pyright: ignore[reportArgumentType]  it may return anything


def check_motion(motion: Motion, where: str, problems: Problems) -> None:
    """Check that JAX can trace the user's parts of a motion and that they return six numbers; each structure is traced once."""
    if any(map(is_own, _parts(motion))):
        leaves, structure = jax.tree.flatten(functions_as_nodes(motion))
        kinds = tuple(jax.ShapeDtypeStruct(np.shape(leaf), jnp.result_type(leaf)) for leaf in leaves)
        problems.collected += [replace(problem, where=where) for problem in _faults(structure, kinds)]


def _parts(motion: Motion) -> list[Motion]:
    """The elementary motions that make up a motion, with sums and delays split into their parts."""
    inner = motion.terms if isinstance(motion, MotionSum) else (motion.motion,) if isinstance(motion, Delayed) else ()
    return [part for one in inner for part in _parts(one)] if inner else [motion]


@functools.lru_cache(maxsize=64)
def _faults(structure: Any, kinds: tuple[Any, ...]) -> list[Problem]:
    problems = Problems()
    check_returned(lambda motion, t: motion(t), structure.unflatten(kinds), (6,), "motion", problems)
    return problems.collected


def _samples(times, translation, rotation, problems: Problems, minimum: int, turns: bool = True):
    """Samples of translation and rotation as (times, (n, 6) values); raises all problems, including earlier ones."""
    times = check_times(times, problems, "Sampled.times", minimum)
    n = None if times is None else times.shape[0]
    columns = [
        _rows(translation, n, (3,), "Sampled.translation", problems),
        _rows(rotation, n, (3, 4) if turns else (3,), "Sampled.rotation", problems),
    ]
    if turns:
        columns[1] = _continuous(columns[1], problems, "Sampled.rotation")
    problems.raise_if_any()
    assert times is not None
    for column, name in zip(columns, ("translation", "rotation"), strict=True):
        warn_of_jumps(column, times, f"Sampled.{name}")
    return times, (np if all(isinstance(c, np.ndarray) for c in columns) else jnp).concatenate(columns, 1)


def warn_of_jumps(values: Any, times: Any, where: str) -> None:
    """Warn BASE_JUMP for a step between samples of more than 20 standard deviations of the steps."""
    known, t = concrete(values), concrete(times)
    if known is None or t is None:
        return
    steps = np.abs(np.diff(known, axis=0))
    spread = np.sqrt(np.mean(steps**2, 0))
    if (steps > JUMP * spread).any():
        i, k = np.argwhere(steps > JUMP * spread)[0]
        message = f"{where} jumps by {steps[i, k]:.4g} along {'xyz'[k]} at {t[i]:.6g} s, {steps[i, k] / spread[k]:.3g} times the usual step"
        warn("BASE_JUMP", message)


def _rows(value: Any, n: int | None, widths: tuple[int, ...], where: str, problems: Problems):
    """Finite rows of numbers, one per time if n is given; zeros for None and for invalid rows, for which a problem is added."""
    zeros = np.zeros((n or 0, 3))
    if value is None:
        return zeros
    array = problems.gather(lambda: float_array(value, where))
    if array is None:
        return zeros
    if array.ndim != 2 or array.shape[1] not in widths or n not in (None, array.shape[0]):
        limit = " or ".join(f"({n or 'n'}, {width})" for width in widths)
        hint = "The array looks transposed." if array.ndim == 2 and array.shape[0] in widths else "One row per time."
        problems.add("BAD_SHAPE", where, f"has shape {array.shape}", value=array.shape, limit=limit, hint=hint)
        return zeros
    return array if finite_rows(array, where, problems) else zeros


def _continuous(samples, problems: Problems, where: str):
    """Rotation vectors without jumps of a whole turn between samples; neighboring ones must be less than 30 degrees apart."""
    known = concrete(samples)
    if known is None:
        phi = samples if samples.shape[1] == 3 else rotations.log_quaternion(rotations.normalize(samples))

        def follow(previous, phi):
            phi = _nearest(previous, phi, jnp)
            return phi, phi

        return jnp.concatenate([phi[:1], jax.lax.scan(follow, phi[0], phi[1:])[1]])
    if known.shape[1] == 4:
        norms = np.linalg.norm(known, axis=1)
        if (abs(norms - 1) > 1e-3).any():
            row = int(np.argmax(abs(norms - 1)))
            message, hint = f"has length {norms[row]:.6g} at row {row}", "Divide it by its length; the order is w, x, y, z."
            problems.add("BAD_QUATERNION", where, message, value=known[row], limit="1 within 1e-3", hint=hint)
            return np.zeros((len(known), 3))
        w, v = known[:, :1], known[:, 1:]
        v, w = np.where(w < 0, -v, v), abs(w)
        s = np.linalg.norm(v, axis=1, keepdims=True)
        known = v * np.where(s > 0, 2 * np.arctan2(s, w) / np.where(s > 0, s, 1), 2)
    out = known.copy()
    for i in range(1, len(out)):
        out[i] = _nearest(out[i - 1], out[i], np)
    steps = np.linalg.norm(np.diff(out, axis=0), axis=1)
    if (steps > LARGEST_TURN).any():
        row = int(np.argmax(steps > LARGEST_TURN))
        problems.add(
            "ORIENTATION_JUMP",
            where,
            f"turns by {np.rad2deg(steps[row]):.3g} degrees between rows {row} and {row + 1}",
            value=row,
            limit="30 degrees",
            hint="Sample faster, or choose a reference pose from which the motion never reaches a whole turn about a changing axis.",
        )
    return out


def _nearest(previous, phi, xp):
    """The rotation vector of the same rotation, up to whole turns about its axis, that is nearest to the previous one. The axis of a zero
    rotation is that of the previous one."""
    along = xp.where(xp.any(phi != 0), phi, previous)
    square = xp.sum(along * along)
    axis = along / xp.sqrt(xp.where(square > 0, square, 1.0))
    turns = xp.round(xp.sum((previous - phi) * axis) / (2 * np.pi))
    return phi + 2 * np.pi * turns * axis
