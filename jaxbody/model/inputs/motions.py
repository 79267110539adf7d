"""Imposed motions: one function of time, Xi(t) = (translation of the support's origin, rotation
vector), from its reference pose.

Velocity and acceleration are derivatives of this function, and so always consistent with it.
"""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxbody.core.arguments import is_own, warn_of_degrees
from jaxbody.core.arrays import (
    Array,
    Float,
    check_times,
    checked,
    concrete,
    device_array,
    shaped,
    time_text,
)
from jaxbody.core.errors import Problems, warn
from jaxbody.geometry import rotations
from jaxbody.geometry.fields import field
from jaxbody.model.inputs.samples import (
    checked_rows,
    curvatures,
    integrals,
    interpolated,
    is_uniform,
    kinks_between_cubics,
    kinks_between_lines,
)
from jaxbody.model.inputs.signals import (
    Delayed,
    Signal,
    SignalSum,
    check_signal,
    function_of_time,
    turned,
)
from jaxbody.numerics.elementary_functions import sincos

JUMP = 20  # size of a jump, in standard deviations of the steps from sample to sample
LARGEST_TURN = np.deg2rad(30)  # from sample to sample


class Motion(Signal):
    """An imposed motion: `motion(t)` is Xi = (xi, phi), translation [m] and rotation vector [rad]
    in world axes. A motion is a signal with six numbers of this meaning; any such signal, or
    function of time that returns the six numbers, can be given in its place.

    >>> (jb.Harmonic(frequency=1.0, translation=[0.1, 0, 0]) + jb.inputs.AtRest())(
    ...     jnp.array(0.0)
    ... ).tolist()
    [0.1, 0.0, 0.0, 0.0, 0.0, 0.0]
    """


class AtRest(Motion):
    """No motion, Xi = 0: the support stays in its reference pose.

    >>> jb.inputs.AtRest()(jnp.array(1.0)).tolist()
    [0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
    """

    def __call__(self, t: Float[Array, ""]) -> Float[Array, "6"]:
        return jnp.zeros(6, jnp.result_type(t, float))

    def after(self, t0):
        return self


class Harmonic(Motion):
    """A harmonic motion of a support, Xi_i = a_i cos(2 pi f t + p_i).

    Args:
        frequency: f [Hz], one number or one per component
        translation: amplitudes [m]
        rotation: amplitudes [rad]
        translation_phase: p_i [rad], one number or one per axis
        rotation_phase: p_i [rad], one number or one per axis

    Warns UNIT for amplitudes of more than one turn. Source: the paper's (78), with a phase
    per axis.

    >>> import jax.numpy as jnp
    >>> jb.Harmonic(frequency=2.0, translation=[0.01, 0, 0])(jnp.array(0.25)).tolist()[0]
    -0.01
    """

    frequency: Float[Array, "*six"] = field("Hz")
    translation: Float[Array, "3"] = field("m")
    rotation: Float[Array, "3"] = field("rad")
    translation_phase: Float[Array, "3"] = field("rad")
    rotation_phase: Float[Array, "3"] = field("rad")

    def __init__(
        self,
        *,
        frequency,
        translation=(0, 0, 0),
        rotation=(0, 0, 0),
        translation_phase=0.0,
        rotation_phase=0.0,
    ):
        given = {
            "frequency": (frequency, ((), (6,))),
            "translation": (translation, ((3,),)),
            "rotation": (rotation, ((3,),)),
            "translation_phase": (translation_phase, ((), (3,))),
            "rotation_phase": (rotation_phase, ((), (3,))),
        }
        with Problems() as problems:
            arrays = {
                name: checked(value, shapes, f"Harmonic.{name}", problems)
                for name, (value, shapes) in given.items()
            }
        for name, array in arrays.items():
            setattr(self, name, device_array(array if name == "frequency" else array * np.ones(3)))
        for name in ("rotation", "translation_phase", "rotation_phase"):
            warn_of_degrees(arrays[name], f"Harmonic.{name}")

    def __call__(self, t: Float[Array, ""]) -> Float[Array, "6"]:
        amplitude = jnp.concatenate([self.translation, self.rotation])
        phase = jnp.concatenate([self.translation_phase, self.rotation_phase])
        # one sine and cosine where the frequency is one number
        s, c = sincos(2 * jnp.pi * self.frequency * t)
        return amplitude * jnp.cos(phase) * c - amplitude * jnp.sin(phase) * s

    def after(self, t0):
        phase = turned(self.frequency, t0) * jnp.ones(6)
        phases = self.translation_phase + phase[:3], self.rotation_phase + phase[3:]
        return eqx.tree_at(
            lambda motion: (motion.translation_phase, motion.rotation_phase), self, phases
        )


