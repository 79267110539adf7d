"""Plots of models and their modes: bodies as outlines around their attachment points, springs as
zigzags, supports hatched."""

from typing import Any

import numpy as np

from jaxbody.core.errors import JaxbodyError, Problem, check_all_known
from jaxbody.core.tables import without_dust
from jaxbody.geometry.closures import Guide as GuideClosure
from jaxbody.geometry.closures import Inline
from jaxbody.model.elements.contacts import Tyre
from jaxbody.model.elements.elements import LineElement
from jaxbody.model.elements.springs import Inerter
from jaxbody.model.joints.joints import Guide
from jaxbody.model.layouts import WORLD
from jaxbody.model.models import Model
from jaxbody.model.preconditions import check_state
from jaxbody.model.states import State
from jaxbody.vibration.damped_modes import ComplexModes
from jaxbody.vibration.linearizations import Linearization
from jaxbody.vibration.natural_modes import Modes
from jaxbody.vibration.spins import SpinLinearization
from jaxbody.views.plots.canvases import (
    COLORS,
    GRAY,
    INK,
    LIGHT,
    Label,
    annotate,
    axes_or_new,
)
from jaxbody.views.plots.poses import (
    SWING,
    PoseSequence,
    check_number,
    displaced_poses,
    named_rows,
    placed_closures,
    poses_of,
)
from jaxbody.views.plots.symbols import AXES, frame_axes, ground_at, zigzag_path

RIM = 8.0  # points, width of the rounded rim of an outline


def draw_model(
    model: Model,
    state: State | None = None,
    *,
    displaced: dict[str, Any] | None = None,
    view: str | None = None,
    names: bool = True,
    ax: Any = None,
) -> Any:
    """Draw the model; tyres are circles with their radius.

    Args:
        model, state: the model and its state; None draws the reference pose.
        displaced: {support: Xi}, displacements of supports [m, rad].
        view: the axes that point right and up, such as "xy", or "oblique". With None, gravity
            points down, and the view is oblique unless the model is flat.
        names: whether to write the names of bodies and elements.
        ax: axes to draw into; None makes a new figure.

    >>> model = jb.Model(
    ...     bodies={"mass": jb.Body(mass=2.0, inertia=[1, 1, 1])},
    ...     gravity=[0, -9.81, 0],
    ...     elements={
    ...         "s": jb.Spring(
    ...             ("mass", [0, 0, 0]), ("world", [0, 1, 0]), stiffness=50.0, free_length=0.9
    ...         )
    ...     },
    ... )
    >>> jb.plots.draw_model(model).get_ylabel()
    'y [m]'
    """
    state = model.reference if state is None else state
    check_state(model, state, "draw_model.state")
    given, supports = displaced or {}, model.layout.supports
    check_all_known(given, "draw_model.displaced", supports)
    xi = np.reshape([given.get(name, np.zeros(6)) for name in supports], (-1, 6))
    scene = Scene(PoseSequence(model, np.zeros(1), *poses_of(model, state.q[None], xi)))
    look = projection(view, model, [scene])
    ax = _axes(ax, [scene], look)
    _draw(ax, scene, look, scene.size(look))
    frame_axes(ax, look, scene.size(look))
    if names:
        annotate(ax, _names(scene, look))
    return ax


