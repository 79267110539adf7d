"""Labels in plots of models, each placed near its object so that it overlaps neither other labels nor the drawing."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from jaxbody.plots.canvases import GRAY

WIDTH, HEIGHT = 0.62, 1.3  # of a letter, relative to the font size
RINGS = (4.0, 8.0, 13.0, 20.0, 30.0, 42.0, 56.0)  # points, trial distances from an object to the edge of its label
ANGLES = np.deg2rad(np.arange(0, 360, 22.5))
STEP = 2.5  # points, distance of the sample points along drawn lines
CLEAR = 3.0  # points, clearance between a label and a line
FAR = 16.0  # points, distance beyond which a thin line leads to the label


class Label(NamedTuple):
    """A name, the position of its object and the preferred direction from there, both in data coordinates; font size [points] and color."""

    name: str
    at: np.ndarray
    toward: np.ndarray
    size: float
    color: str


def annotate(ax: Any, labels: list[Label]) -> None:
    """Write the labels beside what has been drawn."""
    from matplotlib.patheffects import withStroke

    if not labels:
        return
    scale = 72 / ax.figure.dpi
    covered = np.concatenate([_points_along(scale * ax.transData.transform(shape)) for shape in _drawn(ax)])
    taken = np.zeros((0, 4))
    for label in labels:
        at = scale * ax.transData.transform(label.at)
        half = 0.5 * label.size * np.array([WIDTH * len(label.name), HEIGHT])
        offsets, reach, costs = _places(label.toward, half)
        low, high = at + offsets - half, at + offsets + half
        depth = np.minimum(high[:, None], taken[:, 2:]) - np.maximum(low[:, None], taken[:, :2])
        costs = costs + 20 * np.sum(np.all(depth > 0, -1), -1)
        costs = costs + np.sum(np.all((covered > low[:, None] - CLEAR) & (covered < high[:, None] + CLEAR), -1), -1)
        best = int(np.argmin(costs))
        taken = np.concatenate([taken, [[*low[best], *high[best]]]])
        leader = {"arrowstyle": "-", "lw": 0.5, "color": GRAY, "shrinkA": 0, "shrinkB": 1} if reach[best] > FAR else None
        ax.annotate(
            label.name, label.at, xytext=offsets[best], textcoords="offset points", fontsize=label.size, color=label.color, ha="center",
            va="center", zorder=7, arrowprops=leader, path_effects=[withStroke(linewidth=2, foreground="white")],
        )  # fmt: skip


def _drawn(ax: Any) -> list[np.ndarray]:
    """All lines and outlines of the axes."""
    lines = [line.get_xydata() for line in ax.lines]
    return lines + [shape for patch in ax.patches for shape in patch.get_path().to_polygons(patch.get_patch_transform(), closed_only=False)]


def _points_along(line: np.ndarray) -> np.ndarray:
    """Points at equal distances along a line."""
    s = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
    at = np.arange(0.0, s[-1] + STEP, STEP)
    return np.stack([np.interp(at, s, x) for x in line.T], -1)


def _places(toward: np.ndarray, half: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Trial offsets of the center of a label of half size `half`, their distances [points], and their costs.

    The cost grows with the distance and with the angle from the direction `toward`."""
    reach, turn = (x.ravel() for x in np.meshgrid(RINGS, ANGLES + np.arctan2(toward[1], toward[0]), indexing="ij"))
    direction = np.stack([np.cos(turn), np.sin(turn)], -1)
    away = 1 - direction @ toward / (np.linalg.norm(toward) or 1.0)
    edge = np.min(half / np.maximum(np.abs(direction), 1e-9), -1)  # from the center to the edge of the label, in this direction
    return (reach + edge)[:, None] * direction, reach, 0.15 * reach + away
