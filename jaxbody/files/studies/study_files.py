"""Studies in files: a model, the motions of its supports, loads, sensors, experiments, designs, and
the arguments of a fit, and their builder from a document."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from dataclasses import field as attribute
from pathlib import Path
from typing import Any

from jaxbody.core.arrays import device_array, shaped, time_text
from jaxbody.core.errors import Problems
from jaxbody.core.tables import Printed, PrintedTable, in_numpy, tables_in
from jaxbody.files.builders import Builder
from jaxbody.files.documents import LARGEST, Document, EntryPath, read_document
from jaxbody.files.schemas import checked_values
from jaxbody.fitting.experiments.measurements import Measurement
from jaxbody.fitting.parameters.ties_and_bounds import ties
from jaxbody.model.inputs.loads import Load, loads_of
from jaxbody.model.inputs.motions import Motion
from jaxbody.model.leaf_paths import Leaf, leaves_of, matching
from jaxbody.model.models import Model
from jaxbody.model.states import State
from jaxbody.sensors.sensors import Sensor


@dataclass(frozen=True, repr=False)
class Study(Printed):
    """A model and what a file states with it, by name, in the form that `simulate`, `measure` and
    `fit` take: `experiments` to fit, `held_out` ones for `validate`; `fit`: arguments of `fit`, or
    of `multistart` if it has `starts`; `designs`: arguments of `tune`; `files`: paths of the curves
    and records that the file names; `units`: the unit system that it states. Numbers are in SI; it
    prints in the units of the file, as results do by `result.summary(units=study.printed_units)`.

    >>> study = jb.files.Study(
    ...     jb.presets.quarter_car(), {"road": jb.Harmonic(frequency=1.5, translation=[0, 0, 0.01])}
    ... )
    >>> trajectory = jb.simulate(
    ...     study.model, [0.0, 0.1], motion=study.motion, loads=study.loads, initial="rest"
    ... )
    """

    model: Model
    motion: dict[str, Motion]
    loads: dict[str, Load] = attribute(default_factory=dict)
    sensors: dict[str, Sensor] = attribute(default_factory=dict)
    experiments: dict[str, Measurement] = attribute(default_factory=dict)
    fit: dict[str, Any] = attribute(default_factory=dict)
    designs: dict[str, dict[str, Any]] = attribute(default_factory=dict)
    files: list[Path] = attribute(default_factory=list)
    held_out: dict[str, Measurement] = attribute(default_factory=dict)
    units: Any = None

    @property
    def printed_units(self) -> Any:
        """The units for `summary` of results: those that the file states, or mm and deg."""
        return self.units or "mm"

    def _tables(self) -> list[PrintedTable]:
        parts = {
            "supports": self.model.layout.supports,
            "elements": self.model.element_names + self.model.force_names,
            "controllers": self.model.controller_names,
            "motion of": self.motion,
            "loads": self.loads,
            "sensors": self.sensors,
        }
        bodies, *_ = in_numpy(self.model)._tables()
        bodies.title = "Study"
        bodies.note = "\n".join(f"{what}: {', '.join(x)}" for what, x in parts.items() if x)
        runs = [_row_of(name, run, "fit") for name, run in self.experiments.items()]
        runs += [_row_of(name, run, "validation") for name, run in self.held_out.items()]
        designs = [
            (
                name,
                design["minimize"],
                ", ".join(_listed(design["free"])),
                ", ".join(design["limits"]),
            )
            for name, design in self.designs.items()
        ]
        shown = [
            PrintedTable("", ("experiment", "kind", "channels", "over", "for"), runs),
            PrintedTable(
                "", ("free in the fit",), [(path,) for path in _listed(self.fit.get("free", ()))]
            ),
            PrintedTable("", ("design", "minimizes", "free", "limits"), designs),
        ]
        return tables_in([bodies, *(table for table in shown if table.rows)], self.printed_units)


def _listed(free: Any) -> list[str]:
    """Return paths as a list; a single path becomes a list of one."""
    return [free] if isinstance(free, str) else list(free)


def _row_of(name: str, run: Measurement, use: str) -> tuple[str, ...]:
    """Return the row of an experiment in a table: its name, kind, channels, span, and use."""
    over, x, unit = run.axis(next(iter(run.channels)))
    span = f"{len(x)} of {over}"
    if unit:
        span += f", {time_text(x[0], x)} to {time_text(x[-1], x)} {unit}"
    return name, type(run).__name__, ", ".join(run.channels), span, use


def read_study(path: Any, *, allow: Sequence[str] = (), largest: float = LARGEST) -> Study:
    """Read a study: the model in a file, as `read_model` does, and what the file states with it:
    motions of supports, loads, sensors, records, measured modes and responses as experiments, free
    parameters of a fit, and designs.

        [records.run1]
        file = "run1.csv"              # in the folder of this file
        time = "t"
        channels = {height = "z", base = {columns = "zb", unit = "mm"}}

        [sensors]
        height = {type = "Position", on = "car", axis = "z"}

        [experiments.run1]
        record = "run1"
        motion.road = {type = "Sampled", record = "run1", translation = "base", axis = "z"}
        initial = "rest"
        # validate = true              # to hold it out of the fit, and validate the model by it

        [experiments.modal]            # without a type: Experiment
        type = "MeasuredModes"
        frequency = "1.21, 9.8 Hz"     # or with file = "modes.csv" a column, {columns = "f"}
        noise = {frequency = "0.02 Hz"}

        [experiments.hammer]
        type = "MeasuredResponse"
        file = "hammer.csv"
        frequencies = {columns = "f"}
        inputs.hammer = {type = "PointForce", on = "car", direction = "z"}
        measured.height.hammer.real = {columns = "re"}
        measured.height.hammer.imaginary = {columns = "im", unit = "mm/N"}

        [fit]
        free = "spring.stiffness"
        bounds = {"spring.stiffness" = ["10 N/mm", "90 N/mm"]}

    Args:
        path: path of the file, .toml or .json
        allow: names of your modules whose classes and functions the file may use:
            type = "mine.laws:Cubic". A quantity of a design, {type = "mine.costs:price",
            unit = "kg", rate = 3}, is the function price(model, rate=3), which returns a number
            in the SI unit of `unit`
        largest: largest size of the file [bytes]

    Errors: those of `read_model`, `read_record`, `Experiment`, `MeasuredModes`
    and `MeasuredResponse`.

    >>> import pathlib, tempfile
    >>> folder = pathlib.Path(tempfile.mkdtemp())
    >>> _ = (folder / "fall.csv").write_text("t [s],x [mm]\\n0,0\\n0.1,-49\\n0.2,-196\\n")
    >>> _ = (folder / "fall.toml").write_text('''jaxbody = 1
    ... bodies.stone = {mass = "2 kg", inertia = "1, 1, 1 kg m2"}
    ... records.fall = {file = "fall.csv", time = "t", channels = {height = "x"}}
    ... sensors.height = {type = "Position", on = "stone", axis = "z"}
    ... experiments.fall = {record = "fall"}
    ... ''')
    >>> jb.read_study(folder / "fall.toml").experiments["fall"].measured["height"].tolist()
    [0.0, -0.049, -0.196]
    """
    path = Path(path)
    document = read_document(path, largest)
    return study_of(document, checked_values(document), path.parent, allow)


def study_of(
    document: Document,
    values: dict[str, Any],
    folder: Path,
    allow: Sequence[str],
    *,
    measured: bool = True,
) -> Study:
    """Return the study in a checked document; `values`: its checked values; `folder`: folder of the
    files that it names; `measured`: whether experiments are read."""
    builder = Builder(document, values, folder, allow)
    parts = StudyBuilder(builder, builder.model())
    motion, loads, sensors = parts.motions(), parts.loads(), parts.sensors()
    experiments = parts.experiments(motion, loads, sensors) if measured else {}
    held_out = {name: experiments.pop(name) for name in parts.held_out() if name in experiments}
    stated = len(values.get("sensors", {}))
    with builder.problems:
        return Study(
            parts.model,
            motion,
            loads,
            sensors,
            experiments,
            fit=parts.fit(experiments) if measured else {},
            designs=parts.designs(sensors) if len(sensors) == stated else {},
            files=builder.files,
            held_out=held_out,
            units=values.get("units"),
        )


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
        checked = [each for each in _listed(given.get("free", ())) if not _about(each, failed)]

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