def draw_mode(
    lin: Linearization | SpinLinearization,
    modes: Modes | ComplexModes,
    number: int = 1,
    *,
    view: str | None = None,
    ax: Any = None,
) -> Any:
    """Draw one mode: the model in both extreme positions, over the model at rest. The title names
    the mode; the amplitude is an eighth of the model's size.

    A complex mode is drawn at the instant at which its largest component is extreme.

    Args:
        lin, modes: the linear system and its modes.
        number: number of the mode, from 1, by ascending frequency.
        view: as in `draw_model`.
        ax: axes to draw into; None makes a new figure.

    Error: UNKNOWN_MODE.

    >>> lin = jb.linearize(jb.presets.quarter_car(), jb.presets.quarter_car().reference)
    >>> jb.plots.draw_mode(lin, jb.modes(lin), 2).get_title().splitlines()
    ['mode 2: 8.796 Hz', 'wheel bounce 100 %']
    """
    model = lin.model
    check_number(modes, number, "draw_mode.number")
    shape = np.real(np.asarray(modes.shapes)[: model.layout.nv, number - 1])

    def moved(factor: float) -> Scene:
        poses = displaced_poses(model, lin.state.q, factor * shape[None])
        return Scene(PoseSequence(model, np.zeros(1), *poses))

    rest = moved(0.0)
    size = rest.size(np.eye(3))
    trial = 1e-6 * size / np.abs(shape).max()
    points = moved(trial).points
    largest = (
        max(np.abs(points[name] - rest.points[name]).max() for name in model.layout.bodies) / trial
    )
    # if all points are at origins of bodies, the rotation limits the amplitude
    largest = max(largest, np.abs(shape[model.layout.turns]).max(initial=0.0) * size * SWING)
    extremes = [moved(sign * size * SWING / largest) for sign in (-1, 1)]
    look = projection(view, model, [rest, *extremes])
    ax = _axes(ax, [rest, *extremes], look)
    _draw(ax, rest, look, size, color=LIGHT, edge=GRAY, springs=GRAY, alpha=0.5)
    for scene, color in zip(extremes, COLORS, strict=False):
        _draw(
            ax, scene, look, size, color=color, edge=color, springs=color, alpha=0.3, ground=False
        )
    frequency, ratio = (
        float(x[number - 1])
        for x in (np.asarray(modes.frequency), without_dust(modes.damping_ratio, 1.0))
    )
    title = f"mode {number}: {frequency:.4g} Hz" + (
        f", damping ratio {ratio:.2g}" if ratio > 0 else ""
    )
    ax.set_title(f"{title}\n{modes.names[number - 1]}", fontsize=9)
    frame_axes(ax, look, size)
    return ax


class Scene:
    """A model in one pose, the first of a sequence: world positions of the points attached to each
    frame."""

    def __init__(self, poses: PoseSequence):
        self.poses, self.model = poses, poses.model
        model, layout = self.model, self.model.layout
        elements, closures = dict(named_rows(model.attached)), dict(placed_closures(model))
        self.ends, self.joined = self._ends(elements), self._ends(closures)
        self.centers = {name: poses.points(name, model[name].com)[0] for name in layout.bodies}
        # position and parent of each body's joint
        self.pivots: dict[str, tuple[np.ndarray, str]] = {}
        for name, parent in zip(layout.bodies, layout.parents, strict=True):
            if layout.block(name).nv < 6:
                at = model.joint(name).at
                place = (name, np.zeros(3)) if at is None else (parent, at)
                self.pivots[name] = poses.points(*place)[0], parent
        attached = list(self.centers.items())
        for name, thing in (elements | closures).items():
            attached += zip(thing.between, (self.ends | self.joined)[name], strict=False)
        for name, (at, parent) in self.pivots.items():
            attached += [(name, at), (parent, at)]
        self.points = {
            name: np.array(
                [at for frame, at in attached if frame == name] or poses.points(name, np.zeros(3))
            )
            for name in layout.frames
        }

    def _ends(self, things: dict[str, Any]) -> dict[str, list[np.ndarray]]:
        """Return world positions of the first two ends of elements or closures."""
        return {name: [end[0] for end in self.poses.ends(x)[:2]] for name, x in things.items()}

    def direction(self, frame: str, axis: Any) -> np.ndarray:
        """Return an axis of a frame in world axes."""
        return self.poses.pose(frame)[1][0] @ np.asarray(axis)

    def all_points(self) -> np.ndarray:
        return np.concatenate(
            [
                rows
                for name, rows in self.points.items()
                if name != WORLD or len(self.ends) + len(self.joined) + len(self.pivots)
            ]
        )

    def size(self, look: np.ndarray) -> float:
        """Return the longer side of the box around all points in this view [m]."""
        return float(np.ptp(self.all_points() @ look.T, axis=0).max()) or 1.0


def projection(view: str | None, model: Model, scenes: list[Scene]) -> np.ndarray:
    """Return the matrix (2, 3) from world coordinates to coordinates to the right and up in the
    drawing."""
    if view is not None and view != "oblique":
        return look_along(view)
    spread = np.ptp(np.concatenate([scene.all_points() for scene in scenes]), axis=0)
    weight = np.abs(np.asarray(model.gravity))
    up = int(np.argmax(weight)) if weight.any() else int(np.argsort(spread)[1])
    rest = [i for i in range(3) if i != up]
    right = rest[0] if spread[rest[0]] >= 0.5 * spread[rest[1]] else rest[1]
    away = 3 - up - right
    look = np.eye(3)[[right, up]]
    if view == "oblique" or spread[away] > 1e-6 * spread.max():
        look[:, away] = (-0.45, -0.28) if (right, up) in ((0, 1), (1, 2), (2, 0)) else (0.45, 0.28)
    return look


