"""Plots of measured data: records and measurements, also with the fitted model and its residuals;
diagnoses, validations, bands."""

from functools import partial
from typing import Any

import numpy as np

from jaxbody.core.errors import JaxbodyError, Problem
from jaxbody.fitting.bands import Bands
from jaxbody.fitting.experiments.diagnoses import Diagnosis
from jaxbody.fitting.experiments.measurements import Measurement
from jaxbody.fitting.fit_results import Fit
from jaxbody.fitting.statistics.uncertainties import quantile
from jaxbody.fitting.validations import Validation
from jaxbody.model.inputs.base_motions import NAMES, Recovered
from jaxbody.records.records import Record
from jaxbody.sensors.sensors import Channel
from jaxbody.views.plots.canvases import (
    axes_below,
    axes_or_new,
    legend,
    of_one,
    pale,
    panels_of_lines,
    panels_of_marks,
    style,
    with_unit,
)
from jaxbody.views.plots.fit_plots import chosen, linearized, records_about
from jaxbody.views.plots.response_plots import degrees, hertz
from jaxbody.views.scenes.colors import COLORS, INK, LIGHT

BAND = 0.95  # confidence level of the bands
FEW = 400  # largest number of samples with large markers
LETTERS = {"force": "F", "moment": "M"}
WIDE = 10.0  # ratio of the largest to the smallest frequency from which on the axis is logarithmic
MARKS = 12  # largest number of values that are drawn as marks with bars
KEYS = 3  # colors shown in a legend entry that stands for several lines


def plot_fit(fit: Fit, *, run: str | None = None, sensor: str | None = None, ax: Any = None) -> Any:
    """Draw the measured points of one sensor and the fitted model's line through them.

    Residuals of records and modes are below, with bands for 95 % of the noise (pale) and for the
    uncertainty of the fitted line (dark). Frequency responses are drawn as magnitudes above and
    phases below, without bands. Error: UNKNOWN_NAME.

    Args:
        fit: the fit.
        run: name of the run; None takes the first one.
        sensor: name of the sensor, or of one part of a sensor with two units, such as "plate
            moment"; None takes the first one ("frequency" for modes).
        ax: axes to draw into; None makes a new figure.

    >>> model = jb.Model(
    ...     bodies={"mass": jb.Body(mass=1.0, inertia=[1, 1, 1], position=[1, 0, 0])},
    ...     joints={"mass": jb.Guide("world", axis=[1, 0, 0])},
    ...     elements={
    ...         "spring": jb.Spring(("mass", [0, 0, 0]), ("world", [0, 0, 0]), stiffness=30.0)
    ...     },
    ... )
    >>> times, noise = jnp.linspace(0, 1, 21), 0.05 * jax.random.normal(jax.random.key(0), (21,))
    >>> track = jb.Experiment(
    ...     times,
    ...     sensors={"x": jb.Position("mass", axis=[1, 0, 0])},
    ...     measured={"x": jnp.cos(2 * jnp.pi * times) + noise},
    ... )
    >>> jb.plots.plot_fit(jb.fit(model, {"track": track}, free=["spring.stiffness"])).get_ylabel()
    'x [m]'
    """
    run, sensor, part = chosen(fit, run, sensor, "plot_fit")
    bands = None if fit.uncertainty is None else partial(_bands, fit, run, sensor)
    return _draw(
        axes_or_new(ax, 7.0, 4.2),
        fit.experiments[run],
        sensor,
        part or 0,
        fit.predicted[run][sensor],
        "fitted",
        bands,
    )


