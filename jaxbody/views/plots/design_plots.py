"""Plots of designs: the history of a search, a Pareto front, sensitivities as a tornado chart,
tolerances as a histogram."""

from typing import Any

import numpy as np

from jaxbody.design.fronts import Front
from jaxbody.design.sensitivity_analyses import Sensitivities
from jaxbody.design.tolerance_analyses import Tolerances
from jaxbody.design.tuning_results import Tuning
from jaxbody.views.plots.canvases import axes_or_new, legend
from jaxbody.views.scenes.colors import COLORS, GRAY, INK, LIGHT

MOST_BARS = 15


def plot_tuning(tuning: Tuning, *, ax: Any = None) -> Any:
    """Draw the objective at every trial of the best start that has a finite value: filled circles
    where all limits are met, open circles elsewhere.

    >>> car = jb.presets.quarter_car(damping=1500.0)
    >>> def trade(model):
    ...     c = model["suspension"].damping / 1500.0
    ...     return {"shake": c + 1 / c, "travel": 1 / c}
    >>> bounds = {"*.damping": (500.0, 5000.0)}
    >>> ax = jb.plots.plot_tuning(
    ...     jb.tune(
    ...         car, trade, minimize="shake", free=["suspension.damping"], bounds=bounds, starts=1
    ...     )
    ... )
    >>> ax.get_xlabel(), ax.get_ylabel()
    ('trial', 'shake')
    """
    ax = axes_or_new(ax, 6.2, 3.0)
    objective, violation = tuning.history.T
    kept = violation <= 1e-6
    count = np.arange(1, len(objective) + 1)
    ax.plot(count, objective, color=COLORS[0], lw=1.0, alpha=0.5)
    ax.plot(count[kept], objective[kept], "o", ms=4, color=COLORS[0], label="within the limits")
    if not kept.all():
        ax.plot(
            count[~kept],
            objective[~kept],
            "o",
            ms=4,
            mfc="white",
            color=COLORS[1],
            label="outside the limits",
        )
    ax.set(xlabel="trial", ylabel=tuning.minimize)
    ax.xaxis.get_major_locator().set_params(integer=True)
    legend(ax, 2)
    return ax


def plot_front(front: Front, *, ax: Any = None) -> Any:
    """Draw a Pareto front: two objectives as a line through the designs, three as points whose
    color shows the third objective.

    >>> car = jb.presets.quarter_car(damping=1500.0)
    >>> def trade(model):
    ...     c = model["suspension"].damping / 1500.0
    ...     return {"shake": c + 1 / c, "travel": 1 / c}
    >>> bounds = {"*.damping": (500.0, 5000.0)}
    >>> front = jb.pareto(
    ...     car,
    ...     trade,
    ...     minimize=["shake", "travel"],
    ...     free=["suspension.damping"],
    ...     bounds=bounds,
    ...     points=4,
    ... )
    >>> ax = jb.plots.plot_front(front)
    >>> ax.get_xlabel(), ax.get_ylabel()
    ('travel', 'shake')
    """
    ax = axes_or_new(ax, 5.0, 3.6)
    names = list(front.objectives)
    y, x = (np.asarray(front.objectives[name]) for name in names[:2])
    if len(names) == 2:
        ax.plot(x, y, "o-", ms=4, lw=1.4, color=COLORS[0])
    else:
        ax.figure.colorbar(
            ax.scatter(x, y, c=front.objectives[names[2]], cmap="viridis", s=28),
            ax=ax,
            label=names[2],
        )
    ax.set(xlabel=names[1], ylabel=names[0])
    return ax


def plot_tornado(
    sensitivities: Sensitivities, quantity: str | None = None, *, ax: Any = None
) -> Any:
    """Draw a tornado chart: the change of a quantity when each parameter decreases or increases,
    for the 15 strongest parameters, the strongest on top.

    quantity: name of the quantity; None takes the first one. Error: UNKNOWN_NAME.

    >>> car = jb.presets.quarter_car(damping=1500.0)
    >>> def trade(model):
    ...     c = model["suspension"].damping / 1500.0
    ...     return {"shake": c + 1 / c, "travel": 1 / c}
    >>> ax = jb.plots.plot_tornado(
    ...     jb.design.sensitivities(car, trade, free=["suspension.damping"]), "travel"
    ... )
    >>> ax.get_xlabel(), [text.get_text() for text in ax.get_yticklabels()]
    ('travel', ['suspension.damping'])
    """
    quantity = quantity or sensitivities.quantities[0]
    row, every = sensitivities.row(quantity), sensitivities.order(quantity)
    order = every[:MOST_BARS]
    ax = axes_or_new(ax, 7.0, 0.8 + 0.3 * max(len(order), 2))
    nominal = sensitivities.nominal[row]
    place = np.arange(len(order))
    for ends, sign, color in (
        (sensitivities.low, "less", COLORS[0]),
        (sensitivities.high, "more", COLORS[1]),
    ):
        ax.barh(
            place,
            ends[row, order] - nominal,
            left=nominal,
            color=color,
            height=0.65,
            label=f"{100 * sensitivities.change:g} % {sign}",
        )
    ax.axvline(nominal, color=INK, lw=0.8)
    ax.set_yticks(place, [sensitivities.parameters[i] for i in order], fontsize=8)
    ax.invert_yaxis()
    if len(every) > len(order):
        ax.set_title(f"the strongest {len(order)} of {len(every)} parameters", fontsize=9)
    ax.set_xlabel(quantity)
    legend(ax, 2)
    return ax


def plot_tolerances(tolerances: Tolerances, quantity: str | None = None, *, ax: Any = None) -> Any:
    """Draw a histogram of the samples of a quantity, with the normal densities predicted to first
    and second order.

    quantity: name of the quantity; None takes the first one. Error: UNKNOWN_NAME.

    >>> car = jb.presets.quarter_car(damping=1500.0)
    >>> def trade(model):
    ...     c = model["suspension"].damping / 1500.0
    ...     return {"shake": c + 1 / c, "travel": 1 / c}
    >>> ax = jb.plots.plot_tolerances(
    ...     jb.tolerances(car, trade, {"suspension.damping": 150.0}, samples=200), "travel"
    ... )
    >>> [text.get_text() for text in ax.get_legend().get_texts()]
    ['200 samples', 'first order', 'second order', 'nominal']
    """
    quantity = quantity or tolerances.quantities[0]
    row = tolerances.row(quantity)
    ax = axes_or_new(ax, 5.0, 3.2)
    samples = np.asarray(tolerances.samples)[:, row]
    samples = samples[np.isfinite(samples)]
    ax.hist(
        samples,
        40,
        density=True,
        color=LIGHT,
        edgecolor=GRAY,
        lw=0.4,
        label=f"{len(samples)} samples",
    )
    x = np.linspace(samples.min(), samples.max(), 200)
    for i, (name, mean, deviation) in enumerate(
        (
            ("first order", tolerances.nominal, tolerances.first),
            ("second order", tolerances.mean, tolerances.deviation),
        )
    ):
        m, s = float(mean[row]), float(deviation[row])
        if s > 0:
            ax.plot(
                x,
                np.exp(-0.5 * ((x - m) / s) ** 2) / (s * np.sqrt(2 * np.pi)),
                color=COLORS[i],
                lw=1.4,
                label=name,
            )
    ax.axvline(float(tolerances.nominal[row]), color=INK, lw=0.8, label="nominal")
    ax.set(xlabel=quantity, ylabel="density")
    legend(ax, 4)
    return ax
