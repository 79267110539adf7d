"""Pictures of models and their modes in axes of matplotlib: the parts of `jb.view` in parallel
projection, to scale."""

from dataclasses import replace
from typing import Any

import numpy as np

from jaxbody.core.errors import JaxbodyError, Problem, check_all_known
from jaxbody.model.models import Model
from jaxbody.model.preconditions import check_state
from jaxbody.model.states import State
from jaxbody.vibration.damped_modes import ComplexModes
from jaxbody.vibration.linearizations import Linearization
from jaxbody.vibration.natural_modes import Modes
from jaxbody.vibration.spins import SpinLinearization
from jaxbody.views.plots.canvases import axes_or_new
from jaxbody.views.scenes.animations import Animation, camera_for, parallel_camera
from jaxbody.views.scenes.colors import GRAY
from jaxbody.views.scenes.drawn_frames import FINER, Renderer, write_names
from jaxbody.views.scenes.poses import PoseSequence, marks, poses_of, still, vibrating
from jaxbody.views.scenes.scenes import FLAT, animation_of

AXES = "xyz"
FIXED = ("supports", "roads")  # groups of parts that a mode does not move
PALE = 0.25  # opacity of the model at rest under a mode
MARGIN = 0.06  # around the drawing, relative to its longer side
SLIM = 0.35  # smallest ratio of the sides of the frame


