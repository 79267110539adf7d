"""Plots of statics: models at rest, equilibria by energy, load paths, load cases, and what a
preload changes."""

from collections.abc import Sequence
from textwrap import fill
from typing import Any

import numpy as np

from jaxbody.core.errors import JaxbodyError, Problem, check_all_known
from jaxbody.mechanics.equilibria import Equilibrium
from jaxbody.mechanics.preloads import Preload
from jaxbody.mechanics.several_equilibria import Equilibria
from jaxbody.mechanics.static_load_cases import LoadCases
from jaxbody.suspension.alignment_curves import SuspensionCurves
from jaxbody.suspension.assemblies import Assembly
from jaxbody.views.plots.canvases import (
    axes_below,
    axes_or_new,
    legend,
    of_one,
    panels_of_lines,
    panels_of_marks,
)
from jaxbody.views.plots.model_plots import draw_model
from jaxbody.views.plots.motion_plots import components, forces_and_moments, stroke_and_force
from jaxbody.views.scenes.colors import COLORS, GRAY

WIDTH = 60  # letters in a line of a title
# relative to the largest number of a panel: components below this in all cases are left out
NEGLIGIBLE = 1e-9


@of_one("energy", 0)
def draw_equilibrium(
    eq: Equilibrium, *, view: str | None = None, names: bool = True, ax: Any = None
) -> Any:
    """Draw the model at its equilibrium; the title states what is wrong with it, if anything.

    Args:
        eq: the equilibrium.
        view: as in `draw_model`.
        names: whether to write the names of bodies and elements.
        ax: axes to draw into; None makes a new figure.

    >>> ax = jb.plots.draw_equilibrium(jb.equilibrium(jb.presets.quarter_car()))
    >>> ax.get_xlabel(), ax.get_ylabel()
    ('x [m]', 'z [m]')
    """
    ax = draw_model(eq.model, eq.state, view=view, names=names, ax=ax)
    if int(eq.status):
        ax.set_title(eq.message(lambda eq: "").partition(":")[0], fontsize=9)
    return ax


@of_one("status", 0)
def draw_assembly(
    assembly: Assembly, *, view: str | None = None, names: bool = True, ax: Any = None
) -> Any:
    """Draw the assembled model; the title names a closure that stays open.

    Args:
        assembly: the result of `assemble`.
        view: as in `draw_model`.
        names: whether to write the names of bodies and elements.
        ax: axes to draw into; None makes a new figure.
    """
    ax = draw_model(assembly.model, assembly.state, view=view, names=names, ax=ax)
    if int(assembly.status):
        ax.set_title(fill(assembly.report(), WIDTH), fontsize=9)
    return ax


def plot_load_path(eq: Equilibrium, *, ax: Any = None) -> Any:
    """Draw the smallest eigenvalue of the stiffness matrix K, relative to the largest without
    loads, over the load factor; it is zero at a limit point.

    eq: an equilibrium under loads. Error: NO_PATH if it has no load path.

    >>> ax = jb.plots.plot_load_path(
    ...     jb.equilibrium(
    ...         jb.presets.quarter_car(), loads={"driver": jb.Force("body", force=[0, 0, -800.0])}
    ...     )
    ... )
    >>> ax.get_xlabel(), ax.lines[0].get_xdata()[0].item()
    ('load factor [-]', 0.0)
    """
    if eq.path is None or np.all(eq.descended):
        how, hint = (
            ("without loads", "Give an equilibrium(model, loads=...).")
            if eq.path is None
            else ("by descent", "Its load path could not be started.")
        )
        raise JaxbodyError(
            Problem(
                "NO_PATH", "plot_load_path.eq", f"was computed {how}", eq.path, "a load path", hint
            )
        )
    ax = axes_or_new(ax, 5.0, 3.4)
    factor, smallest = (np.asarray(x) for x in (eq.path.factor, eq.path.smallest))
    ax.plot(factor, smallest, "o-", ms=4, color=COLORS[0])
    ax.axhline(0, color=GRAY, lw=0.8)
    ax.set(xlabel="load factor [-]", ylabel="smallest eigenvalue of K [-]")
    if int(eq.status):
        ax.set_title(fill(eq.message(lambda eq: ""), WIDTH), fontsize=9)
    return ax


