"""Studies in files: a model, the motions of its supports, loads, sensors, experiments, designs, and
the arguments of a fit."""

from collections.abc import Sequence
from dataclasses import dataclass
from dataclasses import field as attribute
from pathlib import Path
from typing import Any

from jaxbody.core.arrays import time_text
from jaxbody.core.tables import Printed, PrintedTable, in_numpy, tables_in
from jaxbody.files.builders import Builder
from jaxbody.files.documents import LARGEST, Document, read_document
from jaxbody.files.schemas import checked_values
from jaxbody.files.studies.study_builders import StudyBuilder
from jaxbody.fitting.experiments.measurements import Measurement
from jaxbody.model.inputs.loads import Load
from jaxbody.model.inputs.motions import Motion
from jaxbody.model.models import Model
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
