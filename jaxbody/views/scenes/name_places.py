"""Where names are written in a picture: near what they name, off what is drawn."""

from typing import Any

import numpy as np

from jaxbody.views.scenes.animations import NameLabel
from jaxbody.views.scenes.colors import GRAY

WIDTH, HEIGHT = 0.62, 1.3  # size of a letter, relative to the font size
# points, trial distances from an object to the edge of its label
RINGS = (4.0, 8.0, 13.0, 20.0, 30.0, 42.0, 56.0)
ANGLES = np.deg2rad(np.arange(0, 360, 22.5))
STEP = 2.5  # points, distance of the sample points along drawn lines
CLEAR = 3.0  # points, clearance between a label and a line or another label
HIDDEN = 1e3  # cost of covering another label, over that of a sample point of a line
FAR = 16.0  # points, distance beyond which a thin line leads to the label


TOWARD = np.array([0.5, 1.0])  # preferred direction from an object to its label


def annotate(
    ax: Any,
    labels: list[NameLabel],
    places: list[np.ndarray],
    lines: list[np.ndarray],
    points: np.ndarray,
) -> None:
    """Write labels of objects at `places` where they cover as little as possible of what the axes
    already contain and of other lines and points, in data coordinates."""
    from matplotlib.patheffects import withStroke

    if not labels:
        return
    scale = 72 / ax.figure.dpi
    covered = [
        _points_along(scale * ax.transData.transform(shape)) for shape in [*_drawn(ax), *lines]
    ]
    covered = np.concatenate([*covered, scale * ax.transData.transform(points)])
    covered = STEP * np.unique(np.round(covered / STEP), axis=0).T
    taken = scale * np.array(
        [[*box.min, *box.max] for box in (text.get_window_extent() for text in ax.texts)]
    ).reshape(-1, 4)
    for label, place in zip(labels, places, strict=True):
        at, size = scale * ax.transData.transform(place), 9 if label.kind == "body" else 8
        half = 0.5 * size * np.array([WIDTH * len(label.text), HEIGHT])
        offsets, reach, costs = _places(half)
        low, high = at + offsets - half, at + offsets + half
        (left, bottom), (right, top) = low.T[..., None] - CLEAR, high.T[..., None] + CLEAR
        costs = costs + HIDDEN * np.sum(
            (taken[:, 2] > left)
            & (taken[:, 0] < right)
            & (taken[:, 3] > bottom)
            & (taken[:, 1] < top),
            -1,
        )
        x, y = covered[
            :, (abs(covered - at[:, None]) < RINGS[-1] + CLEAR + 2 * half[:, None]).all(0)
        ]  # points near enough to be covered by a label
        costs = costs + np.sum((x > left) & (x < right) & (y > bottom) & (y < top), -1)
        best = int(np.argmin(costs))
        taken = np.concatenate([taken, [[*low[best], *high[best]]]])
        leader = (
            {"arrowstyle": "-", "lw": 0.5, "color": GRAY, "shrinkA": 0, "shrinkB": 1}
            if reach[best] > FAR
            else None
        )
        ax.annotate(
            label.text,
            place,
            xytext=offsets[best],
            textcoords="offset points",
            fontsize=size,
            color=label.color,
            ha="center",
            va="center",
            zorder=7,
            arrowprops=leader,
            path_effects=[withStroke(linewidth=2, foreground="white")],
        )


def _drawn(ax: Any) -> list[np.ndarray]:
    """Return the points of all lines and outlines of the axes, in data coordinates."""
    lines = [line.get_xydata() for line in ax.lines]
    return lines + [
        shape
        for patch in ax.patches
        for shape in patch.get_path().to_polygons(patch.get_patch_transform(), closed_only=False)
    ]


def _points_along(line: np.ndarray) -> np.ndarray:
    """Return points at equal distances along a line, `STEP` apart."""
    s = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
    at = np.arange(0.0, s[-1] + STEP, STEP)
    return np.stack([np.interp(at, s, x) for x in line.T], -1)


def _places(half: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return trial offsets of the center of a label of half size `half`, their distances from the
    object [points] and their costs.

    The cost grows with the distance and with the angle from the direction `toward`."""
    reach, turn = (
        x.ravel() for x in np.meshgrid(RINGS, ANGLES + np.arctan2(*TOWARD[::-1]), indexing="ij")
    )
    direction = np.stack([np.cos(turn), np.sin(turn)], -1)
    away = 1 - direction @ TOWARD / np.linalg.norm(TOWARD)
    # from the center to the edge of the label, in this direction
    edge = np.min(half / np.maximum(np.abs(direction), 1e-9), -1)
    return (reach + edge)[:, None] * direction, reach, 0.15 * reach + away
