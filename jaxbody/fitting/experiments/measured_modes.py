"""Measured modes for fits: natural frequencies, damping ratios, and mode shapes at sensors."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from equinox import field

from jaxbody.core.arrays import Array, Float, concrete, device_array, float_array
from jaxbody.core.errors import Problems
from jaxbody.fitting.experiments.measured_responses import equilibrium_status
from jaxbody.fitting.experiments.measurements import Measurement, noise_of
from jaxbody.sensors.channels import Channel
from jaxbody.sensors.sensors import Sensor
from jaxbody.vibration.mode_branches import mac
from jaxbody.vibration.natural_modes import modes
from jaxbody.vibration.ports import component_units, outputs_of, port_matrices

UNITS = {"frequency": "Hz", "damping_ratio": "", "shapes": ""}


class ModalChannel(Channel):
    """One number or shape for each mode."""

    series = False
    unit: str = field(static=True)  # pyright: ignore[reportIncompatibleVariableOverride]
    shape = ()


class MeasuredModes(Measurement):
    """Result of a modal test with `nm` natural modes, for a fit.

    Args:
        frequency: [Hz] (nm,); NaN for a missing number here and below.
        damping_ratio: (nm,); by default not measured.
        shapes: real mode shapes (nm, ns) at the `sensors`, in their order; by default not measured.
        sensors: {name: sensor} of positions or rotations; of several numbers each component is a
            column of `shapes`.
        number: the mode of the model that each measured mode is compared with, 0 for the lowest; by
            default 0 to nm - 1.
        pairing: "order" for the modes of `number`; "mac" for the mode with the highest modal
            assurance criterion at the sensors.
        noise: standard deviations {"frequency": [Hz], "damping_ratio": ..., "shapes": ...}, each
            one number or one for each measured number; by default estimated from the residuals.

    Scale and sign of shapes do not matter: a measured shape x/|x| is compared with the nearest
    multiple of the shape of the model.

    Errors, all at once: NO_DATA, BAD_SHAPE, BAD_FREQUENCY, NON_FINITE, ALL_NAN, BAD_NOISE,
    UNKNOWN_NAME, WRONG_KIND, BAD_PAIRING.

    >>> test = MeasuredModes(
    ...     frequency=[0.8, 2.1], damping_ratio=[0.01, np.nan], noise={"frequency": 0.01}
    ... )
    >>> list(test.channels)
    ['frequency', 'damping_ratio']
    """

    linear = True
    measured: dict[str, Float[Array, "nm ..."]]
    noise: dict[str, Float[Array, "..."]] | None
    sensors: dict[str, Sensor]
    number: tuple[int, ...] | None = field(static=True)

    def __init__(
        self,
        *,
        frequency,
        damping_ratio=None,
        shapes=None,
        sensors=None,
        number=None,
        pairing: str = "order",
        noise=None,
    ):
        with Problems() as problems:
            self.sensors = dict(sensors or {})
            given = {"frequency": frequency, "damping_ratio": damping_ratio, "shapes": shapes}
            arrays = {
                name: float_array(x, f"MeasuredModes.{name}")
                for name, x in given.items()
                if x is not None
            }
            count = arrays["frequency"].shape[0] if arrays["frequency"].ndim else 0
            expected = {
                "frequency": (count,),
                "damping_ratio": (count,),
                "shapes": (count, len(component_units(self.sensors))),
            }
            if not count:
                problems.add(
                    "NO_DATA",
                    "MeasuredModes.frequency",
                    "is empty",
                    limit="one number for each mode",
                )
            for name, array in arrays.items():
                where, values = f"MeasuredModes.{name}", concrete(array)
                if array.shape != expected[name]:
                    hint = (
                        "A row for each mode, a column for each sensor."
                        if name == "shapes"
                        else "One number for each mode."
                    )
                    problems.add(
                        "BAD_SHAPE",
                        where,
                        f"has shape {array.shape}",
                        value=array.shape,
                        limit=str(expected[name]),
                        hint=hint,
                    )
                elif values is not None and np.isinf(values).any():
                    problems.add(
                        "NON_FINITE",
                        where,
                        "has infinite values",
                        limit="finite, or NaN for a missing number",
                    )
                elif name == "frequency" and values is not None and (values < 0).any():
                    least = float(np.nanmin(values))
                    problems.add(
                        "BAD_FREQUENCY",
                        where,
                        f"has {least:g} Hz",
                        value=least,
                        limit=">= 0",
                        hint="Give NaN for a missing number.",
                    )
                elif values is not None and values.size and np.isnan(values).all():
                    problems.add("ALL_NAN", where, "has only NaN", hint="Leave it out.")
            if pairing not in ("order", "mac") or (pairing == "mac" and shapes is None):
                message = f"is {pairing!r}" + (
                    ", but there are no shapes" if pairing == "mac" else ""
                )
                problems.add(
                    "BAD_PAIRING",
                    "MeasuredModes.pairing",
                    message,
                    value=pairing,
                    limit='"order", or "mac" with shapes',
                )
            numbers = (
                tuple(range(count)) if number is None else tuple(int(n) for n in np.ravel(number))
            )
            if (
                len(numbers) != count
                or len(set(numbers)) < len(numbers)
                or any(n < 0 for n in numbers)
            ):
                problems.add(
                    "BAD_SHAPE",
                    "MeasuredModes.number",
                    f"is {number}",
                    value=number,
                    limit=f"{count} different numbers from 0 up",
                )
            levels = noise_of(noise or {}, arrays, "MeasuredModes.noise", problems)
        if "shapes" in arrays:
            arrays["shapes"] = arrays["shapes"] / np.sqrt(
                np.nansum(arrays["shapes"] ** 2, 1, keepdims=True)
            )
        self.measured = {name: device_array(array) for name, array in arrays.items()}
        self.noise = levels or None
        self.number = numbers if pairing == "order" else None

    @property
    def channels(self):
        # its shape is a class attribute
        return {name: ModalChannel(unit) for name, unit in UNITS.items() if name in self.measured}  # pyright: ignore[reportCallIssue]

    def named(self):
        return dict(self.sensors)

    def check(self, model, where):
        with Problems() as problems:
            if self.sensors:
                outputs = outputs_of(model, self.sensors, where, problems)
                for name, unit in zip(outputs.names, outputs.units, strict=True):
                    if unit not in ("m", "rad"):
                        limit = "positions and rotations, such as jb.Position"
                        problems.add(
                            "WRONG_KIND",
                            f"{where}.sensors['{name}']",
                            f"reads {unit}",
                            value=unit,
                            limit=limit,
                        )
            count = len(model.layout.with_mass)
            if max(self.number or (len(self.measured["frequency"]) - 1,)) >= count:
                message = (
                    "has more modes than the model"
                    if self.number is None
                    else "is compared with a mode that the model does not have"
                )
                problems.add(
                    "BAD_SHAPE",
                    f"{where}.frequency",
                    message,
                    value=self.number,
                    limit=f"{count} modes",
                )

    def readings(self, model, integration, lin):
        predicted = modes(lin)
        at_sensors = None
        if self.sensors:
            ports = port_matrices(lin, (), tuple(self.sensors.values()))
            at_sensors = ports.Y[0][:, : len(predicted.shapes)] @ predicted.shapes
            at_sensors = (
                at_sensors if ports.chains is None else at_sensors * ports.chains.gain[:, None]
            )
        if self.number is not None:
            which: Any = np.array(self.number)
        else:
            which = jnp.argmax(
                mac(
                    *(
                        jax.lax.stop_gradient(x)
                        for x in (at_sensors, jnp.nan_to_num(self.measured["shapes"]).T)
                    )
                ),
                axis=0,
            )
        readings = {
            "frequency": predicted.frequency[which],
            "damping_ratio": predicted.damping_ratio[which],
        }
        if "shapes" in self.measured:
            assert at_sensors is not None
            x, y = at_sensors[:, which].T, self.measured["shapes"]
            present = ~jnp.isnan(y)
            scale = jnp.sum(jnp.where(present, x * y, 0), 1) / jnp.sum(
                jnp.where(present, x * x, 0), 1
            )
            readings["shapes"] = scale[:, None] * x
        return {name: readings[name] for name in self.measured}

    def explain(self, model, integration):
        return equilibrium_status(model)

    def axis(self, channel):
        return "mode", np.arange(1, 1 + len(self.measured[channel])), ""

    def place(self, row):
        return f"mode {row + 1}", row + 1
