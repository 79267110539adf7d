"""What any measurement says of itself, be it in time, in frequency or of modes, so that fits treat all alike."""

from abc import abstractmethod
from collections.abc import Mapping
from typing import Any

import equinox as eqx
import numpy as np
from jaxtyping import Array

from jaxbody.sensors.channels import Channel


class Measurement(eqx.Module):
    """The base of what a model is fitted to: `measured` numbers by channel, `noise`, their standard deviations where stated, and `readings`,
    what a model says in their place."""

    measured: eqx.AbstractVar[dict[str, Array]]
    noise: eqx.AbstractVar[dict[str, Array] | None]

    @property
    @abstractmethod
    def channels(self) -> Mapping[str, Channel]: ...

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

    @abstractmethod
    def axis(self, channel: str) -> tuple[str, Array | np.ndarray, str]:
        """What the rows of a channel's record are over: its name, values, unit."""

    @abstractmethod
    def place(self, row: int) -> tuple[str, float]:
        """Where a row of `measured` is, in words and as a number."""

    def present(self, name: str) -> np.ndarray:
        """Which components of the residuals of a channel have their samples."""
        return ~self.channels[name].missing(np.asarray(self.measured[name]))
