"""Likely errors in measured channels, found by comparison with a model: wrong units, signs, delays,
offsets, wrapped angles, swapped channels, left-handed axes, conjugated responses.

    measured(t) ~ offset + gain reading(t - delay),    measured ~ gain reading for what is not a
                                                       record in time

for every channel, by least squares. Use it before a fit, with a model that is roughly right: a fit
would hide such errors in its estimates.
"""

import itertools
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from jaxbody.core import tables
from jaxbody.core.arrays import Array, Int, indices, time_text
from jaxbody.core.errors import Status, warn
from jaxbody.core.progress_lines import working
from jaxbody.core.results import Result
from jaxbody.core.units import EARTH
from jaxbody.fitting.experiments.experiments import Experiment
from jaxbody.fitting.experiments.measurements import (
    Measurement,
    check_measurements,
    small_motions,
)
from jaxbody.fitting.statistics.autocorrelations import (
    UNLIKELY,
    best_shift,
    centered,
    correlation,
    whiteness,
)
from jaxbody.model.models import Model
from jaxbody.motion.simulations import simulate
from jaxbody.motion.trajectories import measure
from jaxbody.sensors.instruments import Accelerometer
from jaxbody.sensors.sensors import Sensor

FACTORS = {
    1000.0: "is it in thousandths of the sensor's unit (mm instead of m)?",
    1e-3: "is it in thousands of the sensor's unit (m instead of mm, s instead of ms)?",
    180 / np.pi: "is it in degrees?",
    np.pi / 180: "is it in radians instead of degrees?",
    9.80665: "is it in m/s2 instead of g?",
    1 / 9.80665: "is it in g?",
    0.0254: "is it in meters instead of inches?",
    1 / 0.0254: "is it in inches?",
    100.0: "is it in percent, or in hundredths of the sensor's unit?",
    0.01: "is it in hundreds of the sensor's unit?",
}
OF_MODES = {
    2 * np.pi: "is it in rad/s instead of Hz?",
    1 / (2 * np.pi): "is it in Hz instead of rad/s?",
    60.0: "is it per minute?",
}
TURNS = {"360 degrees": 360.0, "2 pi": 2 * np.pi}  # size of the jump of a wrapped angle
# largest difference of a jump from one turn, and largest jump of its prediction, in turns
TURN = 0.3
# smallest offset of a record that is reported, relative to the residual without it; it must also
# exceed the variation of the record
ASIDE = 3.0
OFFSETS = {
    "Position": "is it a displacement? Use Displacement",
    "Displacement": "is it a place? Use Position",
}
ROUNDED = 1e-9  # offset, relative to the record, below which it is round-off
OWN = ("WRAPPED", "GAIN_FACTOR")  # errors that explain an offset or a low correlation
FAULTS = (  # errors that make a fit wrong
    "GAIN_FACTOR",
    "WRAPPED",
    "SWAPPED",
    "LEFT_HANDED",
    "OFFSET",
    "CONJUGATED",
    "OTHER_RESPONSE",
)
# correlation of real or imaginary parts of responses from which a wrong sign is reported
AGREED = 0.5
# mean of the differences of phases, as numbers of size one, of responses above their noise
ALIKE = 0.7
POWERS = {
    2: "an acceleration",
    1: "a velocity",
    -1: "a velocity for an acceleration",
    -2: "a displacement for an acceleration",
}
CLOSE = 0.05  # largest difference of the logarithms of a gain and a factor
CORRELATED = 0.8  # smallest correlation for which gain and delay are considered
LATE = 0.05  # smallest delay that is reported, in samples
SIGNIFICANT = 4.0  # smallest delay that is reported, in standard errors
# share r2 of the variation of a record explained by its prediction, below which the channel is
# reported, unless the rest is white noise
EXPLAINED = 0.5

BETTER = 0.7  # cost ratio below which exchanged channels or reflected axes are reported


