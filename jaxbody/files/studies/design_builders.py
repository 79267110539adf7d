"""Designs in files: the arguments of `tune` from a document, and the quantities that it minimizes
or limits, functions of the model at its equilibrium. Limits and bounds are in the unit of the
quantity or parameter that they limit."""

import inspect
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import jax

from jaxbody.core import units
from jaxbody.core.arrays import Array
from jaxbody.design import objectives
from jaxbody.files.builders import EntryBuilder
from jaxbody.mechanics.equilibria import Equilibrium, equilibrium
from jaxbody.model.inputs.port_inputs import BaseMotion
from jaxbody.model.leaf_paths import Leaf, leaves_of, matching, parameter_paths
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


OF_TABLE = ("type", "unit")  # entries of a quantity that are not arguments of its function


class DesignBuilder(EntryBuilder):
    """Builder of a design from its entry in a document."""

    def build(self) -> dict[str, Any]:
        """Return the arguments of `tune` other than the model, bounds and catalogues."""
        stated, limits = self.values["quantities"], self.values.get("limits", {})
        roads = self.values.get("roads", {})
        leaves = leaves_of(self.model)
        kinds = {name: self.kind(values, name) for name, values in stated.items()}
        self.check_known(limits, stated, "limits")
        if self.values["minimize"] not in {*stated, *limits}:  # of limits they are known by now
            self.builder.unknown(self.values["minimize"], stated, (*self.path, "minimize"))
        self.check_known(roads, self.model.layout.supports, "roads")
        known = {name: kind for name, kind in kinds.items() if kind is not None}
        for name, kind in known.items():
            self.check(stated[name], kind, leaves, "quantities", name)
        read = {
            sensor
            for values in stated.values()
            if values["type"] in QUANTITIES
            for sensor in (values.get("sensor"), *values.get("weights", {}))
        }
        given = {
            name: self.values[name]
            for name in ("free", "minimize", "starts")
            if name in self.values
        }
        if "key" in self.values:
            given["key"] = self.key(self.values["key"])
        given["limits"] = {
            name: self.limit(limits[name], stated[name], kind, leaves, name)
            for name, kind in known.items()
            if name in limits
        }
        given["evaluate"] = Evaluation(
            {
                name: (kind, {key: x for key, x in stated[name].items() if key not in OF_TABLE})
                for name, kind in known.items()
            },
            {name: self.unit_of(stated[name], kind, leaves) for name, kind in known.items()},
            {name: sensor for name, sensor in self.sensors.items() if name in read},
            {name: (road["class"], road["speed"]) for name, road in roads.items()},
            tuple(self.values.get("band", (0.1, 100.0))),
        )
        return given

    def key(self, seed: int) -> Any:
        """Return the random key of a seed."""
        if 0 <= seed < 2**32:
            return jax.random.key(seed)
        self.add("BAD_NUMBER", f"is {seed!r:.30}", "key", value=seed, limit=f"0 to {2**32 - 1}")
        return None

    def kind(self, values: dict[str, Any], name: str) -> Quantity | None:
        """Return the kind of a quantity: one of QUANTITIES, or a function from an allowed module of
        the user."""
        path, kind = ("quantities", name), str(values["type"])
        if kind in QUANTITIES:
            return QUANTITIES[kind]
        of = self.builder.own_object(kind, (*self.path, *path))
        if of is None:
            return None
        is_function = (
            callable(of)
            and not inspect.isclass(of)
            and getattr(of, "__module__", None) == kind.partition(":")[0]
        )
        if not (is_function and inspect.signature(of).parameters):
            self.add(
                "UNKNOWN_NAME",
                f"names '{kind}', which is no function of that module",
                *path,
                "type",
                value=kind,
                limit="a function of the model",
                hint="Name the module that defines it.",
            )
            return None
        unit = str(values.get("unit", "1"))
        self.builder.gather((*self.path, *path, "unit"), "", lambda: units.parse(unit, ""))
        self.check_call(of, values, *path)
        return Quantity(lambda at, **stated: of(at.model, **stated), unit)  # pyright: ignore[reportCallIssue]

    def check_call(self, of: Any, values: dict[str, Any], *path: str) -> None:
        """Check that a function accepts the model and the entries stated with it."""
        parameters = dict(list(inspect.signature(of).parameters.items())[1:])
        if any(
            parameter.kind is inspect.Parameter.VAR_KEYWORD for parameter in parameters.values()
        ):
            return
        self.check_known(set(values) - set(OF_TABLE), parameters, *path)
        for name, parameter in parameters.items():
            if parameter.default is inspect.Parameter.empty and name not in values:
                self.add(
                    "MISSING_ENTRY",
                    f"has no '{name}'",
                    *path,
                    value=name,
                    hint=f"Give {name} = ..., which the function takes.",
                )

    def check(self, stated: dict[str, Any], kind: Quantity, leaves: list[Leaf], *path: str) -> None:
        """Check the entries of a quantity: roads, sensors, mode and path."""
        if kind.on_roads and not self.values.get("roads"):
            self.add(
                "MISSING_ENTRY",
                "is a quantity of a ride, and there are no roads",
                *path,
                limit="roads",
                hint='Write roads.NAME = {class = "C", speed = "20 m/s"}.',
            )
        if stated["type"] not in QUANTITIES:
            return
        self.check_known(stated.get("weights", {}), self.sensors, *path, "weights")
        mode, modes = stated.get("mode", 1), len(self.model.layout.with_mass)
        if not 1 <= mode <= modes:
            self.add("BAD_NUMBER", f"is {mode}", *path, "mode", value=mode, limit=f"1 to {modes}")
        if "path" in stated and stated["path"] not in {leaf.path for leaf in leaves}:
            self.builder.gather(
                (*self.path, *path, "path"), "", lambda: matching(leaves, [stated["path"]], "")
            )

    def limit(
        self, value: Any, stated: dict[str, Any], kind: Quantity, leaves: list[Leaf], name: str
    ) -> Any:
        """Return a limit, or a pair of limits, in SI."""
        unit = self.unit_of(stated, kind, leaves)
        pair = self.builder.quantity(value, unit, (*self.path, "limits", name))
        return tuple(pair) if isinstance(pair, list) else pair

    def unit_of(self, stated: dict[str, Any], kind: Quantity, leaves: list[Leaf]) -> str:
        """Return the unit of a quantity: that of its kind, of its sensor, or of its number of the
        model."""
        of_path = next((leaf.kind.unit for leaf in leaves if leaf.path == stated.get("path")), "")
        sensor = (
            self.sensors.get(stated.get("sensor", "")) if stated["type"] in QUANTITIES else None
        )
        return sensor.unit_on(self.model) if sensor is not None else kind.unit or of_path
