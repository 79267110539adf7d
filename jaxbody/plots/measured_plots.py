"""Plots of measured data with the fitted model: records with residuals, frequency responses with phases, modes."""

from __future__ import annotations

from typing import Any

import numpy as np

from jaxbody.identification.fits import Fit
from jaxbody.plots.canvases import COLORS, INK, LIGHT, axes_below, axes_or_new, legend, pale
from jaxbody.plots.fit_plots import chosen, linearized, records_about
from jaxbody.plots.response_plots import hertz
from jaxbody.sensors.channels import Channel
from jaxbody.statistics.quantiles import quantile

BAND = 0.95  # level of the bands
FEW = 400  # samples up to which markers are large
LETTERS = {"force": "F", "moment": "M"}
WIDE = 10.0  # ratio of the largest to the smallest frequency from which on the axis is logarithmic
KEYS = 3  # colors shown in a legend entry that stands for several lines


def plot_fit(fit: Fit, *, run: str | None = None, sensor: str | None = None, ax: Any = None) -> Any:
    """The measured points of one sensor and the fitted model's line through them.

    Records and modes have their residuals below, with bands for 95 % of the noise (pale) and for the uncertainty of the fitted line (dark).
    Frequency responses have their magnitudes above and their phases below, without bands. Error: UNKNOWN_NAME.

    Args:
        fit: the fit.
        run: name of the run; None takes the first one.
        sensor: name of the sensor, or of one part of a sensor with two units, such as "plate moment"; None takes the first one
            ("frequency" for modes).
        ax: axes to draw into; None makes a new figure.

    >>> model = Model(bodies={"mass": Body(mass=1.0, inertia=[1, 1, 1], position=[1, 0, 0])},
    ...               joints={"mass": Guide("world", axis=[1, 0, 0])},
    ...               elements={"spring": Spring(("mass", [0, 0, 0]), ("world", [0, 0, 0]), stiffness=30.0)})
    >>> times, noise = jnp.linspace(0, 1, 21), 0.05 * jax.random.normal(jax.random.key(0), (21,))
    >>> track = Experiment(times, sensors={"x": Position("mass", axis=[1, 0, 0])}, measured={"x": jnp.cos(2 * jnp.pi * times) + noise})
    >>> plot_fit(fit(model, {"track": track}, free=["spring.stiffness"])).get_ylabel()
    'x [m]'
    """
    run, sensor, part = chosen(fit, run, sensor, "plot_fit")
    ax = axes_or_new(ax, 7.0, 4.2)
    if np.iscomplexobj(fit.experiments[run].measured[sensor]):
        return _draw_response(fit, run, sensor, ax)
    return _draw_record(fit, run, sensor, part or 0, ax)


def _draw_record(fit: Fit, run: str, sensor: str, part: int, ax: Any) -> Any:
    experiment = fit.experiments[run]
    channel, (over, x, its_unit) = experiment.channels[sensor], experiment.axis(sensor)
    x = np.asarray(x)
    measured, predicted, residual = _compared(channel, np.asarray(experiment.measured[sensor]), np.asarray(fit.predicted[run][sensor]))
    columns, rows = _columns(channel, part, measured.shape[1], residual.shape[1])
    (below,) = axes_below(ax, 0.4)
    shown = [i for i in columns if np.isfinite(measured[:, i]).any() and np.ptp(predicted[:, i]) > 0] or columns[:1]
    shown = shown if len(rows) == len(columns) else columns
    left = rows if len(rows) != len(columns) else [rows[columns.index(i)] for i in shown]
    names = [_name(channel, sensor, part, columns.index(i), len(columns)) for i in shown]
    dots = dict(ls="none", marker="o", mew=0, ms=5.0 if len(x) <= FEW else 3.5)
    points, line = [], {"lw": 1.2} if channel.series else {"ls": "none", "marker": "_", "ms": 16, "mew": 1.8}
    for color, i, name in zip(COLORS, shown, names, strict=False):
        center = np.mean(predicted[:, i]) if len(shown) > 1 and channel.series else 0.0
        points += ax.plot(x, measured[:, i] - center, color=pale(color), zorder=2, **dots)
        ax.plot(x, predicted[:, i] - center, color=color, label=name, zorder=3, **line)
    bands = _bands(fit, run, sensor, residual.shape) if fit.uncertainty is not None else {}
    for color, i in zip(COLORS[len(shown) - len(left) :], left, strict=False):
        below.plot(x, residual[:, i], color=color, alpha=0.6, **(dots | {"ms": 3.0 if channel.series else 5.0}))
        if i in bands:
            _draw_band(below, x, bands[i], color, len(left), series=channel.series)
    below.axhline(0.0, color=INK, lw=0.8)
    what = names[0] if len(shown) == 1 else " ".join([sensor, *channel.parts[part : part + 1]])
    ax.set_ylabel(_with_unit(what + (", from its mean" if len(shown) > 1 and channel.series else ""), _unit(channel, part, columns, rows)))
    below.set(xlabel=_with_unit(over, its_unit), ylabel=_with_unit("residual", _unit(channel, part, rows, rows)))
    if not channel.series:
        below.xaxis.get_major_locator().set_params(integer=True, min_n_ticks=1)
        below.set_xlim(x[0] - 0.5, x[-1] + 0.5)
    _explain(ax, points)
    return ax