Remarks = Iterator[tuple[str, str]]  # (code, message)


@dataclass(frozen=True)
class Compared:
    """Comparison of one component of a channel with its prediction. `delay` and its standard error
    `delay_error` [samples] are NaN for measurements that are not records in time; `residual` is
    relative to the variation of the record."""

    name: str
    gain: float
    correlation: float
    delay: float
    delay_error: float
    residual: float


class Diagnosis(Result):
    """Result of `diagnose`: `channels`, the gain, correlation, delay and residual of each
    component, as in `Compared`; `words`, descriptions of likely errors."""

    status: Int[Array, ""]
    channels: tuple[Compared, ...] = eqx.field(static=True)
    words: tuple[str, ...] = eqx.field(static=True)

    def _tables(self) -> list[tables.PrintedTable]:
        rows = [
            (c.name, c.gain, c.correlation, c.delay, c.delay_error, f"{100 * c.residual:.3g} %")
            for c in self.channels
        ]
        heads = ("channel", "gain", "correlation", "delay [samples]", "+-", "residual")
        return [
            tables.PrintedTable("Diagnosis", heads, rows, "\n".join(self.words) or "no remarks")
        ]


def diagnose(
    model: Model,
    experiments: dict[str, Measurement],
    *,
    progress: bool | None = None,
    **options: Any,
) -> Diagnosis:
    """Report likely errors of measured channels by comparison with the predictions of a model,
    without a fit.

    Args:
        model: a model with parameters that are roughly right.
        experiments: {name: Experiment, MeasuredResponse, MeasuredModes, MeasuredStiffness
            or MeasuredCurves}.
        progress: None shows progress on a terminal or in a notebook after five seconds, False
            is silent.
        options: options of `simulate`, such as rtol.

    Warns GAIN_FACTOR for a gain near 1000, 100, 57.3, 9.81, 39.4 or their inverses, or a negative
    gain; WRAPPED for an angle that jumps by whole turns where the prediction does not; OFFSET for a
    constant offset larger than the variation of the record and than three times the remaining
    difference; CONJUGATED for responses with phases of opposite sign; OTHER_RESPONSE for responses
    of another derivative, such as accelerances; DELAY for a delay of more than 0.05 samples and 4
    standard errors for white noise; SWAPPED for two channels whose cost is 30 % lower when
    exchanged; LEFT_HANDED for three axes that agree with the model only after a reflection;
    UNCORRELATED for a prediction that explains less than half of the variation of the record,
    r2 < 0.5, unless their difference is white noise, as in a noisy record of a small motion;
    GRAVITY for an accelerometer record without gravity, or with gravity that the model does
    not have.
    Errors: those of `simulate`, WRONG_KIND, NO_DATA.

    >>> times = jnp.linspace(0, 1, 50)
    >>> spring = jb.Spring(("mass", [0, 0, 0]), ("world", [0, 0, 0]), stiffness=40.0)
    >>> model = jb.Model(
    ...     bodies={"mass": jb.Body(mass=1.0, inertia=[1, 1, 1], position=[1, 0, 0])},
    ...     elements={"spring": spring},
    ...     joints={"mass": jb.Guide("world", axis=[1, 0, 0])},
    ... )
    >>> run = jb.Experiment(
    ...     times,
    ...     sensors={"x": jb.Position("mass", axis=[1, 0, 0])},
    ...     measured={"x": jnp.cos(40**0.5 * times)},
    ... )
    >>> jb.diagnose(model, {"run": run}).words
    ()
    """
    check_measurements(experiments, "diagnose.experiments").raise_if_any()
    compared, words = [], []
    with working("diagnose", progress) as line:
        for name, experiment in experiments.items():
            line(f"'{name}'")
            of_run, remarks = likely_errors(
                model, name, experiment, _predicted(model, experiment, options)
            )
            compared += of_run
            words += remarks
    for code, message in words:
        warn(code, message)
    return Diagnosis(
        jnp.asarray(Status.OK), tuple(compared), tuple(message for _, message in words)
    )