def draw_model(
    model: Model,
    state: State | None = None,
    *,
    displaced: dict[str, Any] | None = None,
    view: str | None = None,
    names: bool = True,
    ax: Any = None,
) -> Any:
    """Draw the model as `jb.view` does, in parallel projection.

    Args:
        model, state: the model and its state; None draws the reference pose.
        displaced: {support: Xi}, displacements of supports [m, rad].
        view: the axes that point right and up, such as "xy", or "oblique". With None, gravity
            points down, and the view is oblique unless the model is flat.
        names: whether to write the names of bodies, supports and elements.
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
    sequence = PoseSequence(model, np.zeros(1), *poses_of(model, state.q[None], xi))
    animation = animation_of(sequence)
    ax, renderer = _drawn(animation, sequence, view, ax)
    if names:
        write_names(ax, renderer, [*animation.labels])
    return ax


def draw_mode(
    lin: Linearization | SpinLinearization,
    modes: Modes | ComplexModes,
    number: int = 1,
    *,
    view: str | None = None,
    ax: Any = None,
) -> Any:
    """Draw one mode: the model in an extreme position, over the model at rest, pale. The title has
    number, frequency, damping ratio and kinetic energies; the amplitude is that of `jb.view`.

    A complex mode is drawn at the instant at which its largest component is extreme.

    Args:
        lin, modes: the linear system and its modes.
        number: number of the mode, from 1, by ascending frequency.
        view: as in `draw_model`.
        ax: axes to draw into; None makes a new figure.

    Error: UNKNOWN_MODE.

    >>> lin = jb.linearize(jb.presets.quarter_car(), jb.presets.quarter_car().reference)
    >>> jb.plots.draw_mode(lin, jb.modes(lin), 2).get_title().splitlines()
    ['mode 2: 8.796 Hz', 'kinetic energy: wheel bounce 100 %']
    """
    sequence = vibrating(modes, number, lin.state, None, 0.0)
    first = replace(sequence, times=np.zeros(1), p=sequence.p[:1], R=sequence.R[:1])
    rest = still(lin.model, lin.state)
    at_rest = animation_of(rest)
    ghosts = tuple(
        part
        if part.path[0] in FIXED
        else replace(part, color=GRAY, opacity=PALE, over=-at_rest.size)
        for part in at_rest.parts
    )
    moved = tuple(part for part in animation_of(first).parts if part.path[0] not in FIXED)
    ax, _ = _drawn(replace(at_rest, parts=ghosts + moved), rest, view, ax)
    ax.set_title(sequence.title, fontsize=9)
    return ax


def _drawn(animation: Animation, sequence: PoseSequence, view: str | None, ax: Any) -> Any:
    """Draw the first frame of an animation into axes, in parallel projection and without its
    background, and return them with the renderer.

    Args:
        animation: what is drawn.
        sequence: its poses.
        view: as in `draw_model`.
        ax: axes to draw into; None makes a new figure.
    """
    parts = tuple(part for part in animation.parts if not part.below)
    animation, right, up = replace(animation, parts=parts), animation.right, animation.up
    if view is not None and view != "oblique":
        right, up = look_along(view)
    axes = np.stack([right, up, np.cross(right, up)], -1)
    if view == "oblique" or (
        view is None and np.ptp(marks(sequence)[0] @ axes[:, 2]) > FLAT * animation.size
    ):
        axes = camera_for(animation).axes
    renderer = Renderer(animation, parallel_camera(animation, axes))
    flat, _ = renderer.camera.project(animation.outline())
    low, high = flat.min(0), flat.max(0)
    width, height = high - low
    ratio = float(np.clip((height + 0.1 * width) / (width + 0.1 * height), 0.25, 2.0))
    ax = axes_or_new(ax, *((6.4, 1.0 + 5.2 * ratio) if ratio < 1 else (1.4 + 5.0 / ratio, 5.8)))
    fine = FINER * max(ax.get_window_extent().size) / max(width, height)
    size = int(np.ceil(fine * height)), int(np.ceil(fine * width))
    raster = renderer.raster(0, low, width, size)
    alpha = np.where(raster.covered, 255, 0).astype(np.uint8)
    pixels = np.dstack([raster.picture(), alpha.reshape(size)[::-1]])
    extent = (low[0], high[0], low[1], low[1] + size[0] / size[1] * width)
    ax.imshow(pixels, extent=extent, interpolation="antialiased", zorder=2)
    frame_axes(ax, axes[:, :2].T, animation.size)
    return ax, renderer


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


def frame_axes(ax, look, size: float) -> None:
    """Set the limits of the axes and label them in meters; an oblique view shows the three world
    axes instead, because its scale depends on the direction."""
    right, up = (int(np.argmax(row)) for row in look)
    if np.allclose(look, np.eye(3)[[right, up]]):
        ax.set(xlabel=f"{AXES[right]} [m]", ylabel=f"{AXES[up]} [m]")
    else:
        _triad(ax, look, size)
        ax.set_axis_off()
    (x0, y0), (x1, y1) = ax.dataLim.get_points()
    width, height = np.array([x1 - x0, y1 - y0]) + 2 * MARGIN * max(x1 - x0, y1 - y0)
    width, height = max(width, SLIM * height), max(height, SLIM * width)
    ax.set(
        xlim=((x0 + x1 - width) / 2, (x0 + x1 + width) / 2),
        ylim=((y0 + y1 - height) / 2, (y0 + y1 + height) / 2),
        adjustable="box",
        aspect="equal",
    )
    ax.apply_aspect()


def _triad(ax, look, size: float) -> None:
    """Draw the projected world axes at the lower left, with their length written below."""
    length = 10.0 ** np.floor(np.log10(size / 7))
    length *= max(k for k in (1, 2, 5) if k * length <= size / 7)
    low = ax.dataLim.get_points()[0]
    origin = (
        low
        - length * (look * (look > 0)).sum(1) * [1.3, 0]
        - length * (look * (look < 0)).sum(1) * [1, 1] * [0, 1]
    )
    for name, direction in zip(AXES, look.T, strict=True):
        ax.plot(
            *np.array([origin, origin + length * direction]).T,
            color=GRAY,
            lw=1.2,
            gid=f"axis {name}",
        )
        ax.text(
            *(origin + 1.25 * length * direction),
            name,
            fontsize=8,
            color=GRAY,
            ha="center",
            va="center",
        )
    ax.annotate(
        f"{length:g} m",
        origin + np.array([0, 1.25 * length * min(look[1].min(), 0.0)]),
        xytext=(0, -14),
        textcoords="offset points",
        fontsize=8,
        color=GRAY,
        ha="left",
        va="center",
    )
