"""Signals: numbers or vectors as functions of time, with sums and delays. Loads and instruments
contain signals; a motion is a signal of six numbers."""

from __future__ import annotations

import functools
from abc import abstractmethod
from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxbody.core.arguments import check_one_of, check_returned, kind_of, plain, warn_of_degrees
from jaxbody.core.arrays import (
    Array,
    Float,
    check_times,
    device_array,
    functions_as_nodes,
    is_concrete,
    shaped,
)
from jaxbody.core.errors import JaxbodyError, Problem, Problems
from jaxbody.geometry.fields import Described, field, take
from jaxbody.model.inputs.samples import (
    cell,
    checked_rows,
    curvatures,
    interpolated,
    is_uniform,
    kinks_between_cubics,
    kinks_between_lines,
)

__all__ = [
    "Constant",
    "Delayed",
    "Function",
    "Samples",
    "Signal",
    "Sine",
]


def __dir__():
    return __all__


KINDS = ("hold", "linear", "cubic")


class Signal(Described, eqx.Module):
    """A number or a vector as a function of time. Signals can be added to each other and to
    functions of time.

    >>> jb.signals.Sine(amplitude=[0, 0, 5.0], frequency=2.0, phase=0.0)(jnp.array(0.25)).tolist()[
    ...     2
    ... ]
    -5.0
    >>> (jb.signals.Sine(amplitude=2.0, frequency=1.0) + (lambda t: 3.0 * t))(jnp.array(1.0)).item()
    5.0
    """

    @abstractmethod
    def __call__(self, t: Float[Array, ""]) -> Float[Array, "*k"]: ...

    def __init_subclass__(cls, **kwargs: Any):
        super().__init_subclass__(**kwargs)
        if "__call__" in vars(cls) and "after" not in vars(cls):
            cls.after = Signal.after  # an inherited `after` would use the base class's formula

    def after(self, t0: Float[Array, ""]) -> Signal:
        """Return signal(t0 + t) as a function of t, for integrations: t0 + t is rounded, by 2e-7 s
        at 1.6e9 s, so signals that have times subtract t0 from these."""
        return Delayed(self, -t0)

    def covers(self) -> tuple[Any, Any]:
        """Return the first and last time [s] at which the signal is known."""
        return -np.inf, np.inf

    def kinks(self) -> Array | None:
        """Return the times [s] at which the signal is not smooth, or begins or ceases to act;
        integration steps end there. None if there are none; times of inf stand for no kink."""

    def __add__(self, other: Signal | Callable[[Array], Array]) -> SignalSum:
        return SignalSum((self, function_of_time(other)))

    def __radd__(self, other: Any) -> Signal:
        return (
            self
            if isinstance(other, int) and other == 0
            else SignalSum((function_of_time(other), self))
        )  # sum() starts from 0


class SignalSum(Signal):
    """The sum of several signals, `terms`, which are numbers or vectors of one size. In a sum of
    motions the translations are added, and so are the rotation vectors."""

    terms: tuple[Signal, ...] = field()

    def __call__(self, t):
        return sum((term(t) for term in self.terms[1:]), self.terms[0](t))

    def after(self, t0):
        return SignalSum(tuple(term.after(t0) for term in self.terms))

    def covers(self) -> tuple[Any, Any]:
        first, last = zip(*(term.covers() for term in self.terms), strict=True)
        xp = np if is_concrete(first, last) else jnp
        return xp.max(xp.asarray(first)), xp.min(xp.asarray(last))

    def kinks(self) -> Array | None:
        return kinks_of(self.terms)

    def _described(self, words):
        return " + ".join(term._described(words) for term in self.terms)


class Delayed(Signal):
    """A delayed signal, signal(t - delay): the same signal `delay` [s] later, such as the motion of
    a rear wheel that follows the front wheel on the same road.

    >>> motion = jb.signals.Delayed(jb.Harmonic(frequency=2.0, translation=[0.01, 0, 0]), 0.25)
    >>> motion(jnp.array(0.25)).tolist()[0]
    0.01
    """

    signal: Signal = field()
    delay: Float[Array, ""] = field("s", converter=device_array)

    def __init__(self, signal, delay):
        take(self, delay=delay)
        self.signal = function_of_time(signal, "Delayed.signal")

    def __call__(self, t):
        return self.signal(t - self.delay)

    def after(self, t0):
        return Delayed(self.signal.after(t0), self.delay)

    def covers(self) -> tuple[Any, Any]:
        first, last = self.signal.covers()
        return first + self.delay, last + self.delay

    def kinks(self) -> Array | None:
        known = self.signal.kinks()
        return None if known is None else known + self.delay


class Constant(Signal):
    """A signal of constant value.

    >>> float(jb.signals.Constant(3.0)(jnp.array(1.0)))
    3.0
    """

    value: Float[Array, "*k"] | float = field("value")

    def __call__(self, t) -> Any:
        return self.value

    def after(self, t0):
        return self


class Sine(Signal):
    """A sinusoid a cos(2 pi f t + p): `amplitude` a, a number or vector, `frequency` f [Hz],
    `phase` p [rad].

    >>> float(jb.signals.Sine(amplitude=2.0, frequency=1.0)(jnp.array(0.0)))
    2.0
    """

    amplitude: Float[Array, "*k"] = field("value", converter=device_array)
    frequency: Float[Array, ""] = field("Hz", converter=device_array)
    phase: Float[Array, ""] = field("rad", converter=device_array)

    def __init__(self, *, amplitude, frequency, phase=0.0):
        with Problems() as problems:
            size = np.shape(amplitude)[:1]
            self.amplitude = shaped(amplitude, size, "Sine.amplitude", problems)
            take(self, problems, frequency=frequency, phase=phase)
        warn_of_degrees(self.phase, "Sine.phase")

    def __call__(self, t):
        return self.amplitude * jnp.cos(2 * jnp.pi * self.frequency * t + self.phase)

    def after(self, t0):
        return eqx.tree_at(lambda sine: sine.phase, self, self.phase + turned(self.frequency, t0))