def _predicted(model: Model, experiment: Measurement, options: dict[str, Any]) -> dict[str, Any]:
    if not isinstance(experiment, Experiment):
        return experiment.readings(model, None, small_motions(model) if experiment.linear else None)
    run = simulate(
        model,
        experiment.times,
        motion=experiment.motion,
        loads=experiment.loads,
        initial=experiment.initial,
        **options,
    )
    return measure(run, experiment.sensors)


def likely_errors(
    model: Model, name: str, experiment: Measurement, predicted: dict[str, Any]
) -> tuple[list[Compared], list[tuple[str, str]]]:
    """Compare each component of a measurement with `predicted`; return the comparisons and the
    (code, message) of each likely error."""
    readings = {key: np.asarray(x) for key, x in predicted.items()}
    if not isinstance(experiment, Experiment):
        return _of_numbers(name, experiment, readings)
    compared, words = [], []
    channels, times = _components(name, experiment, readings), np.asarray(experiment.times)
    step = np.median(np.diff(times))
    for key, (y, p, sensor) in channels.items():
        compared.append(_compared(key, times, y, p, step))
        own = [*_wrapped(key, times, y, p, sensor.unit)] or [*_remarks(compared[-1])]
        if not any(code in OWN for code, _ in own):
            own += _aside(key, y, p, sensor)
        words += own
    arranged = [*_swapped(channels), *_mirrored(name, experiment, readings)]
    return compared, [
        *words,
        *arranged,
        *_unrelated(channels, arranged + [word for word in words if word[0] in OWN], step),
        *_without_gravity(name, model, experiment, readings),
    ]


def faults(errors: list[tuple[str, str]]) -> list[tuple[str, str]]:
    """Return the errors that no fit can compensate, those with a code in FAULTS."""
    return [error for error in errors if error[0] in FAULTS]


def _wrapped(name: str, times: np.ndarray, y: np.ndarray, p: np.ndarray, unit: str) -> Remarks:
    """Yield a remark on a measured angle that jumps by a whole turn where its prediction does
    not."""
    valid = np.flatnonzero(np.isfinite(y) & np.isfinite(p))
    for label, turn in TURNS.items() if unit == "rad" else ():
        steps = np.abs(np.diff(y[valid])) / turn
        jumps = (np.abs(steps - 1) < TURN) & (np.abs(np.diff(p[valid])) < TURN * 2 * np.pi)
        if jumps.any() and (steps[~jumps] < TURN).all():
            first = time_text(times[valid[1 + np.argmax(jumps)]], times)
            yield (
                "WRAPPED",
                f"{name} jumps by about {label} {jumps.sum()} times, first at t = {first} s, and "
                "its prediction does not: add up its turns, "
                f"np.unwrap(x{', period=360' if turn == 360 else ''})",
            )
            return


def _aside(name: str, y: np.ndarray, p: np.ndarray, sensor: Sensor) -> Remarks:
    """Yield a remark if a record differs from the prediction by a constant offset; none for
    accelerometers, whose records may lack gravity."""
    off = (y - p)[np.isfinite(y) & np.isfinite(p)]
    if not off.size or isinstance(sensor, Accelerometer):
        return
    offset = float(np.mean(off))
    notable = abs(offset) > max(ASIDE * np.std(off), np.nanstd(y))
    if notable and abs(offset) >= ROUNDED * np.nanmax(np.abs(y)):
        remedy = OFFSETS.get(type(sensor).__name__, "subtract it, or free its bias in the fit")
        yield (
            "OFFSET",
            f"{name} is {abs(offset):.4g} {sensor.unit} {'above' if offset > 0 else 'below'} the "
            f"prediction throughout: {remedy}",
        )


