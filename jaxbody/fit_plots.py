"""Pictures of fits: the line through the points with residuals and bands, the way there, correlations, whiteness, a profile."""

from __future__ import annotations

from typing import Any

import numpy as np

from jaxbody.autocorrelations import most_lags, products
from jaxbody.canvases import COLORS, GRAY, INK, LIGHT, axes_below, axes_or_new, legend
from jaxbody.errors import JaxbodyError, Problem
from jaxbody.fits import Fit
from jaxbody.intervals import quantile
from jaxbody.models import unknown
from jaxbody.noises import records_of
from jaxbody.profiles import Profile
from jaxbody.tasks import residual_and_jacobian

BAND = 0.95  # level of the bands
AXES = "xyz"
DARK = 0.6  # correlations above which numbers are white


def plot_fit(fit: Fit, *, run: str | None = None, sensor: str | None = None, ax: Any = None) -> Any:
    """One sensor of one run (the first, if none are named): measured points, the fitted model's line, and below them the residuals, with bands that hold
    95 % of the noise (pale) and the uncertainty of the fitted line (dark); of a measured response magnitudes. Error: UNKNOWN_NAME.

    >>> model = Model(bodies={"mass": Body(mass=1.0, inertia=[1, 1, 1], position=[1, 0, 0])}, joints={"mass": Guide("world", axis=[1, 0, 0])},
    ...               elements={"spring": Spring(("mass", [0, 0, 0]), ("world", [0, 0, 0]), stiffness=30.0)})
    >>> times, noise = jnp.linspace(0, 1, 21), 0.05 * jax.random.normal(jax.random.key(0), (21,))
    >>> track = Experiment(times, sensors={"x": Position("mass", axis=[1, 0, 0])}, measured={"x": jnp.cos(2 * jnp.pi * times) + noise})
    >>> plot_fit(fit(model, {"track": track}, free=["spring.stiffness"])).get_ylabel()
    'x [m]'
    """
    run, sensor = _chosen(fit, run, sensor, "plot_fit")
    experiment = fit.experiments[run]
    ax = axes_or_new(ax, 7.0, 4.2)
    over, x, its_unit = experiment.axis(sensor)
    x = np.asarray(x)
    measured, predicted = (_columns(values[sensor], len(x)) for values in (experiment.measured, fit.predicted[run]))
    below = axes_below(ax, 0.4)
    shown = [i for i in range(measured.shape[1]) if np.isfinite(measured[:, i]).any() and np.ptp(predicted[:, i]) > 0] or [0]
    bands = _bands(fit, run, sensor) if fit.uncertainty is not None else {}
    for color, i in zip(COLORS, shown, strict=False):
        name = sensor if measured.shape[1] == 1 else f"{sensor} {_component(i, measured.shape[1])}"
        center = np.mean(predicted[:, i]) if len(shown) > 1 else 0.0
        ax.plot(x, measured[:, i] - center, ".", color=color, ms=3.0, alpha=0.45, mew=0, zorder=2)
        ax.plot(x, predicted[:, i] - center, color=color, lw=1.4, label=name, zorder=3)
        below.plot(x, measured[:, i] - predicted[:, i], ".", color=color, ms=3.0, alpha=0.6, mew=0)
        if i in bands:
            rows, noise, uncertainty = bands[i]
            below.axhspan(-noise, noise, color=LIGHT, alpha=0.5 / len(shown), lw=0, zorder=0)
            below.fill_between(x[rows], -uncertainty, uncertainty, color=color, alpha=0.25, lw=0, zorder=1)
    below.axhline(0.0, color=INK, lw=0.8)
    ax.plot([], [], ".", color=GRAY, ms=6, label="measured")
    ax.plot([], [], color=GRAY, lw=1.4, label="fitted")
    unit = experiment.channels[sensor].unit
    about = ", from its mean" if len(shown) > 1 else ""
    ax.set_ylabel(f"{sensor}{about} [{unit}]")
    ax.tick_params(labelbottom=False)
    below.set(xlabel=f"{over} [{its_unit}]" if its_unit else over, ylabel=f"residual [{unit}]")
    legend(ax, len(shown) + 2)
    return ax


def plot_history(fit: Fit, *, ax: Any = None) -> Any:
    """The cost of a fit at every evaluation, on a logarithmic scale."""
    ax = axes_or_new(ax, 5.0, 3.0)
    cost = np.asarray(fit.history, float).ravel()
    ax.plot(np.arange(len(cost)), cost, ".-", color=COLORS[0], lw=1.2, ms=4)
    if (cost > 0).any():
        ax.set_yscale("log")
    ax.set(xlabel="evaluation", ylabel="cost [-]")
    ax.xaxis.get_major_locator().set_params(integer=True)
    return ax


def plot_correlations(fit: Fit, *, ax: Any = None) -> Any:
    """Correlations of the estimates as a heat map: near 1 or -1 the data tell a combination of two better than each. What is not determined is left out."""
    names, C = fit.task.labels, fit.covariance
    known = np.flatnonzero((np.diag(C) > 0) & np.isfinite(fit._assessed().spread(np.eye(len(C)))[0]))
    deviation = np.sqrt(np.diag(C))[known]
    rho = C[np.ix_(known, known)] / np.outer(deviation, deviation)
    ax = axes_or_new(ax, 2.2 + 0.55 * len(known), 1.6 + 0.45 * len(known))
    ax.grid(False)
    ax.imshow(rho, cmap="RdBu_r", vmin=-1, vmax=1)
    for (i, j), value in np.ndenumerate(rho):
        if i != j:
            ax.text(j, i, f"{value:.2f}", ha="center", va="center", fontsize=8, color="white" if abs(value) > DARK else INK)
    labels = [names[i] for i in known]
    ax.set_xticks(range(len(known)), labels, fontsize=8, rotation=40, ha="right", rotation_mode="anchor")
    ax.set_yticks(range(len(known)), labels, fontsize=8)
    ax.set_title("correlations of the estimates", fontsize=9)
    return ax


