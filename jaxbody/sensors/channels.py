"""What is measured, channel by channel: how far a reading is from a measured one, which samples are missing, how noise is on it."""

from abc import abstractmethod
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


class Measurement(eqx.Module):
    """The base of what a model is fitted to: `measured` numbers by channel, `noise`, their standard deviations where stated, and `readings`,
    what a model says in their place."""

    measured: eqx.AbstractVar[dict[str, Array]]
    noise: eqx.AbstractVar[dict[str, Array] | None]

    @property
    @abstractmethod
    def channels(self) -> dict[str, Channel]: ...

    @abstractmethod
    def readings(self, model: Any, integration: Any) -> dict[str, Array]:
        """{channel: array like `measured`}; NaN where the model cannot tell."""

    def residual(self, name: str, reading: Array) -> Array:
        """Reading less measured of a channel, zero where a sample is missing."""
        return self.channels[name].residual(reading, self.measured[name])

    def named(self) -> dict[str, Any]:
        """What of it has a name in paths."""
        return {}

    def absent(self) -> dict[str, str]:
        """{path: how to have it} of what would have a name in paths if it were given."""
        return {}

    def moved_rows(self, path: str, channel: str) -> Array | None:
        """(rows, parts) of booleans: which rows of a channel's record each part of a leaf of this measurement moves, none of them more than two
        parts that follow one another. None: any row."""

    def check(self, model: Any, where: str) -> None:
        """It fits the model."""

    def explain(self, model: Any, integration: Any) -> str:
        """Why readings are not finite."""
        return "the model has no finite number there"

    def axis(self, channel: str) -> tuple[str, Array | np.ndarray, str]:
        """What the rows of a channel's record are over: its name, values, unit."""
        raise NotImplementedError  # pragma: no cover

    def place(self, row: int) -> tuple[str, float]:
        """Where a row of `measured` is, in words and as a number."""
        raise NotImplementedError  # pragma: no cover

    def present(self, name: str) -> np.ndarray:
        """Which components of the residuals of a channel have their samples."""
        return ~self.channels[name].missing(np.asarray(self.measured[name]))
