"""Confidence intervals of estimates: Student's t for the transformed parameter u, mapped to values
of the parameter so that these stay physically possible.

    value(u - t s) to value(u + t s),    s the standard error of u, t the quantile for the degrees
                                         of freedom of s

At a bound the interval has one side and follows from the likelihood. It ends at the distance d of u
from the bound over which the cost increases as much as over t standard errors at an optimum:

    2 g d + h d^2 = t^2 h s^2

with slope g and curvature h of the cost at the bound when the other parameters are adjusted.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from jaxbody.fitting.parameters.spaces import Space
from jaxbody.fitting.parameters.transforms import Elementwise
from jaxbody.fitting.statistics.uncertainties import Uncertainty, quantile

Interval = tuple[np.ndarray, np.ndarray]
FEW = 13  # degrees of freedom below which Student's t widens 95 % intervals by more than a tenth


def interval_of_u(u: np.ndarray, uncertainty: Uncertainty, level: float) -> Interval:
    """Return (lower, upper) of each u, infinite where the data do not determine it."""
    error, freedom = uncertainty.spread(np.eye(len(u)))
    half_width = quantile(level, freedom) * error
    low, high = u - half_width, u + half_width
    for i, (slope, curvature, error, freedom) in uncertainty.at_bounds.items():
        t = float(quantile(level, freedom, sides=1))
        distance = (
            t**2
            * error**2
            * curvature
            / (abs(slope) + np.sqrt(slope**2 + (t * error * curvature) ** 2))
        )
        low[i], high[i] = (u[i], u[i] + distance) if slope > 0 else (u[i] - distance, u[i])
    return low, high


def intervals_of(
    space: Space, u: np.ndarray, values: dict[str, Any], uncertainty: Uncertainty, level: float
) -> dict[str, Interval]:
    """Return {path: (lower, upper)}, arrays of the shape of the leaf. Intervals of the elements of
    a matrix or a direction are computed from their own standard errors."""
    low, high = interval_of_u(u, uncertainty, level)
    intervals = {}
    for (parameter, own), G in zip(space.parts, uncertainty.slopes, strict=True):
        if isinstance(parameter.form, Elementwise):
            with np.errstate(over="ignore"):
                intervals[parameter.path] = tuple(
                    np.asarray(parameter.form.value(end[own])) for end in (low, high)
                )
        else:
            error, freedom = uncertainty.spread(G.reshape(-1, len(u)))
            value, half_width = (
                np.asarray(values[parameter.path]),
                (quantile(level, freedom) * error).reshape(G.shape[:-1]),
            )
            intervals[parameter.path] = (value - half_width, value + half_width)
    return intervals


def freedoms_of(space: Space, uncertainty: Uncertainty) -> dict[str, np.ndarray]:
    """Return {path: degrees of freedom} of Student's t in these intervals, arrays of the shape of
    the leaf."""
    freedoms = {}
    for (parameter, own), G in zip(space.parts, uncertainty.slopes, strict=True):
        _, freedom = uncertainty.spread(G.reshape(-1, G.shape[-1]))
        if isinstance(parameter.form, Elementwise):
            freedom = np.array(
                [
                    uncertainty.at_bounds[i][3] if i in uncertainty.at_bounds else x
                    for i, x in enumerate(freedom, own.start)
                ]
            )
        freedoms[parameter.path] = freedom.reshape(G.shape[:-1])
    return freedoms


def widening(freedom: Any, level: float) -> str:
    """Return a note by how much few degrees of freedom widen the intervals, "" if there are
    many."""
    least = np.min(freedom, initial=np.inf)
    if not least < FEW:
        return ""
    times, degrees = (
        quantile(level, least) / quantile(level, np.inf),
        "degree" if f"{least:.3g}" == "1" else "degrees",
    )
    return (
        f"intervals use Student's t with {least:.3g} {degrees} of freedom, which makes them "
        f"{times:.2g} times wider, because the noise is estimated from few independent samples"
    )
