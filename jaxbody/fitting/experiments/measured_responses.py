"""Measured small motions for fits: complex frequency responses between named inputs and named
outputs; natural frequencies, damping ratios and mode shapes of a modal test."""

from itertools import product
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxbody.core.arrays import (
    Array,
    Complex,
    Float,
    concrete,
    device_array,
    float_array,
    module_of,
)
from jaxbody.core.errors import Problems, unknown
from jaxbody.fitting.experiments.measurements import (
    ByFrequency,
    Measurement,
    NumberChannel,
    check_rows,
    noise_of,
)
from jaxbody.sensors.sensors import Channel, Sensor
from jaxbody.vibration.frequency_responses import (
    check_frequencies,
    check_loss_factors,
    check_without_force_sensors,
    frequency_response,
)
from jaxbody.vibration.mode_branches import mac
from jaxbody.vibration.natural_modes import modes
from jaxbody.vibration.ports import component_units, inputs_of, outputs_of, port_matrices


class ResponseChannel(Channel):
    """One complex response. Its residuals are the real and the imaginary part; the noise level is
    the standard deviation of each."""

    shape: ClassVar[tuple[int, ...]] = ()  # pyright: ignore[reportIncompatibleVariableOverride]
    unit: str = eqx.field(static=True, default="")  # pyright: ignore[reportIncompatibleVariableOverride]

    def residual(self, reading, measured):
        difference = jnp.where(jnp.isnan(measured), 0.0, reading - measured)
        return jnp.stack([difference.real, difference.imag], -1)

    def missing(self, measured):
        xp = module_of(measured)
        return xp.stack([xp.isnan(measured)] * 2, -1)

    def spread(self, level):
        level = jnp.asarray(level)
        return level[:, None] if level.size > 1 else level


class MeasuredResponse(ByFrequency):
    """Measured frequency responses for a fit.

    Args:
        frequencies: [Hz] (nf,).
        inputs, outputs: {name: port} as in `frequency_response`.
        measured: {(output, input): complex (nf,)} for any number of pairs, NaN for frequencies to
            leave out. None: a plan of the pairs in `noise`, or of all pairs, whose frequencies
            have the path "hammer.frequencies".
        noise: the standard deviation of the real part and of the imaginary part, one number
            or {(output, input): one number or one for each frequency}. For a coherence g2 of n
            averages it is |H| sqrt((1 - g2)/(2 n g2)). By default estimated from the residuals.
        loss_factor: as in `frequency_response`; its paths are "hammer.loss_factor.AB" or
            "hammer.loss_factor.all". By default none.

    Errors, all at once: BAD_FREQUENCY, BAD_SHAPE, NO_DATA, NON_FINITE, ALL_NAN, BAD_NOISE,
    UNKNOWN_NAME, WRONG_KIND.

    >>> force, motion = jb.PointForce("mass", direction="y"), jb.Position("mass", axis="y")
    >>> measured = {("y", "f"): [0.02 + 0j, -0.01 - 0.001j]}
    >>> hammer = jb.MeasuredResponse(
    ...     [1.0, 2.0], inputs={"f": force}, outputs={"y": motion}, measured=measured
    ... )
    >>> list(hammer.channels)
    ['y/f']
    """

    frequencies: Float[Array, "nf"]
    inputs: dict[str, Any]
    outputs: dict[str, Any]
    loss_factor: dict[str, Array] | None
    linear = True
    measured: dict[str, Complex[Array, "nf"]]
    noise: dict[str, Float[Array, "..."]] | None
    pairs: tuple[tuple[str, str], ...] = eqx.field(static=True)

    def __init__(
        self, frequencies, *, inputs, outputs, measured=None, noise=None, loss_factor=None
    ):
        with Problems() as problems:
            checked = problems.gather(
                lambda: check_frequencies(frequencies, "MeasuredResponse.frequencies")
            )
            shape = np.shape(frequencies if checked is None else checked)
            plan, known = measured is None, component_units(outputs)
            pairs = noise if isinstance(noise, dict) else product(known, inputs)
            given = {pair: np.zeros(shape) for pair in pairs} if measured is None else measured
            if not given:
                problems.add(
                    "NO_DATA",
                    "MeasuredResponse.measured",
                    "is empty",
                    limit="at least one pair (output, input)",
                )
            arrays = {}
            for pair, value in given.items():
                where = f"MeasuredResponse.measured[{pair!r}]"
                output, source = (
                    pair if isinstance(pair, tuple) and len(pair) == 2 else (pair, pair)
                )
                for name, ports in ((output, known), (source, inputs)):
                    if name not in ports:
                        problems.collected.append(unknown(str(name), where, tuple(ports)))
                arrays[pair] = _complex(value, shape, where, problems)
            if not isinstance(noise, dict):
                noise = {} if noise is None else dict.fromkeys(given, noise)
            levels = noise_of(noise, arrays, "MeasuredResponse.noise", problems)
        self.frequencies = checked  # pyright: ignore[reportAttributeAccessIssue]
        self.inputs, self.outputs = dict(inputs), dict(outputs)
        by_element = loss_factor if isinstance(loss_factor, dict) else {"all": loss_factor}
        self.loss_factor = (
            None
            if loss_factor is None
            else {name: device_array(x) for name, x in by_element.items()}
        )
        self.measured = {} if plan else {_name(pair): jnp.asarray(x) for pair, x in arrays.items()}
        self.noise = {_name(pair): level for pair, level in levels.items()} or None
        self.pairs = tuple(arrays)

    @property
    def channels(self):
        outputs = component_units(self.outputs)
        units = {
            pair: response_unit(outputs[pair[0]], self.inputs[pair[1]].unit) for pair in self.pairs
        }
        return {_name(pair): ResponseChannel(unit=unit) for pair, unit in units.items()}

    def named(self):
        return {
            **self.inputs,
            **self.outputs,
            **({} if self.loss_factor is None else {"loss_factor": self.loss_factor}),
            **({} if self.measured else {"frequencies": self.frequencies}),
        }

    def check(self, model, where):
        with Problems() as problems:
            inputs_of(model, self.inputs, where, problems)
            outputs_of(model, self.outputs, where, problems)
        if self.loss_factor is not None:
            check_loss_factors(self._loss_factors(), model, f"{where}.loss_factor")
            check_without_force_sensors(
                self.loss_factor, f"{where}.loss_factor", tuple(self.outputs.values()), model
            )

    def readings(self, model, integration, lin):
        responses = frequency_response(
            lin, self.frequencies, self.inputs, self.outputs, loss_factor=self._loss_factors()
        )
        return {_name(pair): responses[pair] for pair in self.pairs}

    def _loss_factors(self):
        return (
            self.loss_factor
            if self.loss_factor is None or "all" not in self.loss_factor
            else self.loss_factor["all"]
        )