def plot_equilibria(equilibria: Equilibria, *, ax: Any = None) -> Any:
    """Draw the energies of equilibria [J] over their distances from the reference pose [m],
    numbered as in the printed table: filled circles are stable, open ones unstable.

    >>> bob = jb.Body(mass=1.0, inertia=[1e-3, 1e-3, 1e-3], com=[0, 0, -0.5])
    >>> pendulum = jb.Model(
    ...     bodies={"bob": bob},
    ...     joints={"bob": jb.Hinge("world", axis=[0, 1, 0])},
    ...     gravity=[0, 0, -9.81],
    ... )
    >>> [
    ...     line.get_label()
    ...     for line in jb.plots.plot_equilibria(jb.find_equilibria(pendulum, starts=8)).lines
    ... ]
    ['stable', 'unstable']
    """
    ax = axes_or_new(ax, 5.0, 3.4)
    energies, distances, stable = (
        equilibria.energies,
        np.asarray(equilibria.distances),
        equilibria.stable,
    )
    for kind, label, color, face in (
        (stable, "stable", COLORS[0], COLORS[0]),
        (~stable, "unstable", COLORS[1], "white"),
    ):
        if kind.any():
            ax.plot(
                distances[kind],
                energies[kind],
                "o",
                ms=6,
                color=color,
                mfc=face,
                mew=1.4,
                label=label,
            )
    for place in sorted(
        {(round(d, 9), round(e, 9)) for d, e in zip(distances, energies, strict=True)}
    ):
        same = [
            str(i)
            for i, at in enumerate(zip(distances, energies, strict=True))
            if (round(at[0], 9), round(at[1], 9)) == place
        ]
        ax.annotate(", ".join(same), place, xytext=(7, 5), textcoords="offset points", fontsize=8)
    ax.margins(0.12)
    ax.set(xlabel="largest displacement of a body [m]", ylabel="energy [J]")
    legend(ax, 2)
    return ax


@of_one("displacement_rows", 3)
def plot_load_cases(cases: LoadCases, *, of: str = "elements", ax: Any = None) -> Any:
    """Draw strokes and forces of the elements in every load case, and below them rotations and
    moments of elements that have these; one mark per case.

    Args:
        cases: the load cases.
        of: "elements", or "bodies" for displacements [m] and rotations [rad] of the bodies.
        ax: axes to draw into; None makes a new figure.

    Components that are zero in all cases are left out. Error: UNKNOWN_NAME.

    >>> car = jb.presets.half_car(height=0.5)
    >>> ax = jb.load_cases(
    ...     car,
    ...     {
    ...         "brake": jb.LoadCase(acceleration=[-0.2, 0, 0]),
    ...         "bump": jb.LoadCase(acceleration=[0, 0, 0.2]),
    ...     },
    ... ).plot()
    >>> ax.get_ylabel(), [text.get_text() for text in ax.get_legend().get_texts()]
    ('stroke [m]', ['brake', 'bump'])
    """
    if of not in ("elements", "bodies"):
        raise JaxbodyError(
            Problem(
                "UNKNOWN_NAME",
                "plot_load_cases.of",
                f"is {of!r}",
                of,
                "elements, bodies",
                "Give one of these.",
            )
        )
    if of == "bodies":
        panels = {
            "displacement [m]": components(cases.displacements),
            "rotation [rad]": components(cases.rotations),
        }
    else:
        (strokes, turns), (forces, moments) = (
            forces_and_moments(cases.unloaded.model, x, "") for x in (cases.strokes, cases.forces)
        )
        label = stroke_and_force(cases.unloaded.model, cases.forces)[1]
        panels = {
            "stroke [m]": strokes,
            label: forces,
            "turn [rad]": turns,
            "moment [N m]": moments,
        }
    panels = {
        label: rows
        for label, rows in panels.items()
        if any(np.any(np.abs(x) > 0) for x in rows.values())
    }
    largest = {
        label: max(np.nanmax(np.abs(x)) for x in rows.values()) for label, rows in panels.items()
    }
    every = dict.fromkeys(name for rows in panels.values() for name in rows)
    names = tuple(
        name
        for name in every
        if any(
            name in rows and np.nanmax(np.abs(rows[name])) > NEGLIGIBLE * largest[label]
            for label, rows in panels.items()
        )
    )
    missing = np.full(len(cases.names), np.nan)
    tables = {
        label: {
            case: [rows.get(name, missing)[i] for name in names]
            for i, case in enumerate(cases.names)
        }
        for label, rows in panels.items()
    }
    ax = axes_or_new(ax, max(5.0, 2.0 + 0.42 * len(names)), 1.2 + 1.7 * len(panels))
    return panels_of_marks(ax, tables, names)


