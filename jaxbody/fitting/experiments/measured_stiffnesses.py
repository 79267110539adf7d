"""Measured dynamic stiffness of an element for fits: magnitude and loss angle by frequency, as in
the data sheet of a mount."""

from typing import Any

import equinox as eqx
import numpy as np

from jaxbody.core.arrays import Array, Float, device_array, float_array, scalar
from jaxbody.core.errors import Problems, unknown
from jaxbody.fitting.experiments.measurements import (
    ByFrequency,
    NumberChannel,
    check_rows,
    noise_of,
)
from jaxbody.vibration.dynamic_stiffnesses import dynamic_stiffness
from jaxbody.vibration.frequency_responses import check_frequencies

UNITS = {"magnitude": "N/m", "loss_angle": "rad"}


class MeasuredStiffness(ByFrequency):
    """The measured dynamic stiffness of one element. Only this element of the model is used.

    Args:
        element: name of the element
        frequencies: [Hz] (nf,)
        magnitude: |K| (nf,) [N/m, N m/rad], NaN for frequencies to leave out
        loss_angle: angle of K (nf,) [rad], likewise; without both, a plan of those in `noise`
        amplitude: amplitude of the deformation [m, rad], as in `dynamic_stiffness`; by default
            small
        preload: static force or moment [N, N m], by default 0
        direction: direction of a Mount: x, y, z, rx, ry or rz
        noise: {"magnitude": standard deviation, "loss_angle": ...}, each one number or one for each
            frequency; by default estimated

    Errors, all at once: NO_DATA, BAD_FREQUENCY, BAD_SHAPE, NON_FINITE, ALL_NAN,
    BAD_NOISE, UNKNOWN_NAME.

    >>> sheet = jb.fitting.MeasuredStiffness(
    ...     "mount",
    ...     [5.0, 10.0],
    ...     magnitude=[3.0e4, 4.6e4],
    ...     loss_angle=jnp.deg2rad(jnp.array([34.0, 36.0])),
    ... )
    >>> list(sheet.channels)
    ['magnitude', 'loss_angle']
    """

    element: str = eqx.field(static=True)
    frequencies: Float[Array, "nf"]
    amplitude: Float[Array, ""] | None
    preload: Float[Array, ""]
    direction: str | None = eqx.field(static=True)
    measured: dict[str, Float[Array, "nf"]]
    noise: dict[str, Float[Array, "..."]] | None

    def __init__(
        self,
        element: str,
        frequencies,
        *,
        magnitude=None,
        loss_angle=None,
        amplitude=None,
        preload=0.0,
        direction=None,
        noise=None,
    ):
        with Problems() as problems:
            checked = problems.gather(
                lambda: check_frequencies(frequencies, "MeasuredStiffness.frequencies")
            )
            shape = np.shape(frequencies if checked is None else checked)
            given = {"magnitude": magnitude, "loss_angle": loss_angle}
            arrays = {
                name: float_array(x, f"MeasuredStiffness.{name}")
                for name, x in given.items()
                if x is not None
            }
            if not arrays and not noise:
                problems.add(
                    "NO_DATA", "MeasuredStiffness", "has no data", limit="magnitude= or loss_angle="
                )
            for name, array in arrays.items():
                check_rows(
                    array,
                    shape,
                    f"MeasuredStiffness.{name}",
                    problems,
                    missing="frequencies to leave out",
                )
            known = arrays or {name: np.zeros(shape) for name in UNITS}
            self.noise = noise_of(noise or {}, known, "MeasuredStiffness.noise", problems) or None
            if amplitude is not None:
                amplitude = scalar(amplitude, "MeasuredStiffness.amplitude", problems)
            force = scalar(preload, "MeasuredStiffness.preload", problems)
        self.element, self.direction = str(element), direction
        self.frequencies = checked  # pyright: ignore[reportAttributeAccessIssue]
        self.amplitude = None if amplitude is None else device_array(amplitude)
        self.preload = device_array(force)
        self.measured = {name: device_array(array) for name, array in arrays.items()}

    @property
    def channels(self):
        return {name: NumberChannel(unit=UNITS[name]) for name in self.names}

    def check(self, model, where):
        with Problems() as problems:
            if self.element not in model.element_names:
                problems.collected.append(unknown(self.element, where, model.element_names))
            else:
                problems.gather(lambda: self._predicted(model))

    def _predicted(self, model) -> Any:
        return dynamic_stiffness(
            model[self.element],
            self.frequencies,
            preload=self.preload,
            amplitude=self.amplitude,
            direction=self.direction,
        )

    def readings(self, model, integration, lin):
        predicted = self._predicted(model)
        return {name: getattr(predicted, name) for name in self.names}

    def explain(self, model, integration):
        return self._predicted(model).report()
