"""Plots of motions: displacements, forces and energies over time, phase portraits, forces
over strokes."""

from collections.abc import Iterable
from typing import Any

import numpy as np

from jaxbody.core.arrays import time_text
from jaxbody.core.errors import JaxbodyError, Problem, check_all_known
from jaxbody.model.elements.torsions import Torsion
from jaxbody.model.models import Model
from jaxbody.motion.trajectories import Trajectory
from jaxbody.views.plots.canvases import (
    axes_below,
    axes_or_new,
    legend,
    of_one,
    panels_of_lines,
    style,
)
from jaxbody.views.scenes.colors import INK
from jaxbody.views.scenes.poses import coordinate_changes, turns


@of_one("times", 1)
def plot_trajectory(
    trajectory: Trajectory, *, bodies: tuple[str, ...] | None = None, ax: Any = None
) -> Any:
    """Draw displacements of bodies and supports from the reference pose [m] over time, with their
    rotations [rad] below; supports are dashed.

    Coordinates that do not move are left out. bodies: names of bodies and supports; None takes all.

    >>> model = jb.Model(
    ...     bodies={"mass": jb.Body(mass=2.0, inertia=[1, 1, 1])},
    ...     joints={"mass": jb.Guide("world", axis=[0, 1, 0])},
    ...     elements={
    ...         "s": jb.Spring(
    ...             ("mass", [0, 0, 0]), ("world", [0, 1, 0]), stiffness=50.0, free_length=0.9
    ...         )
    ...     },
    ... )
    >>> ax = jb.plots.plot_trajectory(jb.simulate(model, jnp.linspace(0, 1, 11)))
    >>> ax.get_ylabel()
    'displacement [m]'
    """
    layout, poses = trajectory.model.layout, trajectory.poses
    names = bodies or (*layout.bodies, *layout.supports)
    check_all_known(names, "plot_trajectory.bodies", poses)
    moves, rotations = {}, {}
    for name in names:
        p, R = np.asarray(poses[name].p), np.asarray(poses[name].R)
        start = trajectory.model[name]
        moves |= components({name: p - np.asarray(start.position)})
        rotations |= components({name: turns(R, np.asarray(start.orientation))}, " about")
    panels = {"displacement [m]": _moving(moves), "turn [rad]": _moving(rotations)}
    panels = {label: lines for label, lines in panels.items() if lines} or {"displacement [m]": {}}
    dashed = tuple(f"{name} " for name in layout.supports)
    return panels_of_lines(
        axes_or_new(ax, 7.0, 4.2), trajectory.times, panels, "time [s]", share=0.6, dashed=dashed
    )


@of_one("times", 1)
def plot_forces(
    trajectory: Trajectory, *, elements: tuple[str, ...] | None = None, ax: Any = None
) -> Any:
    """Draw the dynamic parts of the forces of the elements [N] over time, dampers included: the
    tension of each spring, and the three forces of each bushing that oppose its deformation along
    its axes, all about the mean over the samples, which is in the legend.

    The moments [N m] of torsion springs and bushings are below. elements: names; None takes all.
    Error: UNKNOWN_NAME.

    >>> oscillator = jb.Model(
    ...     bodies={"mass": jb.Body(mass=2.0, inertia=[1, 1, 1])},
    ...     joints={"mass": jb.Guide("world", axis=[0, 1, 0])},
    ...     elements={
    ...         "s": jb.Spring(
    ...             ("mass", [0, 0, 0]), ("world", [0, 1, 0]), stiffness=50.0, free_length=0.9
    ...         )
    ...     },
    ... )
    >>> ax = jb.plots.plot_forces(jb.simulate(oscillator, jnp.linspace(0, 1, 11)))
    >>> ax.get_ylabel(), [line.get_label() for line in ax.lines]
    ('dynamic force, tension positive [N]', ['s'])
    """
    forces = trajectory.forces
    names = elements or tuple(forces)
    check_all_known(names, "plot_forces.elements", forces)
    pulls, moments = forces_and_moments(trajectory.model, {name: forces[name] for name in names})
    moments = {name: moment for name, moment in moments.items() if np.any(moment)}
    panels = {stroke_and_force(trajectory.model, names)[1]: pulls, "moment [N m]": moments}
    panels = {label: lines for label, lines in panels.items() if lines}
    means = {
        label: {name: np.nanmean(values) for name, values in lines.items()}
        for label, lines in panels.items()
    }
    dynamic = {
        f"dynamic {label}": {name: values - means[label][name] for name, values in lines.items()}
        for label, lines in panels.items()
    }
    ax = axes_or_new(ax, 7.0, 0.6 + 2.4 * len(panels))
    known = len(ax.figure.axes)
    panels_of_lines(ax, trajectory.times, dynamic, "time [s]")
    for axes, (label, values) in zip([ax, *ax.figure.axes[known:]], means.items(), strict=False):
        unit = label.partition("[")[2].rstrip("]")
        for text, (name, mean) in zip(axes.get_legend().get_texts(), values.items(), strict=True):
            text.set_text(f"{name}, mean {mean:.4g} {unit}")
    return ax


