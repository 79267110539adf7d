"""Plots of responses: frequency response, transmissibility and power spectral density."""

from __future__ import annotations

from typing import Any

import numpy as np

from jaxbody.core.errors import JaxbodyError, Problem
from jaxbody.plots.canvases import COLORS, DASHES, GRAY, LIGHT, axes_below, axes_or_new, legend, style
from jaxbody.responses.frequency_responses import FrequencyResponse
from jaxbody.responses.random_responses import RandomResponse

MANY = 16  # lines up to which the legend fits beside a plot of normal width


def plot_frequency_response(response: FrequencyResponse, *, ax: Any = None) -> Any:
    """Magnitudes over frequency, both on logarithmic scales, one panel per unit, with the phases below; returns the top axes.

    >>> model = jb.presets.quarter_car(damping=1500.0)
    >>> inputs, outputs = {"road": BaseMotion("road", "z")}, {"body": Position("body", axis="z")}
    >>> response = frequency_response(linearize(model, equilibrium(model)), jnp.geomspace(0.1, 50, 100), inputs, outputs)
    >>> ax = plot_frequency_response(response)
    >>> ax.get_ylabel()
    'magnitude'
    """
    f, size, phase = _above_0_hz(response)
    pairs = _pairs(response)
    panels: dict[str, list[int]] = {}
    for k, (i, j, _) in enumerate(pairs):
        panels.setdefault(response.unit(response.outputs[i], response.inputs[j]), []).append(k)
    ax = axes_or_new(ax, 7.0 if len(pairs) <= MANY else 9.0, 2.2 + 2.2 * len(panels))
    *others, below = axes_below(ax, *[1.0] * (len(panels) - 1), 0.55)
    for axes, (unit, members) in zip((ax, *others), panels.items(), strict=True):
        for k in members:
            i, j, name = pairs[k]
            turns = np.round(phase[i, j, 0] / (2 * np.pi))
            axes.loglog(f, size[i, j], label=name, lw=1.5, **look(response, i, j))
            below.semilogx(f, np.rad2deg(phase[i, j] - 2 * np.pi * turns), lw=1.5, **look(response, i, j))
        axes.set_ylabel(f"magnitude [{unit}]" if unit else "magnitude")
        legend(axes, len(members))
    hertz(below, f)
    below.set_ylabel("phase [degrees]")
    below.yaxis.get_major_locator().set_params(steps=[1, 1.8, 3.6, 4.5, 9, 10])
    return ax


def plot_transmissibility(response: FrequencyResponse, *, ax: Any = None) -> Any:
    """Dimensionless magnitudes over frequency, of motion over motion or force over force; the region above 1 is shaded.

    Error: BAD_UNIT if no output has the unit of an input.
    """
    ratios = [(i, j, name) for i, j, name in _pairs(response) if not response.unit(response.outputs[i], response.inputs[j])]
    if not ratios:
        message, hint = "has no output in the unit of an input", "Use displacements for inputs and outputs, or forces for both."
        raise JaxbodyError(Problem("BAD_UNIT", "plot_transmissibility.response", message, response, "a ratio", hint))
    ax = axes_or_new(ax, 7.0 if len(ratios) <= MANY else 9.0, 3.4)
    f, size, _ = _above_0_hz(response)
    for i, j, name in ratios:
        ax.loglog(f, size[i, j], lw=1.5, label=name, **look(response, i, j))
    top = max(size[i, j].max() for i, j, _ in ratios)
    ax.axhspan(1.0, max(2.0, 2 * top), color=LIGHT, alpha=0.4, lw=0, zorder=0)
    ax.axhline(1.0, color=GRAY, lw=0.8)
    ax.set(ylabel="transmissibility", ylim=(None, max(2.0, 2 * top)))
    hertz(ax, f)
    legend(ax, len(ratios))
    return ax


def plot_psd(response: RandomResponse, *, outputs: tuple[str, ...] | None = None, ax: Any = None) -> Any:
    """Power spectral densities of outputs on logarithmic scales, with their rms values.

    outputs: names of outputs with one unit; None takes all with the unit of the first. Errors: UNKNOWN_NAME; BAD_UNIT if they have
    several units.
    """
    names = outputs or tuple(name for name, unit in zip(response.outputs, response.units, strict=True) if unit == response.units[0])
    values = {name: float(response[name]) for name in names}
    units = {response.units[response.outputs.index(name)] for name in names}
    if len(units) > 1:
        message, hint = f"are in {', '.join(sorted(units))}", "Give outputs= with the names of outputs in one unit."
        raise JaxbodyError(Problem("BAD_UNIT", "plot_psd.outputs", message, units, "one unit", hint))
    ax = axes_or_new(ax, 7.0, 3.4)
    (unit,) = units
    f, psd = np.asarray(response.frequencies), np.asarray(response.psd)
    for i, (name, value) in enumerate(values.items()):
        ax.loglog(f, psd[response.outputs.index(name)], lw=1.5, label=f"{name}, rms {value:.3g} {unit}", **style(i))
    shown = unit if unit.isalpha() else f"({unit})"
    ax.set_ylabel(f"power spectral density [{shown}$^2$/Hz]")
    hertz(ax, f)
    top = max(np.nanmax(psd[response.outputs.index(name)]) for name in names)
    ax.set_ylim(bottom=max(ax.get_ylim()[0], top * 1e-8))
    legend(ax, len(names))
    return ax


def _above_0_hz(response: FrequencyResponse) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The frequencies above 0 Hz, for the logarithmic scale, with magnitudes and unwrapped phases."""
    f = np.asarray(response.frequencies)
    values = np.asarray(response.values)[..., f > 0]
    return f[f > 0], np.abs(values), np.unwrap(np.angle(values))


def _pairs(response: FrequencyResponse) -> list[tuple[int, int, str]]:
    """Indices of each output and input with a nonzero response between them, and the label of the pair."""
    size = np.asarray(response.magnitude).max(-1)
    several = len(response.inputs) > 1
    pairs = [(i, j, f"{y} of {u}" if several else y) for i, y in enumerate(response.outputs) for j, u in enumerate(response.inputs)]
    return [(i, j, name) for i, j, name in pairs if not size[i, j] <= 1e-12 * size[i].max()] or pairs


def look(response: FrequencyResponse, i: int, j: int) -> dict[str, Any]:
    """One color per output and one dash pattern per input, if there are enough of both; else `style` by number."""
    if len(response.outputs) <= len(COLORS) and len(response.inputs) <= len(DASHES):
        return {"color": COLORS[i], "ls": DASHES[j]}
    return style(i * len(response.inputs) + j)


def hertz(ax: Any, f: np.ndarray) -> None:
    """A logarithmic frequency axis with plain numbers: 1, 2, 5 of each decade, or 1 only where there are many decades."""
    from matplotlib.ticker import LogLocator, NullFormatter

    subs = (1.0, 2.0, 5.0) if f[-1] / f[0] < 3000 else (1.0,)
    ax.set(xlabel="frequency [Hz]", xlim=(f[0], f[-1]))
    ax.xaxis.set_major_locator(LogLocator(subs=subs))
    ax.xaxis.set_major_formatter("{x:g}")
    ax.xaxis.set_minor_formatter(NullFormatter())