@of_one("status", 1)
def plot_suspension_curves(
    curves: SuspensionCurves,
    *,
    of: Sequence[str] = ("camber", "toe", "roll center height", "wheel rate"),
    ax: Any = None,
) -> Any:
    """Draw curves of a suspension over its travel, with a panel for each unit.

    Args:
        curves: the curves.
        of: names of the curves that are drawn.
        ax: axes to draw into; None makes a new figure.

    Error: UNKNOWN_NAME.

    >>> curves = jb.suspension.double_wishbone().curves(np.linspace(-0.1, 0.1, 11))
    >>> ax = curves.plot(of=["camber", "toe"])  # doctest: +SKIP
    """
    check_all_known(of, "plot_suspension_curves.of", curves.curves)
    panels: dict[str, dict[str, Any]] = {}
    for name in of:
        unit, what = {
            "rad": ("deg", "angle"),
            "m": ("mm", "place or length"),
            "N/m": ("N/mm", "rate"),
            "N": ("N", "force"),
        }.get(curves.unit(name), ("-", "ratio"))
        panels.setdefault(f"{what} [{unit}]", {})[name] = _shown_in(unit, curves[name])
    travel = curves.drives[0]
    unit = "deg" if travel.unit == "rad" else "mm"
    ax = axes_or_new(ax, 5.0, 0.8 + 1.7 * len(panels))
    return panels_of_lines(
        ax, _shown_in(unit, curves.over[travel.name]), panels, f"{travel.name} [{unit}]"
    )


def _shown_in(unit: str, values: Any) -> np.ndarray:
    return np.asarray(values) * {"deg": 180 / np.pi, "mm": 1e3, "N/mm": 1e-3}.get(unit, 1.0)


@of_one("values", 1)
def plot_preload(preload: Preload, *, ax: Any = None) -> Any:
    """Draw the changes of the free lengths [m] that make a pose an equilibrium, and of the
    coordinates that may move; angles [rad] are below.

    >>> quarter = jb.presets.quarter_car()
    >>> softer = jb.replace(quarter, {"suspension.stiffness": 3e4})
    >>> jb.preload(softer).plot().get_xlabel()
    'change [m]'
    """
    layout = preload.model.layout
    angles = {path for path in preload.paths if path.endswith("free_angle")}
    angles |= {name for name, turn in zip(layout.coordinates, layout.turns, strict=True) if turn}
    changes = {name: float(x) for name, x in (preload.changes | preload.moved).items()}
    parts = {
        f"change [{unit}]": {
            name: x for name, x in changes.items() if (name in angles) == (unit == "rad")
        }
        for unit in ("m", "rad")
    }
    parts = {label: bars for label, bars in parts.items() if bars}
    ax = axes_or_new(ax, 6.0, 0.4 + sum(0.7 + 0.28 * len(bars) for bars in parts.values()))
    heights = [len(bars) / len(next(iter(parts.values()))) for bars in parts.values()][1:]
    for axes, (label, bars) in zip(
        [ax, *axes_below(ax, *heights, share=False)], parts.items(), strict=True
    ):
        axes.barh(range(len(bars)), list(bars.values()), color=COLORS[0], height=0.6)
        axes.axvline(0.0, color=GRAY, lw=0.8)
        axes.set_yticks(range(len(bars)), list(bars), fontsize=8)
        axes.invert_yaxis()
        axes.set_xlabel(label)
    return ax
