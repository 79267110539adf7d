"""Axes, panels, colors and legends that all plots share. matplotlib is imported when something
is drawn."""

from collections.abc import Callable
from functools import wraps
from typing import Any, TypeVar

import numpy as np

from jaxbody.core.arrays import is_concrete
from jaxbody.core.errors import JaxbodyError, Problem
from jaxbody.views.scenes.colors import COLORS, GRAY, INK, rgb

Draw = TypeVar("Draw", bound=Callable[..., Any])
DASHES = ("-", (0, (6, 1.5)), (0, (3, 1, 1, 1)), (0, (1, 1)))  # one for each four lines
MARKERS = "osD^vP*X"  # of series of marks
NAME = 0.165  # height of a line of a legend [in]
DARK = 0.5  # brightness of a cell below which its number is white
ROOM = 50  # number of letters that fit side by side below axes of usual width


def axes_or_new(ax: Any, width: float, height: float) -> Any:
    """Return the given axes, or those of a new figure of this size [in], in the common style."""
    if ax is None:
        import matplotlib.pyplot as plt

        _, ax = plt.subplots(figsize=(width, height), layout="constrained")
    tidy(ax)
    return ax


def tidy(ax: Any) -> None:
    """Hide the upper and right frame lines and draw a pale grid."""
    ax.spines[["top", "right"]].set_visible(False)
    ax.grid(True, color="#e8e8e8", lw=0.6)
    ax.set_axisbelow(True)


def axes_below(ax: Any, *heights: float, share: bool = True) -> list[Any]:
    """Split the area of `ax`, add axes below it and return the added ones.

    Args:
        ax: axes that keep the top part of their area.
        heights: of the new axes, relative to the remaining height of `ax`.
        share: whether all have the abscissa of `ax`, which is then labeled below the last axes
            only.
    """
    spec, shares = ax.get_subplotspec(), (1.0, *heights)
    gap, same = (0.15, ax) if share else (0.4, None)
    if spec is None:
        box, room = ax.get_position(), sum(shares) + gap * len(heights)
        tops = [
            box.y1 - box.height * (sum(shares[:i]) + gap * i) / room for i in range(len(shares))
        ]
        places = [
            (box.x0, top - box.height * s / room, box.width, box.height * s / room)
            for top, s in zip(tops, shares, strict=True)
        ]
        ax.set_position(places[0])
        below = [ax.figure.add_axes(place, sharex=same) for place in places[1:]]
    else:
        grid = spec.subgridspec(len(shares), 1, height_ratios=shares, hspace=0.4 * gap)
        ax.set_subplotspec(grid[0])
        below = [ax.figure.add_subplot(grid[i], sharex=same) for i in range(1, len(shares))]
    for axes in below:
        tidy(axes)
    for axes in [ax, *below][:-1] if share else ():
        axes.tick_params(labelbottom=False)
    return below


def panels_of_lines(
    ax: Any,
    x: Any,
    panels: dict[str, dict[str, Any]],
    xlabel: str,
    *,
    share: float = 1.0,
    dashed: tuple[str, ...] = (),
) -> Any:
    """Draw lines over x in panels one below the other and return the top axes.

    Args:
        ax: axes whose area the panels share.
        x: abscissas of all lines.
        panels: {ordinate with unit: {name of a line: values}}, from the top.
        xlabel: label of the common abscissa, with unit.
        share: height of each further panel, relative to the first.
        dashed: lines whose names begin with one of these are dashed and thin.
    """
    every = [ax, *axes_below(ax, *[share] * (len(panels) - 1))]
    for axes, (label, lines) in zip(every, panels.items(), strict=True):
        for i, (name, values) in enumerate(lines.items()):
            thin = bool(dashed) and name.startswith(dashed)
            axes.plot(
                x,
                values,
                label=name,
                **style(i) | ({"ls": "--", "lw": 1.0} if thin else {"lw": 1.5}),
            )
        axes.set_ylabel(label)
        legend(axes, 0 if all(label.startswith(f"{name} [") for name in lines) else len(lines))
    every[-1].set_xlabel(xlabel)
    return ax


def panels_of_marks(ax: Any, panels: dict[str, dict[str, Any]], names: tuple[str, ...]) -> Any:
    """Draw one mark per named quantity in panels one below the other and return the top axes.

    Args:
        ax: axes whose area the panels share.
        panels: {ordinate with unit: {name of a series: one value per name}}, from the top.
        names: of the quantities, which are the ticks of the abscissa.
    """
    every = [ax, *axes_below(ax, *[1.0] * (len(panels) - 1))]
    for axes, (label, series) in zip(every, panels.items(), strict=True):
        for i, (name, values) in enumerate(series.items()):
            # marks of equal numbers are drawn side by side
            offset = 0.5 * ((i + 0.5) / len(series) - 0.5)
            mark = {"marker": MARKERS[i % len(MARKERS)], "color": COLORS[i % len(COLORS)]}
            axes.plot(np.arange(len(names)) + offset, values, ls="none", ms=5, label=name, **mark)
        axes.axhline(0.0, color=GRAY, lw=0.8, zorder=1)
        axes.set_ylabel(label)
        legend(axes, len(series) if len(series) > 1 and axes is ax else 0)
    every[-1].set_xticks(range(len(names)), names, fontsize=8)
    every[-1].set_xlim(-0.6, len(names) - 0.4)
    if max(map(len, names)) * len(names) > ROOM:
        slanted(every[-1])
    return ax


