"""Plots of small motions: matrices, shapes, energies, poles and backbones of modes, their
frequencies along a parameter, elastic axes."""

from typing import Any

import numpy as np

from jaxbody.core.errors import JaxbodyError, Problem, Status, check_known
from jaxbody.core.tables import counted, without_dust
from jaxbody.vibration.backbones import Backbones
from jaxbody.vibration.damped_modes import ComplexModes
from jaxbody.vibration.linearizations import LinearSystem
from jaxbody.vibration.modal_energies import ModeEnergies
from jaxbody.vibration.mode_branches import LEAST_MAC, Branches
from jaxbody.vibration.mount_axes import ElasticAxes, TorqueRollAxis
from jaxbody.vibration.natural_modes import Modes
from jaxbody.views.plots.canvases import (
    DASHES,
    axes_below,
    axes_or_new,
    check_single,
    heat_map,
    legend,
    of_one,
    style,
)
from jaxbody.views.plots.model_plots import look_along
from jaxbody.views.scenes.colors import COLORS, GRAY, INK, LIGHT

KINDS = {"kinetic": "kinetic energy", "strain": "strain energy", "dissipation": "dissipation"}
RATIOS = (0.05, 0.1, 0.2, 0.5)  # damping ratios whose lines are drawn
PERCENT = 5.0  # largest change of frequency to which a backbone is drawn [%]
CURVE = np.linspace(0, 1, 50)
# percent; rows with less in all modes would be written as zeros and are left out
LEAST_SHOWN = 0.05


@of_one("frequency", 1)
def plot_mode_energies(energies: ModeEnergies, *, kind: str = "kinetic", ax: Any = None) -> Any:
    """Draw the shares of each mode's energy [%] as a heat map with one column per mode.

    kind: "kinetic" by body and direction, "strain" by element, or "dissipation" by damper. Rows in
    which all modes have less than 0.05 % are left out; the title says how many. Error: UNKNOWN_NAME
    for another kind.

    >>> car = jb.presets.half_car()
    >>> ax = jb.plots.plot_mode_energies(
    ...     jb.vibration.mode_energies(jb.linearize(car, jb.equilibrium(car)), forward="x")
    ... )
    >>> ax.get_title()
    'kinetic energy [%]; 4 rows below 0.05 % left out'
    """
    if kind not in KINDS:
        raise JaxbodyError(
            Problem(
                "UNKNOWN_NAME",
                "plot_mode_energies.kind",
                f"is {kind!r}",
                kind,
                ", ".join(KINDS),
                "Give one of these.",
            )
        )
    every = _rows(energies, kind)
    rows = {
        name: row
        for name, row in every.items()
        if not np.nanmax(np.abs(row), initial=0.0) < LEAST_SHOWN
    } or every
    count = energies.frequency.shape[-1]
    shares = np.array(list(rows.values())).reshape(-1, count)
    less = (
        f"; {counted(len(every) - len(rows), 'row')} below {LEAST_SHOWN:g} % left out"
        if len(rows) < len(every)
        else ""
    )
    return heat_map(
        ax,
        (1.6 + 0.75 * count, 1.0 + 0.32 * max(len(shares), 2)),
        shares,
        list(rows),
        mode_heads(energies.frequency),
        (0.0, 100.0),
        f"{KINDS[kind]} [%]{less}",
        least=LEAST_SHOWN,
    )


def _rows(energies: ModeEnergies, kind: str) -> dict[str, np.ndarray]:
    if kind == "kinetic":
        shares = np.asarray(energies.kinetic_shares).reshape(-1, energies.frequency.shape[-1])
        return dict(zip(energies.rows, shares, strict=True)) | {
            name: np.asarray(row) for name, row in energies.inertia.items()
        }
    rows = energies.strain | energies.other_strain if kind == "strain" else energies.dissipation
    return {name: np.asarray(row) for name, row in rows.items()}


