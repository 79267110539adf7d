"""Measured modes, to fit a model to: natural frequencies, damping ratios, shapes at the places of sensors."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from equinox import field
from jaxtyping import Array, Float

from jaxbody.core.arrays import concrete, device_array, float_array
from jaxbody.core.errors import Problems
from jaxbody.experiments.measured_responses import rested, told
from jaxbody.experiments.measurements import Measurement
from jaxbody.sensors.channels import Channel
from jaxbody.vibrations.mode_branches import mac
from jaxbody.vibrations.natural_modes import modes
from jaxbody.vibrations.ports import PointMotion, port_matrices, ports_of

UNITS = {"frequency": "Hz", "damping_ratio": "", "shapes": ""}


class ModalChannel(Channel):
    """A number of each mode."""

    series = False
    unit: str = field(static=True)  # pyright: ignore[reportIncompatibleVariableOverride]
    shape = ()


class MeasuredModes(Measurement):
    """What a modal test found of `nm` modes: `frequency` [Hz] (nm,), `damping_ratio` (nm,), `shapes` (nm, ns), real, at the `sensors`,
    {name: PointMotion of a displacement}, in their order; NaN where there is no number.

    A measured mode is compared with the model's mode of the same number in ascending order, or with that of `number` (0 the lowest); with
    pairing="mac", with the mode whose shape at the sensors is most like its own. Scale and sign of shapes are left open: compared are x/|x| of the
    measured one and the multiple of the model's that is nearest to it. noise: {"frequency": [Hz], "damping_ratio": ..., "shapes": ...},
    each one number or one for each number measured; estimated from the residuals where it is not given. Natural modes are meant, those of small damping.

    Errors, all at once: NO_DATA, BAD_SHAPE, BAD_FREQUENCY, NON_FINITE, ALL_NAN, BAD_NOISE, UNKNOWN_NAME, WRONG_KIND, BAD_PAIRING.

    >>> test = MeasuredModes(frequency=[0.8, 2.1], damping_ratio=[0.01, np.nan], noise={"frequency": 0.01})
    >>> list(test.channels)
    ['frequency', 'damping_ratio']
    """

    measured: dict[str, Float[Array, "nm ..."]]
    noise: dict[str, Float[Array, "..."]] | None
    sensors: dict[str, PointMotion]
    number: tuple[int, ...] | None = field(static=True)

    def __init__(self, *, frequency, damping_ratio=None, shapes=None, sensors=None, number=None, pairing: str = "order", noise=None):
        problems = Problems()
        self.sensors = dict(sensors or {})
        given = {"frequency": frequency, "damping_ratio": damping_ratio, "shapes": shapes}
        arrays = {name: float_array(x, f"MeasuredModes.{name}") for name, x in given.items() if x is not None}
        count = arrays["frequency"].shape[0] if arrays["frequency"].ndim else 0
        expected = {"frequency": (count,), "damping_ratio": (count,), "shapes": (count, len(self.sensors))}
        if not count:
            problems.add("NO_DATA", "MeasuredModes.frequency", "is empty", limit="one number for each mode")
        for name, array in arrays.items():
            where, known = f"MeasuredModes.{name}", concrete(array)
            if array.shape != expected[name]:
                hint = "A row for each mode, a column for each sensor." if name == "shapes" else "One number for each mode."
                problems.add("BAD_SHAPE", where, f"has shape {array.shape}", value=array.shape, limit=str(expected[name]), hint=hint)
            elif known is not None and np.isinf(known).any():
                problems.add("NON_FINITE", where, "has infinite values", limit="finite, or NaN where there is none")
            elif name == "frequency" and known is not None and (known < 0).any():
                least = float(np.nanmin(known))
                problems.add("BAD_FREQUENCY", where, f"has {least:g} Hz", value=least, limit=">= 0", hint="NaN where there is none.")
            elif known is not None and known.size and np.isnan(known).all():
                problems.add("ALL_NAN", where, "has no number at all", hint="Leave it out.")
        if pairing not in ("order", "mac") or (pairing == "mac" and shapes is None):
            told = f"is {pairing!r}" + (", but there are no shapes" if pairing == "mac" else "")
            problems.add("BAD_PAIRING", "MeasuredModes.pairing", told, value=pairing, limit='"order", or "mac" with shapes')
        numbers = tuple(range(count)) if number is None else tuple(int(n) for n in np.ravel(number))
        if len(numbers) != count or len(set(numbers)) < len(numbers) or any(n < 0 for n in numbers):
            problems.add("BAD_SHAPE", "MeasuredModes.number", f"is {number}", value=number, limit=f"{count} different numbers from 0 on")
        levels = {}
        for name, level in (noise or {}).items():
            where, known = f"MeasuredModes.noise['{name}']", np.asarray(level, float)
            if name not in arrays:
                problems.add("UNKNOWN_NAME", where, "is of nothing measured", value=name, limit=", ".join(arrays))
            elif known.shape not in ((), arrays[name].shape):
                problems.add("BAD_SHAPE", where, f"has shape {known.shape}", value=known, limit=f"() or {arrays[name].shape}")
            elif not (np.isfinite(known) & (known > 0)).all():
                problems.add("BAD_NOISE", where, "is not positive", value=known, limit="> 0", hint="Leave noise out to have it estimated.")
            else:
                levels[name] = device_array(known)
        problems.raise_if_any()
        if "shapes" in arrays:
            arrays["shapes"] = arrays["shapes"] / np.sqrt(np.nansum(arrays["shapes"] ** 2, 1, keepdims=True))
        self.measured = {name: device_array(array) for name, array in arrays.items()}
        self.noise = levels or None
        self.number = numbers if pairing == "order" else None

    @property
    def channels(self):
        return {name: ModalChannel(unit) for name, unit in UNITS.items() if name in self.measured}  # pyright: ignore[reportCallIssue]  # the class states the shape

    def named(self):
        return dict(self.sensors)

    def check(self, model, where):
        problems = Problems()
        if self.sensors:
            ports_of(model, self.sensors, "outputs", where, problems)
        for name, port in self.sensors.items():
            if not isinstance(port, PointMotion) or port.kind != "displacement":
                limit = "a PointMotion of a displacement"
                problems.add("WRONG_KIND", f"{where}.sensors['{name}']", f"is a {type(port).__name__}", value=port, limit=limit)
        count = model.layout.nv
        if max(self.number or (len(self.measured["frequency"]) - 1,)) >= count:
            told = f"has a mode that the model, with {count}, has not"
            problems.add("BAD_SHAPE", f"{where}.frequency", told, value=self.number, limit=f"{count} modes")
        problems.raise_if_any()

    def readings(self, model, integration):
        lin = rested(model)
        found = modes(lin)
        at_sensors = None
        if self.sensors:
            at_sensors = port_matrices(lin, (), tuple(self.sensors.values())).Y[0][:, : model.layout.nv] @ found.shapes
        if self.number is not None:
            which: Any = np.array(self.number)
        else:
            which = jnp.argmax(mac(*(jax.lax.stop_gradient(x) for x in (at_sensors, jnp.nan_to_num(self.measured["shapes"]).T))), axis=0)
        readings = {"frequency": found.frequency[which], "damping_ratio": found.damping_ratio[which]}
        if "shapes" in self.measured:
            assert at_sensors is not None
            x, y = at_sensors[:, which].T, self.measured["shapes"]
            there = ~jnp.isnan(y)
            along = jnp.sum(jnp.where(there, x * y, 0), 1) / jnp.sum(jnp.where(there, x * x, 0), 1)
            readings["shapes"] = along[:, None] * x
        return {name: readings[name] for name in self.measured}

    def explain(self, model, integration):
        return told(model)

    def axis(self, channel):
        return "mode", np.arange(1, 1 + len(self.measured[channel])), ""

    def place(self, row):
        return f"mode {row + 1}", row + 1
