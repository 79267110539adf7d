"""Signals: numbers or vectors that vary with time, of a load or an instrument, as one function of time."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from jaxbody.core.arguments import check_returned, plain
from jaxbody.core.arrays import Array, Float, check_times, checked, device_array, finite_rows, float_array
from jaxbody.core.errors import Problems
from jaxbody.geometry.fields import field
from jaxbody.inputs.samples import cell, curvatures, is_uniform

__all__ = [
    "Constant",
    "Function",
    "Samples",
    "Signal",
    "Sine",
]


KINDS = ("hold", "linear", "cubic")


class Signal(eqx.Module):
    """A number or a vector as a function of time.

    >>> Sine(amplitude=[0, 0, 5.0], frequency=2.0, phase=0.0)(jnp.array(0.25)).tolist()[2]
    -5.0
    """

    @abstractmethod
    def __call__(self, t: Float[Array, ""]) -> Float[Array, "*k"]: ...

    def covers(self) -> tuple[Any, Any]:
        """First and last time [s] at which it is known."""
        return -np.inf, np.inf

    def kinks(self) -> Array | None:
        """Times [s] at which its slope jumps, where integration steps should end; None if there are none."""


class Constant(Signal):
    """A constant.

    >>> float(Constant(3.0)(jnp.array(1.0)))
    3.0
    """

    value: Float[Array, "*k"] | float = field("value")

    def __call__(self, t) -> Any:
        return self.value


class Sine(Signal):
    """a cos(2 pi f t + p): `amplitude` a, a number or vector, `frequency` f [Hz], `phase` p [rad].

    >>> float(Sine(amplitude=2.0, frequency=1.0)(jnp.array(0.0)))
    2.0
    """

    amplitude: Float[Array, "*k"] = field("value")
    frequency: Float[Array, ""] = field("Hz")
    phase: Float[Array, ""] = field("rad")

    def __init__(self, *, amplitude, frequency, phase=0.0):
        with Problems() as problems:
            self.amplitude = device_array(_number_or_vector(amplitude, "Sine.amplitude", problems))
            for name, value in (("frequency", frequency), ("phase", phase)):
                array = checked(value, ((),), f"Sine.{name}", problems)
                setattr(self, name, device_array(np.zeros(()) if array is None else array))

    def __call__(self, t):
        return self.amplitude * jnp.cos(2 * jnp.pi * self.frequency * t + self.phase)


class Samples(Signal):
    """A signal through samples at increasing times [s], such as a record. `kind`, the interpolation between them:

    "hold"    each value holds until the next sample (a digital source)
    "linear"  straight lines
    "cubic"   a C2 cubic spline, as in Sampled motions: best for a smooth signal that is sampled fast enough

    `values` (n,) or (n, k). Times outside the samples are an error. Errors: times as in `simulate`, BAD_SHAPE, NON_FINITE, BAD_KIND.

    >>> float(Samples([0.0, 1.0, 2.0, 3.0], [0.0, 2.0, 4.0, 6.0], kind="linear")(jnp.array(0.25)))
    0.5
    """

    times: Float[Array, "n"] = field("s")
    values: Float[Array, "n *k"] = field("value")
    curvatures: Float[Array, "n *k"] | None = field("value/s2")
    kind: str = field(static=True, converter=plain)
    uniform: bool = field(static=True)

    def __init__(self, times, values, *, kind: str = "cubic"):
        with Problems() as problems:
            if kind not in KINDS:
                problems.add("BAD_KIND", "Samples.kind", f"is {kind!r}", value=kind, limit=" ".join(KINDS), hint="Give one of these.")
            known = check_times(times, problems, "Samples.times", minimum=4 if kind == "cubic" else 2)
            y = _rows(values, known, problems)
        self.times, self.values = device_array(known), device_array(y)
        self.kind, self.uniform = kind, is_uniform(known)
        flat = self.values.reshape(len(self.values), -1)
        self.curvatures = curvatures(self.times, flat).reshape(self.values.shape) if kind == "cubic" else None

    def covers(self) -> tuple[Any, Any]:
        return self.times[0], self.times[-1]

    def kinks(self):
        return self.times if self.kind == "linear" else None

    def __call__(self, t):
        i, h, a, b = cell(self.times, self.uniform, t)
        if self.kind == "hold":
            return jnp.where(b < 1, self.values[i], self.values[i + 1])
        line = a * self.values[i] + b * self.values[i + 1]
        if self.curvatures is None:
            return line
        return line + h**2 / 6 * ((a**3 - a) * self.curvatures[i] + (b**3 - b) * self.curvatures[i + 1])


class Function(Signal):
    """Any JAX function of time. Each new function object is compiled again; a Signal with array leaves avoids that.

    >>> Function(lambda t: 3.0 * t)(0.5).item()
    1.5
    """

    function: Callable[..., Any] = eqx.field(static=True)

    def __call__(self, t):
        return jnp.asarray(self.function(t))


def as_signal(value: Any, where: str, problems: Problems, size: tuple[int, ...]) -> Signal:
    """The Signal for a signal, for a Python function of time, or for constant numbers of this size."""
    if isinstance(value, Signal):
        signal = value
    elif callable(value):
        signal = Function(value)
    else:
        array = checked(value, (size,), where, problems)
        return Constant(np.zeros(size) if array is None else array)
    check_returned(lambda signal, t: signal(t), signal, size, where, problems)
    return signal


def _number_or_vector(value: Any, where: str, problems: Problems) -> Any:
    array = checked(value, ((), (np.size(value),)), where, problems)
    return np.zeros(()) if array is None else array


def _rows(values: Any, times: Any, problems: Problems) -> Any:
    y = problems.gather(lambda: float_array(values, "Samples.values"))
    if y is None or times is None:
        return y
    if y.ndim not in (1, 2) or y.shape[0] != len(times):
        limit = f"({len(times)},) or ({len(times)}, k)"
        problems.add("BAD_SHAPE", "Samples.values", f"has shape {y.shape}", value=y.shape, limit=limit, hint="One value per time.")
    finite_rows(y, "Samples.values", problems)
    return y