@of_one("frequency", 2)
def plot_tracked_modes(branches: Branches, *, parameter: str = "parameter", ax: Any = None) -> Any:
    """Draw the frequency of each mode [Hz] along a parameter; a gap and a cross mark where a mode
    could not be tracked.

    The modes are tracked by shape and named by their shapes at the first value. parameter: name of
    the parameter, with its unit.

    >>> car = jb.presets.half_car()
    >>> found = jb.vibration.track_modes(
    ...     lambda k: jb.linearize(jb.replace(car, {"front spring.stiffness": k}), car.reference),
    ...     jnp.linspace(1.5e4, 4e4, 6),
    ... )
    >>> [
    ...     line.get_label()
    ...     for line in jb.plots.plot_tracked_modes(found, parameter="front stiffness [N/m]").lines
    ... ]
    ['1: body bounce 86 %', '2: body about y 86 %']
    """
    ax = axes_or_new(ax, 6.0, 4.0)
    values, ended = np.asarray(branches.values), np.asarray(branches.status) == Status.LOST_BRANCH
    for i, (name, frequency) in enumerate(
        zip(branches.names, np.asarray(branches.frequency).T, strict=True)
    ):
        gaps = np.flatnonzero(ended & (np.asarray(branches.mac)[:, i] < LEAST_MAC))
        ax.plot(
            np.insert(values, gaps, np.nan),
            np.insert(frequency, gaps, np.nan),
            lw=1.6,
            label=f"{i + 1}: {name}",
            **style(i),
        )
        if gaps.size:
            ax.plot(values[gaps], frequency[gaps], "x", color=style(i)["color"], ms=6)
    ax.set(xlabel=parameter, ylabel="frequency [Hz]")
    legend(ax, branches.frequency.shape[-1])
    return ax


def plot_matrix(lin: LinearSystem, *, matrix: str = "K", ax: Any = None) -> Any:
    """Draw the coupling of the coordinates by a matrix as a heat map: A_ij/sqrt(|A_ii A_jj|),
    without units; 1 or -1 is full coupling.

    matrix: "M", "C" or "K" (or "D", "K_elastic", ... with coordinates in its rows and columns).
    Error: UNKNOWN_NAME.

    >>> engine = jb.presets.engine_on_mounts()
    >>> ax = jb.linearize(engine, jb.equilibrium(engine)).plot()
    >>> [text.get_text() for text in ax.get_xticklabels()][:2]
    ['engine move along x', 'engine move along y']
    """
    known = tuple(
        name
        for name in ("M", "C", "D", "K", "K_elastic", "K_geometric", "K_gravity", "K_loads", "G")
        if hasattr(lin, name)
    )
    check_known(matrix, "plot_matrix.matrix", known)
    A, names = np.asarray(getattr(lin, matrix)), list(lin.coordinates)
    check_single("plot_matrix.lin", A, 2)
    size = np.sqrt(np.abs(np.diag(A)))
    scale = np.outer(size, size)
    coupling = without_dust(np.divide(A, scale, out=np.zeros_like(A), where=scale > 0), 1.0)
    return heat_map(
        ax,
        (2.4 + 0.48 * len(names), 2.0 + 0.32 * len(names)),
        coupling,
        names,
        names,
        (-1.0, 1.0),
        rf"coupling by {matrix}: ${matrix[0]}_{{ij}}/\sqrt{{|{matrix[0]}_{{ii}} "
        rf"{matrix[0]}_{{jj}}|}}$ [-]",
        digits=2,
        least=0.005,
        slant=True,
    )


@of_one("frequency", 1)
def plot_modes(modes: Modes, *, ax: Any = None) -> Any:
    """Draw the shapes of natural modes as a heat map with one column per mode: sqrt(M_ii) phi_i,
    without units and with their signs.

    The squares of a column add up to 1 if M couples no coordinates. `draw_mode` draws one mode as a
    motion of the model.

    >>> lin = jb.linearize(jb.presets.quarter_car(), jb.presets.quarter_car().reference)
    >>> [text.get_text() for text in jb.plots.plot_modes(jb.modes(lin)).get_yticklabels()]
    ['body move along its guide', 'wheel move along its guide']
    """
    shapes = np.sqrt(np.diag(np.asarray(modes.M)))[:, None] * np.asarray(modes.shapes)
    names = list(modes.layout.with_mass)
    return heat_map(
        ax,
        (2.2 + 0.6 * shapes.shape[1], 1.2 + 0.3 * len(names)),
        without_dust(shapes, 1.0),
        names,
        mode_heads(modes.frequency),
        (-1.0, 1.0),
        r"shapes of the modes: $\sqrt{M_{ii}}\,\phi_i$ [-]",
        digits=2,
        least=0.005,
    )


def mode_heads(frequency: Any) -> list[str]:
    """Return the number and the frequency [Hz] of each mode, on two lines."""
    return [f"{i + 1}\n{f:.4g} Hz" for i, f in enumerate(np.asarray(frequency))]


