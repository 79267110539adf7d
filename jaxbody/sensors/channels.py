"""Measured channels: residuals between readings and measured values, missing samples, components of
the noise."""

import math
from typing import Any, ClassVar

import equinox as eqx

from jaxbody.core.arrays import Array, Float, module_of
from jaxbody.geometry.points_and_orientations import DIRECTIONS


class Channel(eqx.Module):
    """The base class of sensors and of the channels of other measurements.

    `shape` is that of a reading, `noise_shape` that of a residual. `unit` is that of both; it may
    hold several, separated by commas, and noise then has one number for each."""

    shape: eqx.AbstractClassVar[tuple[int, ...]]
    unit: eqx.AbstractClassVar[str]
    # a time series: neighbors may be correlated, and there are enough samples to estimate the noise
    series: ClassVar[bool] = True
    # names of the groups of components, where there are several units
    parts: ClassVar[tuple[str, ...]] = ()

    def residual(self, reading: Array, measured: Array) -> Float[Array, "*r"]:
        """Reading minus measured, zero where a sample is missing."""
        return module_of(reading, measured).where(self.missing(measured), 0.0, reading - measured)

    def missing(self, measured: Any) -> Any:
        """True for components of a residual whose sample is missing (NaN)."""
        return module_of(measured).isnan(measured)

    def spread(self, level: Any) -> Any:
        """Noise levels of the components of a residual, from one number or one for each unit;
        several as a row of the samples."""
        if self.units == 1:
            return level
        xp = module_of(level)
        return xp.repeat(xp.broadcast_to(level, (self.units,)), self.noise_shape[-1] // self.units)[
            None
        ]

    def pooled(self, x: Any) -> Any:
        """The sum of the components of residuals over all samples: one number for each unit."""
        return (
            x.sum()
            if self.units == 1
            else x.reshape(-1, self.units, self.noise_shape[-1] // self.units).sum((0, 2))
        )

    @property
    def noise_shape(self) -> tuple[int, ...]:
        return self.shape

    @property
    def components(self) -> tuple[str, ...]:
        """The names of the components of a residual: "" for a single number, "x" to "rz" for up to
        six, else their numbers."""
        shape = self.noise_shape
        if not shape:
            return ("",)
        count = math.prod(shape)
        return DIRECTIONS[:count] if count <= len(DIRECTIONS) else tuple(map(str, range(count)))

    def unit_on(self, model: Any) -> str:
        """The unit on a model, where it depends on the kind of an element."""
        return self.unit

    @property
    def possible_units(self) -> tuple[str, ...]:
        """The units that it may have, depending on the kind of an element."""
        return (self.unit,)

    @property
    def units(self) -> int:
        """The number of units, each of the same number of consecutive components."""
        return self.unit.count(",") + 1
