"""Plots of fits: the history of the cost, correlations of the estimates, autocorrelations of the residuals, a likelihood profile."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np

from jaxbody.core.errors import JaxbodyError, Problem, unknown
from jaxbody.experiments.residual_series import records_of
from jaxbody.identification.fits import Fit
from jaxbody.identification.residuals import residual_and_jacobian
from jaxbody.inference.profiles import Profile
from jaxbody.plots.canvases import COLORS, GRAY, INK, LIGHT, axes_or_new, legend
from jaxbody.statistics.autocorrelations import FEWEST, most_lags, products
from jaxbody.statistics.noises import ResidualSeries

COMPLEX = ("real", "imaginary")
DARK = 0.6  # correlation above which the number is printed in white


def plot_history(fit: Fit, *, ax: Any = None) -> Any:
    """The cost of a fit at every evaluation, on a logarithmic scale; crosses mark trials that could not be simulated.

    A dotted line marks each new estimate of the noise, which changes the weights in the cost: compare costs only between two such lines."""
    ax = axes_or_new(ax, 5.0, 3.0)
    cost, estimated = np.asarray(fit.history, float).ravel(), [i for i in fit.rounds if i < len(fit.history)]
    good = np.isfinite(cost)
    for start, stop in pairwise([0, *estimated, len(cost)]):
        at = np.flatnonzero(good[start:stop]) + start
        ax.plot(at, cost[at], ".-", color=COLORS[0], lw=1.2, ms=4)
    for k, start in enumerate(estimated):
        ax.axvline(start - 0.5, color=GRAY, lw=0.9, ls=":", label="noise estimated again" if k == 0 else None)
    if not good.all():
        failed, style = np.flatnonzero(~good), {"color": COLORS[4], "ms": 6, "transform": ax.get_xaxis_transform()}
        ax.plot(failed, np.full(len(failed), 0.96), "x", label="could not be simulated", **style)
    if (cost[good] > 0).any():
        ax.set_yscale("log")
    ax.set(xlabel="evaluation", ylabel="cost [-]")
    ax.xaxis.get_major_locator().set_params(integer=True)
    if estimated or not good.all():
        ax.legend(frameon=False, fontsize=8)
    return ax


def plot_correlations(fit: Fit, *, ax: Any = None) -> Any:
    """Correlations of the estimates as a heat map; parameters that the data do not determine are left out.

    Near 1 or -1 the data determine a combination of the two parameters better than each of them."""
    names, C = fit.task.space.names, fit.covariance
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
    """The autocorrelation of the residuals of one sensor, with the band that contains 95 % of the values for white noise.

    The lag is in samples, for a frequency response in spectral lines. Errors: UNKNOWN_NAME; NO_DATA if the record has too few samples or,
    like modes, is not a sequence.

    Args:
        fit: the fit.
        run: name of the run; None takes the first one.
        sensor: name of the sensor; None takes the first one.
        ax: axes to draw into; None makes a new figure.
    """
    run, sensor, part = chosen(fit, run, sensor, "plot_autocorrelation")
    r, _ = linearized(fit)
    records = [x for x in records_about(fit, run, sensor) if part is None or x.group.endswith(f" {part}")]
    records = [x for x in records if x.series and r[x.rows].any() and most_lags(len(x.rows))]
    if not records:
        message, hint = f"'{sensor}' has no autocorrelation", f"Choose a sensor with a sequence of {FEWEST} samples or more."
        raise JaxbodyError(Problem("NO_DATA", "plot_autocorrelation.sensor", message, sensor, hint=hint))
    ax = axes_or_new(ax, 5.5, 3.0)
    for i, record in enumerate(records):
        color = COLORS[i % len(COLORS)]
        values = r[record.rows]
        rho = products(values, most_lags(len(values))) / (values @ values)
        at = np.arange(1, len(rho)) + (i - (len(records) - 1) / 2) * 0.6 / max(len(records), 2)
        name = record.name if not np.iscomplexobj(fit.experiments[run].measured[sensor]) else f"{run}.{sensor} {COMPLEX[i]}"
        ax.vlines(at, 0, rho[1:], color=color, lw=2, label=name)
        ax.plot(at, rho[1:], "o", color=color, ms=3)
    far = 1.96 / np.sqrt(min(len(record.rows) for record in records))
    ax.axhspan(-far, far, color=LIGHT, alpha=0.6, lw=0, zorder=0)
    ax.axhline(0.0, color=INK, lw=0.8)
    lag = "samples" if fit.experiments[run].axis(sensor)[0] == "time" else "lines"
    ax.set(xlabel=f"lag [{lag}]", ylabel="autocorrelation of residuals", ylim=(min(-0.25, ax.get_ylim()[0]), 1.0))
    ax.xaxis.get_major_locator().set_params(integer=True)
    legend(ax, len(records))
    return ax


def plot_profile(profile: Profile, *, ax: Any = None) -> Any:
    """The signed root tau of a likelihood profile over its parameter, with the confidence interval, where tau is between the dashed lines.

    tau is a straight line where the likelihood is that of a normal distribution."""
    ax = axes_or_new(ax, 4.6, 3.2)
    ax.plot(profile.values, profile.tau, "o-", color=COLORS[0], ms=3.5, lw=1.4)
    for sign in (-1, 1):
        ax.axhline(sign * profile.limit, color=GRAY, lw=0.9, ls="--")
    low, high = (x if np.isfinite(x) else None for x in profile.interval)
    if low is not None and high is not None:
        ax.axvspan(low, high, color=LIGHT, alpha=0.5, lw=0, zorder=0)
    ax.axvline(profile.estimate, color=INK, lw=0.8)
    ax.set(
        xlabel=profile.path,
        ylabel=r"$\tau$ [standard errors]",
        title=f"{100 * profile.level:g} % interval {profile.interval[0]:.5g} to {profile.interval[1]:.5g}",
    )
    ax.title.set_fontsize(9)
    return ax


def chosen(fit: Fit, run: str | None, sensor: str | None, where: str) -> tuple[str, str, int | None]:
    """The named run, sensor and part of a sensor, or the first ones; "plate moment" names the second part of the ForcePlate "plate".

    Args:
        fit: the fit.
        run, sensor: names; None takes the first ones.
        where: name of the calling function, for messages.
    """
    run = run or next(iter(fit.experiments))
    if run not in fit.experiments:
        raise JaxbodyError(unknown(run, f"{where}.run", tuple(fit.experiments)))
    given = fit.experiments[run]
    names: dict[str, tuple[str, int | None]] = {name: (name, None) for name in given.channels}
    names |= {f"{name} {part}": (name, i) for name, channel in given.channels.items() for i, part in enumerate(channel.parts)}
    sensor = sensor or next(iter(names))
    if sensor not in names:
        raise JaxbodyError(unknown(sensor, f"{where}.sensor", tuple(names)))
    return run, *names[sensor]


def records_about(fit: Fit, run: str, sensor: str) -> list[ResidualSeries]:
    """The residual series of each component of a sensor."""
    return [x for x in records_of(fit.experiments) if x.run == run and x.name.split("[")[0] == f"{run}.{sensor}"]


def linearized(fit: Fit) -> tuple[np.ndarray, np.ndarray]:
    """The residuals divided by the noise, and their Jacobian."""
    _, J, runs = residual_and_jacobian(fit.task, fit.u)
    return fit.task.linearized(runs, np.asarray(J))