def plot_autocorrelation(fit: Fit, *, run: str | None = None, sensor: str | None = None, ax: Any = None) -> Any:
    """Correlations of residuals of one sensor with themselves some samples later, and the band that holds 95 % of those of white noise.

    Errors: UNKNOWN_NAME; NO_DATA of a record of too few samples, or none in time.
    """
    run, sensor = _chosen(fit, run, sensor, "plot_autocorrelation")
    r, _ = _linearized(fit)
    records = [x for x in records_of(fit.experiments) if x.run == run and _of(x, run, sensor) and x.series and r[x.rows].any()]
    records = [x for x in records if most_lags(len(x.rows))]
    if not records:
        raise JaxbodyError(Problem("NO_DATA", "plot_autocorrelation.sensor", f"'{sensor}' has no record in time to look at", sensor))
    ax = axes_or_new(ax, 5.5, 3.0)
    for i, (color, record) in enumerate(zip(COLORS, records, strict=False)):
        values = r[record.rows]
        rho = products(values, most_lags(len(values))) / (values @ values)
        at = np.arange(1, len(rho)) + (i - (len(records) - 1) / 2) * 0.6 / max(len(records), 2)
        ax.vlines(at, 0, rho[1:], color=color, lw=2, label=record.name)
        ax.plot(at, rho[1:], "o", color=color, ms=3)
    far = 1.96 / np.sqrt(min(len(record.rows) for record in records))
    ax.axhspan(-far, far, color=LIGHT, alpha=0.6, lw=0, zorder=0)
    ax.axhline(0.0, color=INK, lw=0.8)
    ax.set(xlabel="lag [samples]", ylabel="autocorrelation of residuals", ylim=(min(-0.25, ax.get_ylim()[0]), 1.0))
    ax.xaxis.get_major_locator().set_params(integer=True)
    legend(ax, len(records))
    return ax


def plot_profile(found: Profile, *, ax: Any = None) -> Any:
    """tau over a parameter: straight where the likelihood is that of a normal distribution; the interval is where it lies between the dashed lines."""
    ax = axes_or_new(ax, 4.6, 3.2)
    ax.plot(found.values, found.tau, "o-", color=COLORS[0], ms=3.5, lw=1.4)
    for sign in (-1, 1):
        ax.axhline(sign * found.limit, color=GRAY, lw=0.9, ls="--")
    low, high = (x if np.isfinite(x) else None for x in found.interval)
    if low is not None and high is not None:
        ax.axvspan(low, high, color=LIGHT, alpha=0.5, lw=0, zorder=0)
    ax.axvline(found.estimate, color=INK, lw=0.8)
    ax.set(
        xlabel=found.path,
        ylabel=r"$\tau$ [standard errors]",
        title=f"{100 * found.level:g} % interval {found.interval[0]:.5g} to {found.interval[1]:.5g}",
    )
    ax.title.set_fontsize(9)
    return ax


def _chosen(fit: Fit, run: str | None, sensor: str | None, where: str) -> tuple[str, str]:
    """The run and the sensor named, or the first."""
    run = run or next(iter(fit.experiments))
    if run not in fit.experiments:
        raise JaxbodyError(unknown(run, f"{where}.run", tuple(fit.experiments)))
    known = tuple(fit.experiments[run].measured)
    sensor = sensor or known[0]
    if sensor not in known:
        raise JaxbodyError(unknown(sensor, f"{where}.sensor", known))
    return run, sensor


def _columns(values: Any, count: int) -> np.ndarray:
    values = np.asarray(values)
    return np.asarray(np.abs(values) if np.iscomplexobj(values) else values, float).reshape(count, -1)


def _component(i: int, count: int) -> str:
    return AXES[i] if count == 3 else str(i + 1)


def _of(record: Any, run: str, sensor: str) -> bool:
    return record.name.split("[")[0] == f"{run}.{sensor}"


def _linearized(fit: Fit) -> tuple[np.ndarray, np.ndarray]:
    _, J, runs = residual_and_jacobian(fit.task, fit.u)
    return fit.task.linearized(runs, np.asarray(J))


def _bands(fit: Fit, run: str, sensor: str) -> dict[int, tuple[np.ndarray, float, np.ndarray]]:
    """Of each component that has residuals like its readings: sample numbers, the half width of the noise and that of the fitted line."""
    worth, channel = fit._assessed(), fit.experiments[run].channels[sensor]
    if channel.noise_shape != channel.shape or np.iscomplexobj(fit.experiments[run].measured[sensor]):
        return {}
    r, J = _linearized(fit)
    levels = np.broadcast_to(channel.spread(np.asarray(fit.task.noise[run][sensor])), channel.shape or (1,)).ravel()
    found = {}
    for i, record in enumerate(x for x in records_of(fit.experiments) if x.run == run and _of(x, run, sensor)):
        error, freedom = worth.spread(J[record.rows])
        width = np.where(np.isfinite(error), quantile(BAND, freedom) * error, np.nan) * levels[i]
        found[i] = (record.times, 1.96 * levels[i] * float(np.sqrt(np.mean(r[record.rows] ** 2))), width)
    return found
