"""What is measured, channel by channel: how far a reading is from a measured one, which samples are missing, how noise is on it."""

from typing import Any, ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float


class Channel(eqx.Module):
    """The base of sensors and of the channels of other measurements.

    `shape` of a reading and `noise_shape` of a residual; `unit` of either, where there are several by commas: noise has a number for each."""

    shape: eqx.AbstractClassVar[tuple[int, ...]]
    unit: eqx.AbstractClassVar[str]
    series: ClassVar[bool] = True  # samples follow one another: neighbors may be correlated, and there are enough to tell their noise
    parts: ClassVar[tuple[str, ...]] = ()  # what the components of each unit are called, where there are several units

    def residual(self, reading: Array, measured: Array) -> Float[Array, "*r"]:
        """Reading less measured, zero where a sample is missing."""
        return jnp.where(self.missing(measured), 0.0, reading - measured)

    def missing(self, measured: Any) -> Any:
        """Which components of a residual lack their sample, being NaN."""
        return np.isnan(measured) if isinstance(measured, np.ndarray) else jnp.isnan(measured)

    def spread(self, level: Any) -> Any:
        """Noise levels, one number or one for each unit, as they belong to the components of a residual."""
        return level if self.units == 1 else jnp.repeat(jnp.broadcast_to(level, (self.units,)), self.noise_shape[-1] // self.units)

    def pooled(self, x: Any) -> Any:
        """The sum of components of residuals of one unit, over all samples: one number, or one for each unit."""
        return x.sum() if self.units == 1 else x.reshape(-1, self.units, self.noise_shape[-1] // self.units).sum((0, 2))

    @property
    def noise_shape(self) -> tuple[int, ...]:
        return self.shape

    @property
    def units(self) -> int:
        """How many units there are, each of as many components that follow one another."""
        return self.unit.count(",") + 1
