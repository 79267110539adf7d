"""Plots of modal tests: estimated responses with their coherence, the stabilization diagram of
identified modes, and their agreement with those of a model."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from jaxbody.core.errors import check_all_known
from jaxbody.fitting.modal.identified_modes import IdentifiedModes
from jaxbody.fitting.modal.response_estimates import EstimatedResponse
from jaxbody.model.models import Model
from jaxbody.views.plots.canvases import (
    axes_below,
    axes_or_new,
    heat_map,
    legend,
    style,
    with_unit,
)
from jaxbody.views.plots.mode_plots import mode_heads
from jaxbody.views.plots.response_plots import degrees, plain_numbers
from jaxbody.views.scenes.colors import COLORS, GRAY

BAND = 1.96  # standard deviations of the 95 % band
MOST = 4  # pairs that are drawn where none are chosen
LOW = 0.3  # of the smallest magnitude, from which the axis begins
APART = 0.035  # least distance of the frequencies written above the diagram, of its width


def plot_estimated_response(
    response: EstimatedResponse,
    *,
    pairs: Sequence[tuple[str, str]] | None = None,
    ax: Any = None,
) -> Any:
    """Draw the magnitudes of estimated responses with their 95 % bands, one panel per unit, and
    below them the phases and the coherence of each pair, the influence of other inputs taken out.

    Args:
        response: the responses.
        pairs: [(output, input), ...]; None takes the first four.
        ax: axes to draw into; None makes a new figure.

    Error: UNKNOWN_NAME.

    >>> force = np.random.default_rng(1).normal(size=4096)
    >>> record = jb.Record(None, {"f": (force, "N"), "x": (2e-3 * force, "m")}, rate=256.0)
    >>> test = jb.modal.estimate_responses(record, inputs=["f"], outputs=["x"], segment=1.0)
    >>> [axes.get_ylabel() for axes in test.plot().figure.axes]
    ['magnitude [m/N]', 'phase [degrees]', 'coherence [-]']
    """
    e, known = response.estimate, tuple(response.pairs)
    shown = known[:MOST] if pairs is None else tuple(map(tuple, pairs))
    check_all_known(shown, "plot_estimated_response.pairs", known)
    panels: dict[str, list[tuple[str, str]]] = {}
    for y, u in shown:
        panels.setdefault(response.channels[f"{y}/{u}"].unit, []).append((y, u))
    ax = axes_or_new(ax, 7.5, 3.2 + 2.2 * len(panels))
    coherent = e.partial is not None  # not so for spectra of ambient vibration
    every = [ax, *axes_below(ax, *[1.0] * (len(panels) - 1), *[0.6] * (1 + coherent))]
    phases = every[len(panels)]
    for axes, (unit, members) in zip(every, panels.items(), strict=False):
        for y, u in members:
            i, j = e.outputs.index(y), e.inputs.index(u)
            kept = np.isfinite(e.H[:, i, j])
            f, H, width = e.frequencies[kept], e.H[kept, i, j], BAND * e.spread[kept, i, j]
            size, look = np.abs(H), style(shown.index((y, u)))
            low = np.maximum(size - width, LOW * size.min())
            axes.fill_between(f, low, size + width, color=look["color"], alpha=0.25, lw=0)
            axes.plot(f, size, lw=1.1, label=f"{y} / {u}", **look)
            phases.plot(f, np.degrees(np.angle(H)), ".", ms=2.5, color=look["color"])
            if e.partial is not None:
                every[-1].plot(f, e.partial[kept, i, j], lw=1.0, **look)
        axes.set(yscale="log", ylabel=with_unit("magnitude", unit))
        plain_numbers(axes, np.concatenate([line.get_ydata() for line in axes.lines]))
        legend(axes, len(members), title="with 95 % bands")
    if len(shown) < len(known) and pairs is None:
        ax.set_title(f"{len(shown)} of {len(known)} pairs", fontsize=9)
    phases.set_ylim(-190, 190)
    degrees(phases, "phase")
    if coherent:
        every[-1].set(ylabel="coherence [-]", ylim=(-0.03, 1.03))
    every[-1].set(xlabel="frequency [Hz]", xlim=(e.frequencies[0], e.frequencies[-1]))
    return ax


def plot_identified_modes(
    identified: IdentifiedModes, *, model: Model | None = None, ax: Any = None
) -> Any:
    """Draw the stabilization diagram: poles over frequency and order, with lines at the modes, and
    behind them the measured responses and those of the modes; or the agreement with a model.

    Args:
        identified: the modes.
        model: draw the modal assurance criterion of its modes (rows) with the identified ones
            (columns) instead; 1 are equal shapes.
        ax: axes to draw into; None makes a new figure.

    The responses are the mean over all pairs, each relative to its rms.

    Error: NO_DATA for a model, without sensors of it.

    >>> f = np.linspace(1, 9, 400)
    >>> s, p = 2j * np.pi * f, np.array([-0.2 + 20j, -0.3 + 38j])
    >>> H = sum(-1e-3j / (s - q) + 1e-3j / (s - q.conjugate()) for q in p)
    >>> force, motion = jb.PointForce("mass", direction="y"), jb.Position("mass", axis="y")
    >>> test = jb.MeasuredResponse(
    ...     f, inputs={"f": force}, outputs={"y": motion}, measured={("y", "f"): H}, noise=1e-6
    ... )
    >>> ax = jb.modal.identify_modes(test).plot()
    >>> [text.get_text() for text in ax.texts]
    ['3.183 Hz', '6.048 Hz']
    """
    if model is not None:
        return _agreement(identified, model, ax)
    i, found = identified.identification, identified.identification.diagram
    ax = axes_or_new(ax, 8.5, 4.6)
    behind = ax.twinx()
    size = np.sqrt(np.mean(np.abs(i.measured) ** 2, 0))
    lines = []
    for H, label, look in (
        (i.measured, "measured", {"color": GRAY, "lw": 3.0, "alpha": 0.6}),
        (i.fit.H, "of the modes", {"color": COLORS[1], "lw": 1.2}),
    ):
        lines += behind.plot(i.frequencies, np.mean(np.abs(H) / size, (1, 2)), label=label, **look)
    for kept, label, look in (
        (~found.stable, "other poles", {"ms": 3.0, "mfc": "none", "mec": GRAY, "mew": 0.9}),
        (found.stable, "stable poles", {"ms": 5.0, "color": COLORS[0], "mew": 0}),
    ):
        poles = found.frequency[kept], found.order[kept]
        lines += ax.plot(*poles, ls="none", marker="o", label=label, **look)
    low, high = i.frequencies[0], i.frequencies[-1]
    gaps = APART * (high - low) * np.arange(len(i.frequency))
    places = np.maximum.accumulate(i.frequency - gaps) + gaps
    look = {"color": COLORS[2], "lw": 1.0, "ls": "--", "label": "modes"}
    lines += [ax.axvline(f, **look) for f in i.frequency]
    for f, place in zip(i.frequency, places, strict=True):
        ax.annotate(
            f"{f:.4g} Hz",
            (f, 1.0),
            (place, 1.04),
            xycoords=("data", "axes fraction"),
            arrowprops={"arrowstyle": "-", "color": COLORS[2], "lw": 0.6},
            rotation=90,
            ha="center",
            va="bottom",
            fontsize=8,
            color=COLORS[2],
        )
    ax.set(xlabel="frequency [Hz]", ylabel="order [-]", xlim=(low, high), ylim=(0, None))
    ax.set(zorder=behind.get_zorder() + 1, frame_on=False)  # poles in front of the responses
    ax.yaxis.get_major_locator().set_params(integer=True)
    behind.set(yscale="log", ylabel="relative magnitude [-]")
    behind.spines["top"].set_visible(False)
    legend(ax, 5, handles=lines[:5], bbox_to_anchor=(1.1, 1.0))
    return ax


def _agreement(identified: IdentifiedModes, model: Model, ax: Any) -> Any:
    frequency, agreement = map(np.asarray, identified.agreement(model))
    rows, columns = agreement.shape
    ax = heat_map(
        ax,
        (1.8 + 0.6 * columns, 1.6 + 0.5 * rows),
        agreement,
        [head.replace("\n", ": ") for head in mode_heads(frequency)],
        mode_heads(identified.identification.frequency),
        (0.0, 1.0),
        "modal assurance criterion [-]",
        digits=2,
    )
    ax.set(xlabel="identified mode", ylabel="mode of the model")
    return ax
