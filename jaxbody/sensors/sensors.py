"""What an instrument on a body reads, with what lies between that and its record: gain, bias, delay and lag."""

from abc import abstractmethod
from typing import Any, ClassVar, TypedDict, Unpack

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxbody.core.arguments import check_kind, checked_dict, plain
from jaxbody.core.arrays import checked, concrete, vector
from jaxbody.core.errors import Problem, Problems, unknown
from jaxbody.elements.elements import Element
from jaxbody.geometry.fields import check_domain, field, kind_of
from jaxbody.geometry.places import unit_vector
from jaxbody.geometry.vectors import dot, rotate
from jaxbody.models.models import Model
from jaxbody.models.states import Instant
from jaxbody.sensors import delays_and_lags
from jaxbody.sensors.channels import Channel

Reading = Float[Array, "*r"]


class Chain(TypedDict, total=False):
    """What may stand between what an instrument measures and what it reads: see Sensor."""

    gain: Any
    bias: Any
    delay: Any
    lag: Any
    start: Any


class Sensor(Channel):
    """The base of all sensors: `reading` of the frames at one time, `transduced` into a record, and `residual`, reading less measured.

        y(t) = gain x_lag(t) + bias,   lag x_lag' + x_lag = x(t - delay),   x_lag(t_0) = start

    Each of these may be missing (None): `gain`, one number or one for each component; `bias` likewise, in the unit of the residual; `delay` [s],
    of either sign; `lag` [s], a time constant; `start`, without it x(t_0 - delay), as of an instrument that had settled. Before the first sample and
    after the last a reading goes on as it did at most one sample far; delayed samples further outside are not known: `measure`
    has NaN there, and in a fit they count as missing, fading over one sample.

    `shape` of a reading and `noise_shape` of a residual; `unit` of either, where there are several by commas: noise has a number for each.
    `accelerations`, `reactions`: whether a reading needs those of the frames, and what they pass on to joints and supports.

    A sensor of your own states `on`, `shape`, `unit` and `reading`; it has the chain too. The speed of a falling body, read 2 % too high:

    >>> import equinox as eqx
    >>> class Speed(Sensor):
    ...     on: str = eqx.field(static=True)
    ...     shape, unit = (), "m/s"
    ...     def reading(self, model, frames):
    ...         return jnp.linalg.norm(frames.v[model.layout.frame(self.on)])
    >>> guide = Guide("world", axis=[0, 0, 1])
    >>> model = Model(bodies={"stone": Body(mass=1, inertia=[1, 1, 1])}, joints={"stone": guide}, gravity=[0, 0, -10])
    >>> run = simulate(model, [0.0, 0.5])
    >>> round(float(measure(run, {"speed": Speed("stone", gain=1.02)})["speed"][-1]), 9)
    5.1
    """

    on: eqx.AbstractVar[str]
    accelerations: ClassVar[bool] = False
    reactions: ClassVar[bool] = False
    stages: ClassVar[tuple[str, ...]] = ("gain", "bias", "delay", "lag", "start")  # of the chain, that it may have
    gain: Float[Array, "*g"] | None = field(default=None, kw_only=True)
    bias: Float[Array, "*b"] | None = field("unit", default=None, kw_only=True)
    delay: Float[Array, ""] | None = field("s", default=None, kw_only=True)
    lag: Float[Array, ""] | None = field(
        "s", "positive", code="BAD_LAG", hint="Leave it out where there is none.", default=None, kw_only=True
    )
    start: Float[Array, "*r"] | None = field("unit", default=None, kw_only=True)

    def __init__(self, on: str, **chain: Unpack[Chain]):
        problems = Problems()
        self.on = on
        self.chained(problems, **chain)
        problems.raise_if_any()

    def chained(self, problems: Problems, **chain: Unpack[Chain]) -> None:
        """Takes gain, bias, delay, lag and start."""
        kind = type(self).__name__
        self.gain = self.bias = self.delay = self.lag = self.start = None
        shapes = {"gain": self.shape, "bias": self.noise_shape, "start": self.shape}
        for name, value in chain.items():
            if name not in Chain.__annotations__:
                raise TypeError(f"{kind} has no argument '{name}'")
            where = f"{kind}.{name}"
            if value is None:
                continue
            if name not in self.stages:
                problems.add("BAD_CHAIN", where, "has no meaning for an orientation", value=value, limit=", ".join(self.stages))
                continue
            shape = shapes.get(name, ())
            several = shape if "gain" in self.stages else ()
            array = checked(value, ((), shape) if shape and several else (shape,), where, problems)
            setattr(self, name, array)
            check_domain(np.zeros(0) if array is None else array, kind_of(self, name), where, problems)
        if self.start is not None and self.lag is None:
            problems.add(
                "BAD_CHAIN", f"{kind}.start", "is where the lag sets out, and there is none", value=self.start, hint="Give lag=..."
            )

    @abstractmethod
    def reading(self, model: Model, frames: Instant) -> Reading:
        """What it measures at one time, before its chain."""

    def transduced(self, times: Float[Array, "nt"], x: Float[Array, "nt *r"]) -> Float[Array, "nt *r"]:
        """The record that its chain makes of what it measures."""
        if self.delay is not None:
            x = self.delayed(times, x)
        if self.lag is not None:
            x = delays_and_lags.lagged(times, x, self.lag, x[0] if self.start is None else self.start)
        if self.gain is not None:
            x = self.gain * x
        return x if self.bias is None else self.disturbed(x, self.bias)

    def delayed(self, times: Float[Array, "nt"], x: Float[Array, "nt *r"]) -> Float[Array, "nt *r"]:
        """x(t - delay)."""
        return delays_and_lags.delayed(times, x, self.delay)

    def weight(self, times: Float[Array, "nt"]) -> Float[Array, "nt"]:
        """How far each sample counts: 0 where delayed ones are not known."""
        return jnp.ones_like(times) if self.delay is None else delays_and_lags.known(times, self.delay)

    def misfit(self, times: Float[Array, "nt"], reading: Float[Array, "nt *r"], measured: Float[Array, "nt *r"]) -> Float[Array, "nt *r"]:
        """Residuals of a record, each as far as it counts."""
        r = self.residual(reading, measured)
        if self.delay is None:
            return r
        weight = self.weight(times).reshape(-1, *[1] * (r.ndim - 1))
        return jnp.where(weight > 0, weight * r, 0.0)

    def disturbed(self, reading: Reading, noise: Float[Array, "*r"]) -> Reading:
        """A reading with noise on it."""
        return reading + noise

    @property
    def plain(self) -> bool:
        """True of one without a chain."""
        return all(getattr(self, stage) is None for stage in Chain.__annotations__)

    @property
    def names(self) -> tuple[str, ...]:
        """The bodies and supports that it is on."""
        return (self.on,)

    def problem(self, model: Model, where: str) -> Problem | None:
        """What is wrong with it on this model."""
        known = model.layout.frames
        return next((unknown(name, where, known) for name in self.names if name not in known), None)

    def misread(self, measured: np.ndarray, where: str) -> Problem | None:
        """What is wrong with samples of the right shape."""
        return None