def _draw_band(below: Any, x: np.ndarray, band: tuple[np.ndarray, np.ndarray, np.ndarray], color: str, count: int, *, series: bool) -> None:
    rows, noise, uncertainty = band
    if series:
        below.axhspan(-noise[0], noise[0], color=LIGHT, alpha=0.5 / count, lw=0, zorder=0)
        below.fill_between(x[rows], -uncertainty, uncertainty, color=color, alpha=0.25, lw=0, zorder=1)
    else:
        below.vlines(x[rows], -noise, noise, color=LIGHT, lw=10, zorder=0)
        below.vlines(x[rows], -uncertainty, uncertainty, color=color, alpha=0.4, lw=4, zorder=1)


def _draw_response(fit: Fit, run: str, sensor: str, ax: Any) -> Any:
    """Magnitudes and unwrapped phases; each measured phase is within half a turn of the fitted one."""
    experiment = fit.experiments[run]
    f = np.asarray(experiment.axis(sensor)[1])
    measured, predicted = np.asarray(experiment.measured[sensor]), np.asarray(fit.predicted[run][sensor])
    (below,) = axes_below(ax, 0.55)
    there = np.isfinite(measured) & (np.abs(predicted) > 0)
    phase = np.unwrap(np.angle(predicted))
    apart = np.angle(np.where(there, measured, 1.0) / np.where(there, predicted, 1.0))
    points = []
    for axes, one, other in (
        (ax, np.abs(measured), np.abs(predicted)),
        (below, *np.rad2deg([np.where(there, phase + apart, np.nan), phase])),
    ):
        points += axes.plot(f, one, "o", color=pale(COLORS[0]), ms=5.0 if len(f) <= FEW else 3.5, mew=0, zorder=2)
        axes.plot(f, other, color=COLORS[0], lw=1.2, zorder=3)
    ax.set_yscale("log")
    ax.set_ylabel(_with_unit(f"magnitude of {sensor}", experiment.channels[sensor].unit))
    below.set(xlabel="frequency [Hz]", ylabel="phase [degrees]")
    below.yaxis.get_major_locator().set_params(steps=[1, 1.8, 3.6, 4.5, 9, 10])
    if f[0] > 0 and f[-1] >= WIDE * f[0]:
        ax.set_xscale("log")
        hertz(below, f)
    _explain(ax, points[:1])
    return ax


def _explain(ax: Any, points: list[Any]) -> None:
    """A legend that names the lines, where there are several, and says which markers are measured and which lines are fitted."""
    from matplotlib.legend_handler import HandlerTuple

    lines = [line for line in ax.lines if line not in points]
    named = [(line, line.get_label()) for line in lines] if len(lines) > 1 else []
    both = [(tuple(points[:KEYS]), "measured"), (tuple(lines[:KEYS]), "fitted")]
    handles, labels = zip(*named, *both, strict=True)
    legend(ax, len(labels), handles=handles, labels=labels, handler_map={tuple: HandlerTuple(ndivide=None)})


def _compared(channel: Channel, measured: np.ndarray, predicted: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Measured values, predicted values and their difference, one column per number; measured quaternions take the sign of the predicted
    ones."""
    n = len(measured)
    apart = np.where(channel.missing(measured), np.nan, -np.asarray(channel.residual(predicted, measured)))
    if channel.shape != channel.noise_shape:
        q = slice(measured.shape[-1] - 4, None)
        sign = np.where(np.sum(measured[..., q] * predicted[..., q], -1, keepdims=True) < 0, -1.0, 1.0)
        measured = np.concatenate([measured[..., : q.start], sign * measured[..., q]], -1)
    return measured.reshape(n, -1), predicted.reshape(n, -1), apart.reshape(n, -1)


def _columns(channel: Channel, part: int, readings: int, residuals: int) -> tuple[list[int], list[int]]:
    """The columns of a reading and of a residual that belong to one part, that is to one unit."""
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
    """The unit of the columns; a quaternion has four columns for three residuals, and no unit."""
    return channel.unit.split(",")[part].strip() if len(columns) == len(rows) else ""


def _with_unit(what: str, unit: str) -> str:
    return f"{what} [{unit}]" if unit else what


def _bands(fit: Fit, run: str, sensor: str, shape: tuple[int, ...]) -> dict[int, tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """For each component of the residuals: sample numbers and half widths of the bands of the noise and of the fitted line."""
    uncertainty, channel = fit._assessed(), fit.experiments[run].channels[sensor]
    r, J = linearized(fit)
    level = np.asarray(channel.spread(np.asarray(fit.task.noise[run][sensor])))
    levels = np.broadcast_to(level.reshape(-1, 1) if level.shape == shape[:1] and shape[1] == 1 else level, shape)
    bands = {}
    for i, record in enumerate(records_about(fit, run, sensor)):
        if len(record.rows):
            error, freedom = uncertainty.spread(J[record.rows])
            width, size = levels[record.times, i], float(np.sqrt(np.mean(r[record.rows] ** 2)))
            bands[i] = (record.times, 1.96 * size * width, np.where(np.isfinite(error), quantile(BAND, freedom) * error, np.nan) * width)
    return bands