def plot_validation(
    validation: Validation, *, run: str | None = None, sensor: str | None = None, ax: Any = None
) -> Any:
    """Draw the measured points of each sensor of a validation run and the line that the fitted
    model predicts, with residuals below.

    The title of each panel states the fit: 100 % if all residuals are zero, 0 % if the mean of the
    record would predict it as well. Frequency responses are drawn as magnitudes above and phases
    below. Error: UNKNOWN_NAME.

    Args:
        validation: the validation.
        run: name of the run; None takes the first one.
        sensor: name of the sensor, or of one part of a sensor with two units; None draws all.
        ax: axes to draw into; None makes a new figure.
    """
    run, *_ = chosen(validation, run, sensor, "plot_validation")
    experiment = validation.experiments[run]
    names = [
        f"{name} {part}".strip()
        for name, channel in experiment.channels.items()
        for part in channel.parts or ("",)
    ]
    shown = names if sensor is None else [sensor]
    ax = axes_or_new(ax, 7.0, 0.2 + 4.2 * len(shown))
    for axes, title in zip(
        [ax, *axes_below(ax, *[1.0] * (len(shown) - 1), share=False)], shown, strict=True
    ):
        _, name, part = chosen(validation, run, title, "plot_validation")
        _draw(axes, experiment, name, part or 0, validation.predicted[run][name], "predicted")
        fits = ", ".join(
            f"{round(100 * (1 - validation.nrmse[record.name]), 1) + 0.0:.1f} %"
            for record in records_about(validation, run, name, part)
        )
        axes.set_title(f"{run}, {title}: fit {fits}", fontsize=9)
    return ax


def _draw(
    ax: Any,
    experiment: Measurement,
    sensor: str,
    part: int,
    predicted: Any,
    word: str,
    bands_of: Any = None,
) -> Any:
    """Draw measured and predicted values of a sensor, with residuals below, and return the axes.

    Args:
        ax: axes whose area the panels share.
        experiment: the measurement.
        sensor: name of the sensor.
        part: number of the part of the sensor, from 0.
        predicted: the predicted values.
        word: name of the predicted values in the legend.
        bands_of: function that returns the bands of residuals of a given shape; None draws none.
    """
    reading = np.asarray(predicted)
    if np.iscomplexobj(experiment.measured[sensor]):
        return _draw_response(experiment, sensor, reading, ax, word)
    channel, (over, x, its_unit) = experiment.channels[sensor], experiment.axis(sensor)
    x = np.asarray(x)
    measured, predicted, residual = _compared(
        channel, np.asarray(experiment.measured[sensor]), reading
    )
    columns, rows = _columns(channel, part, measured.shape[1], residual.shape[1])
    (below,) = axes_below(ax, 0.4)
    shown = [
        i for i in columns if np.isfinite(measured[:, i]).any() and np.ptp(predicted[:, i]) > 0
    ] or columns[:1]
    shown = shown if len(rows) == len(columns) else columns
    kept = rows if len(rows) != len(columns) else [rows[columns.index(i)] for i in shown]
    names = [_name(channel, sensor, part, columns.index(i), len(columns)) for i in shown]
    dots = dict(ls="none", marker="o", mew=0, ms=5.0 if len(x) <= FEW else 3.5)
    points, line = (
        [],
        {"lw": 1.2} if channel.series else {"ls": "none", "marker": "_", "ms": 16, "mew": 1.8},
    )
    for color, i, name in zip(COLORS, shown, names, strict=False):
        center = np.mean(predicted[:, i]) if len(shown) > 1 and channel.series else 0.0
        points += ax.plot(x, measured[:, i] - center, color=pale(color), zorder=2, **dots)
        ax.plot(x, predicted[:, i] - center, color=color, label=name, zorder=3, **line)
    bands = bands_of(residual.shape) if bands_of else {}
    for color, i in zip(COLORS[len(shown) - len(kept) :], kept, strict=False):
        below.plot(
            x,
            residual[:, i],
            color=color,
            alpha=0.6,
            **(dots | {"ms": 3.0 if channel.series else 5.0}),
        )
        if i in bands:
            _draw_band(below, x, bands[i], color, len(kept), series=channel.series)
    below.axhline(0.0, color=INK, lw=0.8)
    what = names[0] if len(shown) == 1 else " ".join([sensor, *channel.parts[part : part + 1]])
    ax.set_ylabel(
        with_unit(
            what + (", from its mean" if len(shown) > 1 and channel.series else ""),
            _unit(channel, part, columns, rows),
        )
    )
    below.set(
        xlabel=with_unit(over, its_unit) if its_unit else over,
        ylabel=with_unit("residual", _unit(channel, part, rows, rows)),
    )
    if not channel.series:
        below.xaxis.get_major_locator().set_params(integer=True, min_n_ticks=1)
        below.set_xlim(x[0] - 0.5, x[-1] + 0.5)
    _explain(ax, points, word)
    return ax


