"""Symbols in drawings of models: the zigzag of a spring, the hatched bar of fixed ground, axes and
the frame around."""

import numpy as np

from jaxbody.views.plots.canvases import GRAY, INK

AXES = "xyz"
MARGIN = 0.06  # around the drawing, relative to its longer side
SLIM = 0.35  # smallest ratio of the sides of the frame


def zigzag_path(A, B, width: float, coils: int = 7) -> np.ndarray:
    """Return the path of a spring from A to B: straight ends of an eighth of the length each, and a
    zigzag between them."""
    along = B - A
    length = np.linalg.norm(along)
    if length == 0:
        return np.array([A, B])
    side = np.array([-along[1], along[0]]) / length * min(width, length / 4)
    s = np.concatenate(
        [[0, 0.12], 0.12 + 0.76 * (np.arange(2 * coils) + 0.5) / (2 * coils), [0.88, 1]]
    )
    teeth = np.concatenate([[0, 0], np.where(np.arange(2 * coils) % 2, -1, 1), [0, 0]])
    return A + s[:, None] * along + teeth[:, None] * side


def ground_at(ax, at, outward, half: float) -> None:
    """Draw a bar across the direction `outward`, hatched on its far side."""
    length = np.linalg.norm(outward)
    n = outward / length if length else np.array([0.0, -1.0])
    t = np.array([-n[1], n[0]])
    ax.plot(
        *np.array([at - half * t, at + half * t]).T,
        color=INK,
        lw=1.6,
        solid_capstyle="butt",
        zorder=4,
    )
    for x in np.linspace(-0.8, 1.0, 6):
        start = at + half * x * t
        ax.plot(
            *np.array([start, start + half * (0.5 * n - 0.4 * t)]).T, color=INK, lw=0.7, zorder=3
        )


def frame_axes(ax, look, size: float) -> None:
    """Set the limits of the axes and label them in meters; an oblique view shows the three world
    axes instead, because its scale depends on the direction."""
    if np.count_nonzero(look) > 2:
        _triad(ax, look, size)
        ax.set_axis_off()
    else:
        right, up = (int(np.argmax(np.abs(row))) for row in look)
        ax.set(xlabel=f"{AXES[right]} [m]", ylabel=f"{AXES[up]} [m]")
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
        origin,
        xytext=(0, -12),
        textcoords="offset points",
        fontsize=8,
        color=GRAY,
        ha="left",
        va="center",
    )
