"""Plots of shocks: spectra of shocks and earthquakes, responses to them, matched records, peaks
and fatigue."""

from typing import Any

import numpy as np

from jaxbody.shock.fatigue_damages import FatigueDamage
from jaxbody.shock.matched_records import MatchedRecord
from jaxbody.shock.peak_factors import PeakFactors
from jaxbody.shock.response_spectra import ResponseSpectrum
from jaxbody.shock.shock_spectra import ShockSpectrum
from jaxbody.shock.spectrum_responses import SpectrumResponse
from jaxbody.views.plots.canvases import (
    axes_below,
    axes_or_new,
    check_single,
    legend,
    of_one,
    with_unit,
)
from jaxbody.views.plots.response_plots import hertz, lines_over_frequency, plain_numbers
from jaxbody.views.scenes.colors import COLORS, GRAY

LEAST_SHARE = 1e-3  # least share of a mode that is drawn


@of_one("frequencies", 1)
def plot_shock_spectrum(spectrum: ShockSpectrum, *, ax: Any = None) -> Any:
    """Draw a shock spectrum over natural frequency on logarithmic scales, with a line for each
    damping ratio."""
    f, values = np.asarray(spectrum.frequencies), np.asarray(spectrum.values)
    order = np.argsort(f)
    lines = [
        (f"damping ratio {zeta:g}", row[order])
        for zeta, row in zip(np.asarray(spectrum.damping), values, strict=True)
    ]
    what = {
        "absolute": "acceleration",
        "relative": "displacement",
        "pseudo": "pseudo-acceleration",
    }[spectrum.kind]
    side = "" if spectrum.side == "maximax" else f"{spectrum.side} "
    label = with_unit(f"largest {side}{what}", spectrum.unit)
    return lines_over_frequency(ax, f[order], lines, label)


def plot_response_spectrum(
    spectrum: ResponseSpectrum, *, damping: tuple[float, ...] | None = None, ax: Any = None
) -> Any:
    """Draw the pseudo-acceleration of a design spectrum over natural frequency on logarithmic
    scales.

    damping: damping ratios; None takes 0.05, or the nearest one for which the spectrum is known."""
    check_single("plot_response_spectrum.spectrum", spectrum.rigid(), 0)
    first, last = (float(x) for x in spectrum.covers())
    f = np.geomspace(first, min(last, 100.0), 400)
    ratios = damping or (float(np.clip(0.05, *spectrum.dampings())),)
    lines = [(f"damping ratio {zeta:g}", np.asarray(spectrum(f, zeta))) for zeta in ratios]
    return lines_over_frequency(ax, f, lines, "pseudo-acceleration [m/s2]")


def plot_spectrum_compatible_record(quake: MatchedRecord, *, ax: Any = None) -> Any:
    """Draw acceleration, velocity and displacement over time, and below them the spectrum of the
    record with the target spectrum."""
    panels = {
        "acceleration [m/s2]": quake.acceleration,
        "velocity [m/s]": quake.velocity,
        "displacement [m]": quake.displacement,
    }
    ax = axes_or_new(ax, 7.5, 7.0)
    *others, below = axes_below(ax, 1.0, 1.0, 1.9, share=False)
    for i, (axes, (label, values)) in enumerate(zip((ax, *others), panels.items(), strict=True)):
        axes.plot(quake.times, np.asarray(values), lw=0.9, color=COLORS[0])
        axes.set(ylabel=label.replace(" [", "\n["), xlabel="time [s]" if i == 2 else "")
        axes.tick_params(labelbottom=i == 2)
    f = np.asarray(quake.frequencies)
    below.loglog(f, np.asarray(quake.target), lw=5.0, color=GRAY, alpha=0.5, label="target")
    below.loglog(f, np.asarray(quake.reached), lw=1.2, color=COLORS[2], label="reached")
    below.set_ylabel("pseudo-acceleration\n[m/s2]")
    plain_numbers(below, np.asarray(quake.target))
    hertz(below, f)
    legend(below, 2)
    return ax