def _draw_band(
    below: Any,
    x: np.ndarray,
    band: tuple[np.ndarray, np.ndarray, np.ndarray],
    color: str,
    count: int,
    *,
    series: bool,
) -> None:
    rows, noise, uncertainty = band
    if series:
        below.axhspan(-noise[0], noise[0], color=LIGHT, alpha=0.5 / count, lw=0, zorder=0)
        below.fill_between(
            x[rows], -uncertainty, uncertainty, color=color, alpha=0.25, lw=0, zorder=1
        )
    else:
        below.vlines(x[rows], -noise, noise, color=LIGHT, lw=10, zorder=0)
        below.vlines(x[rows], -uncertainty, uncertainty, color=color, alpha=0.4, lw=4, zorder=1)


def _draw_response(
    experiment: Measurement, sensor: str, predicted: np.ndarray, ax: Any, word: str
) -> Any:
    """Draw magnitudes and unwrapped phases over frequency; each measured phase is within half a
    turn of the predicted one."""
    f, measured = np.asarray(experiment.axis(sensor)[1]), np.asarray(experiment.measured[sensor])
    (below,) = axes_below(ax, 0.55)
    known = np.isfinite(measured) & (np.abs(predicted) > 0)
    phase = np.unwrap(np.angle(predicted))
    difference = np.angle(np.where(known, measured, 1.0) / np.where(known, predicted, 1.0))
    points = []
    for axes, one, other in (
        (ax, np.abs(measured), np.abs(predicted)),
        (below, *np.rad2deg([np.where(known, phase + difference, np.nan), phase])),
    ):
        points += axes.plot(
            f, one, "o", color=pale(COLORS[0]), ms=5.0 if len(f) <= FEW else 3.5, mew=0, zorder=2
        )
        axes.plot(f, other, color=COLORS[0], lw=1.2, zorder=3)
    ax.set(
        yscale="log",
        ylabel=with_unit(f"magnitude of {sensor}", experiment.channels[sensor].unit),
    )
    _phases_over(f, below)
    _explain(ax, points[:1], word)
    return ax


def _phases_over(f: np.ndarray, below: Any) -> None:
    """Label the axes of phases over frequency; the frequency axis is logarithmic if it covers a
    decade or more."""
    below.set_xlabel("frequency [Hz]")
    degrees(below, "phase")
    if f[0] > 0 and f[-1] >= WIDE * f[0]:
        below.set_xscale("log")
        hertz(below, f)


def _explain(ax: Any, points: list[Any], word: str) -> None:
    """Add a legend with the names of several lines and the meaning of markers (measured) and lines
    (`word`)."""
    from matplotlib.legend_handler import HandlerTuple

    lines = [line for line in ax.lines if line not in points]
    named = [(line, line.get_label()) for line in lines] if len(lines) > 1 else []
    both = [(tuple(points[:KEYS]), "measured"), (tuple(lines[:KEYS]), word)]
    handles, labels = zip(*named, *both, strict=True)
    legend(
        ax,
        len(labels),
        handles=handles,
        labels=labels,
        handler_map={tuple: HandlerTuple(ndivide=None)},
    )


