"""What all pictures share: axes, colors, legends. matplotlib is imported when something is drawn."""

from __future__ import annotations

from typing import Any

from jaxbody.errors import JaxbodyError
from jaxbody.models import unknown

COLORS = ("#1f6fb4", "#d9661f", "#2f8f4e", "#8a4fbf", "#b8344a", "#7a6a4f", "#1c9a9a", "#c79a1a")
GRAY, LIGHT, INK = "#8a8f98", "#dfe4ea", "#2b2f36"
MOST_LINES = 8  # with names in a legend


def axes_or_new(ax: Any, width: float, height: float) -> Any:
    """The axes given, or those of a new figure of this size [in], tidied."""
    if ax is None:
        import matplotlib.pyplot as plt

        _, ax = plt.subplots(figsize=(width, height), layout="constrained")
    tidy(ax)
    return ax


def tidy(ax: Any) -> None:
    """No frame above and to the right, a pale grid."""
    ax.spines[["top", "right"]].set_visible(False)
    ax.grid(True, color="#e8e8e8", lw=0.6)
    ax.set_axisbelow(True)


def axes_below(ax: Any, height: float) -> Any:
    """Axes below others, in the room that those had; `height` is relative to what remains of them."""
    spec = ax.get_subplotspec()
    if spec is None:
        box = ax.get_position()
        upper = box.height / (1 + height + 0.15)
        ax.set_position((box.x0, box.y1 - upper, box.width, upper))
        below = ax.figure.add_axes((box.x0, box.y0, box.width, height * upper), sharex=ax)
    else:
        upper, lower = spec.subgridspec(2, 1, height_ratios=(1, height), hspace=0.06)
        ax.set_subplotspec(upper)
        below = ax.figure.add_subplot(lower, sharex=ax)
    tidy(below)
    return below


def pale(color: str) -> str:
    """The color, half way to white: of points under a line, opaque, so that many of them don't darken to it."""
    return "#" + "".join(f"{(int(color[i : i + 2], 16) + 255) // 2:02x}" for i in (1, 3, 5))


def legend(ax: Any, count: int, **options: Any) -> None:
    """Names beside the axes, unless they are too many."""
    if 0 < count <= MOST_LINES:
        ax.legend(**options, frameon=False, fontsize=8, loc="upper left", bbox_to_anchor=(1.0, 1.0), borderaxespad=0.2)


def check_known(names: tuple[str, ...], known: tuple[str, ...], where: str) -> None:
    problems = [unknown(name, where, known) for name in names if name not in known]
    if problems:
        raise JaxbodyError(*problems)
