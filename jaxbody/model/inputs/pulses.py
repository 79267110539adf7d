"""Shock pulses: half sine, sawtooth, triangle and trapezoid, as signals and as the motions whose
acceleration they are."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from jaxbody.core.arguments import check_kind, positive_number, whole_number
from jaxbody.core.arrays import Array, Float, device_array, is_concrete
from jaxbody.core.errors import Problems
from jaxbody.geometry.fields import field, take
from jaxbody.geometry.points_and_orientations import direction
from jaxbody.model.inputs.motions import Motion
from jaxbody.model.inputs.signals import Signal


class Pulse(Signal):
    """The base class of pulses: the value at time t is amplitude f(u) with u = (t - start)/duration
    from 0 to 1, zero before and after.

    For a pulse of acceleration [m/s2], `motion(direction)` returns the motion with this
    acceleration, and `samples()` a record of it; `shock_spectrum` accepts the pulse itself."""

    amplitude: Float[Array, ""] = field("value", converter=device_array)
    duration: Float[Array, ""] = field("s", "positive", converter=device_array)
    start: Float[Array, ""] = field("s", converter=device_array)

    def __init__(self, amplitude, duration, start=0.0):
        with Problems() as problems:
            self.given(amplitude, duration, start, problems)

    def given(self, amplitude: Any, duration: Any, start: Any, problems: Problems) -> None:
        """Check and set the fields that all pulses have."""
        take(self, problems, amplitude=amplitude, start=start)
        length = positive_number(duration, f"{type(self).__name__}.duration", problems)
        self.duration = np.ones(()) if length is None else length

    @abstractmethod
    def shape(self, u: Float[Array, "*n"]) -> tuple[Array, Array, Array]:
        """Return f at u from 0 to 1, its integral from 0 to u, and the integral of that."""

    def corners(self) -> tuple[Any, ...]:
        """Return the values of u from 0 to 1 at which f is not smooth."""
        return 0.0, 1.0

    def __call__(self, t):
        u = (t - self.start) / self.duration
        inside = (u >= 0) & (u < 1)
        return jnp.where(inside, self.amplitude * self.shape(jnp.where(inside, u, 0.0))[0], 0.0)

    def after(self, t0):
        return eqx.tree_at(lambda pulse: pulse.start, self, self.start - t0)

    def kinks(self):
        return self.start + self.duration * jnp.stack(
            [jnp.asarray(u, float) for u in self.corners()]
        )

    def motion(self, axis: Any) -> PulseMotion:
        """Return the translation along an axis (x, y, z or a vector, world axes) with this
        acceleration [m/s2], from rest in the support's reference pose. After the pulse its velocity
        is constant: the velocity change of a shock machine without rebound."""
        return PulseMotion(self, axis)

    def samples(self, *, count: int = 200, lengths: int = 20) -> tuple[Array, Array]:
        """Return evenly spaced times [s] and values, like a record. A jump becomes a line over two
        steps h through the mean of both sides, which lowers a response at a frequency f by the
        ratio (2 pi f h)^2/6: `shock_spectrum` of the pulse itself is exact.

        Args:
            count: number of steps in the pulse
            lengths: duration of the record, pulse and free vibration after it, in multiples of the
                pulse's duration"""
        with Problems() as problems:
            count = whole_number(count, "samples.count", problems, 4)
            lengths = whole_number(lengths, "samples.lengths", problems)
        u = np.arange(count * lengths + 1) / count
        inside = self.shape(jnp.asarray(np.minimum(u, 1.0)))[0]
        values = self.amplitude * jnp.where(u < 1, inside, jnp.where(u == 1, inside / 2, 0.0))
        return self.start + self.duration * u, values


class PulseMotion(Motion):
    """The motion from rest whose acceleration is a pulse, as `pulse.motion(axis)` returns it.

    Args:
        pulse: its acceleration [m/s2]
        axis: its direction, x, y, z or a vector in world axes

    Errors: WRONG_KIND, BAD_DIRECTION, ZERO_AXIS.

    >>> PulseMotion(jb.inputs.HalfSine(9.81, 0.01), "z").axis.tolist()
    [0.0, 0.0, 1.0]
    """

    pulse: Pulse = field(words={"value": "m/s2"})
    axis: Float[Array, "3"] = field("", "direction")

    def __init__(self, pulse, axis):
        with Problems() as problems:
            check_kind(
                pulse,
                Pulse,
                "PulseMotion.pulse",
                "a pulse, such as jb.inputs.HalfSine(...)",
                problems,
            )
            self.pulse, self.axis = (
                pulse,
                device_array(direction(axis, "PulseMotion.axis", problems)),
            )

    def __call__(self, t):
        """Return A T^2 (F2(u) + F1(u) (s - u)), with s = (t - start)/T and u = s within the pulse,
        0 before it and 1 after it: in this form, the second derivative is A f(u) within the pulse
        and 0 elsewhere."""
        s = (t - self.pulse.start) / self.pulse.duration
        u = jnp.where((s >= 0) & (s < 1), s, jnp.where(s < 0, 0.0, 1.0))
        _, velocity, displacement = self.pulse.shape(u)
        size = self.pulse.amplitude * self.pulse.duration**2
        return jnp.concatenate(
            [size * (displacement + velocity * (s - u)) * self.axis, jnp.zeros(3, self.axis.dtype)]
        )

    def after(self, t0):
        return eqx.tree_at(lambda motion: motion.pulse, self, self.pulse.after(t0))

    def kinks(self):
        return self.pulse.kinks()


