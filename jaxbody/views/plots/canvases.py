"""Axes, panels, colors and legends that all plots share. matplotlib is imported when something
is drawn."""

from typing import Any, NamedTuple

import numpy as np

from jaxbody.core.arrays import is_concrete
from jaxbody.core.errors import JaxbodyError, Problem

# Any four successive colors differ in luminance and thus in gray print; the color-blind can
# distinguish all of them
COLORS = ("#1871bc", "#e0803a", "#8e0523", "#dbb72d", "#09663e", "#8470f1", "#292a6d", "#3db5ad")
GRAY, LIGHT, INK = "#8a8f98", "#dfe4ea", "#2b2f36"
DASHES = ("-", (0, (6, 1.5)), (0, (3, 1, 1, 1)), (0, (1, 1)))  # one for each four lines
MARKERS = "osD^vP*X"  # of series of marks
NAME = 0.165  # height of a line of a legend [in]
DARK = 0.5  # brightness of a cell below which its number is white
ROOM = 50  # number of letters that fit side by side below axes of usual width
WIDTH, HEIGHT = 0.62, 1.3  # size of a letter, relative to the font size
# points, trial distances from an object to the edge of its label
RINGS = (4.0, 8.0, 13.0, 20.0, 30.0, 42.0, 56.0)
ANGLES = np.deg2rad(np.arange(0, 360, 22.5))
STEP = 2.5  # points, distance of the sample points along drawn lines
CLEAR = 3.0  # points, clearance between a label and a line or another label
FAR = 16.0  # points, distance beyond which a thin line leads to the label


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


def rgb(color: str) -> tuple[int, ...]:
    """Return red, green and blue of "#rrggbb", from 0 to 255."""
    return tuple(bytes.fromhex(color[1:]))


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
            "handlelength": 2.4,
            "columnspacing": 1.0,
        }
        ax.legend(**options, loc="upper left", bbox_to_anchor=(1.0, 1.0), borderaxespad=0.2)


def with_unit(what: str, unit: str) -> str:
    """Return the label "what [unit]" of an axis; the unit is "-" if `unit` is empty."""
    return f"{what} [{unit or '-'}]"


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


class Label(NamedTuple):
    """A name to be written: position of the named object and preferred direction from there, both
    in data coordinates; font size [points] and color."""

    name: str
    at: np.ndarray
    toward: np.ndarray
    size: float
    color: str


def annotate(ax: Any, labels: list[Label]) -> None:
    """Write labels where they cover as little as possible of what the axes already contain."""
    from matplotlib.patheffects import withStroke

    if not labels:
        return
    scale = 72 / ax.figure.dpi
    covered = np.concatenate(
        [_points_along(scale * ax.transData.transform(shape)) for shape in _drawn(ax)]
    ).T
    taken = scale * np.array(
        [[*box.min, *box.max] for box in (text.get_window_extent() for text in ax.texts)]
    ).reshape(-1, 4)
    for label in labels:
        at = scale * ax.transData.transform(label.at)
        half = 0.5 * label.size * np.array([WIDTH * len(label.name), HEIGHT])
        offsets, reach, costs = _places(label.toward, half)
        low, high = at + offsets - half, at + offsets + half
        (left, bottom), (right, top) = low.T[..., None] - CLEAR, high.T[..., None] + CLEAR
        costs = costs + 20 * np.sum(
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
            label.name,
            label.at,
            xytext=offsets[best],
            textcoords="offset points",
            fontsize=label.size,
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


def _places(toward: np.ndarray, half: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return trial offsets of the center of a label of half size `half`, their distances from the
    object [points] and their costs.

    The cost grows with the distance and with the angle from the direction `toward`."""
    reach, turn = (
        x.ravel()
        for x in np.meshgrid(RINGS, ANGLES + np.arctan2(toward[1], toward[0]), indexing="ij")
    )
    direction = np.stack([np.cos(turn), np.sin(turn)], -1)
    away = 1 - direction @ toward / (np.linalg.norm(toward) or 1.0)
    # from the center to the edge of the label, in this direction
    edge = np.min(half / np.maximum(np.abs(direction), 1e-9), -1)
    return (reach + edge)[:, None] * direction, reach, 0.15 * reach + away
