"""Pictures with matplotlib: each function takes data, draws into `ax` (or a new figure) and returns the axes; it shows and sets nothing.

Models are drawn along world axes: bodies as outlines through their attachment points, springs as zigzags, supports hatched.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import jax.numpy as jnp
import numpy as np

from jaxbody.canvases import COLORS, GRAY, INK, LIGHT, axes_below, axes_or_new, legend
from jaxbody.design_plots import plot_front as plot_front
from jaxbody.design_plots import plot_tolerances as plot_tolerances
from jaxbody.design_plots import plot_tornado as plot_tornado
from jaxbody.design_plots import plot_tuning as plot_tuning
from jaxbody.elements import LineElement
from jaxbody.errors import JaxbodyError, Problem
from jaxbody.fit_plots import plot_autocorrelation as plot_autocorrelation
from jaxbody.fit_plots import plot_correlations as plot_correlations
from jaxbody.fit_plots import plot_history as plot_history
from jaxbody.fit_plots import plot_profile as plot_profile
from jaxbody.frames import Pose
from jaxbody.joints import Guide
from jaxbody.kinematics import Coordinates
from jaxbody.linearizations import Linearization
from jaxbody.measured_plots import plot_fit as plot_fit
from jaxbody.mode_plots import plot_branches as plot_branches
from jaxbody.mode_plots import plot_mode_energies as plot_mode_energies
from jaxbody.models import WORLD, Model, State, unknown
from jaxbody.options import jit_as_it_is
from jaxbody.poles import ComplexModes
from jaxbody.response_plots import plot_frequency_response as plot_frequency_response
from jaxbody.response_plots import plot_psd as plot_psd
from jaxbody.response_plots import plot_transmissibility as plot_transmissibility
from jaxbody.simulations import Trajectory
from jaxbody.spins import SpinLinearization
from jaxbody.statics import Equilibrium
from jaxbody.vibrations import Modes

AXES = "xyz"
RIM = 8.0  # points: width of the rounded rim of an outline
SWING = 1 / 8  # largest displacement of a drawn mode, in sizes of the model


def plot_trajectory(trajectory: Trajectory, *, bodies: tuple[str, ...] | None = None, ax: Any = None) -> Any:
    """Displacements of bodies and supports from the reference pose [m] and, below, their turns [rad], over time; supports dashed.

    What stays still is left out. bodies: names of bodies and supports, all of them if none are given.

    >>> model = Model(bodies={"mass": Body(mass=2.0, inertia=[1, 1, 1])}, joints={"mass": Guide("world", axis=[0, 1, 0])},
    ...               elements={"s": Spring(("mass", [0, 0, 0]), ("world", [0, 1, 0]), stiffness=50.0, free_length=0.9)})
    >>> ax = plot_trajectory(simulate(model, jnp.linspace(0, 1, 11)))
    >>> ax.get_ylabel()
    'displacement [m]'
    """
    ax = axes_or_new(ax, 7.0, 4.2)
    layout, t = trajectory.model.layout, np.asarray(trajectory.times)
    poses = trajectory.poses
    names = bodies or (*layout.bodies, *layout.supports)
    _check_known(names, tuple(poses), "plot_trajectory.bodies")
    moves, turns = {}, {}
    for name in names:
        p, R = np.asarray(poses[name].p), np.asarray(poses[name].R)
        start = trajectory.model[name]
        moves |= {f"{name} {axis}": p[:, i] - float(start.position[i]) for i, axis in enumerate(AXES)}
        turns |= {f"{name} about {axis}": angle for axis, angle in zip(AXES, _turns(R, np.asarray(start.orientation)).T, strict=True)}
    dashed = tuple(f"{name} " for name in layout.supports)
    moves, turns = _moving(moves), _moving(turns)
    _lines(ax, t, moves, dashed)
    ax.set_ylabel("displacement [m]")
    below = ax
    if turns:
        ax.tick_params(labelbottom=False)
        below = axes_below(ax, 0.6)
        _lines(below, t, turns, dashed)
        below.set_ylabel("turn [rad]")
    below.set_xlabel("time [s]")
    return ax


def plot_forces(trajectory: Trajectory, *, elements: tuple[str, ...] | None = None, ax: Any = None) -> Any:
    """The tension of every spring [N] over time, its damper's part included; of a bushing its three forces."""
    ax = axes_or_new(ax, 7.0, 3.0)
    forces = trajectory.forces
    names = elements or tuple(forces)
    _check_known(names, tuple(forces), "plot_forces.elements")
    lines = {}
    for name in names:
        force = np.asarray(forces[name])
        lines |= {name: force} if force.ndim == 1 else {f"{name} {axis}": force[:, i] for i, axis in enumerate(AXES)}
    _lines(ax, np.asarray(trajectory.times), lines)
    ax.set(xlabel="time [s]", ylabel="force, tension positive [N]")
    return ax