def _of_numbers(
    run: str, measurement: Measurement, readings: dict[str, np.ndarray]
) -> tuple[list[Compared], list[tuple[str, str]]]:
    """Compare measurements that are not records in time with their predictions: responses, modes,
    stiffnesses and curves, which vary about zero. Return comparisons and likely errors as in
    `likely_errors`."""
    compared, words = [], []
    for name in measurement.channels:
        y, p = np.asarray(measurement.measured[name]), readings[name]
        for label, column in zip(indices(y.shape[1:]), np.ndindex(*y.shape[1:]), strict=True):
            own, other = (x[(slice(None), *column)] for x in (y, p))
            valid = np.isfinite(own) & np.isfinite(other)
            own, other, key = own[valid], other[valid], f"{run}.{name}{label}"
            size = float(np.sqrt(np.vdot(own, own).real * np.vdot(other, other).real))
            if not size:
                continue
            product, residual = (
                float(np.vdot(other, own).real),
                np.linalg.norm(own - other) / np.linalg.norm(own),
            )
            gain = product / float(np.vdot(other, other).real)
            compared.append(Compared(key, gain, product / size, np.nan, np.nan, float(residual)))
            frequencies = np.asarray(measurement.axis(name)[1])[valid]
            turned = [*_turned(key, frequencies, own, other)] if np.iscomplexobj(y) else []
            words += turned or _remarks(compared[-1], FACTORS | OF_MODES)
    return compared, words


def _turned(name: str, frequencies: np.ndarray, y: np.ndarray, p: np.ndarray) -> Remarks:
    """Yield a remark if a measured response seems to be another time derivative than the predicted
    one, such as velocity in place of acceleration, or if its phases have the opposite sign, as in a
    complex conjugate. The latter is judged without magnitudes, which differ because an initial
    guess has its resonances at other frequencies."""
    if len(y) < 8 or not (np.abs(y) * np.abs(p)).all():
        return
    power = (
        np.polyfit(np.log(frequencies), np.log(np.abs(y) / np.abs(p)), 1)[0]
        if frequencies.min() > 0
        else 0.0
    )
    wide = frequencies.max() > 3 * frequencies.min()
    # where noise is larger than a response, their ratio may grow, but phases have nothing in common
    alike = abs(np.mean(y * p.conj() / abs(y * p))) > ALIKE
    real, imaginary = (
        correlation(part(y / abs(y)), part(p / abs(p))) for part in (np.real, np.imag)
    )
    if wide and alike and round(power) in POWERS and abs(power - round(power)) < 0.25:
        yield (
            "OTHER_RESPONSE",
            f"{name} grows as f^{round(power)} relative to the prediction: is it "
            f"{POWERS[round(power)]}? Use a sensor that reads it",
        )
    elif max(real, imaginary) <= -AGREED:
        yield (
            "GAIN_FACTOR",
            f"{name} is the negative of the prediction: is its sign or its axis reversed?",
        )
    elif min(real, imaginary) <= -AGREED and max(real, imaginary) >= AGREED:
        yield (
            "CONJUGATED",
            f"{name} is {'the conjugate' if real > 0 else 'the negative conjugate'} of the "
            "prediction: its phases are those of exp(-i 2 pi f t); give np.conj of it",
        )


def _components(
    run: str, experiment: Experiment, readings: dict[str, np.ndarray]
) -> dict[str, tuple[np.ndarray, np.ndarray, Sensor]]:
    """Return {name: (measured, predicted, sensor)} for every component of scalar and vector
    channels; poses are left out."""
    components = {}
    for name, sensor in experiment.sensors.items():
        y, p = np.asarray(experiment.measured[name]), readings[name]
        if y.ndim == 1:
            components[f"{run}.{name}"] = (y, p, sensor)
        elif y.shape[1] <= 3:
            components |= {
                f"{run}.{name}[{k}]": (y[:, k], p[:, k], sensor) for k in range(y.shape[1])
            }
    return components


