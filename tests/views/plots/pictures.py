"""Structure of pictures for tests: texts that overlap or leave the figure, labels without
a unit."""

import itertools
import re

import numpy as np
from matplotlib.text import Annotation, Text

COUNTS = {
    "trial",
    "evaluation",
    "optimum",
    "starts",
    "mode",
    "identified mode",
    "mode of the model",
    "component",
    "value",
    "density",
    "parameter",
}  # numbers without a unit


def texts(figure):
    """{text: its box in pixels} of everything written in a figure."""
    figure.canvas.draw()
    left_out = not_drawn(figure)
    written = {}
    for number, text in enumerate(
        figure.findobj(
            lambda x: isinstance(x, Text) and x.get_visible() and x.get_text().strip() != ""
        )
    ):
        if text in left_out:
            continue
        if isinstance(text, Annotation):
            text.get_window_extent()  # places it; its box has the leading line too
        written[f"{number}: {text.get_text()}"] = (text, Text.get_window_extent(text))
    return written


def not_drawn(figure):
    """Labels of ticks outside of the limits, and those of axes that are switched off."""
    left_out = set()
    for ax in figure.axes:
        for axis in (ax.xaxis, ax.yaxis):
            own = set(axis.findobj(Text))
            drawn = {
                label for tick in axis._update_ticks() for label in (tick.label1, tick.label2)
            } | {axis.label, axis.offsetText}
            left_out |= own - drawn if ax.axison and axis.get_visible() else own
    return left_out


def overlaps(figure):
    """Pairs of texts that overlap, and texts that leave the figure."""
    written, page = texts(figure), figure.bbox
    # their boxes overlap, they do not
    slanted = {name for name, (text, _) in written.items() if text.get_rotation() % 90}
    pairs = [
        (one, other)
        for (one, (_, box)), (other, (_, beside)) in itertools.combinations(written.items(), 2)
        if box.overlaps(beside) and not {one, other} <= slanted
    ]
    beyond = [
        name
        for name, (_, box) in written.items()
        if box.x0 < page.x0 - 1
        or box.y0 < page.y0 - 1
        or box.x1 > page.x1 + 1
        or box.y1 > page.y1 + 1
    ]
    return pairs + beyond


def without_unit(figure, quantities=()):
    """Labels of axes that have neither a unit nor are counts or one of the `quantities`, whose
    units only their user knows."""
    labels = [
        label for ax in figure.axes if ax.axison for label in (ax.get_xlabel(), ax.get_ylabel())
    ]
    return [
        label
        for label in labels
        if label and not re.search(r"\[.+\]$", label) and label not in COUNTS | set(quantities)
    ]


def units(figure):
    """The unit of each panel's ordinate."""
    return [
        found.group(1) for ax in figure.axes if (found := re.search(r"\[(.+)\]$", ax.get_ylabel()))
    ]


def pixels_at(ax, point, reach=1):
    """The colors (n, 4) of the picture in axes around a point of its data coordinates, transparent
    outside."""
    (image,) = ax.images
    left, right, bottom, top = image.get_extent()
    picture = np.asarray(image.get_array())
    height, width = picture.shape[:2]
    column = int((point[0] - left) / (right - left) * width)
    row = int((top - point[1]) / (top - bottom) * height)
    if not (0 <= column < width and 0 <= row < height):
        return np.zeros((1, 4))
    near = (slice(max(x - reach, 0), x + reach + 1) for x in (row, column))
    return picture[tuple(near)].reshape(-1, 4).astype(float)


def has_color(ax, point, color):
    """Whether something of this color, "#rrggbb" in any light, is drawn at a point."""
    c = np.array([int(color[i : i + 2], 16) for i in (1, 3, 5)], float)
    seen = pixels_at(ax, point)
    share = np.clip(seen[:, :3] @ c / (c @ c), 0.45, 1.08)
    return bool(((np.abs(seen[:, :3] - share[:, None] * c).max(1) < 6) & (seen[:, 3] > 0)).any())
