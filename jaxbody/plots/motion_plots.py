"""Plots of motions: displacements of the bodies, forces of the elements, and the load path to an equilibrium."""

from __future__ import annotations

from typing import Any

import numpy as np

from jaxbody.core.errors import JaxbodyError, Problem
from jaxbody.elements.torsions import Torsion
from jaxbody.plots.canvases import COLORS, GRAY, axes_below, axes_or_new, check_known, legend, style
from jaxbody.simulations.trajectories import Trajectory
from jaxbody.statics.equilibria import Equilibrium

AXES = "xyz"


def plot_trajectory(trajectory: Trajectory, *, bodies: tuple[str, ...] | None = None, ax: Any = None) -> Any:
    """Displacements of bodies and supports from the reference pose [m] over time, with their rotations [rad] below; supports are dashed.

    Lines without motion are left out. bodies: names of bodies and supports; None takes all.

    >>> model = Model(bodies={"mass": Body(mass=2.0, inertia=[1, 1, 1])}, joints={"mass": Guide("world", axis=[0, 1, 0])},
    ...               elements={"s": Spring(("mass", [0, 0, 0]), ("world", [0, 1, 0]), stiffness=50.0, free_length=0.9)})
    >>> ax = plot_trajectory(simulate(model, jnp.linspace(0, 1, 11)))
    >>> ax.get_ylabel()
    'displacement [m]'
    """
    layout, poses = trajectory.model.layout, trajectory.poses
    names = bodies or (*layout.bodies, *layout.supports)
    check_known(names, tuple(poses), "plot_trajectory.bodies")
    moves, turns = {}, {}
    for name in names:
        p, R = np.asarray(poses[name].p), np.asarray(poses[name].R)
        start = trajectory.model[name]
        moves |= {f"{name} {axis}": p[:, i] - np.asarray(start.position)[i] for i, axis in enumerate(AXES)}
        turns |= {f"{name} about {axis}": angle for axis, angle in zip(AXES, _turns(R, np.asarray(start.orientation)).T, strict=True)}
    moves, turns = _moving(moves), _moving(turns)
    panels = {"displacement [m]": moves} | ({"turn [rad]": turns} if turns else {})
    return _panels(axes_or_new(ax, 7.0, 4.2), trajectory, panels, 0.6, dashed=tuple(f"{name} " for name in layout.supports))


def plot_forces(trajectory: Trajectory, *, elements: tuple[str, ...] | None = None, ax: Any = None) -> Any:
    """Forces of the elements [N] over time, dampers included: the tension of each spring, the three forces of each bushing.

    The moments [N m] of torsion springs and bushings are below. elements: names; None takes all. Error: UNKNOWN_NAME.
    """
    forces = trajectory.forces
    names = elements or tuple(forces)
    check_known(names, tuple(forces), "plot_forces.elements")
    pulls, moments = {}, {}
    for name in names:
        force = np.asarray(forces[name])
        if force.ndim == 1:
            (moments if isinstance(trajectory.model[name], Torsion) else pulls)[name] = force
        else:
            pulls |= {f"{name} {axis}": force[:, i] for i, axis in enumerate(AXES)}
            moments |= {f"{name} about {axis}": force[:, i + 3] for i, axis in enumerate(AXES) if np.any(force[:, i + 3])}
    panels = {"force, tension positive [N]": pulls, "moment [N m]": moments}
    panels = {label: lines for label, lines in panels.items() if lines}
    return _panels(axes_or_new(ax, 7.0, 0.6 + 2.4 * len(panels)), trajectory, panels, 1.0)


def load_path(eq: Equilibrium, *, ax: Any = None) -> Any:
    """The smallest eigenvalue of K, relative to the largest without loads, over the load factor; it is zero at a limit point.

    eq: an equilibrium under loads. Error: NO_PATH if it has no load path.
    """
    if eq.path is None or np.all(eq.descended):
        how, hint = (
            ("without loads", "Give an equilibrium(model, loads=...).")
            if eq.path is None
            else ("by descent", "Its load path could not be started.")
        )
        raise JaxbodyError(Problem("NO_PATH", "load_path.eq", f"was computed {how}", eq.path, "a load path", hint))
    ax = axes_or_new(ax, 5.0, 3.4)
    factor, smallest = (np.asarray(x) for x in (eq.path.factor, eq.path.smallest))
    ax.plot(factor, smallest, "o-", ms=4, color=COLORS[0])
    ax.axhline(0, color=GRAY, lw=0.8)
    ax.set(xlabel="load factor", ylabel="smallest eigenvalue of K", title=eq.message(lambda eq: "") if int(eq.status) else "")
    return ax


def _panels(ax, trajectory: Trajectory, panels: dict[str, dict[str, np.ndarray]], share: float, dashed: tuple[str, ...] = ()) -> Any:
    """Lines over time in panels one below the other, by label; each after the first has this share of its height."""
    every = [ax, *axes_below(ax, *[share] * (len(panels) - 1))]
    for axes, (label, lines) in zip(every, panels.items(), strict=True):
        for i, (name, values) in enumerate(lines.items()):
            support = bool(dashed) and name.startswith(dashed)
            axes.plot(trajectory.times, values, label=name, **style(i) | ({"ls": "--", "lw": 1.0} if support else {"lw": 1.5}))
        axes.set_ylabel(label)
        legend(axes, len(lines))
    every[-1].set_xlabel("time [s]")
    return ax


def _moving(lines: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The lines whose variation exceeds a millionth of the largest variation."""
    widths = {name: np.ptp(values[np.isfinite(values)]) if np.isfinite(values).any() else 0.0 for name, values in lines.items()}
    return {name: values for name, values in lines.items() if widths[name] > 1e-6 * max(widths.values()) and widths[name] > 1e-12}


def _turns(R: np.ndarray, start: np.ndarray) -> np.ndarray:
    """Rotation vectors relative to an orientation (quaternion w, x, y, z), in world axes, unwrapped through full turns."""
    from scipy.spatial.transform import Rotation

    good = np.isfinite(R).all((1, 2))
    out = np.full((len(R), 3), np.nan)
    if good.any():
        out[good] = (Rotation.from_matrix(R[good]) * Rotation.from_quat(start[[1, 2, 3, 0]]).inv()).as_rotvec()
    for i in range(1, len(out)):
        angle = np.linalg.norm(out[i])
        if np.isfinite(angle) and angle > 0:
            out[i] *= 1 + 2 * np.pi * np.round((out[i - 1] @ out[i] / angle - angle) / (2 * np.pi)) / angle
    return out