@of_one("values", 1)
def plot_spectrum_response(response: SpectrumResponse, *, ax: Any = None) -> Any:
    """Draw the shares of the modes in the peak of each output: shares of the squares, or of the
    magnitudes for combine="absolute"."""
    shares = np.asarray(response.shares)
    shown = [j for j in range(shares.shape[1]) if np.abs(shares[:, j]).max() > LEAST_SHARE]
    ax, y = axes_or_new(ax, 7.5, 1.4 + 0.45 * len(shares)), np.arange(len(shares))
    ends = [np.zeros(len(shares)), np.zeros(len(shares))]  # of the positive and the negative shares
    for i, j in enumerate(shown):
        name = (
            "rest"
            if j == shares.shape[1] - 1
            else f"mode {j + 1}, {float(response.frequency[j]):.3g} Hz"
        )
        row = 100 * shares[:, j]
        left = np.where(row >= 0, *ends)
        ax.barh(y, row, left=left, height=0.6, color=COLORS[i % len(COLORS)], label=name, lw=0)
        ends = [ends[0] + np.maximum(row, 0), ends[1] + np.minimum(row, 0)]
    named = [
        f"{name}\n{value:.4g} {unit}"
        for name, value, unit in zip(
            response.outputs, np.asarray(response.values), response.units, strict=True
        )
    ]
    ax.set_yticks(y, named, fontsize=8)
    ax.set(
        xlabel="share in the peak [%]"
        if response.combine == "absolute"
        else "share in the square of the peak [%]",
        ylim=(len(y) - 0.5, -0.5),
    )
    ax.axvline(0.0, color=GRAY, lw=0.8)
    legend(ax, len(shown))
    return ax


@of_one("factor", 1)
def plot_peak_factors(peaks: PeakFactors, *, ax: Any = None) -> Any:
    """Draw the peak factors of outputs with their standard deviations; the labels of the outputs
    state their maxima."""
    ax, y = axes_or_new(ax, 7.0, 1.3 + 0.4 * len(peaks.outputs)), np.arange(len(peaks.outputs))
    spread = np.nan_to_num(np.asarray(peaks.deviation))
    ax.errorbar(np.asarray(peaks.factor), y, xerr=spread, fmt="o", ms=5, color=COLORS[0], capsize=3)
    named = [
        f"{name}\n{value:.4g} {unit}"
        for name, value, unit in zip(
            peaks.outputs, np.asarray(peaks.maximum), peaks.units, strict=True
        )
    ]
    ax.set_yticks(y, named, fontsize=8)
    ax.set(
        xlabel=f"peak factor in {float(peaks.duration):g} s [-]",
        xlim=(0, None),
        ylim=(len(y) - 0.5, -0.5),
    )
    return ax


@of_one("damage", 1)
def plot_fatigue_damage(damage: FatigueDamage, *, ax: Any = None) -> Any:
    """Draw the fatigue damage of each output on a logarithmic scale; a damage of 1 means
    failure."""
    ax, values = axes_or_new(ax, 7.0, 1.3 + 0.4 * len(damage.outputs)), np.asarray(damage.damage)
    y, positive = np.arange(len(values)), values[values > 0]
    ax.barh(y, values, height=0.6, color=COLORS[0], lw=0)
    ax.axvline(1.0, color=COLORS[2], lw=1.2)
    ax.set_yticks(
        y,
        [
            f"{name}\n{life / 3600:.3g} h"
            for name, life in zip(damage.outputs, np.asarray(damage.life), strict=True)
        ],
        fontsize=8,
    )
    ax.set(
        xscale="log",
        xlim=(min([0.1, *positive]) / 3, max([1.0, *positive]) * 3),
        ylim=(len(y) - 0.5, -0.5),
        xlabel=f"damage in {float(damage.duration):g} s, {damage.method} [-]",
    )
    return ax
