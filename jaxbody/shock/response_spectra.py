"""The base class of response spectra: the largest response of oscillators to one base acceleration,
over frequency and damping ratio."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from jaxbody.core import tables
from jaxbody.core.arrays import Array, Float, checked, concrete, device_array, float_array
from jaxbody.core.errors import Problems

ROUNDING = 1e-9  # relative, of frequencies at the ends of what a spectrum covers


class ResponseSpectrum(tables.Printed, eqx.Module):
    """The base of response spectra: `spectrum(frequencies, damping)` is the pseudo-acceleration w^2
    max|x| [m/s2] at frequencies [Hz] and damping ratios, of oscillators x'' + 2 zeta w x' + w^2
    x = -a. Yours states `__call__` and `covers`.

    >>> class Plateau(ResponseSpectrum):
    ...     level: float
    ...     def __call__(self, frequencies, damping=0.05):
    ...         return self.level * jnp.sqrt(0.05 / damping) * jnp.ones(jnp.shape(frequencies))
    ...     def covers(self):
    ...         return 0.5, 20.0
    >>> print(Plateau(3.0))
    Plateau
               value
      lowest     0.5  Hz
      highest     20  Hz
    <BLANKLINE>
    """

    def _tables(self) -> list[tables.PrintedTable]:
        rows = [
            (end, float(f), "Hz")
            for end, f in zip(("lowest", "highest"), self.covers(), strict=True)
        ]
        return [tables.PrintedTable(type(self).__name__, ("", "value", ""), rows)]

    @abstractmethod
    def __call__(self, frequencies: Any, damping: Any = 0.05) -> Float[Array, "*n"]: ...

    @abstractmethod
    def covers(self) -> tuple[Any, Any]:
        """The lowest and the highest frequency [Hz] at which it is known; above the second its
        value is that of a rigid body."""

    def dampings(self) -> tuple[Any, Any]:
        """The least and the largest damping ratio for which it is known."""
        return 0.0, 1.0

    def rigid(self) -> Float[Array, ""]:
        """The acceleration of a rigid body, which is the peak of the base acceleration [m/s2]: the
        value at the highest frequency."""
        return self(self.covers()[1], self.dampings()[0])


def check_dampings(given: Any, where: str, problems: Problems) -> Any:
    """Damping ratios, one or several, from 0 to below 1; None if they are not, with a problem
    added. Errors: NOT_A_FRACTION, BAD_SHAPE."""
    array = problems.gather(lambda: float_array(given, where))
    if array is None:
        return None
    array = checked(
        array,
        ((), (max(array.size, 1),)),
        where,
        problems,
        "Give one damping ratio, or several in one row.",
    )
    known = None if array is None else concrete(array)
    if known is not None and (wrong := (known < 0) | (known >= 1)).any():
        value = float(np.ravel(known)[np.flatnonzero(wrong)[0]])
        hint = (
            f"Give {value / 100:g} for {value:g} percent."
            if 1 <= value < 100
            else "It is a fraction of the critical damping."
        )
        problems.add(
            "NOT_A_FRACTION", where, f"is {value:g}", value=value, limit="0 to below 1", hint=hint
        )
        return None
    return array


def log_interpolated(
    x: Float[Array, "*n"], at: Float[Array, "k"], values: Float[Array, "k"]
) -> Float[Array, "*n"]:
    """Straight lines in logarithms of both, constant outside; exact at the points."""
    tiny = jnp.finfo(values.dtype).tiny
    return jnp.exp(jnp.interp(jnp.log(x), jnp.log(at), jnp.log(jnp.maximum(values, tiny))))


def as_rows(given: Any) -> Float[Array, "*n"]:
    """Frequencies, or other numbers along them, as an array of the present precision."""
    return device_array(float_array(given, "frequencies"))
