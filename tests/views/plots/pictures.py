"""Structure of pictures for tests: texts that overlap or leave the figure, labels without
a unit."""

import itertools
import re

from matplotlib.text import Annotation, Text

COUNTS = {
    "trial",
    "evaluation",
    "optimum",
    "starts",
    "mode",
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
            left_out |= own - drawn if ax.axison else own
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
