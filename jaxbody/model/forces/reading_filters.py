"""The lag and the delay of a reading in a control loop as states: a first-order lag, and a delay
by its Pade approximation of a stated order n.

    T x' = y - x                                         a lag T, which follows the delay
    exp(-s d) = N(-s d)/N(s d),  N(x) = sum of c_j x^j   a delay d,
    c_j = (2n - j)! n!/((2n)! j! (n - j)!)
"""

from math import factorial
from typing import Any

import jax.numpy as jnp
import numpy as np

from jaxbody.core.arrays import Array, Float


def filter_states(sensor: Any, order: int) -> int:
    """Return the number of states of each component of a reading; 0 of what is no sensor."""
    late, lagged = (getattr(sensor, name, None) is not None for name in ("delay", "lag"))
    return order * late + lagged


def filtered(
    sensor: Any, order: int, y: Float[Array, "k"] | None, x: Float[Array, "k n"]
) -> tuple[Any, list[Any]]:
    """Return a reading y after its delay and lag, whose states are x, and the rates of these, as
    columns; y may be None if only the lag's state is asked for."""
    rates = []
    if sensor.delay is not None and y is not None:
        (c, out, direct), x_d = _pade(order), x[:, :order]
        last = (y - x_d @ c[:-1]) / c[-1]
        rates = [*jnp.moveaxis(x_d, 1, 0)[1:] / sensor.delay, last / sensor.delay]
        y = x_d @ out + direct * y
    if sensor.lag is not None:
        rates += [] if y is None else [(y - x[:, -1]) / sensor.lag]
        y = x[:, -1]
    return y, rates


def _pade(n: int) -> tuple[np.ndarray, np.ndarray, float]:
    """Return c_j, and C and D of y_d = C x_d + D y for the states x_d in which N(s d) x = y."""
    c = np.array(
        [
            factorial(2 * n - j) * factorial(n) / factorial(2 * n) / factorial(j) / factorial(n - j)
            for j in range(n + 1)
        ]
    )
    direct = (-1.0) ** n
    signs = (-1.0) ** np.arange(n + 1)
    return c, (c * (signs - direct))[:-1], direct
