"""Measured frequency responses for fits: complex numbers by frequency, from named inputs to
named outputs."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from jaxbody.core.arrays import Array, Complex, Float, concrete, device_array
from jaxbody.core.errors import Problems, Status, unknown
from jaxbody.fitting.experiments.measurements import Measurement, noise_of
from jaxbody.mechanics.equilibria import equilibrium
from jaxbody.model.models import Model
from jaxbody.sensors.channels import Channel
from jaxbody.vibration.frequency_responses import (
    check_frequencies,
    check_loss_factors,
    check_without_force_sensors,
    frequency_response,
)
from jaxbody.vibration.linearizations import Linearization, linearize
from jaxbody.vibration.ports import component_units, inputs_of, outputs_of


class ResponseChannel(Channel):
    """One complex response; its residuals are the real and imaginary parts, each with the noise
    level as standard deviation."""

    shape = ()
    unit: str = eqx.field(static=True, default=(""))  # pyright: ignore[reportIncompatibleVariableOverride]

    def residual(self, reading, measured):
        difference = jnp.where(jnp.isnan(measured), 0.0, reading - measured)
        return jnp.stack([difference.real, difference.imag], -1)

    def missing(self, measured):
        one = np if isinstance(measured, np.ndarray) else jnp
        return one.stack([one.isnan(measured)] * 2, -1)

    def spread(self, level):
        level = jnp.asarray(level)
        return level[:, None] if level.size > 1 else level


class MeasuredResponse(Measurement):
    """Measured frequency responses for a fit.

    Args:
        frequencies: [Hz] (nf,).
        inputs, outputs: {name: port} as in `frequency_response`.
        measured: {(output, input): complex (nf,)} for any number of pairs, NaN for frequencies to
            leave out.
        noise: the standard deviation of the real part and of the imaginary part, one number
            or {(output, input): one number or one for each frequency}. For a coherence g2
            with n averages it is |H| sqrt((1 - g2)/(2 n g2)). By default it is estimated from
            the residuals.
        loss_factor: as in `frequency_response`; its paths are "hammer.loss_factor.AB" or
            "hammer.loss_factor.all". By default none.

    Errors, all at once: BAD_FREQUENCY, BAD_SHAPE, NO_DATA, NON_FINITE, ALL_NAN, BAD_NOISE,
    UNKNOWN_NAME, WRONG_KIND.

    >>> force, motion = PointForce("mass", direction="y"), Position("mass", axis="y")
    >>> measured = {("y", "f"): [0.02 + 0j, -0.01 - 0.001j]}
    >>> hammer = MeasuredResponse(
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

    def __init__(self, frequencies, *, inputs, outputs, measured, noise=None, loss_factor=None):
        with Problems() as problems:
            checked = problems.gather(
                lambda: check_frequencies(frequencies, "MeasuredResponse.frequencies")
            )
            shape = np.shape(frequencies if checked is None else checked)
            if not measured:
                problems.add(
                    "NO_DATA",
                    "MeasuredResponse.measured",
                    "is empty",
                    limit="at least one pair (output, input)",
                )
            arrays, known = {}, component_units(outputs)
            for pair, value in measured.items():
                where = f"MeasuredResponse.measured[{pair!r}]"
                output, source = (
                    pair if isinstance(pair, tuple) and len(pair) == 2 else (pair, pair)
                )
                for name, ports in ((output, known), (source, inputs)):
                    if name not in ports:
                        problems.collected.append(unknown(str(name), where, tuple(ports)))
                arrays[pair] = _complex(value, shape, where, problems)
            given = (
                noise
                if isinstance(noise, dict)
                else {}
                if noise is None
                else dict.fromkeys(measured, noise)
            )
            levels = noise_of(given, arrays, "MeasuredResponse.noise", problems)
        self.frequencies = checked  # pyright: ignore[reportAttributeAccessIssue]
        self.inputs, self.outputs = dict(inputs), dict(outputs)
        by_element = loss_factor if isinstance(loss_factor, dict) else {"all": loss_factor}
        self.loss_factor = (
            None
            if loss_factor is None
            else {name: device_array(x) for name, x in by_element.items()}
        )
        self.measured = {_name(pair): jnp.asarray(x) for pair, x in arrays.items()}
        self.noise = (
            {_name(pair): level for pair, level in levels.items()} if noise is not None else None
        )
        self.pairs = tuple(arrays)

    @property
    def channels(self):
        outputs = component_units(self.outputs)
        units = {
            pair: response_unit(outputs[pair[0]], self.inputs[pair[1]].unit) for pair in self.pairs
        }
        return {_name(pair): ResponseChannel(unit=unit) for pair, unit in units.items()}  # pyright: ignore[reportCallIssue]  the class states the shape

    def named(self):
        return {
            **self.inputs,
            **self.outputs,
            **({} if self.loss_factor is None else {"loss_factor": self.loss_factor}),
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

    def explain(self, model, integration):
        return equilibrium_status(model)

    def axis(self, channel):
        return "frequency", self.frequencies, "Hz"

    def place(self, row):
        return f"{float(self.frequencies[row]):.6g} Hz", float(self.frequencies[row])

    def _loss_factors(self):
        return (
            self.loss_factor
            if self.loss_factor is None or "all" not in self.loss_factor
            else self.loss_factor["all"]
        )


def small_motions(model: Model) -> Linearization:
    """Small motions about the equilibrium that a search from the reference pose reaches."""
    return linearize(model, equilibrium(model))


def equilibrium_status(model: Model) -> str:
    """The status of this linearization, for messages."""
    return Status(int(small_motions(model).status)).name + " at the equilibrium"


def _name(pair: tuple[str, str]) -> str:
    return f"{pair[0]}/{pair[1]}"


def response_unit(above: str, below: str) -> str:
    """The unit of a response, "m/N"; "" for a ratio."""
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
    if array.shape != shape:
        problems.add(
            "BAD_SHAPE",
            where,
            f"has shape {array.shape}",
            value=array.shape,
            limit=str(shape),
            hint="One for each frequency.",
        )
    elif np.isinf(array).any():
        problems.add(
            "NON_FINITE",
            where,
            "has infinite values",
            limit="finite, or NaN for frequencies to leave out",
        )
    elif np.isnan(array).all():
        problems.add("ALL_NAN", where, "has only NaN", hint="Leave out this pair.")
    return array