def heat_map(
    ax: Any,
    size: tuple[float, float],
    values: np.ndarray,
    rows: list[str],
    columns: list[str],
    limits: tuple[float, float],
    title: str,
    *,
    digits: int = 1,
    least: float = 0.0,
    slant: bool = False,
) -> Any:
    """Draw a matrix as colored cells with their numbers and return the axes.

    Args:
        ax: axes to draw into; None makes a new figure.
        size: width and height of a new figure [in].
        values: the matrix.
        rows, columns: names of its rows and columns.
        limits: values of the ends of the color scale: blue to red about zero if the first is
            negative, else white to blue.
        title: title of the axes.
        digits: digits after the decimal point.
        least: numbers of a smaller magnitude are not written.
        slant: whether the names of the columns are slanted.
    """
    ax = axes_or_new(ax, *size)
    from matplotlib.colors import Normalize

    signed, scale = limits[0] < 0, Normalize(*limits, clip=True)
    ax.grid(False)
    image = ax.imshow(
        np.clip(values, *limits), cmap="RdBu_r" if signed else "Blues", norm=scale, aspect="auto"
    )
    for (i, j), value in np.ndenumerate(values):
        if np.isfinite(value) and abs(value) >= least:
            r, g, b, _ = image.cmap(scale(value))
            color = "white" if 0.2126 * r + 0.7152 * g + 0.0722 * b < DARK else INK
            ax.text(j, i, f"{value:.{digits}f}", ha="center", va="center", fontsize=8, color=color)
    ax.set_xticks(range(len(columns)), columns, fontsize=8)
    ax.set_yticks(range(len(rows)), rows, fontsize=8)
    ax.set_xticks(np.arange(len(columns) - 1) + 0.5, minor=True)
    ax.set_yticks(np.arange(len(rows) - 1) + 0.5, minor=True)
    ax.grid(which="minor", color="white", lw=1.5)
    ax.tick_params(which="both", length=0)
    ax.spines[:].set_visible(False)
    ax.set_title(title, fontsize=9)
    if slant:
        slanted(ax)
    return ax


def slanted(ax: Any) -> None:
    """Slant the labels of the abscissa, so that long names fit."""
    for text in ax.get_xticklabels():
        text.set(rotation=40, ha="right", rotation_mode="anchor")


def pale(color: str) -> str:
    """Return the color "#rrggbb" mixed half and half with white. It is opaque, so that overlapping
    points do not get darker."""
    return "#" + "".join(f"{(part + 255) // 2:02x}" for part in rgb(color))


def style(i: int) -> dict[str, Any]:
    """Return color and dash pattern of the i-th line. The first 32 lines all differ; of eight
    successive lines, any two with the same dash pattern differ in gray print too."""
    return {"color": COLORS[i % len(COLORS)], "ls": DASHES[(i // 4 + i // 16) % len(DASHES)]}


def legend(ax: Any, count: int, **options: Any) -> None:
    """Add a legend to the right of the axes, with enough columns to stay within their height.

    Args:
        ax: the axes.
        count: number of entries; with 0 there is no legend.
        options: further options of matplotlib's `legend`.
    """
    if count:
        rows = max(int(ax.get_position().height * ax.figure.get_figheight() / NAME), 4)
        options |= {
            "ncols": -(-count // rows),
            "frameon": False,
            "fontsize": 8,
            "title_fontsize": 8,
            "handlelength": 2.4,
            "columnspacing": 1.0,
        }
        place = {"loc": "upper left", "bbox_to_anchor": (1.0, 1.0), "borderaxespad": 0.2}
        ax.legend(**place | options)


def with_unit(what: str, unit: str) -> str:
    """Return the label "what [unit]" of an axis; the unit is "-" if `unit` is empty."""
    return f"{what} [{unit or '-'}]"


def of_one(array: str, ndim: int) -> Callable[[Draw], Draw]:
    """Return a decorator of plots whose first argument is one result, neither a batch nor traced.

    Args:
        array: name of an array of the result.
        ndim: its number of dimensions in one result.

    Errors of the plot: BAD_SHAPE, TRACED."""

    def of_plot(draw: Draw) -> Draw:
        first = next(iter(draw.__annotations__))

        @wraps(draw)
        def checked(*given: Any, **named: Any) -> Any:
            result = given[0] if given else named[first]
            check_single(f"{draw.__name__}.{first}", getattr(result, array), ndim)
            return draw(*given, **named)

        return checked  # pyright: ignore[reportReturnType]

    return of_plot


def check_single(where: str, values: Any, ndim: int) -> None:
    """Check that a plot is given one result, neither a batch nor a traced one.

    Args:
        where: function and argument, for the message.
        values: an array of the result.
        ndim: its number of dimensions in one result.

    Errors: BAD_SHAPE, TRACED."""
    if not is_concrete(values):
        raise JaxbodyError(
            Problem(
                "TRACED",
                where,
                "has no numbers yet inside jit or vmap",
                hint="Draw what the compiled or batched function returns.",
            )
        )
    if np.ndim(values) != ndim:
        raise JaxbodyError(
            Problem(
                "BAD_SHAPE",
                where,
                f"is a batch of {len(values)} results",
                limit="one result",
                hint="Draw one of them: jax.tree.map(lambda x: x[0], results).",
            )
        )