def _fit(columns: list[np.ndarray], y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the coefficients of a linear least-squares fit of y by `columns` and their standard
    errors for white noise, infinite if the columns are nearly dependent."""
    A = np.stack(columns, 1)
    c, _, rank, _ = np.linalg.lstsq(A, y, rcond=1e-6)
    if rank < A.shape[1]:
        return c, np.full(len(c), np.inf)
    residual = y - A @ c
    s2 = residual @ residual / max(len(y) - A.shape[1], 1)
    return c, np.sqrt(s2 * np.diag(np.linalg.pinv(A.T @ A)))


def _compared(name: str, times: np.ndarray, y: np.ndarray, p: np.ndarray, step: float) -> Compared:
    """Estimate gain g and delay d of the record y relative to the prediction p by iterated linear
    fits y ~ c0 + g (p - d p'), with the derivative p' in time."""
    from scipy.interpolate import CubicSpline

    valid = np.isfinite(y) & np.isfinite(p)
    (y, p, t), length = (x[valid] for x in (y, p, times)), times[-1] - times[0]
    spread = np.std(y)
    residual = float(np.sqrt(np.mean((y - p) ** 2)) / spread) if spread else np.nan
    if len(y) < 8 or not np.ptp(p) or not spread:
        return Compared(name, np.nan, np.nan, np.nan, np.nan, residual)
    spline, delay, error, gain = CubicSpline(t, p), 0.0, np.inf, 1.0
    for _ in range(3):
        at = np.clip(t - delay, t[0], t[-1])
        c, e = _fit([np.ones(len(at)), spline(at), -spline(at, 1)], y)
        gain = c[1]
        if not gain or abs(c[2] / gain) > 0.1 * length:
            break
        delay, error = delay + c[2] / gain, e[2] / abs(gain)
    return Compared(
        name,
        gain=float(gain),
        correlation=float(np.corrcoef(y, p)[0, 1]),
        delay=float(delay / step),
        delay_error=float(error / step),
        residual=residual,
    )


def _remarks(c: Compared, factors: dict[float, str] = FACTORS) -> Remarks:
    """Yield remarks on a gain near one of `factors` or negative, and on a delay."""
    if not abs(c.correlation) > CORRELATED:
        return
    reversed_ = "is its sign or its axis reversed?" if c.gain < 0 else ""
    near = (why for f, why in factors.items() if abs(np.log(abs(c.gain) / f)) < CLOSE)
    if why := next(near, reversed_):
        yield "GAIN_FACTOR", f"{c.name} is {c.gain:.4g} times the prediction: {why}"
    if abs(c.delay) > max(LATE, SIGNIFICANT * c.delay_error):
        yield (
            "DELAY",
            f"{c.name} is {abs(c.delay):.3g} samples {'later' if c.delay > 0 else 'earlier'} than "
            "the prediction: free its delay in the fit",
        )


def _swapped(channels: dict[str, tuple[np.ndarray, np.ndarray, Sensor]]) -> Remarks:
    """Yield remarks on pairs of channels with the same unit that agree better with the predictions
    when exchanged."""
    for (a, (y, p, first)), (b, (z, q, second)) in itertools.combinations(channels.items(), 2):
        valid = np.isfinite(y) & np.isfinite(z)
        if first.unit != second.unit or not valid.any():
            continue
        y, z, p, q = (x[valid] - x[valid].mean() for x in (y, z, p, q))
        recorded, exchanged = (
            np.sum((y - p) ** 2 + (z - q) ** 2),
            np.sum((y - q) ** 2 + (z - p) ** 2),
        )
        if exchanged < BETTER * recorded:
            yield (
                "SWAPPED",
                f"{a} and {b} fit better when exchanged, with "
                f"{100 * (1 - exchanged / recorded):.0f} % lower cost: are their cables swapped?",
            )


def _mirrored(run: str, experiment: Experiment, readings: dict[str, np.ndarray]) -> Remarks:
    """Yield remarks on vectors that a reflection aligns with the prediction much better than any
    rotation (Kabsch algorithm)."""
    for name, p in readings.items():
        y = np.asarray(experiment.measured[name])
        if y.ndim != 2 or y.shape[1] != 3:
            continue
        valid = np.isfinite(y).all(1)
        y, p = y[valid] - y[valid].mean(0), p[valid] - p[valid].mean(0)
        U, S, Vt = np.linalg.svd(y.T @ p)
        power = np.sum(y**2) + np.sum(p**2)
        rotated, mirrored = (
            power - 2 * (S[0] + S[1] + S[2] * np.sign(np.linalg.det(U @ Vt))),
            power - 2 * S.sum(),
        )
        if np.linalg.det(U @ Vt) < 0 and mirrored < BETTER * rotated and rotated > ROUNDED * power:
            yield (
                "LEFT_HANDED",
                f"{run}.{name} agrees with the model only when mirrored: are its axes left-handed?",
            )


def _unrelated(channels: dict[str, Any], arranged: list[tuple[str, str]], step: float) -> Remarks:
    """Yield remarks on channels that hardly follow their prediction, and on the prediction that
    they do follow: that of another channel, or their own at another time. Channels named in the
    remarks `arranged` are skipped.

    A record of a small motion in strong noise also has a low correlation, but its difference from
    the prediction is white noise; it is skipped too."""
    without_means = {name: centered(y, p) for name, (y, p, _) in channels.items()}
    for name, (y, p, valid) in without_means.items():
        test, r = whiteness((y - p)[valid]), correlation(y, p)
        known = any(name.partition("[")[0] in message for _, message in arranged)
        if known or r**2 >= EXPLAINED or test is None or test.p > UNLIKELY:
            continue
        message = (
            f"{name} hardly follows the prediction, correlation {r:.2g}, R2 {r**2:.2g}: is it the "
            "right channel, with the right sign, unit and times, or is the guess far off?"
        )
        near = max(
            (other for other in without_means if other != name),
            key=lambda other: correlation(y, without_means[other][1]) ** 2,
            default=name,
        )
        alike, (late, of_shift) = correlation(y, without_means[near][1]), best_shift(y, p)
        if abs(alike) > CORRELATED:
            message += f" It follows that of {near}, correlation {alike:.2g}."
        elif abs(of_shift) > CORRELATED:
            message += (
                f" It follows it {abs(late) * step:.3g} s {'later' if late > 0 else 'earlier'}, "
                f"correlation {of_shift:.2g}."
            )
        yield "UNCORRELATED", message


def _without_gravity(
    run: str, model: Model, experiment: Experiment, readings: dict[str, np.ndarray]
) -> Remarks:
    """Yield remarks on accelerometers whose record lacks gravity, or contains gravity that the
    model does not have."""
    g = float(np.linalg.norm(model.gravity))
    for name, sensor in experiment.sensors.items():
        if not isinstance(sensor, Accelerometer):
            continue
        y, p = np.asarray(experiment.measured[name]), readings[name]
        mean, expected = (
            float(
                np.linalg.norm(
                    np.mean(x[np.isfinite(y) & np.isfinite(p)].reshape(-1, *y.shape[1:]), 0)
                )
            )
            for x in (y, p)
        )
        if expected > 0.3 * g > 0 and mean < 0.2 * expected:
            yield (
                "GRAVITY",
                f"{run}.{name} is {mean:.3g} m/s2 on average, but an accelerometer reads "
                f"{expected:.4g}: was gravity removed from the record? Add it again, or remove "
                "gravity and the sag that it causes from the model",
            )
        if not g and EARTH[0] <= mean <= EARTH[1]:
            yield (
                "GRAVITY",
                f"{run}.{name} is {mean:.4g} m/s2 on average: it reads gravity, but the model has "
                "none; give it gravity=",
            )
