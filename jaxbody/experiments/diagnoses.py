"""What may be wrong with a record beside what a model reads: a unit, a sign, a delay, channels swapped, axes of the other hand.

    measured(t) ~ offset + gain reading(t - delay)

for every channel, by least squares. It is meant for a model that is roughly right, before its fit takes a blunder up.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Int

from jaxbody.core import tables
from jaxbody.core.errors import Status, warn
from jaxbody.core.progress_lines import working
from jaxbody.core.results import Result
from jaxbody.experiments.experiments import Experiment
from jaxbody.models.models import Model
from jaxbody.sensors.instruments import Accelerometer
from jaxbody.simulations.readings import measure
from jaxbody.simulations.simulations import simulate

FACTORS = {
    1000.0: "is it in thousandths of the unit that the sensor has (mm for m)?",
    1e-3: "is it in thousands of the unit that the sensor has (m for mm, s for ms)?",
    180 / np.pi: "is it in degrees?",
    np.pi / 180: "is it in radians, read as degrees?",
    9.80665: "are these m/s2, taken for g?",
    1 / 9.80665: "is it in g?",
    0.0254: "is it in inches, taken for meters?",
    1 / 0.0254: "is it in inches?",
}
CLOSE = 0.05  # in the logarithm of a gain
ALIKE = 0.8  # correlation from which on a gain means something
LATE = 0.05  # samples
SURE = 4.0  # standard errors
HEAVY = 0.3  # part of gravity in the mean of an accelerometer, from which on it is looked for
NONE = 0.2  # part of that mean which is none
EARTH = (9.7, 9.9)  # m/s2
BETTER = 0.7  # of the cost, below which another arrangement is worth telling


@dataclass(frozen=True)
class Compared:
    """One number of a channel: measured against read."""

    name: str
    gain: float
    correlation: float
    delay: float
    delay_error: float
    residual: float


class Diagnosis(Result):
    """What `diagnose` found: `channels`, for each number its gain, correlation, delay in samples with standard error, and residual over
    signal; `words`, what that may mean."""

    status: Int[Array, ""]
    channels: tuple[Compared, ...] = eqx.field(static=True)
    words: tuple[str, ...] = eqx.field(static=True)

    def _tables(self) -> list[tables.PrintedTable]:
        rows = [(c.name, c.gain, c.correlation, c.delay, c.delay_error, f"{100 * c.residual:.3g} %") for c in self.channels]
        heads = ("channel", "gain", "correlation", "delay [samples]", "+-", "residual")
        return [tables.PrintedTable("Diagnosis", heads, rows, "\n".join(self.words) or "nothing to remark")]


def diagnose(model: Model, experiments: dict[str, Experiment], *, progress: bool | None = None, **options: Any) -> Diagnosis:
    """What may be wrong with measured channels, from what the model reads with its parameters as they are; `options` go to `simulate`. progress: a line after
    five seconds on a terminal or in a notebook; False is silent.

    Warns GAIN_FACTOR (a gain near 1000, 57.3, 9.81, 39.4 or their inverses, or negative), DELAY (above 0.05 samples and 4 standard errors of white noise),
    SWAPPED (two channels that would fit 30 % better exchanged), LEFT_HANDED (three axes that only a reflection brings in line), GRAVITY (an accelerometer's record without
    the gravity that it reads, or with one that the model lacks). Errors: those of `simulate`.

    >>> times = jnp.linspace(0, 1, 50)
    >>> model = Model(bodies={"mass": Body(mass=1.0, inertia=[1, 1, 1], position=[1, 0, 0])}, joints={"mass": Guide("world", axis=[1, 0, 0])},
    ...               elements={"spring": Spring(("mass", [0, 0, 0]), ("world", [0, 0, 0]), stiffness=40.0)})
    >>> run = Experiment(times, sensors={"x": Position("mass", axis=[1, 0, 0])}, measured={"x": jnp.cos(40**0.5 * times)})
    >>> diagnose(model, {"run": run}).words
    ()
    """
    compared, words = [], []
    with working("diagnose", progress) as line:
        for name, experiment in experiments.items():
            line(f"'{name}'")
            initial = experiment.initial
            run = simulate(model, experiment.times, motion=experiment.motion, loads=experiment.loads, initial=initial, **options)
            readings = {key: np.asarray(x) for key, x in measure(run, experiment.sensors).items()}
            channels = _numbers(name, experiment, readings)
            step = np.median(np.diff(experiment.times))
            for key, (y, p, _) in channels.items():
                compared.append(_compared(key, np.asarray(experiment.times), y, p, step))
                words += _remarks(compared[-1])
            words += _swapped(channels) + _mirrored(name, experiment, readings) + _weighed(name, model, experiment, readings)
    for code, told in words:
        warn(code, told)
    return Diagnosis(jnp.asarray(Status.OK), tuple(compared), tuple(told for _, told in words))


def _numbers(run: str, experiment: Experiment, readings: dict[str, np.ndarray]) -> dict[str, tuple[np.ndarray, np.ndarray, str]]:
    """{name: (measured, read, unit)} of every number of channels that are plain numbers or vectors, no poses."""
    found = {}
    for name, sensor in experiment.sensors.items():
        y, p = np.asarray(experiment.measured[name]), readings[name]
        if y.ndim == 1:
            found[f"{run}.{name}"] = (y, p, sensor.unit)
        elif y.shape[1] <= 3:
            found |= {f"{run}.{name}[{k}]": (y[:, k], p[:, k], sensor.unit) for k in range(y.shape[1])}
    return found


def _fit(columns: list[np.ndarray], y: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """Coefficients, their standard errors for white noise, and the rms of what is left."""
    A = np.stack(columns, 1)
    c = np.linalg.lstsq(A, y, rcond=None)[0]
    left = y - A @ c
    s2 = left @ left / max(len(y) - A.shape[1], 1)
    return c, np.sqrt(s2 * np.diag(np.linalg.pinv(A.T @ A))), float(np.sqrt(np.mean(left**2)))


def _compared(name: str, times: np.ndarray, y: np.ndarray, p: np.ndarray, step: float) -> Compared:
    """Gain and delay of y against p: y ~ c0 + g (p - d p'), twice, the second time from where the first led."""
    from scipy.interpolate import CubicSpline

    here = np.isfinite(y) & np.isfinite(p)
    spread = np.std(y[here])
    if here.sum() < 8 or not np.ptp(p[here]) or not spread:
        return Compared(name, np.nan, np.nan, np.nan, np.nan, float(np.sqrt(np.mean((y - p)[here] ** 2)) / spread) if spread else np.nan)
    spline, delay, error, gain = CubicSpline(times[here], p[here]), 0.0, np.inf, 1.0
    for _ in range(3):
        t = np.clip(times[here] - delay, times[here][0], times[here][-1])
        c, e, _ = _fit([np.ones(len(t)), spline(t), -spline(t, 1)], y[here])
        gain = c[1]
        if not gain or abs(c[2] / gain) > 0.1 * (times[-1] - times[0]):
            break
        delay, error = delay + c[2] / gain, e[2] / abs(gain)
    residual = np.sqrt(np.mean((y - p)[here] ** 2)) / spread
    return Compared(
        name, float(gain), float(np.corrcoef(y[here], p[here])[0, 1]), float(delay / step), float(error / step), float(residual)
    )


def _remarks(c: Compared) -> list[tuple[str, str]]:
    found = []
    if abs(c.correlation) > ALIKE:
        near = next((f for f in FACTORS if abs(np.log(abs(c.gain) / f)) < CLOSE), None)
        if near is not None:
            found.append(("GAIN_FACTOR", f"{c.name} is {c.gain:.4g} times what the model reads: {FACTORS[near]}"))
        elif c.gain < 0:
            found.append(("GAIN_FACTOR", f"{c.name} is {c.gain:.4g} times what the model reads: is its sign, or its axis, turned round?"))
        if abs(c.delay) > max(LATE, SURE * c.delay_error):
            late = "later" if c.delay > 0 else "earlier"
            found.append(("DELAY", f"{c.name} comes {abs(c.delay):.3g} samples {late} than the model reads it: let its delay be free"))
    return found


def _swapped(channels: dict[str, tuple[np.ndarray, np.ndarray, str]]) -> list[tuple[str, str]]:
    """Pairs of one unit that fit better exchanged."""
    found = []
    for (a, (y, p, unit)), (b, (z, q, other)) in itertools.combinations(channels.items(), 2):
        here = np.isfinite(y) & np.isfinite(z)
        if unit != other or not here.any():
            continue
        y, z, p, q = (x[here] - x[here].mean() for x in (y, z, p, q))
        as_they_are, exchanged = np.sum((y - p) ** 2 + (z - q) ** 2), np.sum((y - q) ** 2 + (z - p) ** 2)
        if exchanged < BETTER * as_they_are:
            share = 100 * (1 - exchanged / as_they_are)
            found.append(("SWAPPED", f"{a} and {b} would fit better exchanged, by {share:.0f} % of the cost: are their cables swapped?"))
    return found


def _mirrored(run: str, experiment: Experiment, readings: dict[str, np.ndarray]) -> list[tuple[str, str]]:
    """Three axes that a reflection, and no rotation, brings in line with what the model reads (Kabsch's alignment)."""
    found = []
    for name, p in readings.items():
        y = np.asarray(experiment.measured[name])
        if y.ndim != 2 or y.shape[1] != 3:
            continue
        here = np.isfinite(y).all(1)
        y, p = y[here] - y[here].mean(0), p[here] - p[here].mean(0)
        U, S, Vt = np.linalg.svd(y.T @ p)
        power = np.sum(y**2) + np.sum(p**2)
        turned, mirrored = power - 2 * (S[0] + S[1] + S[2] * np.sign(np.linalg.det(U @ Vt))), power - 2 * S.sum()
        if np.linalg.det(U @ Vt) < 0 and mirrored < BETTER * turned:
            found.append(("LEFT_HANDED", f"{run}.{name} is in line with the model only when mirrored: are its axes left-handed?"))
    return found


def _weighed(run: str, model: Model, experiment: Experiment, readings: dict[str, np.ndarray]) -> list[tuple[str, str]]:
    """Accelerometers whose mean is that of a reading without gravity, or with one where the model has none."""
    remarks, g = [], float(np.linalg.norm(model.gravity))
    for name, sensor in experiment.sensors.items():
        if not isinstance(sensor, Accelerometer):
            continue
        y, p = np.asarray(experiment.measured[name]), readings[name]
        mean, expected = (float(np.linalg.norm(np.mean(x[np.isfinite(y) & np.isfinite(p)].reshape(-1, *y.shape[1:]), 0))) for x in (y, p))
        if expected > HEAVY * g > 0 and mean < NONE * expected:
            hint = "was gravity taken out already? Put it back, or leave gravity out of the model with the sag that it makes"
            remarks.append(("GRAVITY", f"{run}.{name} is {mean:.3g} m/s2 on average, where an accelerometer reads {expected:.4g}: {hint}"))
        if not g and EARTH[0] <= mean <= EARTH[1]:
            remarks.append(
                ("GRAVITY", f"{run}.{name} is {mean:.4g} m/s2 on average: it reads gravity, which the model lacks; give it gravity=")
            )
    return remarks
