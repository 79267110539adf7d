"""Builders of studies: records, sensors, loads, motions and experiments of a document, and what is free in a fit."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from jaxbody.core.arrays import device_array, shaped
from jaxbody.core.errors import Problems, unknown
from jaxbody.experiments.experiments import Experiment
from jaxbody.experiments.measurements import Measurement
from jaxbody.files.builders import Builder
from jaxbody.files.documents import EntryPath
from jaxbody.files.quantities import in_SI
from jaxbody.inputs.loads import Load, loads_of
from jaxbody.inputs.motions import Motion
from jaxbody.models.leaf_paths import Leaf, leaves_of, matching
from jaxbody.models.models import Model
from jaxbody.models.states import State
from jaxbody.sensors.sensors import Sensor
from jaxbody.studies.design_quantities import QUANTITIES, Evaluation, sensors_of


@dataclass
class StudyBuilder:
    """Makes what a study states beside its model; objects by the builder of the document, which collects the problems."""

    builder: Builder
    model: Model

    @property
    def values(self) -> dict[str, Any]:
        return self.builder.values

    def named(self, section: str, make: Any, values: dict[str, Any] | None = None, path: EntryPath = ()) -> dict[str, Any]:
        """The objects of a section, or of a table at a path."""
        given = self.values.get(section, {}) if values is None else values
        return {name: made for name, value in given.items() if (made := make(value, (*path, section, name))) is not None}

    def motions(self, values: dict[str, Any] | None = None, path: EntryPath = ()) -> dict[str, Motion]:
        """The motions of supports."""
        motions = self.named("motion", self.builder.motion, values, path)
        known = self.model.layout.supports
        for name in set(motions) - set(known):
            where = self.builder.document.where((*path, "motion", name))
            self.builder.problems.collected.append(unknown(name, where, known))
        return motions

    def loads(self, values: dict[str, Any] | None = None, path: EntryPath = ()) -> dict[str, Load]:
        make = lambda value, at: self.builder.thing(value, None, at, {})  # noqa: E731
        loads = self.named("loads", make, values, path)
        for name, load in loads.items():
            where = (*path, "loads", name)
            self.builder.gather(where, f"loads[{name!r}]", lambda name=name, load=load: loads_of({name: load}, self.model.layout.bodies))
        return loads

    def sensors(self) -> dict[str, Sensor]:
        return self.named("sensors", self.sensor)

    def sensor(self, values: dict[str, Any], path: EntryPath) -> Sensor | None:
        """A sensor on a model, which determines the unit of its bias and start."""
        own = {name: values[name] for name in ("bias", "start") if name in values}
        sensor = self.builder.thing({name: value for name, value in values.items() if name not in own}, None, path, {})
        if sensor is not None and not isinstance(sensor, Sensor):
            message = f"is a {type(sensor).__name__}"
            self.builder.problems.add("WRONG_KIND", self.builder.document.where(path), message, value=sensor, limit="a sensor")
            return None
        problem = None if sensor is None else sensor.problem(self.model, "")
        if problem is not None:
            self.builder.problems.collected.append(replace(problem, where=self.builder.document.where(path)))
        if sensor is None or problem is not None or not own:
            return sensor
        stated = {name: self.quantity(value, sensor.unit_on(self.model), (*path, name)) for name, value in own.items()}
        return self.builder.thing(values | stated, None, path, {})

    def quantity(self, value: Any, unit: str, path: EntryPath) -> Any:
        """Numbers in SI, whose unit is known only here."""
        return in_SI(value, unit, {}, self.builder.check.system, self.builder.document.where(path), self.builder.problems)

    def experiments(self, motion: dict[str, Motion], loads: dict[str, Load], sensors: dict[str, Sensor]) -> dict[str, Measurement]:
        """The experiments, with the motions, loads and sensors of the study where they state none."""
        return self.named("experiments", lambda values, path: self.experiment(values, path, motion, loads, sensors))

    def experiment(self, values: dict[str, Any], path: EntryPath, motion: Any, loads: Any, sensors: dict[str, Sensor]) -> Any:
        record = self.builder.record(values["record"])
        if record is None:
            return None
        chosen = values.get("sensors", [name for name in sensors if name in record.channels])
        given: dict[str, Any] = {"sensors": {name: sensors[name] for name in chosen if name in sensors}, "measured": record}
        given["motion"] = self.motions(values["motion"], path) if "motion" in values else motion
        given["loads"] = self.loads(values["loads"], path) if "loads" in values else loads
        if "initial" in values:
            given["initial"] = self.initial(values["initial"], (*path, "initial"))
        if "noise" in values:
            given["noise"] = {name: self.level(name, x, given["sensors"], (*path, "noise", name)) for name, x in values["noise"].items()}
        if "leave_out" in values:
            given["leave_out"] = values["leave_out"]
        experiment = self.builder.gather(path, "Experiment", lambda: Experiment(**given))
        if experiment is not None:
            self.builder.gather(path, "", lambda: experiment.check(self.model, ""))
        return experiment

    def level(self, name: str, value: Any, sensors: dict[str, Sensor], path: EntryPath) -> Any:
        """The noise of a sensor; an unknown name is left to `Experiment`."""
        return self.quantity(value, sensors[name].unit_on(self.model), path) if name in sensors else value

    def initial(self, value: Any, path: EntryPath) -> State | str | None:
        if isinstance(value, str):
            return value
        rows = {"q": self.model.layout.q_units, "v": self.model.layout.v_units}
        numbers = {name: self.quantity(value[name], ", ".join(row), (*path, name)) for name, row in rows.items()}

        def state() -> State:
            with Problems() as problems:
                q, v = (shaped(numbers[name], (len(row),), f".{name}", problems) for name, row in rows.items())
            return State(device_array(q), device_array(v))

        return self.builder.gather(path, "", state)

    def fit(self, experiments: dict[str, Any]) -> dict[str, Any]:
        """The arguments of `fit`. The unit of a bound or a prior is that of its parameter."""
        given = dict(self.values.get("fit", {}))
        leaves = [*leaves_of(self.model), *(leaf for name, run in experiments.items() for leaf in leaves_of(run, f"{name}."))]
        return given | {name: self.of_parameters(given[name], leaves, ("fit", name)) for name in ("bounds", "priors") if name in given}

    def of_parameters(self, given: dict[str, Any], leaves: list[Leaf], path: EntryPath) -> dict[str, Any]:
        """Numbers by the path or pattern of parameters, in their units."""
        rows = {"configuration": self.model.layout.q_units, "speeds": self.model.layout.v_units}
        numbers = {}
        for pattern, value in given.items():
            at = (*path, pattern)
            found = self.builder.gather(at, "", lambda pattern=pattern: matching(leaves, [pattern], "")[pattern])
            if found:
                kind = found[0].kind
                unit = ", ".join(rows[kind.domain]) if kind.domain in rows else kind.unit
                numbers[pattern] = (
                    tuple(self.quantity(x, unit, at) for x in value) if isinstance(value, list) else self.quantity(value, unit, at)
                )
        return numbers

    def designs(self, sensors: dict[str, Sensor]) -> dict[str, dict[str, Any]]:
        return self.named("designs", lambda values, path: self.design(values, path, sensors))

    def design(self, values: dict[str, Any], path: EntryPath, sensors: dict[str, Sensor]) -> dict[str, Any] | None:
        """The arguments of `tune` beside the model."""
        own = {name: stated["type"] for name, stated in values["quantities"].items() if stated["type"] not in QUANTITIES}
        for name, kind in own.items():  # "module:name", which elsewhere is a class of the user's
            where = self.builder.document.where((*path, "quantities", name, "type"))
            self.builder.problems.collected.append(unknown(kind, where, tuple(QUANTITIES)))
        if own:
            return None
        leaves, quantities, problems = leaves_of(self.model), values["quantities"], self.builder.problems
        where = lambda *parts: self.builder.document.where((*path, *parts))  # noqa: E731
        for name in {values["minimize"], *values.get("limits", {})} - set(quantities):
            at = ("limits", name) if name in values.get("limits", {}) else ("minimize",)
            problems.collected.append(unknown(name, where(*at), tuple(quantities)))
        for name, stated in quantities.items():
            self._check_quantity(stated, sensors, leaves, (*path, "quantities", name))
            if QUANTITIES[stated["type"]].on_roads and not values.get("roads"):
                message, hint = "is a quantity of a ride, and there are no roads", 'Write roads.NAME = {class = "C", speed = "20 m/s"}.'
                problems.add("MISSING_ENTRY", where("quantities", name), message, limit="roads", hint=hint)
        for name in set(values.get("roads", {})) - set(self.model.layout.supports):
            problems.collected.append(unknown(name, where("roads", name), self.model.layout.supports))
        given = {name: values[name] for name in ("free", "minimize", "starts") if name in values}
        for name in ("bounds", "catalogues"):
            given |= {name: self.of_parameters(values[name], leaves, (*path, name))} if name in values else {}
        limits = {}
        for name, value in values.get("limits", {}).items():
            unit = self.unit_of(quantities.get(name, {"type": "value"}), sensors, leaves)
            pair = self.quantity(value, unit, (*path, "limits", name))
            limits[name] = tuple(pair) if isinstance(pair, list) else pair
        roads = {name: (road["class"], road["speed"]) for name, road in values.get("roads", {}).items()}
        read = {name: sensors[name] for name in sensors_of(quantities) if name in sensors}
        evaluate = Evaluation(quantities, read, roads, tuple(values.get("band", (0.1, 100.0))))
        return given | {"evaluate": evaluate, "limits": limits}

    def _check_quantity(self, stated: dict[str, Any], sensors: dict[str, Sensor], leaves: list[Leaf], path: EntryPath) -> None:
        where = lambda part: self.builder.document.where((*path, part))  # noqa: E731
        for name in set(stated.get("weights", {})) - set(sensors):
            self.builder.problems.collected.append(unknown(name, where("weights") + f".{name}", tuple(sensors)))
        if stated.get("mode", 1) not in range(1, self.model.layout.nv + 1):
            limit = f"1 to {self.model.layout.nv}"
            self.builder.problems.add("BAD_NUMBER", where("mode"), f"is {stated['mode']}", value=stated["mode"], limit=limit)
        if "path" in stated and stated["path"] not in {leaf.path for leaf in leaves}:
            self.builder.gather((*path, "path"), "", lambda: matching(leaves, [stated["path"]], ""))

    def unit_of(self, quantity: dict[str, Any], sensors: dict[str, Sensor], leaves: list[Leaf]) -> str:
        """The unit of a quantity: of its kind, its sensor or its number."""
        if quantity.get("sensor") in sensors:
            return sensors[quantity["sensor"]].unit_on(self.model)
        of_path = next((leaf.kind.unit for leaf in leaves if leaf.path == quantity.get("path")), "")
        return QUANTITIES[quantity["type"]].unit or of_path