def _name(pair: tuple[str, str]) -> str:
    return f"{pair[0]}/{pair[1]}"


def response_unit(above: str, below: str) -> str:
    """Return the unit of a response from the units of output and input, "m/N"; "" for a ratio."""
    if above == below:
        return ""
    return (
        f"{f'({above})' if '/' in above else above}/"
        f"{f'({below})' if set(below) & set('/ ') else below}"
    )


def _complex(value: Any, shape: tuple[int, ...], where: str, problems: Problems) -> Any:
    if concrete(value) is None:
        return value
    try:
        array = np.asarray(value, complex)
    except (TypeError, ValueError):
        problems.add(
            "NOT_A_NUMBER", where, f"is {value!r:.60}", value=value, limit="complex numbers"
        )
        return np.zeros(shape)
    check_rows(
        array,
        shape,
        where,
        problems,
        missing="frequencies to leave out",
        hint="One for each frequency.",
        remedy="Leave out this pair.",
    )
    return array


UNITS = {"frequency": "Hz", "damping_ratio": "", "shapes": ""}


class MeasuredModes(Measurement):
    """Result of a modal test with `nm` natural modes, as measurements for a fit.

    Args:
        frequency: [Hz] (nm,); NaN for a missing number here and below. None: a plan of the modes in
            `number` and of the quantities in `noise`.
        damping_ratio: (nm,); by default not measured.
        shapes: real mode shapes (nm, ns) at the `sensors`, in their order; by default not measured.
        sensors: {name: sensor} of positions or rotations; each component of a sensor is a column
            of `shapes`.
        number: index of the mode of the model with which each measured mode is compared, 0 for the
            lowest; by default 0 to nm - 1.
        pairing: "order" compares with the modes in `number`; "mac" with the mode of the highest
            modal assurance criterion at the sensors.
        noise: standard deviations {"frequency": [Hz], "damping_ratio": ..., "shapes": ...}, each
            one number or one for each measured number; by default estimated from the residuals.

    Scale and sign of shapes are arbitrary: a measured shape x/|x| is compared with the nearest
    multiple of the shape of the model.

    Errors, all at once: NO_DATA, BAD_SHAPE, BAD_FREQUENCY, NON_FINITE, ALL_NAN, BAD_NOISE,
    UNKNOWN_NAME, WRONG_KIND, BAD_PAIRING.

    >>> test = jb.MeasuredModes(
    ...     frequency=[0.8, 2.1], damping_ratio=[0.01, np.nan], noise={"frequency": 0.01}
    ... )
    >>> list(test.channels)
    ['frequency', 'damping_ratio']
    """

    linear = True
    measured: dict[str, Float[Array, "nm ..."]]
    noise: dict[str, Float[Array, "..."]] | None
    sensors: dict[str, Sensor]
    columns: tuple[str, ...] = eqx.field(static=True)  # of shapes; JAX sorts the names in a dict
    number: tuple[int, ...] | None = eqx.field(static=True)

    def __init__(
        self,
        *,
        frequency=None,
        damping_ratio=None,
        shapes=None,
        sensors=None,
        number=None,
        pairing: str = "order",
        noise=None,
    ):
        with Problems() as problems:
            self.sensors = dict(sensors or {})
            self.columns = tuple(self.sensors)
            given = {"frequency": frequency, "damping_ratio": damping_ratio, "shapes": shapes}
            arrays = {
                name: float_array(x, f"MeasuredModes.{name}")
                for name, x in given.items()
                if x is not None
            }
            plan = frequency is None
            count = np.size(number if plan else arrays["frequency"])
            expected = {
                "frequency": (count,),
                "damping_ratio": (count,),
                "shapes": (count, len(component_units(self.sensors))),
            }
            if not count or (plan and number is None):
                problems.add(
                    "NO_DATA",
                    "MeasuredModes.frequency",
                    "is empty",
                    limit="one number for each mode",
                    hint="A plan has number=[0, 1, ...] and noise= instead.",
                )
            for name, array in arrays.items():
                where, values = f"MeasuredModes.{name}", concrete(array)
                if array.size or array.shape != expected[name]:
                    check_rows(
                        array,
                        expected[name],
                        where,
                        problems,
                        missing="a missing number",
                        hint="A row for each mode, a column for each sensor."
                        if name == "shapes"
                        else "One number for each mode.",
                    )
                if name == "frequency" and values is not None and (values < 0).any():
                    least = float(np.nanmin(values))
                    problems.add(
                        "BAD_FREQUENCY",
                        where,
                        f"has {least:g} Hz",
                        value=least,
                        limit=">= 0",
                        hint="Give NaN for a missing number.",
                    )
            if pairing not in ("order", "mac") or (pairing == "mac" and shapes is None):
                problems.add(
                    "BAD_PAIRING",
                    "MeasuredModes.pairing",
                    f"is {pairing!r}" + (", but there are no shapes" if pairing == "mac" else ""),
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
            known = arrays or {name: np.zeros(shape) for name, shape in expected.items()}
            self.noise = noise_of(noise or {}, known, "MeasuredModes.noise", problems) or None
        if "shapes" in arrays:
            arrays["shapes"] = arrays["shapes"] / np.sqrt(
                np.nansum(arrays["shapes"] ** 2, 1, keepdims=True)
            )
        self.measured = {name: device_array(array) for name, array in arrays.items()}
        self.number = numbers if pairing == "order" else None

    @property
    def channels(self):
        return {
            name: NumberChannel(unit=unit, series=False)
            for name, unit in UNITS.items()
            if name in self.names
        }

    def named(self):
        return dict(self.sensors)

    def check(self, model, where):
        with Problems() as problems:
            if self.sensors:
                outputs = outputs_of(model, self.sensors, where, problems)
                for name, unit in zip(outputs.names, outputs.units, strict=True):
                    if unit not in ("m", "rad"):
                        problems.add(
                            "WRONG_KIND",
                            f"{where}.sensors['{name}']",
                            f"reads {unit}",
                            value=unit,
                            limit="positions and rotations, such as jb.Position",
                        )
            count = len(model.layout.with_mass)
            if max(self.number or (len(self.measured["frequency"]) - 1,)) >= count:
                problems.add(
                    "BAD_SHAPE",
                    f"{where}.frequency",
                    "has more modes than the model"
                    if self.number is None
                    else "is compared with a mode that the model does not have",
                    value=self.number,
                    limit=f"{count} modes",
                )

    def readings(self, model, integration, lin):
        frequency, damping_ratio, at_sensors = self.predicted(lin)
        which: Any = np.array(self.number)
        if self.number is None:
            both = jax.lax.stop_gradient((at_sensors, jnp.nan_to_num(self.measured["shapes"]).T))
            which = jnp.argmax(mac(*both), axis=0)
        readings = {
            "frequency": frequency[which],
            "damping_ratio": damping_ratio[which],
        }
        if "shapes" in self.names:
            x = at_sensors[:, which].T
            y = self.measured.get("shapes", jnp.zeros_like(x))
            present = ~jnp.isnan(y)
            along = jnp.sum(jnp.where(present, x * y, 0), 1)
            square = jnp.sum(jnp.where(present, x * x, 0), 1)
            # a planned shape has the length one
            scale = jnp.where(along == 0, 1 / jnp.sqrt(square), along / square)
            readings["shapes"] = scale[:, None] * x
        return {name: readings[name] for name in self.names}

    def predicted(self, lin: Any) -> tuple[Array, Array, Array]:
        """Return natural frequencies, damping ratios and shapes at the sensors (ns, n) of all modes
        of the model."""
        found = modes(lin)
        return found.frequency, found.damping_ratio, self.at_sensors(lin, found.shapes)

    def at_sensors(self, lin: Any, shapes: Array) -> Array:
        """Return shapes (columns) as the sensors read them."""
        if not self.columns:
            return shapes[:0]
        ports = port_matrices(lin, (), tuple(self.sensors[name] for name in self.columns))
        rows = ports.Y[0][:, : len(shapes)]
        if ports.chains is not None:
            rows = rows * ports.chains.gain[:, None]
        return rows.astype(shapes.dtype) @ shapes

    def axis(self, channel):
        return "mode", np.arange(1, 1 + len(self.measured[channel])), ""

    def place(self, row):
        return f"mode {row + 1}", row + 1