def load_path(eq: Equilibrium, *, ax: Any = None) -> Any:
    """The smallest eigenvalue of K, relative to the largest without loads, over the load factor: at a limit point it goes to zero.

    eq: an equilibrium under loads. Error: NO_PATH where it has none.
    """
    if eq.path is None:
        hint = "Give an equilibrium(model, loads=...)."
        raise JaxbodyError(Problem("NO_PATH", "load_path.eq", "was found without loads", eq.path, "a load path", hint))
    ax = axes_or_new(ax, 5.0, 3.4)
    factor, smallest = (np.asarray(x) for x in (eq.path.factor, eq.path.smallest))
    ax.plot(factor, smallest, "o-", ms=4, color=COLORS[0])
    ax.axhline(0, color=GRAY, lw=0.8)
    ax.set(xlabel="load factor", ylabel="smallest eigenvalue of K", title=eq.report().split(";")[0] if int(eq.status) else "")
    return ax


def draw_model(
    model: Model,
    state: State | None = None,
    *,
    displaced: dict[str, Any] | None = None,
    view: str | None = None,
    names: bool = True,
    ax: Any = None,
) -> Any:
    """The model in a state (without one, the reference pose), supports displaced by {name: Xi}.

    view: two of x, y, z, right and up ("xy"), or "oblique"; if none is given, gravity points down, and the view is oblique unless the
    model is flat. Distances in meters.

    >>> model = Model(bodies={"mass": Body(mass=2.0, inertia=[1, 1, 1])}, gravity=[0, -9.81, 0],
    ...               elements={"s": Spring(("mass", [0, 0, 0]), ("world", [0, 1, 0]), stiffness=50.0, free_length=0.9)})
    >>> draw_model(model).get_ylabel()
    'y [m]'
    """
    ax = axes_or_new(ax, 6.0, 4.5)
    state = model.reference if state is None else state
    xi = np.zeros((len(model.layout.supports), 6))
    _check_known(tuple(displaced or ()), model.layout.supports, "draw_model.displaced")
    for name, value in (displaced or {}).items():
        xi[model.layout.supports.index(name)] = value
    scene = Scene(model, _poses_at(model, state.q, np.zeros(model.layout.nv), xi))
    look = projection(view, model, [scene])
    _draw(ax, scene, look, scene.size(look), names=names)
    _finish(ax, look, view, model)
    return ax


def draw_mode(
    lin: Linearization | SpinLinearization, modes: Modes | ComplexModes, number: int = 1, *, view: str | None = None, ax: Any = None
) -> Any:
    """Mode `number` (from 1, ascending) in both extremes over the state at rest; the amplitude is an eighth of the model's size.

    A complex mode is drawn where its largest component is extreme."""
    model, count = lin.model, modes.frequency.shape[0]
    if not 1 <= number <= count:
        raise JaxbodyError(
            Problem("UNKNOWN_MODE", "draw_mode.number", f"is {number}; there are modes 1 to {count}", number, f"1 to {count}")
        )
    ax = axes_or_new(ax, 5.0, 4.0)
    shape = np.real(np.asarray(modes.shapes)[:, number - 1])
    still = np.zeros((len(model.layout.supports), 6))
    q = lin.state.q
    rest = Scene(model, _poses_at(model, q, 0 * shape, still))
    size = rest.size(np.eye(3))
    trial = 1e-6 * size / np.abs(shape).max()
    moved = Scene(model, _poses_at(model, q, trial * shape, still))
    largest = max(np.abs(moved.points[name] - rest.points[name]).max() for name in model.layout.bodies) / trial
    largest = max(largest, np.abs(shape[model.layout.turns]).max(initial=0.0) * size * SWING)  # where nothing is attached off O
    extremes = [Scene(model, _poses_at(model, q, sign * size * SWING / largest * shape, still)) for sign in (-1, 1)]
    look = projection(view, model, [rest, *extremes])
    _draw(ax, rest, look, size, names=False, color=LIGHT, edge=GRAY, springs=GRAY, alpha=0.5)
    for scene, color in zip(extremes, COLORS, strict=False):
        _draw(ax, scene, look, size, names=False, color=color, edge=color, springs=color, alpha=0.3, ground=False)
    frequency, ratio = float(modes.frequency[number - 1]), float(modes.damping_ratio[number - 1])
    ax.set_title(f"mode {number}: {frequency:.4g} Hz" + (f", damping ratio {ratio:.2g}" if ratio > 0 else ""), fontsize=9)
    _finish(ax, look, view, model)
    return ax