class Sampled(Motion):
    """A motion by a C2 cubic spline through samples of translation [m] and rotation vectors [rad]
    (or unit quaternions w, x, y, z) at times [s].

    Between two samples, with h = t_{i+1} - t_i, a = (t_{i+1} - t)/h and b = (t - t_i)/h, values y
    and second derivatives m,

        Xi(t) = a y_i + b y_{i+1} + h^2/6 ((a^3 - a) m_i + (b^3 - b) m_{i+1}).

    The m follow from continuity of Xi', with the end slopes of the cubic through the four
    outermost samples. `Sampled.from_accelerations` takes the m and integrates them from given
    initial values: acceleration is then linear between samples, as in earthquake engineering.
    Times outside the samples are an error. Warns BASE_JUMP for a step of more than 20 standard
    deviations of the steps.

    >>> times = jnp.linspace(0, 1, 11)
    >>> drift = jb.Sampled(times, translation=jnp.stack([times**2, 0 * times, 0 * times], 1))
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
        cls,
        times,
        *,
        translation=None,
        rotation=None,
        initial_position=(0, 0, 0, 0, 0, 0),
        initial_velocity=(0, 0, 0, 0, 0, 0),
    ) -> Sampled:
        """Return the motion whose Xi'' is linear between samples.

        Args:
            times: times of the samples [s], increasing
            translation: accelerations [m/s2]
            rotation: second derivative of the rotation vector [rad/s2], which is the angular
                acceleration where the axis is constant
            initial_position: Xi at the first sample, 6 numbers [m, rad]
            initial_velocity: Xi' at the first sample, 6 numbers [m/s, rad/s]
        """
        problems = Problems()
        x0 = shaped(initial_position, (6,), "Sampled.initial_position", problems)
        v0 = shaped(initial_velocity, (6,), "Sampled.initial_velocity", problems)
        times, m = _samples(times, translation, rotation, problems, minimum=2, turns=False)
        self = object.__new__(cls)
        t, m = device_array(times), device_array(m)
        _, values = integrals(t, m, x0[None], v0[None])
        for name, value in dict(
            times=t, values=values, curvatures=m, uniform=is_uniform(times), rough=True
        ).items():
            object.__setattr__(self, name, value)
        return self

    def covers(self) -> tuple[Any, Any]:
        return self.times[0], self.times[-1]

    def kinks(self) -> Array | None:
        if self.rough:
            return kinks_between_lines(self.times, self.curvatures)
        return kinks_between_cubics(self.times, self.values, self.curvatures)

    def __call__(self, t: Float[Array, ""]) -> Float[Array, "6"]:
        return interpolated(self, t)

    def after(self, t0):
        return eqx.tree_at(lambda motion: motion.times, self, self.times - t0)


def as_motion(motion: Any, where: str = "motion") -> Signal:
    """Return the motion for a motion, for another signal or for a Python function of time."""
    return function_of_time(
        motion,
        where,
        "a Motion, such as jb.Harmonic(...)",
        "Give a Motion or a function t -> Xi, 6 numbers.",
    )


def check_motion(motion: Signal, where: str, problems: Problems) -> None:
    """Check that JAX can trace a motion and that it returns six numbers, unless it consists only of
    motions of this package."""
    if not _known(motion):
        check_signal(motion, where, problems, (6,))


def _known(motion: Signal) -> bool:
    """Return whether a motion, or each part of a sum or a delayed motion, belongs to this package;
    such motions have been checked when they were made."""
    parts = (
        motion.terms
        if isinstance(motion, SignalSum)
        else (motion.signal,)
        if isinstance(motion, Delayed)
        else ()
    )
    return all(map(_known, parts)) if parts else isinstance(motion, Motion) and not is_own(motion)


def _samples(times, translation, rotation, problems: Problems, minimum: int, turns: bool = True):
    """Return samples of translation and rotation as (times, (n, 6) values); raise all problems,
    including earlier ones."""
    times = check_times(times, problems, "Sampled.times", minimum)
    n = None if times is None else times.shape[0]
    columns = [
        _columns(translation, n, (3,), "Sampled.translation", problems),
        _columns(rotation, n, (3, 4) if turns else (3,), "Sampled.rotation", problems),
    ]
    if turns and rotation is not None and len(columns[1]):
        columns[1] = _continuous(columns[1], problems, "Sampled.rotation")
    problems.raise_if_any()
    assert times is not None
    for column, name in zip(columns, ("translation", "rotation"), strict=True):
        warn_of_jumps(column, times, f"Sampled.{name}")
    return times, (np if all(isinstance(c, np.ndarray) for c in columns) else jnp).concatenate(
        columns, 1
    )


def warn_of_jumps(values: Any, times: Any, where: str) -> None:
    """Warn BASE_JUMP for a step between samples of more than 20 standard deviations of
    the steps."""
    known, t = concrete(values), concrete(times)
    if known is None or t is None:
        return
    steps = np.abs(np.diff(known, axis=0))
    spread = np.sqrt(np.mean(steps**2, 0))
    if (steps > JUMP * spread).any():
        i, k = np.argwhere(steps > JUMP * spread)[0]
        warn(
            "BASE_JUMP",
            (
                f"{where} jumps by {steps[i, k]:.4g} along {'xyz'[k]} at {time_text(t[i], t)} s, "
                f"{steps[i, k] / spread[k]:.3g} times the usual step"
            ),
        )


def _columns(value: Any, n: int | None, widths: tuple[int, ...], where: str, problems: Problems):
    """Return finite rows of numbers, one for each time if n is given; zeros for None and for
    invalid rows, for which a problem is added."""
    rows = None if value is None else checked_rows(value, n, widths, where, problems)
    return np.zeros((n or 0, 3)) if rows is None else rows


def _continuous(samples, problems: Problems, where: str):
    """Return rotation vectors without jumps of a whole turn between samples; neighboring ones must
    be less than 30 degrees apart."""
    known = concrete(samples)
    if known is not None and known.shape[1] == 4:
        norms = np.linalg.norm(known, axis=1)
        if (abs(norms - 1) > 1e-3).any():
            row = int(np.argmax(abs(norms - 1)))
            problems.add(
                "BAD_QUATERNION",
                where,
                f"has length {norms[row]:.6g} at row {row}",
                value=known[row],
                limit="1 within 1e-3",
                hint="Divide it by its length; the order is w, x, y, z.",
            )
            return np.zeros((len(known), 3))
    if samples.shape[1] == 4:
        samples = rotations.log_quaternion(rotations.normalize(samples))
    turns = unwound(samples)
    if known is None:
        return turns
    out = np.asarray(turns)
    steps = np.linalg.norm(np.diff(out, axis=0), axis=1)
    if (steps > LARGEST_TURN).any():
        row = int(np.argmax(steps > LARGEST_TURN))
        turn = float(
            np.linalg.norm(rotations.log(rotations.exp(-out[row]) @ rotations.exp(out[row + 1])))
        )
        if turn > LARGEST_TURN:
            message, limit = (
                f"turns by {np.rad2deg(turn):.3g} degrees between rows {row} and {row + 1}",
                "30 degrees",
            )
            hint = "Sample faster."
        else:
            message = (
                f"is near a whole turn, {np.rad2deg(np.linalg.norm(out[row])):.4g} degrees, at row "
                f"{row}, and its axis changes there"
            )
            limit = (
                "less than a whole turn from the reference pose about a changing axis, where "
                "rotation vectors jump"
            )
            hint = (
                "End the samples before, or count rotations from a pose in the middle of them: up "
                "to a whole turn either way."
            )
        problems.add("ORIENTATION_JUMP", where, message, value=row, limit=limit, hint=hint)
    return out


@jax.jit
def unwound(phi: Float[Array, "n 3"]) -> Float[Array, "n 3"]:
    """Return vectors of the same rotations without jumps: whole turns about its axis are added to
    each vector so that it is nearest to the one before. A zero rotation takes the axis of the one
    before."""

    def follow(previous, phi):
        along = jnp.where(jnp.any(phi != 0), phi, previous)
        square = jnp.sum(along * along)
        axis = along / jnp.sqrt(jnp.where(square > 0, square, 1.0))
        phi = phi + 2 * np.pi * jnp.round(jnp.sum((previous - phi) * axis) / (2 * np.pi)) * axis
        return phi, phi

    return jnp.concatenate([phi[:1], jax.lax.scan(follow, phi[0], phi[1:])[1]])