@of_one("times", 1)
def plot_energies(trajectory: Trajectory, *, ax: Any = None) -> Any:
    """Draw energies over time [J] with their balance:

        kinetic + potential + dissipated - work of the supports - work of the loads = constant

    The potential energy is relative to its value at the first sample. Dissipated energy and work
    are integrals of `powers`, by a cubic spline through the samples: the sum is not constant if the
    samples do not resolve the motion or the integration is not accurate.

    >>> car = jb.presets.quarter_car(damping=1500.0)
    >>> motion = {"road": jb.Harmonic(frequency=1.0, translation=[0, 0, 0.01])}
    >>> ax = jb.plots.plot_energies(jb.simulate(car, jnp.linspace(0, 1, 101), motion=motion))
    >>> print(*(line.get_label() for line in ax.lines), sep=", ")
    kinetic, potential, dissipated, work of the supports, kinetic + potential + dissipated - work
    """
    lines = energy_balance(trajectory)
    ax = panels_of_lines(
        axes_or_new(ax, 7.5, 3.4), trajectory.times, {"energy [J]": lines}, "time [s]"
    )
    ax.lines[-1].set(color=INK, ls="-", lw=2.2)  # the sum
    legend(ax, len(lines))
    return ax


def energy_balance(trajectory: Trajectory) -> dict[str, np.ndarray]:
    """Return the lines of `plot_energies` [J] by name, without works that are zero."""
    energies, powers = (
        {name: np.asarray(x) for name, x in values.items()}
        for values in (trajectory.energies, trajectory.powers)
    )
    lines = {
        "kinetic": energies["kinetic"],
        "potential": energies["potential"] - energies["potential"][0],
    }
    times = np.asarray(trajectory.times)
    names = {
        "damping": ("dissipated", 1.0),
        "supports": ("work of the supports", -1.0),
        "loads": ("work of the loads", -1.0),
    }
    total, parts = lines["kinetic"] + lines["potential"], ["kinetic", "potential"]
    for power, (name, sign) in names.items():
        if np.any(np.nan_to_num(powers[power])):
            lines[name] = _integral(times, powers[power])
            total = total + sign * lines[name]
            parts += [name] if sign > 0 else []
    work = " - work" if any(name.startswith("work") for name in lines) else ""
    return lines | {" + ".join(parts) + work: total}