@dataclass
class Scene:
    """A posed model: for each frame the world positions of what is attached to it."""

    model: Model
    frames: tuple[np.ndarray, np.ndarray]  # origins and orientations
    points: dict[str, np.ndarray] = field(init=False)
    pivots: dict[str, tuple[np.ndarray, str]] = field(init=False)  # of each jointed body where, and on what
    ends: dict[str, tuple[np.ndarray, np.ndarray]] = field(init=False)
    centers: dict[str, np.ndarray] = field(init=False)  # of mass

    def __post_init__(self):
        layout = self.model.layout
        pose = {name: (p, R) for name, p, R in zip(layout.frames, *self.frames, strict=True)}
        points: dict[str, list[np.ndarray]] = {name: [] for name in layout.frames}
        self.ends, self.pivots, self.centers = {}, {}, {}
        for table in self.model.elements:
            for name, link, a, b in zip(table.names, table.links, *(np.asarray(x) for x in table.rows.points[:2]), strict=True):
                A, B = (pose[end][0] + pose[end][1] @ point for end, point in zip(link[:2], (a, b), strict=True))
                self.ends[name] = (A, B)
                points[link[0]].append(A)
                points[link[1]].append(B)
        for name, kind, parent in zip(layout.bodies, layout.kinds, layout.parents, strict=True):
            p, R = pose[name]
            self.centers[name] = p + R @ np.asarray(self.model[name].com)
            points[name].append(self.centers[name])
            if kind.nv < 6:
                at = getattr(self.model.joint(name), "at", None)
                pivot = p if at is None else pose[parent][0] + pose[parent][1] @ np.asarray(at)
                self.pivots[name] = (pivot, parent)
                points[name].append(pivot)
                points[parent].append(pivot)
        self.points = {name: np.array(rows) if rows else pose[name][0][None] for name, rows in points.items()}

    def all_points(self) -> np.ndarray:
        return np.concatenate([rows for name, rows in self.points.items() if name != WORLD or len(self.ends) + len(self.pivots)])

    def size(self, look: np.ndarray) -> float:
        """The longer side of the box around everything, as seen."""
        return float(np.ptp(self.all_points() @ look.T, axis=0).max()) or 1.0


def projection(view: str | None, model: Model, scenes: list[Scene]) -> np.ndarray:
    """(2, 3): what is drawn to the right and up of a displacement along the world axes."""
    if view is not None and view != "oblique" and not (len(view) == 2 and view[0] != view[1] and set(view) <= set(AXES)):
        raise JaxbodyError(
            Problem("BAD_VIEW", "view", f"is {view!r}", view, "two of x, y, z", "Give two axes, right and up, as 'xy', or 'oblique'.")
        )
    if view is not None and view != "oblique":
        return np.eye(3)[[AXES.index(axis) for axis in view]]
    points = np.concatenate([scene.all_points() for scene in scenes])
    spread = np.ptp(points, axis=0)
    weight = np.abs(np.asarray(model.gravity))
    up = int(np.argmax(weight)) if weight.any() else int(np.argsort(spread)[1])
    rest = [i for i in range(3) if i != up]
    right = rest[0] if spread[rest[0]] >= 0.5 * spread[rest[1]] else rest[1]
    away = 3 - up - right
    look = np.eye(3)[[right, up]]
    if view == "oblique" or spread[away] > 1e-6 * spread.max():
        look[:, away] = (-0.45, -0.28) if (right, up) in ((0, 1), (1, 2), (2, 0)) else (0.45, 0.28)
    return look


