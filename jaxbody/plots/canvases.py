"""Axes, colors and legends that all plots share. matplotlib is imported when something is drawn."""

from __future__ import annotations

from typing import Any

from jaxbody.core.errors import JaxbodyError, unknown

COLORS = ("#1f6fb4", "#d9661f", "#2f8f4e", "#8a4fbf", "#b8344a", "#7a6a4f", "#1c9a9a", "#c79a1a")
GRAY, LIGHT, INK = "#8a8f98", "#dfe4ea", "#2b2f36"
DASHES = ("-", (0, (6, 1.5)), (0, (3, 1, 1, 1)), (0, (1, 1)))  # each eight lines repeat the colors with the next dash pattern
NAME = 0.165  # in, height of a line of a legend


def axes_or_new(ax: Any, width: float, height: float) -> Any:
    """The given axes, or those of a new figure of this size [in], in the common style."""
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


def axes_below(ax: Any, *heights: float) -> list[Any]:
    """Split the area of `ax` and add axes below it, one below the other; `heights` are relative to the remaining height of `ax`."""
    spec, shares = ax.get_subplotspec(), (1.0, *heights)
    if spec is None:
        box, room = ax.get_position(), sum(shares) + 0.15 * len(heights)
        tops = [box.y1 - box.height * (sum(shares[:i]) + 0.15 * i) / room for i in range(len(shares))]
        places = [
            (box.x0, top - box.height * share / room, box.width, box.height * share / room) for top, share in zip(tops, shares, strict=True)
        ]
        ax.set_position(places[0])
        below = [ax.figure.add_axes(place, sharex=ax) for place in places[1:]]
    else:
        grid = spec.subgridspec(len(shares), 1, height_ratios=shares, hspace=0.06)
        ax.set_subplotspec(grid[0])
        below = [ax.figure.add_subplot(grid[i], sharex=ax) for i in range(1, len(shares))]
    for axes in below:
        tidy(axes)
    for axes in [ax, *below][:-1]:
        axes.tick_params(labelbottom=False)
    return below


def pale(color: str) -> str:
    """The color, halfway to white and opaque, for points under a line: overlapping points do not get darker."""
    return "#" + "".join(f"{(int(color[i : i + 2], 16) + 255) // 2:02x}" for i in (1, 3, 5))


def style(i: int) -> dict[str, Any]:
    """Color and dash pattern of the i-th line; the first 32 all differ."""
    return {"color": COLORS[i % len(COLORS)], "ls": DASHES[i // len(COLORS) % len(DASHES)]}


def legend(ax: Any, count: int, **options: Any) -> None:
    """A legend to the right of the axes, with enough columns to stay within their height."""
    if count:
        rows = max(int(ax.get_position().height * ax.figure.get_figheight() / NAME), 4)
        options |= {"ncols": -(-count // rows), "frameon": False, "fontsize": 8, "handlelength": 2.4, "columnspacing": 1.0}
        ax.legend(**options, loc="upper left", bbox_to_anchor=(1.0, 1.0), borderaxespad=0.2)


def check_known(names: tuple[str, ...], known: tuple[str, ...], where: str) -> None:
    """Raise one error that lists UNKNOWN_NAME for each unknown name."""
    problems = [unknown(name, where, known) for name in names if name not in known]
    if problems:
        raise JaxbodyError(*problems)
