"""The base classes of measured channels and of sensors: residuals and noise of a channel; the
reading of an instrument on a body, and its chain of gain, bias, delay and lag.

Between samples a record x is the polynomial through the twelve nearest ones. For a sine at a tenth
of the sampling rate the error is 2e-7 of its amplitude, five samples or more from the ends; at a
fifth of the rate it is 1e-3.
"""

import math
from abc import abstractmethod
from typing import Any, ClassVar, TypedDict, Unpack

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxbody.core.arguments import check_kind, checked_dict
from jaxbody.core.arrays import Array, Float, Int, checked, concrete, module_of
from jaxbody.core.errors import Problem, Problems, unknown
from jaxbody.geometry.fields import Described, field, in_domain, kind_of
from jaxbody.geometry.frames import Instant
from jaxbody.geometry.points_and_orientations import DIRECTIONS
from jaxbody.geometry.vectors import to_rank
from jaxbody.model.models import Model


class Channel(eqx.Module):
    """The base class of sensors and of the channels of other measurements.

    `shape` is that of a reading, `noise_shape` that of a residual. `unit` is that of both; it may
    hold several, separated by commas, and noise then has one number for each."""

    shape: eqx.AbstractClassVar[tuple[int, ...]]
    unit: eqx.AbstractClassVar[str]
    # True for a time series: neighbors may be correlated, and samples suffice to estimate the noise
    series: ClassVar[bool] = True
    # names of the groups of components, where there are several units
    parts: ClassVar[tuple[str, ...]] = ()

    def residual(self, reading: Array, measured: Array) -> Float[Array, "*r"]:
        """Return reading minus measured, zero where a sample is missing."""
        return module_of(reading, measured).where(self.missing(measured), 0.0, reading - measured)

    def missing(self, measured: Any) -> Any:
        """Return True for components of a residual whose sample is missing (NaN)."""
        return module_of(measured).isnan(measured)

    def spread(self, level: Any) -> Any:
        """Return the noise levels of the components of a residual, from one number or one for each
        unit; several units give one row, which broadcasts over samples."""
        if self.units == 1:
            return level
        xp = module_of(level)
        return xp.repeat(xp.broadcast_to(level, (self.units,)), self.noise_shape[-1] // self.units)[
            None
        ]

    def pooled(self, x: Any) -> Any:
        """Return the sum of residual components x over all samples: one number for each unit."""
        return (
            x.sum()
            if self.units == 1
            else x.reshape(-1, self.units, self.noise_shape[-1] // self.units).sum((0, 2))
        )

    @property
    def noise_shape(self) -> tuple[int, ...]:
        return self.shape

    @property
    def components(self) -> tuple[str, ...]:
        """The names of the components of a residual: "" for a single number, "x" to "rz" for up to
        six, else their numbers."""
        shape = self.noise_shape
        if not shape:
            return ("",)
        count = math.prod(shape)
        return DIRECTIONS[:count] if count <= len(DIRECTIONS) else tuple(map(str, range(count)))

    def unit_on(self, model: Any) -> str:
        """Return the unit on a model, as it may depend on the kind of an element."""
        return self.unit

    @property
    def possible_units(self) -> tuple[str, ...]:
        """The units that it may have, depending on the kind of an element."""
        return (self.unit,)

    @property
    def units(self) -> int:
        """The number of units, each of the same number of consecutive components."""
        return self.unit.count(",") + 1


POINTS = 12  # number of samples that the polynomial interpolates
# nodes of the quadrature of x in the lag's solution, as fractions of a cell
NODES = (1 - np.cos(np.pi * np.arange(6) / 5)) / 2
# h/T below which moments come from their series, and the number of its terms: 3^28/28! < 1e-16
SERIES, TERMS = 3.0, 28


def between(
    times: Float[Array, "n"], x: Float[Array, "n k"], cells: Int[Array, "m"], t: Float[Array, "m q"]
) -> Float[Array, "m q k"]:
    """Return x at times t in (or near) cells, by Lagrange's formula. Cell i is from times[i] to
    times[i + 1]."""
    n = len(times)
    points = min(POINTS, n)
    first = jnp.clip(cells - (points // 2 - 1), 0, n - points)
    near = first[:, None] + np.arange(points, dtype=first.dtype)[None]
    nodes = times[near]
    span = nodes[:, -1:] - nodes[:, :1]
    apart = (nodes[:, :, None] - nodes[:, None]) / span[..., None]
    below = jnp.prod(jnp.where(np.eye(points, dtype=bool)[None], 1.0, apart), -1)[:, None]
    away = (t[:, :, None] - nodes[:, None]) / span[..., None]
    # products of the factors before and after each node
    left, right = [jnp.ones_like(t)], [jnp.ones_like(t)]
    for j in range(points - 1):
        left.append(left[-1] * away[..., j])
        right.append(right[-1] * away[..., points - 1 - j])
    weights = jnp.stack([a * b for a, b in zip(left, reversed(right), strict=True)], -1) / below
    return jnp.sum(weights[..., None] * x[near][:, None], 2)


def delayed(
    times: Float[Array, "n"], x: Float[Array, "n *r"], tau: Float[Array, ""]
) -> Float[Array, "n *r"]:
    """Return x(t - tau); the polynomials of the first and last cell extrapolate by at most one
    sample."""
    t = jnp.clip(times - tau, 2 * times[0] - times[1], 2 * times[-1] - times[-2])
    cells = jnp.clip(jnp.searchsorted(times, t, side="right") - 1, 0, len(times) - 2)
    return between(times, x.reshape(len(times), -1), cells, t[:, None])[:, 0].reshape(x.shape)


def known(times: Float[Array, "n"], tau: Float[Array, ""]) -> Float[Array, "n"]:
    """Return the weight of each delayed sample: 1 where t - tau lies in the record, 0 more than a
    sample outside, linear between."""
    t = times - tau
    before = (times[0] - t) / (times[1] - times[0])
    after = (t - times[-1]) / (times[-1] - times[-2])
    return jnp.clip(1 - jnp.maximum(before, after), 0.0, 1.0)


def lagged(
    times: Float[Array, "n"],
    x: Float[Array, "n *r"],
    T: Float[Array, ""],
    start: Float[Array, "*r"],
) -> Float[Array, "n *r"]:
    """Return the solution y of T y' + y = x, y(t_0) = start, which is exact for the polynomials
    through x:

    y(t + h) = e^-z y(t) + sum_q W_q(z) x(t + s_q h),   W_q = z int_0^1 e^-z(1 - s) l_q(s) ds,
    z = h/T
    """
    n = len(times)
    h = jnp.diff(times)
    inside = between(
        times, x.reshape(n, -1), jnp.arange(n - 1), times[:-1, None] + NODES[None] * h[:, None]
    )
    z = h / T
    drive = jnp.sum(_weights(z)[..., None] * inside, 1)

    def step(y, cell):
        y = cell[0] * y + cell[1]
        return y, y

    y0 = jnp.broadcast_to(start, x.shape[1:]).reshape(-1)
    _, rest = jax.lax.scan(step, y0, (jnp.exp(-z), drive), unroll=8)
    return jnp.concatenate([y0[None], rest]).reshape(x.shape)


def _weights(z: Float[Array, "m"]) -> Float[Array, "m q"]:
    """Return W_q(z), which are exact for powers s^k with the moments m_k = z int_0^1 e^-z(1 - s)
    s^k ds. For small z the moments come from their series m_k = z e^-z sum z^n/(n! (n + k + 1)),
    for larger z from the recursion m_k = 1 - k m_(k-1)/z, because each loses digits where the other
    is used."""
    near, far = jnp.minimum(z, SERIES), jnp.maximum(z, SERIES)
    series, recursion = [], [-jnp.expm1(-far)]
    for k in range(len(NODES)):
        total = jnp.zeros_like(z)
        for n in reversed(range(TERMS)):
            total = total * near + 1 / (math.factorial(n) * (n + k + 1))
        series.append(near * jnp.exp(-near) * total)
        recursion.append(1 - (k + 1) / far * recursion[-1])
    moments = jnp.where(z[:, None] < SERIES, jnp.stack(series, -1), jnp.stack(recursion[:-1], -1))
    powers = NODES[None] ** np.arange(len(NODES))[:, None]
    return jnp.sum(moments[:, None] * np.linalg.inv(powers)[None], -1)


Reading = Float[Array, "*r"]


class Chain(TypedDict, total=False):
    """The chain from the measured quantity to the record: see Sensor."""

    gain: Any
    bias: Any
    delay: Any
    lag: Any
    start: Any


class Sensor(Described, Channel):
    """The base class of sensors: `reading` of the frames at one time, `transduced` into a record,
    and `residual`, reading minus measured.

        y(t) = gain x_lag(t) + bias,   lag x_lag' + x_lag = x(t - delay),   x_lag(t_0) = start

    Args:
        gain: one number, or one for each component
        bias: one number, or one for each component of the residual, in its unit
        delay: a delay, positive or negative [s]
        lag: time constant [s]
        start: initial value of the lag; None: x(t_0 - delay), as for an instrument that has settled

    By default all of them are None, without effect. A record is extrapolated by at most one sample.
    Delayed samples further outside are unknown: `measure` returns NaN, and a fit treats them as
    missing, with a weight that decreases to zero over one sample.

    Class attributes: `shape` of a reading; `noise_shape` of a residual; `unit` of both, or several
    separated by commas, and noise then has one number for each; `accelerations` and `reactions`,
    True where a reading needs the accelerations of the frames or the loads on joints and supports.

    Your own sensor defines `on`, `shape`, `unit` and `reading`, and has this chain too. The speed
    of a falling body, read 2 % too high:

    >>> import equinox as eqx
    >>> class Speed(jb.sensors.Sensor):
    ...     on: str = eqx.field(static=True)
    ...     shape, unit = (), "m/s"
    ...     def reading(self, model, frames):
    ...         return jnp.linalg.norm(frames.v[model.layout.frame(self.on)])
    >>> guide = jb.Guide("world", axis=[0, 0, 1])
    >>> model = jb.Model(
    ...     bodies={"stone": jb.Body(mass=1, inertia=[1, 1, 1])},
    ...     joints={"stone": guide},
    ...     gravity=[0, 0, -10],
    ... )
    >>> run = jb.simulate(model, [0.0, 0.5])
    >>> round(float(jb.measure(run, {"speed": Speed("stone", gain=1.02)})["speed"][-1]), 9)
    5.1
    """

    on: eqx.AbstractVar[str]
    accelerations: ClassVar[bool] = False
    reactions: ClassVar[bool] = False
    # the allowed stages of the chain, each with an initial value for a fit
    stages: ClassVar[dict[str, str]] = {
        "gain": "1.0",
        "bias": "0.0",
        "delay": "0.0",
        "lag": "1e-3",
        "start": "0.0",
    }
    gain: Float[Array, "*g"] | None = field(default=None, kw_only=True)
    bias: Float[Array, "*b"] | None = field("unit", default=None, kw_only=True)
    delay: Float[Array, ""] | None = field("s", default=None, kw_only=True)
    lag: Float[Array, ""] | None = field(
        "s",
        "positive",
        code="BAD_LAG",
        hint="Leave it out if there is no lag.",
        default=None,
        kw_only=True,
    )
    start: Float[Array, "*r"] | None = field("unit", default=None, kw_only=True)

    def __init__(self, on: str, **chain: Unpack[Chain]):
        with Problems() as problems:
            self.on = on
            self.chained(problems, **chain)

    def chained(self, problems: Problems, **chain: Unpack[Chain]) -> None:
        """Check and set gain, bias, delay, lag and start."""
        kind = type(self).__name__
        self.gain = self.bias = self.delay = self.lag = self.start = None
        shapes = {"gain": self.shape, "bias": self.noise_shape, "start": self.shape}
        for name, value in chain.items():
            if name not in Chain.__annotations__:
                raise TypeError(f"{kind} has no argument '{name}'")
            if value is None:
                continue
            where, shape = f"{kind}.{name}", shapes.get(name, ())
            if name not in self.stages:
                problems.add(
                    "BAD_CHAIN",
                    where,
                    "does not apply to an orientation",
                    value=value,
                    limit=", ".join(self.stages),
                )
                continue
            one_or_all = ((), shape) if shape and "gain" in self.stages else (shape,)
            array = checked(value, one_or_all, where, problems)
            if array is not None:
                setattr(self, name, in_domain(array, kind_of(self, name), where, problems))
        if self.start is not None and self.lag is None:
            problems.add(
                "BAD_CHAIN",
                f"{kind}.start",
                "is the initial value of a lag, which is not given",
                value=self.start,
                hint="Give lag=...",
            )

    def needs_accelerations(self, model: Model) -> bool:
        """Return whether the reading on this model needs the accelerations of the frames."""
        return self.accelerations

    def follows_commands(self, model: Model) -> bool:
        """Return whether the reading follows the commands of controllers at once."""
        return False

    @abstractmethod
    def reading(self, model: Model, frames: Instant) -> Reading:
        """Return the measured quantity at one time, before the chain."""

    def change(
        self, model: Model, frames: Instant, rest: Instant, at_rest: Model
    ) -> Float[Array, "*s"]:
        """Return the reading minus that at rest, in the form of a residual; its derivatives are the
        rows of an output of responses. `model` and `at_rest` contain the states of their
        elements."""
        readings = self.reading(model, frames), self.reading(at_rest, rest)
        return self.residual(
            *(x if self.bias is None else self.disturbed(x, self.bias) for x in readings)
        )

    def transduced(
        self, times: Float[Array, "nt"], x: Float[Array, "nt *r"]
    ) -> Float[Array, "nt *r"]:
        """Return the record of a measured quantity x after delay, lag, gain and bias."""
        if self.delay is not None:
            x = self.delayed(times, x)
        if self.lag is not None:
            x = lagged(times, x, self.lag, x[0] if self.start is None else self.start)
        if self.gain is not None:
            x = to_rank(self.gain, x.ndim) * x
        return x if self.bias is None else self.disturbed(x, to_rank(self.bias, x.ndim))

    def delayed(self, times: Float[Array, "nt"], x: Float[Array, "nt *r"]) -> Float[Array, "nt *r"]:
        """Return x(t - delay)."""
        return delayed(times, x, self.delay)  # pyright: ignore[reportArgumentType]  called where there is one

    def weight(self, times: Float[Array, "nt"]) -> Float[Array, "nt"]:
        """Return the weight of each sample: 0 where a delayed one is unknown."""
        return jnp.ones_like(times) if self.delay is None else known(times, self.delay)

    def misfit(
        self,
        times: Float[Array, "nt"],
        reading: Float[Array, "nt *r"],
        measured: Float[Array, "nt *r"],
    ) -> Float[Array, "nt *s"]:
        """Return the weighted residuals of a record."""
        r = self.residual(reading, measured)
        if self.delay is None:
            return r
        weight = self.weight(times).reshape(-1, *[1] * (r.ndim - 1))
        return jnp.where(weight > 0, weight * r, 0.0)

    def disturbed(
        self, reading: Float[Array, "*#r"], noise: Float[Array, "*#r"]
    ) -> Float[Array, "*#r"]:
        """Return a reading with noise added."""
        return reading + noise

    def absent(self) -> dict[str, str]:
        """Return {stage: arguments that add it} for the stages that the chain does not have;
        `start` needs a `lag`."""
        arguments = {
            stage: f"{stage}={start}"
            for stage, start in self.stages.items()
            if getattr(self, stage) is None
        }
        if {"lag", "start"} <= arguments.keys():
            arguments["start"] = f"{arguments['lag']}, {arguments['start']}"
        return arguments

    @property
    def plain(self) -> bool:
        """True for a sensor without a chain."""
        return all(getattr(self, stage) is None for stage in Chain.__annotations__)

    @property
    def names(self) -> tuple[str, ...]:
        """The bodies and supports to which it is attached."""
        return (self.on,)

    def problem(self, model: Model, where: str) -> Problem | None:
        """Return the problem of this sensor on a model; None if there is none."""
        known = model.layout.frames
        return next((unknown(name, where, known) for name in self.names if name not in known), None)

    def misread(self, measured: np.ndarray, where: str) -> Problem | None:
        """Return the problem of measured samples of the right shape; None if there is none."""
        return None


def check_sensors(sensors: dict[str, Sensor], model: Model, where: str) -> None:
    """Check that all sensors are Sensors, on parts of the model. Errors: WRONG_KIND, those of
    `Sensor.problem`."""
    with Problems() as problems:
        for name, sensor in checked_dict(
            sensors, where, "name: jb.Position(...)", problems
        ).items():
            check_kind(
                sensor, Sensor, f"{where}['{name}']", "a sensor, such as jb.Position(...)", problems
            )
            problem = (
                sensor.problem(model, f"{where}['{name}']") if isinstance(sensor, Sensor) else None
            )
            problems.collected += [] if problem is None else [problem]


def noise_levels(
    sensors: dict[str, Sensor], noise: Any, where: str, problems: Problems, *, zero: bool
) -> dict[str, Any]:
    """Return {sensor: standard deviation} from one number for all sensors or a dict; problems are
    added to `problems`. `zero`: whether 0 is allowed."""
    levels = {}
    for name, value in (
        noise if isinstance(noise, dict) else dict.fromkeys(sensors, noise)
    ).items():
        place = f"{where}['{name}']"
        if name not in sensors:
            problems.collected.append(unknown(name, place, tuple(sensors)))
            continue
        units = sensors[name].units
        level = checked(
            value,
            ((),) if units == 1 else ((), (units,)),
            place,
            problems,
            f"One number [{sensors[name].unit}].",
        )
        known = None if level is None else concrete(level)
        if known is not None and ((known < 0).any() or not (zero or known.all())):
            problems.add(
                "BAD_NOISE",
                place,
                f"is {known}",
                value=known,
                limit=">= 0" if zero else "> 0",
                hint="" if zero else "Leave noise out to have it estimated.",
            )
        if level is not None:
            levels[name] = level
    return levels