def look_along(view: str) -> np.ndarray:
    """Return the matrix (2, 3) of a view named by the axes that point right and up, such as "xz".
    Error: BAD_VIEW."""
    if not (len(view) == 2 and view[0] != view[1] and set(view) <= set(AXES)):
        raise JaxbodyError(
            Problem(
                "BAD_VIEW",
                "view",
                f"is {view!r}",
                view,
                "two of x, y, z",
                "Give 'oblique', or the axes that point right and up, such as 'xy'.",
            )
        )
    return np.eye(3)[[AXES.index(axis) for axis in view]]


def _axes(ax: Any, scenes: list[Scene], look: np.ndarray) -> Any:
    """Return the given axes, or those of a new figure with the proportions of the drawing."""
    width, height = (
        np.ptp(np.concatenate([scene.all_points() for scene in scenes]) @ look.T, axis=0) + 1e-9
    )
    ratio = np.clip((height + 0.1 * width) / (width + 0.1 * height), 0.25, 2.0)
    return axes_or_new(ax, *((6.4, 1.0 + 5.2 * ratio) if ratio < 1 else (1.4 + 5.0 / ratio, 5.8)))


def _draw(
    ax, scene: Scene, look, size, *, color=None, edge=INK, springs=INK, alpha=1.0, ground=True
) -> None:
    layout = scene.model.layout
    for i, name in enumerate(layout.bodies):
        _outline(
            ax,
            scene.points[name] @ look.T,
            size,
            color or COLORS[i % len(COLORS)],
            edge,
            alpha if color else 0.35,
            color is not None,
        )
        if color is None:
            ax.plot(
                *(scene.centers[name] @ look.T), "o", ms=6, mfc="white", mec=INK, mew=1.0, zorder=6
            )
    for table in scene.model.attached:
        if isinstance(table.rows, Tyre):
            _wheels(ax, scene, table, look, size, edge, alpha, ground)
            continue
        zigzag, slim = (
            isinstance(table.rows, LineElement),
            isinstance(table.rows, LineElement | Inerter),
        )
        for name, link in zip(table.names, table.links, strict=True):
            A, B = (end @ look.T for end in scene.ends[name])
            path = zigzag_path(A, B, 0.022 * size) if zigzag else np.array([A, B])
            ax.plot(
                *path.T,
                color=springs,
                lw=1.1 if slim else 3.0,
                alpha=alpha,
                solid_joinstyle="round",
                zorder=4,
            )
            ax.plot(
                *np.array([A, B]).T,
                "." if slim else "s",
                color=springs,
                ms=4,
                alpha=alpha,
                zorder=5,
            )
            if isinstance(table.rows, Inerter):
                ax.plot(
                    *((A + B) / 2),
                    "o",
                    mfc="white",
                    mec=springs,
                    mew=1.6,
                    ms=9,
                    alpha=alpha,
                    zorder=5,
                )  # the flywheel
            for end, here, there in zip(link[:2], (A, B), (B, A), strict=True):
                if ground and end not in layout.bodies:
                    ground_at(ax, here, here - there, 0.035 * size)
    _closures(ax, scene, look, size, edge, alpha, ground)
    for name, (at, parent) in scene.pivots.items():
        pivot, joint = at @ look.T, scene.model.joint(name)
        if isinstance(joint, Guide):
            along = scene.direction(parent, joint.axis) @ look.T * 0.12 * size
            ax.plot(*np.array([pivot - along, pivot + along]).T, "-.", color=GRAY, lw=0.9, zorder=1)
        elif not joint.in_series:
            ax.plot(*pivot, "o", ms=6, mfc="white", mec=edge, mew=1.2, alpha=alpha, zorder=6)
            if ground and parent not in layout.bodies:
                ground_at(
                    ax, pivot - np.array([0, 0.02 * size]), np.array([0.0, -1.0]), 0.035 * size
                )