def _integral(times: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return the integral from the first sample at each time, NaN where the values are NaN."""
    from scipy.interpolate import CubicSpline

    known = np.isfinite(values)
    out = np.full(len(times), np.nan)
    if known.sum() > 1:
        out[known] = CubicSpline(times[known], values[known]).antiderivative()(times[known])
    return out


@of_one("times", 1)
def plot_phases(
    trajectory: Trajectory, *, coordinates: tuple[str, ...] | None = None, ax: Any = None
) -> Any:
    """Draw phase portraits: the rate of each coordinate over its value, from the reference pose; a
    circle marks the start.

    Coordinates in m and in rad have a panel each. Rotations of free bodies and of ball joints are
    rotation vectors, their rates angular velocities.

    Args:
        trajectory: the motion.
        coordinates: names, as in `model.layout.coordinates`; None takes all that move.
        ax: axes to draw into; None makes a new figure.

    Error: UNKNOWN_NAME.

    >>> bob = jb.Body(mass=1.0, inertia=[1e-3, 1e-3, 1e-3], com=[0, 0, -0.5])
    >>> model = jb.Model(
    ...     bodies={"bob": bob},
    ...     joints={"bob": jb.Hinge("world", axis=[0, 1, 0])},
    ...     gravity=[0, 0, -9.81],
    ... )
    >>> ax = jb.plots.plot_phases(
    ...     jb.simulate(model, jnp.linspace(0, 1, 51), initial=jb.State(jnp.ones(1), jnp.zeros(1)))
    ... )
    >>> ax.get_xlabel(), ax.get_ylabel(), [line.get_label() for line in ax.lines]
    ('turn [rad]', 'rate of turn [rad/s]', ['bob turn about its hinge', 'start'])
    """
    model, rates = trajectory.model, np.asarray(trajectory.state.v)
    layout = model.layout
    values = coordinate_changes(layout, trajectory.state.q, model.reference.q)
    check_all_known(coordinates or (), "plot_phases.coordinates", layout.coordinates)
    panels = {}
    for (xlabel, ylabel), turn in (
        (("displacement [m]", "velocity [m/s]"), False),
        (("turn [rad]", "rate of turn [rad/s]"), True),
    ):
        own = {
            name: values[:, i]
            for i, name in enumerate(layout.coordinates)
            if layout.turns[i] == turn
        }
        shown = (
            {name: x for name, x in own.items() if name in coordinates}
            if coordinates
            else _moving(own)
        )
        if shown:
            panels[xlabel, ylabel] = {
                name: (x, rates[:, layout.coordinates.index(name)]) for name, x in shown.items()
            }
    return _curves(ax, panels, start=True)


@of_one("times", 1)
def plot_force_strokes(
    trajectory: Trajectory,
    *,
    elements: tuple[str, ...] | None = None,
    start: float | None = None,
    ax: Any = None,
) -> Any:
    """Draw the force of each element over its elongation; a loop encloses the energy that is
    dissipated in a cycle.

    Moments over angles [N m over rad] have a panel of their own. Bushings have a curve for each
    component that moves.

    Args:
        trajectory: the motion.
        elements: names; None takes all.
        start: first time that is drawn [s], such as the end of the transient; None takes all
            samples.
        ax: axes to draw into; None makes a new figure.

    Errors: UNKNOWN_NAME; NO_DATA if fewer than two samples are after `start`.

    >>> motion = {"road": jb.Harmonic(frequency=1.0, translation=[0, 0, 0.01])}
    >>> ax = jb.plots.plot_force_strokes(
    ...     jb.simulate(
    ...         jb.presets.quarter_car(damping=1500.0), jnp.linspace(0, 1, 101), motion=motion
    ...     )
    ... )
    >>> ax.get_xlabel(), [line.get_label() for line in ax.lines]
    ('elongation [m]', ['suspension', 'tyre'])
    """
    model, times = trajectory.model, np.asarray(trajectory.times)
    check_all_known(elements or (), "plot_force_strokes.elements", model.element_names)
    shown = times >= (times[0] if start is None else start)
    if shown.sum() < 2:
        raise JaxbodyError(
            Problem(
                "NO_DATA",
                "plot_force_strokes.start",
                f"leaves {shown.sum()} samples",
                start,
                f"{time_text(times[0], times)} to {time_text(times[-1], times)} s",
                "Give an earlier time.",
            )
        )
    names = elements or model.element_names
    rows = [
        forces_and_moments(
            model, {name: np.asarray(x)[shown] for name, x in all_of.items() if name in names}
        )
        for all_of in (trajectory.elongations, trajectory.forces)
    ]
    labels = (stroke_and_force(model, names), ("turn [rad]", "moment [N m]"))
    panels = {
        label: {name: (e[name], f[name]) for name in _moving(e)}
        for label, e, f in zip(labels, *rows, strict=True)
    }
    return _curves(ax, {label: curves for label, curves in panels.items() if curves})


def _curves(
    ax: Any,
    panels: dict[tuple[str, str], dict[str, tuple[np.ndarray, np.ndarray]]],
    *,
    start: bool = False,
) -> Any:
    """Draw curves of y over x in panels with separate abscissas and return the top axes.

    Args:
        ax: axes to draw into; None makes a new figure.
        panels: {(x label, y label): {name: (x, y)}}, from the top.
        start: whether a circle marks the first point of each curve.
    """
    ax = axes_or_new(ax, 6.4, 0.8 + 3.0 * max(len(panels), 1))
    for axes, ((xlabel, ylabel), curves) in zip(
        [ax, *axes_below(ax, *[1.0] * (len(panels) - 1), share=False)], panels.items(), strict=False
    ):
        for i, (name, (x, y)) in enumerate(curves.items()):
            axes.plot(x, y, label=name, lw=1.4, **style(i))
        for i, (x, y) in enumerate(curves.values() if start else ()):
            axes.plot(
                x[:1],
                y[:1],
                "o",
                ms=5,
                mfc="white",
                mec=style(i)["color"],
                zorder=3,
                label="start" if i == 0 else None,
            )
        axes.set(xlabel=xlabel, ylabel=ylabel)
        legend(axes, len(curves) + start)
    return ax


def stroke_and_force(model: Model, names: Iterable[str]) -> tuple[str, str]:
    """Return the labels of deformations and forces: elongation and tension, or deformation and
    force if some of the elements, such as bushings, deform along several axes."""
    if all(model[name].size == 1 for name in names):
        return "elongation [m]", "force, tension positive [N]"
    return "deformation [m]", "force opposing\nthe deformation [N]"


def forces_and_moments(
    model: Model, values: dict[str, Any], about: str = " about"
) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Return time histories of components by name: first the forces or displacements [N or m], then
    the moments or rotations [N m or rad].

    Args:
        model: the model of the elements.
        values: {element: histories of its forces or deformations}.
        about: word between element and axis in the names of moments and rotations.
    """
    straight: dict[str, np.ndarray] = {}
    turning: dict[str, np.ndarray] = {}
    for name, x in ((name, np.asarray(x)) for name, x in values.items()):
        if x.ndim == 2:
            straight |= components({name: x[:, :3]})
            turning |= components({name: x[:, 3:]}, about)
        else:
            (turning if isinstance(model[name], Torsion) else straight)[name] = x
    return straight, turning


def components(values: dict[str, Any], about: str = "") -> dict[str, np.ndarray]:
    """Return the columns of vectors by name: "plate x", or "plate about x"."""
    return {
        f"{name}{about} {axis}": np.asarray(x)[:, i]
        for name, x in values.items()
        for i, axis in enumerate("xyz")
    }


def _moving(lines: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Return the lines whose variation exceeds a millionth of the largest variation."""
    widths = {
        name: np.ptp(values[np.isfinite(values)]) if np.isfinite(values).any() else 0.0
        for name, values in lines.items()
    }
    return {
        name: values
        for name, values in lines.items()
        if widths[name] > 1e-6 * max(widths.values()) and widths[name] > 1e-12
    }
