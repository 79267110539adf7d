"""Builders of studies: records, sensors, loads, motions, experiments and designs of a document, and
the arguments of its fit."""

from collections.abc import Collection
from dataclasses import dataclass, replace
from typing import Any

from jaxbody.core.arrays import device_array, shaped
from jaxbody.core.errors import Problems
from jaxbody.files.builders import Builder
from jaxbody.files.documents import EntryPath
from jaxbody.fitting.experiments.measurements import Measurement
from jaxbody.fitting.parameters.ties_and_bounds import ties
from jaxbody.model.inputs.loads import Load, loads_of
from jaxbody.model.inputs.motions import Motion
from jaxbody.model.leaf_paths import Leaf, leaves_of, matching
from jaxbody.model.models import Model
from jaxbody.model.states import State
from jaxbody.sensors.sensors import Sensor


@dataclass
class StudyBuilder:
    """Builder of what a study states besides its model; `builder`, that of the document, builds the
    objects and collects the problems."""

    builder: Builder
    model: Model

    def named(
        self, section: str, make: Any, values: dict[str, Any] | None = None, path: EntryPath = ()
    ) -> dict[str, Any]:
        """Return {name: make(value, path)} of a section of the document, or of `values`, a table at
        `path`, without those that failed."""
        given = self.builder.values.get(section, {}) if values is None else values
        return {
            name: made
            for name, value in given.items()
            if (made := make(value, (*path, section, name))) is not None
        }

    def motions(
        self, values: dict[str, Any] | None = None, path: EntryPath = ()
    ) -> dict[str, Motion]:
        """Return the motions of supports, by name."""
        motions = self.named("motion", self.builder.motion, values, path)
        known = self.model.layout.supports
        for name in set(motions) - set(known):
            self.builder.unknown(name, known, (*path, "motion", name))
        return {name: motion for name, motion in motions.items() if name in known}

    def loads(self, values: dict[str, Any] | None = None, path: EntryPath = ()) -> dict[str, Load]:
        return self.named("loads", self.load, values, path)

    def load(self, values: dict[str, Any], path: EntryPath) -> Load | None:
        """Build a load and check that it acts on a body of the model."""
        load, name = self.builder.thing(values, None, path, {}), path[-1]
        checked = load and self.builder.gather(
            path, f"loads[{name!r}]", lambda: loads_of({str(name): load}, self.model.layout.bodies)
        )
        return load if checked else None

    def sensors(self) -> dict[str, Sensor]:
        return self.named("sensors", self.sensor)

    def sensor(self, values: dict[str, Any], path: EntryPath) -> Sensor | None:
        """Build a sensor; the unit of its bias and start depends on the model."""
        own = {name: values[name] for name in ("bias", "start") if name in values}
        sensor = self.builder.thing(
            {name: value for name, value in values.items() if name not in own}, None, path, {}
        )
        if sensor is None:
            return None
        where = self.builder.document.where(path)
        if not isinstance(sensor, Sensor):
            self.builder.problems.add(
                "WRONG_KIND", where, f"is a {type(sensor).__name__}", value=sensor, limit="a sensor"
            )
            return None
        problem = sensor.problem(self.model, "")
        if problem is not None:
            self.builder.problems.collected.append(replace(problem, where=where))
            return sensor
        stated = {
            name: self.builder.quantity(value, sensor.unit_on(self.model), (*path, name))
            for name, value in own.items()
        }
        return self.builder.thing(values | stated, None, path, {}) if own else sensor

    def experiments(
        self, motion: dict[str, Motion], loads: dict[str, Load], sensors: dict[str, Sensor]
    ) -> dict[str, Measurement]:
        """Return the experiments by name; one that states no motions, loads or sensors has those of
        the study."""
        return self.named(
            "experiments",
            lambda values, path: self.experiment(values, path, motion, loads, sensors),
        )

    def held_out(self) -> list[str]:
        """Return the names of the experiments that validate the fit and are not part of it."""
        return [
            name
            for name, values in self.builder.values.get("experiments", {}).items()
            if values.get("validate")
        ]

    def experiment(
        self,
        values: dict[str, Any],
        path: EntryPath,
        motion: Any,
        loads: Any,
        sensors: dict[str, Sensor],
    ) -> Any:
        if values.get("type", "Experiment") != "Experiment":
            # slow to import, and many files have none
            from jaxbody.files.studies.measurement_builders import MeasurementBuilder

            return MeasurementBuilder(self.builder, self.model, sensors, values, path).build()
        from jaxbody.fitting.experiments.experiments import Experiment  # slow to import

        record, before = self.builder.record(values["record"]), len(self.builder.problems.collected)
        channels = self.builder.values["records"][values["record"]]["channels"]
        chosen = values.get(
            "sensors", [name for name in self.builder.values.get("sensors", {}) if name in channels]
        )
        given: dict[str, Any] = {
            "measured": record,
            "sensors": {name: sensors[name] for name in chosen if name in sensors},
            "motion": self.motions(values["motion"], path) if "motion" in values else motion,
            "loads": self.loads(values["loads"], path) if "loads" in values else loads,
        }
        if "initial" in values:
            given["initial"] = self.initial(values["initial"], (*path, "initial"))
        if "noise" in values:
            given["noise"] = {  # unknown names are reported by `Experiment`
                name: self.builder.quantity(
                    x, sensors[name].unit_on(self.model), (*path, "noise", name)
                )
                if name in given["sensors"]
                else x
                for name, x in values["noise"].items()
            }
        if "leave_out" in values:
            given["leave_out"] = values["leave_out"]
        # if its parts have problems, the constructor would only report their consequences
        if (
            record is None
            or set(chosen) - set(sensors)
            or len(self.builder.problems.collected) > before
        ):
            return None
        return self.builder.measurement(Experiment, given, self.model, path)

    def initial(self, value: Any, path: EntryPath) -> State | str | None:
        if isinstance(value, str):
            return value
        rows = {
            name: getattr(self.model.layout, f"{name}_units") for name in "qvz" if name in value
        }
        numbers = {
            name: self.builder.quantity(value[name], ", ".join(row), (*path, name))
            for name, row in rows.items()
        }

        def state() -> State:
            with Problems() as problems:
                parts = [
                    shaped(_row(numbers[name]), (len(row),), f".{name}", problems)
                    for name, row in rows.items()
                ]
            return State(*map(device_array, parts))

        return self.builder.gather(path, "", state)

    def fit(self, experiments: dict[str, Any]) -> dict[str, Any]:
        """Return the arguments of `fit`. Bounds and priors are in the unit of their parameter."""
        given = dict(self.builder.values.get("fit", {}))
        leaves = [
            *leaves_of(self.model),
            *(leaf for name, run in experiments.items() for leaf in leaves_of(run, f"{name}.")),
        ]
        stated = self.builder.values.get("experiments", {})
        failed = stated.keys() - experiments.keys() - set(self.held_out())
        self.check_free(given, leaves, ("fit",), failed)
        for name in ("bounds", "priors"):
            if name in given:
                known = {path: x for path, x in given[name].items() if not _about(path, failed)}
                given[name] = self.of_parameters(known, leaves, ("fit", name))
        return given

    def check_free(
        self,
        given: dict[str, Any],
        leaves: list[Leaf],
        path: EntryPath,
        failed: Collection[str] = (),
    ) -> None:
        """Check that the free paths are parameters, except paths that may refer to experiments that
        could not be built, `failed`."""
        free = given.get("free", [])
        paths = [free] if isinstance(free, str) else free
        checked = [each for each in paths if not _about(each, failed)]

        def check() -> None:
            with Problems() as problems:
                ties(leaves, checked, "", problems)

        if checked:
            self.builder.gather((*path, "free"), "", check)

    def of_parameters(
        self, given: dict[str, Any], leaves: list[Leaf], path: EntryPath
    ) -> dict[str, Any]:
        """Return {path or pattern of parameters: numbers in SI}; the document states the numbers in
        the units of the parameters."""
        rows = {"configuration": self.model.layout.q_units, "speeds": self.model.layout.v_units}
        numbers = {}
        for pattern, value in given.items():
            at = (*path, pattern)
            chosen = self.builder.gather(
                at, "", lambda pattern=pattern: matching(leaves, [pattern], "")[pattern]
            )
            if chosen:
                kind = chosen[0].kind
                unit = ", ".join(rows.get(kind.domain, [kind.unit]))
                numbers[pattern] = (
                    tuple(self.builder.quantity(x, unit, at) for x in value)
                    if isinstance(value, list)
                    else self.builder.quantity(value, unit, at)
                )
        return numbers

    def designs(self, sensors: dict[str, Sensor]) -> dict[str, dict[str, Any]]:
        return self.named("designs", lambda values, path: self.design(values, path, sensors))

    def design(
        self, values: dict[str, Any], path: EntryPath, sensors: dict[str, Sensor]
    ) -> dict[str, Any]:
        """Return the arguments of `tune` other than the model."""
        # slow to import, and many files have none
        from jaxbody.files.studies.design_builders import DesignBuilder

        leaves = leaves_of(self.model)
        self.check_free(values, leaves, path)
        numbers = {
            name: self.of_parameters(values[name], leaves, (*path, name))
            for name in ("bounds", "catalogues")
            if name in values
        }
        return DesignBuilder(self.builder, self.model, sensors, values, path).build() | numbers


def _about(path: str, failed: Collection[str]) -> bool:
    """Return whether a path, pattern or tie may refer to an experiment that could not be built."""
    return bool(failed) and (
        "*" in path or "?" in path or any(f"{name}." in path for name in failed)
    )


def _row(numbers: Any) -> Any:
    """Return a row of numbers; a single number becomes a row of one."""
    return [numbers] if isinstance(numbers, float) else numbers