def _draw(ax, scene: Scene, look, size, *, names, color=None, edge=INK, springs=INK, alpha=1.0, ground=True) -> None:
    layout = scene.model.layout
    for i, name in enumerate(layout.bodies):
        fill = color or COLORS[i % len(COLORS)]
        seen = scene.points[name] @ look.T
        _outline(ax, seen, size, fill, edge, alpha if color else 0.35, color is not None)
        if names:
            middle = scene.centers[name] @ look.T
            ax.plot(*middle, "o", ms=6, mfc="white", mec=INK, mew=1.0, zorder=6)
            ax.annotate(name, middle, xytext=(7, 6), textcoords="offset points", fontsize=9, color=INK, zorder=7)
    for table in scene.model.elements:
        zigzag = isinstance(table.rows, LineElement)
        for name, link in zip(table.names, table.links, strict=True):
            A, B = (end @ look.T for end in scene.ends[name])
            path = _zigzag(A, B, 0.022 * size) if zigzag else np.array([A, B])
            ax.plot(*path.T, color=springs, lw=1.1 if zigzag else 3.0, alpha=alpha, solid_joinstyle="round", zorder=4)
            ax.plot(*np.array([A, B]).T, "." if zigzag else "s", color=springs, ms=4, alpha=alpha, zorder=5)
            for end, here, there in zip(link[:2], (A, B), (B, A), strict=True):
                if ground and end not in layout.bodies:
                    _ground(ax, here, here - there, 0.035 * size)
            if names:
                side = np.array([-(B - A)[1], (B - A)[0]])
                side = side / (np.linalg.norm(side) or 1.0)
                ax.annotate(
                    name, (A + B) / 2, xytext=13 * side, textcoords="offset points", fontsize=8, color=GRAY, ha="center", va="center"
                )
    for name, (at, parent) in scene.pivots.items():
        pivot, joint = at @ look.T, scene.model.joint(name)
        if isinstance(joint, Guide):
            axis = scene.frames[1][layout.frame(parent)] @ np.asarray(joint.axis)
            along = axis @ look.T * 0.12 * size
            ax.plot(*np.array([pivot - along, pivot + along]).T, "-.", color=GRAY, lw=0.9, zorder=1)
        else:
            ax.plot(*pivot, "o", ms=6, mfc="white", mec=edge, mew=1.2, alpha=alpha, zorder=6)
            if ground and parent not in layout.bodies:
                _ground(ax, pivot - np.array([0, 0.02 * size]), np.array([0.0, -1.0]), 0.035 * size)


def _outline(ax, seen, size, fill, edge, alpha, ghost) -> None:
    """The convex hull of the points with a rounded rim; a disk for a single point."""
    from matplotlib.colors import to_rgba
    from matplotlib.patches import Circle, Polygon

    hull = _hull(seen, 1e-9 * size)
    if len(hull) == 1:
        ax.add_patch(Circle(hull[0], 0.035 * size, facecolor=to_rgba(fill, alpha), edgecolor=edge, lw=1.2, zorder=2))
    elif ghost:
        ax.add_patch(Polygon(hull, closed=True, facecolor=to_rgba(fill, alpha), edgecolor=edge, lw=1.6, joinstyle="round", zorder=3))
    else:
        pale = tuple(1 - 0.35 * (1 - c) for c in to_rgba(fill)[:3])
        for color, width in ((edge, RIM), (pale, RIM - 2.2)):
            rim = {"lw": width, "zorder": 2, "snap": False}
            if len(hull) == 2:
                ax.plot(*hull.T, color=color, solid_capstyle="round", **rim)
            else:
                ax.add_patch(Polygon(hull, closed=True, facecolor=color, edgecolor=color, joinstyle="round", **rim))


