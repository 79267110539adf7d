"""Plots of modes: the distribution of their energy as a heat map, and their frequencies along a parameter."""

from __future__ import annotations

from typing import Any

import numpy as np

from jaxbody.core.errors import JaxbodyError, Problem, Status
from jaxbody.core.tables import counted
from jaxbody.plots.canvases import axes_or_new, legend, style
from jaxbody.vibrations.modal_energies import ModeEnergies
from jaxbody.vibrations.mode_branches import LEAST_MAC, Branches

KINDS = {"kinetic": "kinetic energy", "strain": "strain energy", "dissipation": "dissipation"}
LEAST_SHOWN = 0.05  # percent; rows in which all modes have less would print as zeros and are left out
DARK = 55.0  # percent above which numbers are printed in white


def plot_mode_energies(energies: ModeEnergies, *, kind: str = "kinetic", ax: Any = None) -> Any:
    """Shares of each mode's energy [%] as a heat map with one column per mode.

    kind: "kinetic" by body and direction, "strain" by element, or "dissipation" by damper. Rows in which all modes have less than 0.05 %
    are left out; the title says how many. Error: UNKNOWN_NAME for another kind.

    >>> car = jb.presets.half_car()
    >>> ax = plot_mode_energies(mode_energies(linearize(car, equilibrium(car)), forward="x"))
    >>> ax.get_title()
    'kinetic energy [%]; 4 rows below 0.05 % left out'
    """
    if kind not in KINDS:
        raise JaxbodyError(Problem("UNKNOWN_NAME", "plot_mode_energies.kind", f"is {kind!r}", kind, ", ".join(KINDS), "Give one of these."))
    every = _rows(energies, kind)
    rows = {name: row for name, row in every.items() if not np.nanmax(np.abs(row), initial=0.0) < LEAST_SHOWN} or every
    count = energies.frequency.shape[-1]
    shares = np.array(list(rows.values())).reshape(-1, count)
    ax = axes_or_new(ax, 1.6 + 0.75 * count, 1.0 + 0.32 * max(len(shares), 2))
    ax.grid(False)
    ax.imshow(np.clip(shares, 0, 100), cmap="Blues", vmin=0, vmax=100, aspect="auto")
    for (i, j), share in np.ndenumerate(shares):
        if np.isfinite(share) and abs(share) >= 0.05:
            ax.text(j, i, f"{share:.1f}", ha="center", va="center", fontsize=8, color="white" if share > DARK else "#2b2f36")
    ax.set_xticks(range(count), [f"{i + 1}\n{f:.4g} Hz" for i, f in enumerate(np.asarray(energies.frequency))], fontsize=8)
    ax.set_yticks(range(len(shares)), list(rows), fontsize=8)
    ax.set_xticks(np.arange(count - 1) + 0.5, minor=True)
    ax.set_yticks(np.arange(len(shares) - 1) + 0.5, minor=True)
    ax.grid(which="minor", color="white", lw=1.5)
    ax.tick_params(which="both", length=0)
    ax.spines[:].set_visible(False)
    less = f"; {counted(len(every) - len(rows), 'row')} below {LEAST_SHOWN:g} % left out" if len(rows) < len(every) else ""
    ax.set_title(f"{KINDS[kind]} [%]{less}", fontsize=9)
    return ax


def _rows(energies: ModeEnergies, kind: str) -> dict[str, np.ndarray]:
    if kind == "kinetic":
        return dict(zip(energies.rows, np.asarray(energies.kinetic_shares).reshape(-1, energies.frequency.shape[-1]), strict=True))
    rows = energies.strain | energies.other_strain if kind == "strain" else energies.dissipation
    return {name: np.asarray(row) for name, row in rows.items()}


def plot_branches(branches: Branches, *, parameter: str = "parameter", ax: Any = None) -> Any:
    """The frequency of each mode [Hz] along a parameter; a gap and a cross mark where a mode could not be tracked.

    The modes are tracked by shape and named as at the first value.

    >>> car = jb.presets.half_car()
    >>> found = track(lambda k: linearize(replace(car, {"front spring.stiffness": k}), car.reference), jnp.linspace(1.5e4, 4e4, 6))
    >>> [line.get_label() for line in plot_branches(found, parameter="front stiffness [N/m]").lines]
    ['1: body bounce 86 %', '2: body about y 86 %']
    """
    ax = axes_or_new(ax, 6.0, 4.0)
    values, ended = np.asarray(branches.values), np.asarray(branches.status) == Status.LOST_BRANCH
    for i, (name, frequency) in enumerate(zip(branches.names, np.asarray(branches.frequency).T, strict=True)):
        gaps = np.flatnonzero(ended & (np.asarray(branches.mac)[:, i] < LEAST_MAC))
        ax.plot(np.insert(values, gaps, np.nan), np.insert(frequency, gaps, np.nan), lw=1.6, label=f"{i + 1}: {name}", **style(i))
        if gaps.size:
            ax.plot(values[gaps], frequency[gaps], "x", color=style(i)["color"], ms=6)
    ax.set(xlabel=parameter, ylabel="frequency [Hz]")
    legend(ax, branches.frequency.shape[-1])
    return ax
