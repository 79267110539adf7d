"""Units of plots: a finished figure, whose data are in SI, labeled in another system of units."""

from typing import Any

from jaxbody.core.printed_tables import Words, printed_unit, text_in


def label_in(figure: Any, words: Words) -> None:
    """Label the axes and texts of a figure in the printed units of `unit_words`. An axis states its
    unit at the end of its label: "displacement [m]"."""
    from matplotlib.ticker import FixedLocator, FuncFormatter

    for axes in figure.axes:
        for axis in axes._axis_map.values():
            name, _, unit = axis.get_label_text().removesuffix("]").rpartition(" [")
            new, factor = printed_unit(unit, words)
            locator = axis.get_major_locator()
            if new == unit:
                continue
            axis.set_label_text(f"{name} [{new}]")
            if not isinstance(locator, FixedLocator):  # of another axis that shares its ticks
                low, high = axis.get_view_interval()
                ticks = locator.tick_values(low * factor, high * factor)
                axis.set_major_locator(FixedLocator([tick / factor for tick in ticks]))
                axis.set_major_formatter(FuncFormatter(lambda x, _, f=factor: f"{x * f:.6g}"))
        legend = axes.get_legend()
        for text in [axes.title, *axes.texts, *(legend.get_texts() if legend else [])]:
            text.set_text(text_in(text.get_text(), words))