def _closures(ax, scene: Scene, look, size, edge, alpha, ground) -> None:
    """Draw rods as lines between two balls, guides and lines in which a point slides as dash-dotted
    lines, and other closures as pins."""
    layout = scene.model.layout
    for name, ends in scene.joined.items():
        closure, (A, B) = scene.model[name], (end @ look.T for end in ends)
        if isinstance(closure, GuideClosure | Inline):
            axis = scene.direction(closure.between[0], closure.axis) @ look.T
            reach = 0.12 * size + np.linalg.norm(B - A)
            ax.plot(
                *np.array([A - reach * axis, A + reach * axis]).T,
                "-.",
                color=GRAY,
                lw=0.9,
                zorder=1,
                gid=f"line of {name}",
            )
            ax.plot(*B, "o", ms=5, mfc=edge, mec=edge, alpha=alpha, zorder=6)
        else:
            path = np.array([A, B])
            ax.plot(
                *path.T,
                "-",
                marker="o",
                color=edge,
                lw=1.8,
                ms=6,
                mfc="white",
                mew=1.2,
                alpha=alpha,
                zorder=5,
                gid=name,
            )
        for end, here, there in zip(closure.between, (A, B), (B, A), strict=True):
            if ground and end not in layout.bodies and (here != there).any():
                ground_at(ax, here, here - there, 0.035 * size)


def _wheels(ax, scene: Scene, table, look, size, edge, alpha, ground) -> None:
    """Draw tyres as circles about the hubs, with the ground below if the view shows the road's
    normal."""
    from matplotlib.patches import Circle

    for name in table.names:
        tyre, (hub, road) = scene.model[name], (end @ look.T for end in scene.ends[name])
        up = scene.direction(tyre.between[1], tyre.axis) @ look.T
        if up.any():
            ax.add_patch(
                Circle(hub, tyre.radius, fill=False, edgecolor=edge, lw=1.6, alpha=alpha, zorder=1)
            )
            if ground:
                ground_at(ax, road, -up, 0.035 * size)


def _names(scene: Scene, look) -> list[Label]:
    """Return the labels of bodies at their centers of mass and of elements at their middles."""
    labels = [
        Label(name, at @ look.T, np.array([1.0, 1.0]), 9, INK) for name, at in scene.centers.items()
    ]
    for name, ends in scene.ends.items():
        A, B = (end @ look.T for end in ends)
        labels.append(
            Label(
                name,
                (A + B) / 2,
                np.array([abs((B - A)[1]), -(B - A)[0] * np.sign((B - A)[1] or 1.0)]),
                8,
                GRAY,
            )
        )
    return labels


def _outline(ax, seen, size, fill, edge, alpha, ghost) -> None:
    """Draw the convex hull of the points with a rounded rim, or a disk for a single point."""
    from matplotlib.colors import to_rgba
    from matplotlib.patches import Circle, Polygon

    hull = _hull(seen, 1e-9 * size)
    if len(hull) == 1:
        ax.add_patch(
            Circle(
                hull[0],
                0.035 * size,
                facecolor=to_rgba(fill, alpha),
                edgecolor=edge,
                lw=1.2,
                zorder=2,
            )
        )
    elif ghost:
        ax.add_patch(
            Polygon(
                hull,
                closed=True,
                facecolor=to_rgba(fill, alpha),
                edgecolor=edge,
                lw=1.6,
                joinstyle="round",
                zorder=3,
            )
        )
    else:
        pale = tuple(1 - 0.35 * (1 - c) for c in to_rgba(fill)[:3])
        for color, width in ((edge, RIM), (pale, RIM - 2.2)):
            rim = {"lw": width, "zorder": 2, "snap": False}
            if len(hull) == 2:
                ax.plot(*hull.T, color=color, solid_capstyle="round", **rim)
            else:
                ax.add_patch(
                    Polygon(
                        hull,
                        closed=True,
                        facecolor=color,
                        edgecolor=color,
                        joinstyle="round",
                        **rim,
                    )
                )


def _hull(points: np.ndarray, tolerance: float) -> np.ndarray:
    """Return the convex hull of points in the plane, counterclockwise; for points on a line its
    ends."""
    from scipy.spatial import ConvexHull

    points = points[np.lexsort(points.T[::-1])]
    points = points[
        np.concatenate([[True], np.linalg.norm(np.diff(points, axis=0), axis=1) > tolerance])
    ]
    if len(points) < 3:
        return points
    if np.linalg.svd(points - points.mean(0), compute_uv=False)[1] <= tolerance:
        return points[[0, -1]]
    return points[ConvexHull(points).vertices]