class Position(Sensor):
    """World position [m] of a point of a body or support; with `axis` (a direction in world axes) one number, the component along it.

    >>> Position("plate", [0.1, 0, 0]).shape, Position("plate", axis=[1, 0, 0]).shape
    ((3,), ())
    """

    on: str = eqx.field(static=True, converter=plain)
    point: Float[Array, "3"] = field("m")
    axis: Float[Array, "3"] | None = field("", "direction")
    unit = "m"

    def __init__(self, on: str, point=(0, 0, 0), *, axis=None, **chain: Unpack[Chain]):
        problems = Problems()
        self.on, self.point = on, vector(point, "Position.point", problems)
        self.axis = None if axis is None else unit_vector(axis, "Position.axis", problems)
        self.chained(problems, **chain)
        problems.raise_if_any()

    @property
    def shape(self) -> tuple[int, ...]:  # pyright: ignore[reportIncompatibleVariableOverride]
        return (3,) if self.axis is None else ()

    def reading(self, model, frames):
        row = model.layout.frame(self.on)
        p = frames.p[row] + rotate(frames.R[row], self.point)
        return p if self.axis is None else dot(self.axis, p)


class Elongation(Sensor):
    """Elongation [m] of a spring, tension positive.

    >>> Elongation("AB").unit
    'm'
    """

    on: str = eqx.field(static=True, converter=plain)
    shape = ()
    unit = "m"

    def reading(self, model, frames):
        element: Element = model[self.on]
        return element.deformation(*(frames[model.layout.frame(end)].pose() for end in element.between))

    def problem(self, model, where):
        names = tuple(name for table in model.elements if table.rows.size == 1 for name in table.names)
        return None if self.on in names else unknown(self.on, where, names)


def check_sensors(sensors: dict[str, Sensor], model: Model, where: str) -> None:
    """Every sensor is one, and on something that the model has."""
    problems = Problems()
    for name, sensor in checked_dict(sensors, where, "name: jb.Position(...)", problems).items():
        check_kind(sensor, Sensor, f"{where}['{name}']", "a sensor, as jb.Position(...)", problems)
        problem = sensor.problem(model, f"{where}['{name}']") if isinstance(sensor, Sensor) else None
        problems.collected += [] if problem is None else [problem]
    problems.raise_if_any()


def noise_levels(sensors: dict[str, Sensor], noise: Any, where: str, problems: Problems, *, zero: bool) -> dict[str, Any]:
    """{sensor: standard deviation} of one number for all sensors or a dict; what is wrong goes to `problems`. `zero` says if 0 is one."""
    levels = {}
    for name, value in (noise if isinstance(noise, dict) else dict.fromkeys(sensors, noise)).items():
        there = f"{where}['{name}']"
        if name not in sensors:
            found = unknown(name, there, tuple(sensors))
            problems.add(found.code, there, found.message, value=name, hint=found.hint)
            continue
        units = sensors[name].units
        level = checked(value, ((),) if units == 1 else ((), (units,)), there, problems, f"One number [{sensors[name].unit}].")
        known = None if level is None else concrete(level)
        if known is not None and ((known < 0).any() or not (zero or known.all())):
            hint = "" if zero else "Leave noise out to have it estimated."
            problems.add("BAD_NOISE", there, f"is {known}", value=known, limit=">= 0" if zero else "> 0", hint=hint)
        if level is not None:
            levels[name] = level
    return levels