def _compared(
    channel: Channel, measured: np.ndarray, predicted: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return measured values, predicted values and their difference, one column per number;
    measured quaternions get the sign of the predicted ones."""
    n = len(measured)
    difference = np.where(
        channel.missing(measured), np.nan, -np.asarray(channel.residual(predicted, measured))
    )
    if channel.shape != channel.noise_shape:
        q = slice(measured.shape[-1] - 4, None)
        sign = np.where(
            np.sum(measured[..., q] * predicted[..., q], -1, keepdims=True) < 0, -1.0, 1.0
        )
        measured = np.concatenate([measured[..., : q.start], sign * measured[..., q]], -1)
    return measured.reshape(n, -1), predicted.reshape(n, -1), difference.reshape(n, -1)


def _columns(
    channel: Channel, part: int, readings: int, residuals: int
) -> tuple[list[int], list[int]]:
    """Return the column indices of the readings and of the residuals that belong to one part of a
    sensor: the components with one unit."""
    each = residuals // channel.units
    last = readings if part == channel.units - 1 else (part + 1) * each
    return list(range(part * each, last)), list(range(part * each, (part + 1) * each))


def _name(channel: Channel, sensor: str, part: int, i: int, count: int) -> str:
    if count == 1:
        return sensor
    names = {3: "xyz", 4: "wxyz" if channel.shape != channel.noise_shape else "1234"}.get(count)
    letter = LETTERS.get(channel.parts[part], "") if channel.parts else ""
    return f"{sensor} {letter}{names[i] if names else i + 1}"


def _unit(channel: Channel, part: int, columns: list[int], rows: list[int]) -> str:
    """Return the unit of the columns, which is empty for a quaternion: it has four columns for
    three residuals."""
    return channel.unit.split(",")[part].strip() if len(columns) == len(rows) else ""


def _bands(
    fit: Fit, run: str, sensor: str, shape: tuple[int, ...]
) -> dict[int, tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Return {component of the residuals: (sample numbers, half width of the noise's band, half
    width of the fitted line's band)}."""
    uncertainty, channel = fit._assessed(), fit.experiments[run].channels[sensor]
    r, J = linearized(fit)
    level = np.asarray(channel.spread(np.asarray(fit.task.noise[run][sensor])))
    levels = np.broadcast_to(
        level.reshape(-1, 1) if level.shape == shape[:1] and shape[1] == 1 else level, shape
    )
    bands = {}
    for i, record in enumerate(records_about(fit, run, sensor)):
        if len(record.rows):
            error, freedom = uncertainty.spread(J[record.rows])
            width, size = levels[record.times, i], float(np.sqrt(np.mean(r[record.rows] ** 2)))
            bands[i] = (
                record.times,
                1.96 * size * width,
                np.where(np.isfinite(error), quantile(BAND, freedom) * error, np.nan) * width,
            )
    return bands


def plot_record(record: Record, *, channels: tuple[str, ...] | None = None, ax: Any = None) -> Any:
    """Draw the channels of a record over time, one panel per unit; missing samples are gaps.

    channels: names; None takes all. Error: UNKNOWN_CHANNEL.

    >>> record = jb.Record(
    ...     [0.0, 0.1, 0.2], {"seat": ([0.1, 0.2, 0.0], "g"), "stroke": ([0, 5, 9], "mm")}
    ... )
    >>> [axes.get_ylabel() for axes in record.plot().figure.axes]
    ['seat [m/s2]', 'stroke [m]']
    """
    units: dict[str, dict[str, np.ndarray]] = {}
    for name in channels or tuple(record.channels):
        x = record[name]
        parts = (
            {name: x} if x.ndim == 1 else {f"{name}[{k}]": column for k, column in enumerate(x.T)}
        )
        units.setdefault(record.units[name], {}).update(parts)
    return _over_time(ax, record.times, units, tuple(record.channels))


def _over_time(
    ax: Any, times: Any, units: dict[str, dict[str, np.ndarray]], names: tuple[str, ...]
) -> Any:
    panels = {}
    for unit, lines in units.items():
        own = [name for name in names if any(line.split("[")[0] == name for line in lines)]
        panels[with_unit(own[0] if len(own) == 1 else "channels", unit)] = lines
    return panels_of_lines(axes_or_new(ax, 7.5, 1.2 + 1.8 * len(panels)), times, panels, "time [s]")


def plot_measurement(measurement: Measurement, *, ax: Any = None) -> Any:
    """Draw measured data: records over time, frequency responses by magnitude and phase, modes by
    number; one panel per unit.

    Error: NO_DATA for a planned experiment, in which nothing is measured yet.

    >>> track = jb.Experiment(
    ...     [0.0, 0.1, 0.2],
    ...     sensors={"x": jb.Position("mass", axis="x")},
    ...     measured={"x": [1.0, 0.9, 0.7]},
    ... )
    >>> jb.plots.plot_measurement(track).get_ylabel()
    'x [m]'
    """
    channels = {
        name: channel
        for name, channel in measurement.channels.items()
        if name in measurement.measured
    }
    if not channels:
        raise JaxbodyError(
            Problem(
                "NO_DATA",
                "plot_measurement.measurement",
                "has no measured channel",
                hint="Give measured= to the experiment.",
            )
        )
    over, x, unit = measurement.axis(next(iter(channels)))
    x, measured = np.asarray(x), {name: np.asarray(measurement.measured[name]) for name in channels}
    if any(np.iscomplexobj(y) for y in measured.values()):
        return _measured_responses(
            ax, x, {name: (channels[name].unit, y) for name, y in measured.items()}
        )
    panels: dict[str, dict[str, np.ndarray]] = {}
    for name, channel in channels.items():
        columns = measured[name].reshape(len(x), -1)
        for part in range(channel.units):
            own, rows = _columns(channel, part, columns.shape[1], columns.shape[1])
            for k, i in enumerate(own):
                panels.setdefault(_unit(channel, part, own, rows), {})[
                    _name(channel, name, part, k, len(own))
                ] = columns[:, i]
    if over != "time":
        labels = {
            with_unit(next(iter(lines)), unit): {name: list(y) for name, y in lines.items()}
            for unit, lines in panels.items()
        }
        ax = panels_of_marks(
            axes_or_new(ax, 5.5, 1.2 + 1.8 * len(labels)), labels, tuple(f"{k:g}" for k in x)
        )
        ax.figure.axes[-1].set_xlabel(with_unit(over, unit) if unit else over)
        return ax
    return _over_time(ax, x, panels, tuple(channels))


def _measured_responses(ax: Any, f: np.ndarray, pairs: dict[str, tuple[str, np.ndarray]]) -> Any:
    units = list(dict.fromkeys(unit for unit, _ in pairs.values()))
    ax = axes_or_new(ax, 7.0, 2.0 + 2.0 * len(units))
    *others, below = axes_below(ax, *[1.0] * (len(units) - 1), 0.55)
    for axes, unit in zip((ax, *others), units, strict=True):
        members = {name: y for name, (own, y) in pairs.items() if own == unit}
        for name, y in members.items():
            look = style(list(pairs).index(name)) | {"marker": ".", "ms": 4, "lw": 0.8}
            axes.plot(f, np.abs(y), label=name, **look)
            known = np.isfinite(y)
            below.plot(f[known], np.rad2deg(np.unwrap(np.angle(y[known]))), **look)
        axes.set(yscale="log", ylabel=with_unit("magnitude", unit))
        legend(axes, len(members))
    _phases_over(f, below)
    return ax


@of_one("times", 1)
def plot_recovered(recovered: Recovered, *, ax: Any = None) -> Any:
    """Draw the motion of the base recovered from its accelerations [m, rad] over time, and what was
    removed from the accelerations [m/s2, rad/s].

    >>> t = jnp.arange(400) / 100
    >>> shaken = jb.inputs.base_motion(
    ...     jb.Record(t, {"acc": (jnp.cos(6 * t), "m/s2")}), "acc", axis=[1, 0, 0]
    ... )
    >>> jb.plots.plot_recovered(shaken).figure.axes[-1].get_xlabel()
    'time [s]'
    """
    values, removed = np.asarray(recovered.motion.values), np.asarray(recovered.removed)
    panels = {}
    for label, rows, own in (
        ("displacement [m]", values, range(3)),
        ("turn [rad]", values, range(3, 6)),
        ("removed [m/s2]", removed, range(3)),
        ("removed [rad/s]", removed, range(3, 6)),
    ):
        lines = {NAMES[i]: rows[:, i] for i in own if np.any(rows[:, i])}
        panels |= {label: lines} if lines else {}
    return panels_of_lines(
        axes_or_new(ax, 7.0, 1.2 + 1.6 * len(panels)), recovered.times, panels, "time [s]"
    )


def plot_confidence_bands(
    bands: Bands, x: Any = None, *, xlabel: str = "component", ylabel: str = "value", ax: Any = None
) -> Any:
    """Draw the value of a function of a fitted model with its confidence band: a line over x, or
    marks with bars for up to twelve numbers.

    Args:
        bands: the bands.
        x: abscissa of the values, such as frequencies [Hz]; None numbers the values from 1.
        xlabel, ylabel: labels of the axes, with units.
        ax: axes to draw into; None makes a new figure.

    Error: BAD_SHAPE if x does not have one number for each value.

    >>> model = jb.Model(
    ...     bodies={"mass": jb.Body(mass=1.0, inertia=[1, 1, 1], position=[1, 0, 0])},
    ...     joints={"mass": jb.Guide("world", axis=[1, 0, 0])},
    ...     elements={
    ...         "spring": jb.Spring(
    ...             ("mass", [0, 0, 0]), ("world", [0, 0, 0]), stiffness=30.0, damping=1.0
    ...         )
    ...     },
    ... )
    >>> times, noise = jnp.linspace(0, 1, 41), 0.02 * jax.random.normal(jax.random.key(0), (41,))
    >>> decay = (
    ...     jnp.exp(-0.5 * times) * (jnp.cos(5.454 * times) + 0.0917 * jnp.sin(5.454 * times))
    ...     + noise
    ... )
    >>> track = jb.Experiment(
    ...     times, sensors={"x": jb.Position("mass", axis=[1, 0, 0])}, measured={"x": decay}
    ... )
    >>> fitted = jb.fit(model, {"track": track}, free=["spring.damping"])
    >>> jb.plots.plot_confidence_bands(
    ...     jb.confidence_bands(fitted, lambda model: model["spring"].damping),
    ...     ylabel="damping [N s/m]",
    ... ).get_ylabel()
    'damping [N s/m]'
    """
    value, low, high = (np.ravel(y) for y in (bands.value, bands.lower, bands.upper))
    at = np.arange(1, 1 + len(value)) if x is None else np.ravel(np.asarray(x, float))
    if len(at) != len(value):
        raise JaxbodyError(
            Problem(
                "BAD_SHAPE",
                "plot_confidence_bands.x",
                f"has {len(at)} numbers",
                x,
                f"{len(value)}, one for each value",
            )
        )
    ax = axes_or_new(ax, 6.5, 3.2)
    label = f"{100 * bands.level:g} % band"
    if x is None and len(value) <= MARKS:
        ax.errorbar(
            at,
            value,
            [value - low, high - value],
            fmt="o",
            ms=5,
            color=COLORS[0],
            capsize=4,
            lw=1.4,
            label=label,
        )
        ax.set_xlim(0.5, len(value) + 0.5)
        ax.xaxis.get_major_locator().set_params(integer=True, min_n_ticks=1)
    else:
        ax.fill_between(at, low, high, color=COLORS[0], alpha=0.25, lw=0, label=label)
        ax.plot(at, value, color=COLORS[0], lw=1.4, label="fitted")
    ax.set(xlabel=xlabel, ylabel=ylabel)
    legend(ax, 2)
    return ax


def plot_diagnosis(diagnosis: Diagnosis, *, ax: Any = None) -> Any:
    """Draw for each channel the gain relative to the prediction, the delay [samples] and the
    residual relative to the signal [%].

    >>> model = jb.Model(
    ...     bodies={"mass": jb.Body(mass=1.0, inertia=[1, 1, 1], position=[1, 0, 0])},
    ...     joints={"mass": jb.Guide("world", axis=[1, 0, 0])},
    ...     elements={
    ...         "spring": jb.Spring(
    ...             ("mass", [0, 0, 0]), ("world", [0, 0, 0]), stiffness=30.0, damping=1.0
    ...         )
    ...     },
    ... )
    >>> times, noise = jnp.linspace(0, 1, 41), 0.02 * jax.random.normal(jax.random.key(0), (41,))
    >>> decay = (
    ...     jnp.exp(-0.5 * times) * (jnp.cos(5.454 * times) + 0.0917 * jnp.sin(5.454 * times))
    ...     + noise
    ... )
    >>> track = jb.Experiment(
    ...     times, sensors={"x": jb.Position("mass", axis=[1, 0, 0])}, measured={"x": decay}
    ... )
    >>> jb.plots.plot_diagnosis(jb.diagnose(model, {"track": track})).get_ylabel()
    'gain [-]'
    """
    names = tuple(c.name for c in diagnosis.channels)
    panels = {
        "gain [-]": {"gain": [c.gain for c in diagnosis.channels]},
        "delay [samples]": {"delay": [c.delay for c in diagnosis.channels]},
        "residual [%]": {"residual": [100 * c.residual for c in diagnosis.channels]},
    }
    return panels_of_marks(axes_or_new(ax, max(5.0, 2.0 + 0.42 * len(names)), 5.2), panels, names)