class HalfSine(Pulse):
    """A half-sine pulse, A sin(pi u) with u = (t - start)/duration from 0 to 1.

    Args:
        amplitude: A [m/s2] if the pulse is an acceleration
        duration: duration of the pulse [s]
        start: time at which it begins [s]

    Errors: BAD_NUMBER, BAD_SHAPE, NON_FINITE. Source: IEC 60068-2-27.

    >>> pulse = jb.inputs.HalfSine(15 * 9.81, 0.011)  # 15 g, 11 ms
    >>> round(
    ...     float(jax.jvp(pulse.motion("z"), (jnp.array(0.02),), (jnp.array(1.0),))[1][2]), 4
    ... )  # velocity after it, 2 A T/pi
    1.0305
    """

    def shape(self, u):
        return (
            jnp.sin(np.pi * u),
            (1 - jnp.cos(np.pi * u)) / np.pi,
            (u - jnp.sin(np.pi * u) / np.pi) / np.pi,
        )


class Sawtooth(Pulse):
    """A terminal-peak sawtooth pulse, A u with u = (t - start)/duration from 0 to 1: it ends with
    a jump from A to zero.

    Args: as HalfSine. Errors: BAD_NUMBER, BAD_SHAPE, NON_FINITE. Source: IEC 60068-2-27.

    >>> (
    ...     jb.inputs.Sawtooth(10.0, 2.0)(jnp.array(1.0)).item(),
    ...     jb.inputs.Sawtooth(10.0, 2.0)(jnp.array(2.0)).item(),
    ... )
    (5.0, 0.0)
    """

    def shape(self, u):
        return u, u**2 / 2, u**3 / 6


class Triangle(Pulse):
    """A symmetric triangular pulse, from zero to A at half the duration and back.

    Args: as HalfSine. Errors: BAD_NUMBER, BAD_SHAPE, NON_FINITE.

    >>> jb.inputs.Triangle(10.0, 2.0)(jnp.array(0.5)).item()
    5.0
    """

    def shape(self, u):
        late = jnp.maximum(u - 0.5, 0.0)
        return 2 * u - 4 * late, u**2 - 2 * late**2, u**3 / 3 - 2 * late**3 / 3

    def corners(self):
        return 0.0, 0.5, 1.0


class Trapezoid(Pulse):
    """A trapezoidal pulse: it rises to A in the time `rise`, stays constant, and falls to zero in
    the time `fall`.

    Args:
        amplitude, duration, start: as HalfSine
        rise: time to rise [s]; None: a tenth of the duration, the longest of IEC 60068-2-27
        fall: time to fall [s]; None: as long as the rise

    Errors: BAD_NUMBER, also where rise and fall are longer than the pulse, BAD_SHAPE, NON_FINITE.
    Source: IEC 60068-2-27.

    >>> pulse = jb.inputs.Trapezoid(10.0, 2.0, rise=0.2)
    >>> round(pulse(jnp.array(0.1)).item(), 9), round(pulse(jnp.array(1.0)).item(), 9)
    (5.0, 10.0)
    """

    rise: Float[Array, ""] = field("s", "positive")
    fall: Float[Array, ""] = field("s", "positive")

    def __init__(self, amplitude, duration, start=0.0, *, rise=None, fall=None):
        with Problems() as problems:
            self.given(amplitude, duration, start, problems)
            up = (
                self.duration / 10
                if rise is None
                else positive_number(rise, "Trapezoid.rise", problems)
            )
            down = up if fall is None else positive_number(fall, "Trapezoid.fall", problems)
            if (
                up is not None
                and down is not None
                and is_concrete(up, down, self.duration)
                and up + down > self.duration * (1 + 1e-9)
            ):
                problems.add(
                    "BAD_NUMBER",
                    "Trapezoid rise and fall",
                    f"are {float(up + down):g} s",
                    value=(up, down),
                    limit=f"the duration, {float(self.duration):g} s",
                )
        self.rise, self.fall = device_array(up), device_array(down)

    def shape(self, u):
        rise, fall = self.rise / self.duration, self.fall / self.duration
        x, y, z = u, jnp.maximum(u - rise, 0.0), jnp.maximum(u - 1 + fall, 0.0)
        f, first, second = (
            (x**n - y**n) / (rise * k) - z**n / (fall * k) for n, k in ((1, 1), (2, 2), (3, 6))
        )
        return f, first, second

    def corners(self):
        return 0.0, self.rise / self.duration, 1 - self.fall / self.duration, 1.0