@of_one("frequency", 1)
def plot_poles(modes: ComplexModes, *, ax: Any = None) -> Any:
    """Draw the poles of complex modes: damped frequency [Hz] over real part [1/s], with lines of
    constant damping ratio.

    An overdamped mode has two real poles; modes right of the vertical line, in the shaded region,
    grow.

    >>> car = jb.presets.quarter_car(damping=1500.0)
    >>> ax = jb.plots.plot_poles(jb.complex_modes(jb.linearize(car, car.reference)))
    >>> ax.get_xlabel(), ax.get_ylabel()
    ('real part [1/s]', 'damped frequency [Hz]')
    """
    ax = axes_or_new(ax, 7.0, 3.8)
    poles = without_dust(modes.poles)
    heights = np.abs(poles.imag) / (2 * np.pi)
    for i, (pair, height, name) in enumerate(zip(poles, heights, modes.names, strict=True)):
        shown = slice(0, 1 if height[0] > 0 else 2)
        mark = {"marker": "x+osD^"[i // 4 % 6], "color": COLORS[i % len(COLORS)], "mfc": "none"}
        ax.plot(
            pair.real[shown],
            height[shown],
            ls="none",
            ms=7,
            mew=1.8,
            label=f"{i + 1}: {name}",
            **mark,
        )
    top, left = (
        1.12 * np.nanmax(heights, initial=0.0) or 1.0,
        1.12 * np.nanmin(poles.real, initial=0.0),
    )
    left = min(left, -2 * np.pi * top * RATIOS[0])
    for ratio in RATIOS:
        slope = ratio / np.sqrt(1 - ratio**2) * 2 * np.pi  # -real part over hertz
        end = (-slope * top, top) if slope * top < -left else (left, -left / slope)
        ax.plot([0, end[0]], [0, end[1]], color=GRAY, lw=0.7, ls=":", zorder=1)
        side = (
            {"ha": "center", "va": "bottom", "xytext": (0, 2)}
            if end[1] == top
            else {"ha": "right", "va": "center", "xytext": (-2, 0)}
        )
        ax.annotate(
            f"ζ = {ratio:g}",
            end,
            textcoords="offset points",
            fontsize=7,
            color=GRAY,
            annotation_clip=False,
            **side,
        )
    right = max(0.06 * -left, 1.2 * np.nanmax(poles.real, initial=0.0))
    ax.axvspan(0, right, color=LIGHT, alpha=0.6, lw=0, zorder=0)
    ax.axvline(0, color=INK, lw=0.8)
    ax.set(xlabel="real part [1/s]", xlim=(left, right), ylim=(-0.02 * top, top))
    ax.set_ylabel("damped frequency [Hz]", labelpad=22)
    legend(ax, len(poles))
    return ax


@of_one("frequency", 1)
def plot_backbone_curves(backbones: Backbones, *, ax: Any = None) -> Any:
    """Draw the change of each natural frequency [%] over the amplitude of the mode's largest
    component, up to 5 %.

    Modes whose largest component is in rad have a panel of their own. Modes without a backbone are
    left out; those whose frequency does not change extend to the largest amplitude of the others.

    >>> bob = jb.Body(mass=1.0, inertia=[1e-3, 1e-3, 1e-3], com=[0, 0, -0.5])
    >>> pendulum = jb.Model(
    ...     bodies={"bob": bob},
    ...     joints={"bob": jb.Hinge("world", axis=[0, 1, 0])},
    ...     gravity=[0, 0, -9.81],
    ... )
    >>> jb.plots.plot_backbone_curves(
    ...     jb.vibration.backbone_curves(jb.linearize(pendulum, pendulum.reference))
    ... ).get_xlabel()
    'amplitude [rad]'
    """
    curvature = np.asarray(backbones.curvature)
    largest, known = np.asarray(backbones.largest), np.isfinite(curvature)
    reach = np.asarray(backbones.frequency_within(PERCENT))
    turns = backbones.turns[largest]
    panels = [
        (label, np.flatnonzero(known & (turns == turn)))
        for label, turn in (("amplitude [m]", False), ("amplitude [rad]", True))
    ]
    panels = [(label, members) for label, members in panels if len(members)]
    ax = axes_or_new(ax, 7.0, 0.8 + 2.6 * max(len(panels), 1))
    for axes, (label, members) in zip(
        [ax, *axes_below(ax, *[1.0] * (len(panels) - 1), share=False)], panels, strict=False
    ):
        limit = np.median([reach[i] for i in members if np.isfinite(reach[i])] or [1.0])
        for i in members:
            a = CURVE * min(reach[i], 3 * limit)
            name = (
                f"{i + 1}: {float(backbones.frequency[i]):.4g} Hz, "
                f"{backbones.coordinates[largest[i]]}"
            )
            axes.plot(
                a, 100 * without_dust(curvature, 1.0)[i] * a**2, lw=1.5, label=name, **style(int(i))
            )
        axes.axhline(0.0, color=GRAY, lw=0.8, zorder=1)
        axes.set(
            xlabel=label, ylabel="change of frequency [%]", ylim=(-1.15 * PERCENT, 1.15 * PERCENT)
        )
        legend(axes, len(members))
    return ax


@of_one("stiffness", 1)
def plot_elastic_axes(axes: ElasticAxes, *, view: str = "xz", ax: Any = None) -> Any:
    """Draw the elastic axes of a body with their stiffnesses and the center of stiffness, in world
    coordinates.

    view: the axes that point right and up. Give the axes of `draw_model` in the same view to draw
    them on the model. Error: BAD_VIEW.

    >>> engine = jb.presets.engine_on_mounts()
    >>> ax = jb.plots.plot_elastic_axes(
    ...     jb.vibration.elastic_axes(jb.linearize(engine, engine.reference), "engine")
    ... )
    >>> ax.get_title(), ax.get_xlabel()
    ('elastic axes of engine', 'x [m]')
    """
    lines = [
        (f"axis {i + 1}: {k:.4g} N/m", np.asarray(point), np.asarray(n))
        for i, (k, point, n) in enumerate(
            zip(np.asarray(axes.stiffness), axes.points, np.asarray(axes.directions).T, strict=True)
        )
    ]
    return _draw_axes(
        ax,
        lines,
        ("center of stiffness", np.asarray(axes.center)),
        view,
        f"elastic axes of {axes.body}",
    )


@of_one("point", 1)
def plot_torque_roll_axis(axis: TorqueRollAxis, *, view: str = "xz", ax: Any = None) -> Any:
    """Draw the torque roll axis of a body through its center of mass, with the frequency of the
    rotation about it; the arguments are those of `plot_elastic_axes`.

    >>> engine = jb.presets.engine_on_mounts()
    >>> ax = jb.plots.plot_torque_roll_axis(
    ...     jb.vibration.torque_roll_axis(
    ...         jb.linearize(engine, engine.reference), "engine", [1.0, 0, 0]
    ...     ),
    ...     view="xy",
    ... )
    >>> ax.get_title(), ax.get_ylabel()
    ('torque roll axis of engine', 'y [m]')
    """
    line = (
        f"torque roll axis: {float(axis.frequency):.4g} Hz",
        np.asarray(axis.point),
        np.asarray(axis.direction),
    )
    return _draw_axes(
        ax,
        [line],
        ("center of mass", np.asarray(axis.point)),
        view,
        f"torque roll axis of {axis.body}",
    )


def _draw_axes(
    ax: Any, lines: list[tuple[str, Any, Any]], center: tuple[str, Any], view: str, title: str
) -> Any:
    """Draw named lines and a named center and return the axes; on the drawing of a model the lines
    are half as long as the drawing.

    Args:
        ax: axes to draw into; None makes a new figure.
        lines: (name, point, unit direction) of each line [m], in world coordinates.
        center: name and position of the center [m].
        view: the axes that point right and up.
        title: title of new axes.
    """
    look, alone = look_along(view), ax is None or not ax.has_data()
    ax = axes_or_new(ax, 6.5, 4.0)
    points = np.array([point for _, point, _ in lines])
    half = 0.25 * max(np.ptp(ax.get_xlim()), np.ptp(ax.get_ylim()))
    if alone:
        half = max(0.5, 1.5 * np.linalg.norm(points - center[1], axis=1).max())
        ax.set(xlabel=f"{view[0]} [m]", ylabel=f"{view[1]} [m]", aspect="equal")
        ax.set_title(title, fontsize=9)
    for i, (name, point, direction) in enumerate(lines):
        ends = np.array([point - half * direction, point + half * direction]) @ look.T
        seen = np.linalg.norm(ends[1] - ends[0]) > 0.1 * half  # else it points toward the viewer
        mark = (
            {"ls": DASHES[i]}
            if seen
            else {"ls": "none", "marker": "o", "ms": 10, "mfc": "none", "mew": 1.8}
        )
        ax.plot(
            *(ends if seen else ends[:1]).T, color=COLORS[i], lw=2.0, zorder=8, label=name, **mark
        )
    ax.plot(
        *(look @ center[1]), "+", ms=10, mew=1.8, color=INK, zorder=9, ls="none", label=center[0]
    )
    legend(ax, len(lines) + 1)
    return ax