class Samples(Signal):
    """A signal through samples at increasing times [s], such as a record. `kind`, the interpolation
    between them:

    "hold"    each value holds until the next sample (a digital source)
    "linear"  straight lines
    "cubic"   a C2 cubic spline, as in Sampled motions: best for a smooth signal that is sampled
              fast enough

    `values` (n,) or (n, k). Times outside the samples are an error. Errors: times as in `simulate`,
    BAD_SHAPE, NON_FINITE, BAD_KIND.

    >>> float(
    ...     jb.signals.Samples([0.0, 1.0, 2.0, 3.0], [0.0, 2.0, 4.0, 6.0], kind="linear")(
    ...         jnp.array(0.25)
    ...     )
    ... )
    0.5
    """

    times: Float[Array, "n"] = field("s")
    values: Float[Array, "n *k"] = field("value")
    curvatures: Float[Array, "n *k"] | None = field("value/s2")
    kind: str = field(static=True, converter=plain)
    uniform: bool = field(static=True)

    def __init__(self, times, values, *, kind: str = "cubic"):
        with Problems() as problems:
            check_one_of(kind, KINDS, "BAD_KIND", "Samples.kind", problems)
            known = check_times(
                times, problems, "Samples.times", minimum=4 if kind == "cubic" else 2
            )
            y = checked_rows(
                values,
                None if known is None else len(known),
                (None, "k"),
                "Samples.values",
                problems,
            )
        self.times, self.values = device_array(known), device_array(y)
        self.kind, self.uniform = kind, is_uniform(known)
        self.curvatures = curvatures(self.times, self.values) if kind == "cubic" else None

    def covers(self) -> tuple[Any, Any]:
        return self.times[0], self.times[-1]

    def kinks(self):
        if self.kind == "hold":
            jumps = jnp.any(jnp.diff(self.values.reshape(len(self.times), -1), axis=0) != 0, 1)
            return jnp.where(jumps, self.times[1:], jnp.inf)
        if self.curvatures is None:
            return kinks_between_lines(self.times, self.values)
        return kinks_between_cubics(self.times, self.values, self.curvatures)

    def after(self, t0):
        return eqx.tree_at(lambda samples: samples.times, self, self.times - t0)

    def __call__(self, t):
        if self.kind != "hold":
            return interpolated(self, t)
        i, _, _, b = cell(self.times, self.uniform, t)
        return jnp.where(b < 1, self.values[i], self.values[i + 1])


class Function(Signal):
    """A signal given by any JAX function of time. A new function object makes programs compile
    again; a user-defined Signal with array fields avoids that.

    >>> jb.signals.Function(lambda t: 3.0 * t)(0.5)
    1.5
    """

    function: Callable[..., Any] = eqx.field(static=True)

    def __call__(self, t):
        return self.function(t)


def turned(frequency: Any, t: Any) -> Array:
    """Return the angle 2 pi f t [rad] without its whole turns, for a frequency f [Hz]."""
    return 2 * jnp.pi * (frequency * t - jnp.floor(frequency * t))


def kinks_of(signals: Iterable[Signal]) -> Array | None:
    """Return the kinks of several signals in increasing order."""
    known = [kinks for signal in signals if (kinks := signal.kinks()) is not None]
    return jnp.sort(jnp.concatenate(known)) if known else None


def function_of_time(
    value: Any,
    where: str = "signal",
    wanted: str = "a Signal, such as jb.signals.Sine(...)",
    hint: str = "Give a Signal or a function of time.",
) -> Signal:
    """Return the Signal for a signal or for a Python function of time. Error: WRONG_KIND."""
    if not callable(value) or isinstance(value, type):
        raise JaxbodyError(
            Problem("WRONG_KIND", where, f"is {kind_of(value)}", value, wanted, hint)
        )
    return value if isinstance(value, Signal) else Function(value)


def as_signal(value: Any, where: str, problems: Problems, size: tuple[int, ...]) -> Signal:
    """Return the Signal for a signal, for a Python function of time, or for constant numbers of
    this size."""
    signal = (
        function_of_time(value, where)
        if callable(value)
        else Constant(shaped(value, size, where, problems))
    )
    check_signal(signal, where, problems, size, lists=True)
    return signal


def check_signal(
    signal: Signal, where: str, problems: Problems, size: tuple[int, ...], lists: bool = False
) -> None:
    """Check that JAX can trace a signal and that it returns an array of this size, or a list if
    `lists`; each structure is traced once."""
    leaves, structure = jax.tree.flatten(functions_as_nodes(signal))
    kinds = tuple(jax.ShapeDtypeStruct(np.shape(leaf), jnp.result_type(leaf)) for leaf in leaves)
    problems.collected += [
        replace(problem, where=where) for problem in _faults(structure, kinds, size, lists)
    ]


@functools.lru_cache(maxsize=64)
def _faults(
    structure: Any, kinds: tuple[Any, ...], size: tuple[int, ...], lists: bool
) -> list[Problem]:
    problems = Problems()
    check_returned(
        lambda signal, t: jnp.asarray(signal(t)) if lists else signal(t),
        structure.unflatten(kinds),
        size,
        "signal",
        problems,
    )
    return problems.collected
