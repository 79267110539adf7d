"""Confidence intervals of estimates: Student's t in the coordinate that a parameter moves in, mapped to its values, which so stay possible.

    value(u - t s) to value(u + t s),    s the standard error of u, t the quantile for the degrees of freedom of s

At a bound the interval has one side, by the likelihood: how far u may go from it until the cost has risen as t standard errors raise it at an optimum,
2 g d + h d^2 = t^2 h s^2, g the slope there and h the curvature with all others following.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from jaxbody.identification.fit_parameters import FreeParameter, parts_of
from jaxbody.parameters.transforms import Elementwise
from jaxbody.statistics.quantiles import quantile
from jaxbody.statistics.uncertainties import Uncertainty

Interval = tuple[np.ndarray, np.ndarray]
FEW = 13  # degrees of freedom, below which Student's t widens intervals of 95 % by more than a tenth


def interval_of_u(u: np.ndarray, uncertainty: Uncertainty, level: float) -> Interval:
    """(lower, upper) of each u, unbounded where the data cannot tell."""
    error, freedom = uncertainty.spread(np.eye(len(u)))
    far = quantile(level, freedom) * error
    low, high = u - far, u + far
    for i, (slope, curvature, error, freedom) in uncertainty.pressed.items():
        t = float(quantile(level, freedom, sides=1))
        away = t**2 * error**2 * curvature / (abs(slope) + np.sqrt(slope**2 + (t * error * curvature) ** 2))
        low[i], high[i] = (u[i], u[i] + away) if slope > 0 else (u[i] - away, u[i])
    return low, high


def intervals_of(
    free: tuple[FreeParameter, ...], u: np.ndarray, values: dict[str, Any], uncertainty: Uncertainty, level: float
) -> dict[str, Interval]:
    """{path: (lower, upper)}, arrays like the leaf; of a matrix or a direction by its elements' standard errors, which are all it has."""
    low, high = interval_of_u(u, uncertainty, level)
    found = {}
    for f, G, mine in zip(free, uncertainty.slopes, parts_of(free), strict=True):
        form = f.form
        if isinstance(form, Elementwise):
            with np.errstate(over="ignore"):
                found[f.path] = tuple(form.value(end[mine]) for end in (low, high))
            continue
        error, freedom = uncertainty.spread(G.reshape(-1, len(u)))
        value, far = np.asarray(values[f.path]), (quantile(level, freedom) * error).reshape(G.shape[:-1])
        found[f.path] = (value - far, value + far)
    return found


def freedoms_of(free: tuple[FreeParameter, ...], uncertainty: Uncertainty) -> dict[str, np.ndarray]:
    """{path: degrees of freedom}, arrays like the leaf, of the t in these intervals."""
    freedoms = {}
    for f, G, mine in zip(free, uncertainty.slopes, parts_of(free), strict=True):
        _, freedom = uncertainty.spread(G.reshape(-1, G.shape[-1]))
        if isinstance(f.form, Elementwise):
            freedom = np.array([uncertainty.pressed[i][3] if i in uncertainty.pressed else x for i, x in enumerate(freedom, mine.start)])
        freedoms[f.path] = freedom.reshape(G.shape[:-1])
    return freedoms


def widening(freedom: Any, level: float) -> str:
    """What Student's t makes of intervals with few degrees of freedom, in words; nothing where these are many."""
    least = np.min(freedom, initial=np.inf)
    if not least < FEW:
        return ""
    times, what = quantile(level, least) / quantile(level, np.inf), "degree" if f"{least:.3g}" == "1" else "degrees"
    return f"intervals are of Student's t: {least:.3g} {what} of freedom, which widen them {times:.2g} times, as the noise is known from few independent numbers"
