"""Studies in files: a model, the motions of its supports, loads, sensors, experiments, and what is
free in a fit."""

from collections.abc import Sequence
from dataclasses import dataclass
from dataclasses import field as attribute
from pathlib import Path
from typing import Any

from jaxbody.core.arrays import time_text
from jaxbody.core.tables import Printed, PrintedTable, in_numpy
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
    """A model and what a file states beside it, by name, as `simulate`, `measure` and `fit` take
    it. `experiments` are those to fit, `held_out` those for `validate`. `fit` holds arguments of
    `fit`, or of `multistart` where it states `starts`; `designs` those of `tune`; `files`, the
    curves and records that belong to it.

    >>> study = Study(
    ...     jb.presets.quarter_car(), {"road": Harmonic(frequency=1.5, translation=[0, 0, 0.01])}
    ... )
    >>> trajectory = simulate(
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

    def _tables(self) -> list[PrintedTable]:
        parts = {
            "supports": self.model.layout.supports,
            "elements": self.model.element_names,
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
        return [bodies, *(table for table in shown if table.rows)]


def _listed(free: Any) -> list[str]:
    return [free] if isinstance(free, str) else list(free)


def _row_of(name: str, run: Measurement, use: str) -> tuple[str, ...]:
    """An experiment: what was measured, over how many times, frequencies or modes."""
    over, x, unit = run.axis(next(iter(run.channels)))
    span = f"{len(x)} of {over}"
    if unit:
        span += f", {time_text(x[0], x)} to {time_text(x[-1], x)} {unit}"
    return name, type(run).__name__, ", ".join(run.channels), span, use


def read_study(path: Any, *, allow: Sequence[str] = (), largest: float = LARGEST) -> Study:
    """The model in a file, as `read_model` reads it, and what it states beside it: motions of
    supports, loads, sensors, records in time, measured modes and responses as experiments, what is
    free in a fit, and designs.

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
        # validate = true              # where it is held out of the fit, to validate the model

        [experiments.modal]            # Experiment where no type is stated
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
        path, largest: as in `read_model`
        allow: names of your modules whose classes and functions the file may use:
            type = "mine.laws:Cubic"; a quantity of a design, {type = "mine.costs:price",
            unit = "kg", rate = 3}, is the function price(model, rate=3), which returns SI units
            of `unit`

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
    >>> read_study(folder / "fall.toml").experiments["fall"].measured["height"].tolist()
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
    """The study in a document that is checked; files that it names are in the folder. `measured`:
    with experiments."""
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
        )