def _hull(points: np.ndarray, tolerance: float) -> np.ndarray:
    """Convex hull in the plane, counterclockwise (A. M. Andrew, Information Processing Letters 9 (1979) 216)."""
    points = points[np.lexsort(points.T[::-1])]
    points = points[np.concatenate([[True], np.linalg.norm(np.diff(points, axis=0), axis=1) > tolerance])]
    if len(points) < 3:
        return points

    def half(points):
        chain: list[np.ndarray] = []
        for p in points:
            while len(chain) > 1 and _area(chain[-2], chain[-1], p) <= 0:
                chain.pop()
            chain.append(p)
        return chain[:-1]

    return np.array(half(points) + half(points[::-1]))


def _area(a, b, c) -> float:
    return float((b - a)[0] * (c - a)[1] - (b - a)[1] * (c - a)[0])


def _zigzag(A, B, width: float, coils: int = 7) -> np.ndarray:
    """A spring from A to B: straight ends of an eighth of the length, teeth between."""
    along = B - A
    length = np.linalg.norm(along)
    if length == 0:
        return np.array([A, B])
    side = np.array([-along[1], along[0]]) / length * min(width, length / 4)
    s = np.concatenate([[0, 0.12], 0.12 + 0.76 * (np.arange(2 * coils) + 0.5) / (2 * coils), [0.88, 1]])
    teeth = np.concatenate([[0, 0], np.where(np.arange(2 * coils) % 2, -1, 1), [0, 0]])
    return A + s[:, None] * along + teeth[:, None] * side


def _ground(ax, at, outward, half: float) -> None:
    """A bar across the direction `outward`, hatched on its far side."""
    length = np.linalg.norm(outward)
    n = outward / length if length else np.array([0.0, -1.0])
    t = np.array([-n[1], n[0]])
    ax.plot(*np.array([at - half * t, at + half * t]).T, color=INK, lw=1.6, solid_capstyle="butt", zorder=4)
    for x in np.linspace(-0.8, 1.0, 6):
        start = at + half * x * t
        ax.plot(*np.array([start, start + half * (0.5 * n - 0.4 * t)]).T, color=INK, lw=0.7, zorder=3)


def _finish(ax, look, view, model: Model) -> None:
    ax.set_aspect("equal", adjustable="datalim")
    ax.margins(0.08)
    right, up = (int(np.argmax(np.abs(row))) for row in look)
    ax.set(xlabel=f"{AXES[right]} [m]", ylabel=f"{AXES[up]} [m]")


@jit_as_it_is
def _poses(model: Model, q, delta, xi) -> Pose:
    coordinates = Coordinates(model)
    zero = jnp.zeros_like(delta)
    return coordinates.frames(coordinates.retract(q, delta), zero, coordinates.supports_at(xi, jnp.zeros_like(xi))).pose()


def _poses_at(model: Model, q, delta, xi) -> tuple[np.ndarray, np.ndarray]:
    dtype = model.gravity.dtype
    frames = _poses(model, jnp.asarray(q), jnp.asarray(delta, dtype), jnp.asarray(xi, dtype))
    return np.asarray(frames.p), np.asarray(frames.R)


def _lines(ax, t, lines: dict[str, np.ndarray], dashed: tuple[str, ...] = ()) -> None:
    for i, (name, values) in enumerate(lines.items()):
        support = bool(dashed) and name.startswith(dashed)
        ax.plot(t, values, "--" if support else "-", lw=1.2 if support else 1.5, color=COLORS[i % len(COLORS)], label=name)
    legend(ax, len(lines))


def _moving(lines: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Without what stays still, to a millionth of what moves most."""
    widths = {name: np.ptp(values[np.isfinite(values)]) if np.isfinite(values).any() else 0.0 for name, values in lines.items()}
    return {name: values for name, values in lines.items() if widths[name] > 1e-6 * max(widths.values()) and widths[name] > 1e-12}


def _turns(R: np.ndarray, start: np.ndarray) -> np.ndarray:
    """Rotation vectors from an orientation (quaternion w, x, y, z), world axes, continued through whole turns."""
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


def _check_known(names: tuple[str, ...], known: tuple[str, ...], where: str) -> None:
    problems = [unknown(name, where, known) for name in names if name not in known]
    if problems:
        raise JaxbodyError(*problems)
