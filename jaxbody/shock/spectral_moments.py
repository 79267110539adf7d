"""Spectral moments of random responses, lambda_k = int w^k S dw, and the rates of crossings that
follow from them (S. O. Rice, 1945)."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np

from jaxbody.core.arrays import Array, Float, checked, device_array, float_array
from jaxbody.core.errors import JaxbodyError, Problem, Problems, unknown
from jaxbody.vibration.random_responses import RandomResponse


def moments(response: RandomResponse, *orders: int) -> tuple[Float[Array, "ny"], ...]:
    """The moments of these orders, of w [rad/s]; infinite where the variance is."""
    w = 2 * jnp.pi * response.frequencies
    sums = (jnp.sum(response.psd * (response.weights * w**k)[..., None, :], -1) for k in orders)
    return tuple(jnp.where(jnp.isinf(response.rms), jnp.inf, each) for each in sums)


def check_response(response: Any, where: str) -> None:
    """Refuse what is no random response. Error: WRONG_KIND."""
    if not isinstance(response, RandomResponse):
        message, hint = f"is a {type(response).__name__}", "Give the result of random_response."
        raise JaxbodyError(
            Problem("WRONG_KIND", where, message, response, "a RandomResponse", hint)
        )


def level_crossings(response: RandomResponse, output: str, levels: Any) -> Float[Array, "*n"]:
    """How often a second a Gaussian output crosses levels upward, from its mean of zero [1/s].

        nu(b) = sqrt(lambda_2/lambda_0)/(2 pi) exp(-b^2/(2 lambda_0))

    Crossings downward are as many. The second moment needs the band of the response to contain all
    of the output's velocity.

    Args:
        response: a result of `random_response`.
        output: one of its outputs.
        levels: one level or several, in the unit of the output.

    Errors: UNKNOWN_NAME, WRONG_KIND, BAD_SHAPE, NON_FINITE. Source: S. O. Rice, Bell System Tech.
    J. 24 (1945) 46.

    >>> car = jb.presets.quarter_car(damping=1500.0)
    >>> ride = random_response(
    ...     linearize(car, car.reference),
    ...     Band(0.1, 50.0),
    ...     {"road": BaseMotion("road", "z")},
    ...     {"travel": Elongation("suspension")},
    ...     {"road": Unevenness.iso("C").at_speed(20.0)},
    ... )
    >>> rates = level_crossings(ride, "travel", [0.0, 2 * ride["travel"]])
    >>> round(float(rates[1] / rates[0]), 6)  # exp(-2)
    0.135335
    """
    check_response(response, "level_crossings.response")
    with Problems() as problems:
        if output not in response.outputs:
            problems.collected.append(unknown(output, "level_crossings.output", response.outputs))
        array = problems.gather(lambda: float_array(levels, "level_crossings.levels"))
        b = (
            None
            if array is None
            else checked(array, ((), (max(1, np.size(array)),)), "level_crossings.levels", problems)
        )
    zeroth, second = (x[..., response.outputs.index(output)] for x in moments(response, 0, 2))
    return (
        jnp.sqrt(second / zeroth) / (2 * jnp.pi) * jnp.exp(-(device_array(b) ** 2) / (2 * zeroth))
    )
