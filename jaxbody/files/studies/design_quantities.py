"""Quantities of a design in a file that `tune` minimizes or limits: functions of the model at its
equilibrium, each with its unit."""

import inspect
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from jaxbody.core.arrays import Array
from jaxbody.design import objectives
from jaxbody.mechanics.equilibria import Equilibrium, equilibrium
from jaxbody.model.inputs.port_inputs import BaseMotion
from jaxbody.model.leaf_paths import parameter_paths
from jaxbody.model.models import Model
from jaxbody.sensors.sensors import Sensor
from jaxbody.vibration.damped_modes import complex_modes
from jaxbody.vibration.linearizations import Linearization, linearize
from jaxbody.vibration.natural_modes import Modes, modes
from jaxbody.vibration.random_responses import RandomResponse, random_response
from jaxbody.vibration.road_spectra import RoadRoughness
from jaxbody.vibration.spectra import Band, Spectrum


@dataclass
class Design:
    """A model, and, computed when first needed, its equilibrium, linearization, modes and response
    to roads; `roads`: {support: (class of ISO 8608, speed [m/s])}, `band` [Hz]."""

    model: Model
    sensors: dict[str, Sensor]
    roads: dict[str, tuple[str, float]]
    band: tuple[float, float]

    @cached_property
    def equilibrium(self) -> Equilibrium:
        return equilibrium(self.model)

    @cached_property
    def linearization(self) -> Linearization:
        return linearize(self.model, self.equilibrium)

    @cached_property
    def modes(self) -> Modes:
        return modes(self.linearization)

    @cached_property
    def ride(self) -> RandomResponse:
        inputs = {name: BaseMotion(name, "z") for name in self.roads}
        spectra: dict[str, Spectrum] = {
            name: RoadRoughness.iso(kind).at_speed(speed)
            for name, (kind, speed) in self.roads.items()
        }
        return random_response(self.linearization, Band(*self.band), inputs, self.sensors, spectra)


@dataclass(frozen=True)
class Quantity:
    """A kind of quantity: a function of a Design and of the entries that a file states with it; its
    SI unit, "" if that depends on the entries; and whether it needs roads."""

    of: Callable[..., Any]
    unit: str = ""
    on_roads: bool = False

    @property
    def stated(self) -> tuple[str, ...]:
        """The names of the entries that the function takes besides the design."""
        return tuple(inspect.signature(self.of).parameters)[1:]


def value(at: Design, path: str) -> Array:
    """Return the number of the model with this path."""
    return parameter_paths(at.model, path)[path]


def frequency(at: Design, mode: int) -> Array:
    """Return the natural frequency of a mode [Hz]."""
    return at.modes.frequency[mode - 1]


def damping_ratio(at: Design, mode: int) -> Array:
    """Return the damping ratio of a complex mode."""
    return complex_modes(at.linearization).damping_ratio[mode - 1]


def deflection(at: Design, on: str) -> Array:
    """Return the elongation of a spring at equilibrium [m]."""
    return at.equilibrium.elongations[on]


def coupling_of_modes(at: Design) -> Array:
    """Return a measure of the coupling of modes: 0 if each mode moves one body in one direction
    only."""
    return objectives.coupling_of_modes(at.linearization)


def band_intrusion(at: Design, band: list[float]) -> Array:
    """Return a penalty on natural frequencies in a band [Hz]."""
    return objectives.band_intrusion(at.modes.frequency, (band[0], band[1]))


def rms(at: Design, sensor: str) -> Array:
    """Return the rms value of the reading of a sensor on the roads."""
    return at.ride[sensor]


def stroke(at: Design, sensor: str) -> Array:
    """Return three times the rms value of an elongation on the roads [m]."""
    return objectives.stroke(at.ride, sensor)


def comfort(at: Design, weights: dict[str, str]) -> Array:
    """Return the vibration total value of accelerations on the roads [m/s2], by ISO 2631-1."""
    return objectives.comfort(at.ride, weights)


# {name of the function: its quantity}
QUANTITIES = {
    each.of.__name__: each
    for each in (
        Quantity(value),
        Quantity(frequency, "Hz"),
        Quantity(damping_ratio),
        Quantity(deflection, "m"),
        Quantity(coupling_of_modes),
        Quantity(band_intrusion),
        Quantity(rms, on_roads=True),
        Quantity(stroke, "m", on_roads=True),
        Quantity(comfort, "m/s2", on_roads=True),
    )
}


class Evaluation:
    """The quantities of a design as a function of the model, in the form that `tune` takes;
    `quantities`: {name: (kind, entries stated with it)}; `units`: their SI units."""

    def __init__(
        self,
        quantities: dict[str, tuple[Quantity, dict[str, Any]]],
        units: dict[str, str],
        sensors: dict[str, Sensor],
        roads: Any,
        band: Any,
    ):
        self.quantities, self.units, self.sensors = quantities, units, sensors
        self.roads, self.band = roads, band

    def __call__(self, model: Model) -> dict[str, Array]:
        design = Design(model, self.sensors, self.roads, self.band)
        return {name: kind.of(design, **stated) for name, (kind, stated) in self.quantities.items()}


def sensors_of(stated: Iterable[dict[str, Any]]) -> set[str]:
    """Return the names of the sensors that quantities refer to."""
    return {
        name
        for options in stated
        for name in (options.get("sensor"), *options.get("weights", {}))
        if name
    }
