"""Studies in files: a model, the motions of its supports, loads, sensors, experiments, and what is free in a fit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from dataclasses import field as attribute
from pathlib import Path
from typing import Any

from jaxbody.experiments.measurements import Measurement
from jaxbody.files.builders import Builder
from jaxbody.files.documents import LARGEST, Document, read_document
from jaxbody.files.schemas import checked_values
from jaxbody.inputs.loads import Load
from jaxbody.inputs.motions import Motion
from jaxbody.models.models import Model
from jaxbody.sensors.sensors import Sensor
from jaxbody.studies.study_builders import StudyBuilder


@dataclass(frozen=True)
class Study:
    """A model and what a file states beside it, by name, as `simulate`, `measure` and `fit` take it. `fit` holds arguments of `fit`: free,
    bounds, priors, loss; `designs` those of `tune`; `files`, the curves and records
    that belong to it.

    >>> study = Study(jb.presets.quarter_car(), {"road": Harmonic(frequency=1.5, translation=[0, 0, 0.01])})
    >>> trajectory = simulate(study.model, [0.0, 0.1], motion=study.motion, loads=study.loads, initial="rest")
    """

    model: Model
    motion: dict[str, Motion]
    loads: dict[str, Load] = attribute(default_factory=dict)
    sensors: dict[str, Sensor] = attribute(default_factory=dict)
    experiments: dict[str, Measurement] = attribute(default_factory=dict)
    fit: dict[str, Any] = attribute(default_factory=dict)
    designs: dict[str, dict[str, Any]] = attribute(default_factory=dict)
    files: list[Path] = attribute(default_factory=list)


def read_study(path: Any, *, allow: Sequence[str] = (), largest: float = LARGEST) -> Study:
    """The model in a file, as `read_model` reads it, and what it states beside it: motions of supports, loads, sensors, experiments with
    their records, and what is free in a fit.

        [records.run1]
        file = "run1.csv"                                     # in the folder of this file
        time = "t"
        channels = {height = "z", base = {columns = "zb", unit = "mm"}}

        [sensors]
        height = {type = "Position", on = "car", axis = "z"}

        [experiments.run1]
        record = "run1"
        motion.road = {type = "Sampled", record = "run1", translation = "base", axis = "z"}
        initial = "rest"

        [fit]
        free = "spring.stiffness"
        bounds = {"spring.stiffness" = ["10 N/mm", "90 N/mm"]}

    Args:
        path, allow, largest: as in `read_model`

    Errors: those of `read_model`, `read_record` and `Experiment`.

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


def study_of(document: Document, values: dict[str, Any], folder: Path, allow: Sequence[str], *, measured: bool = True) -> Study:
    """The study in a document that is checked; files that it names are in the folder. `measured`: with experiments."""
    builder = Builder(document, values, folder, allow)
    parts = StudyBuilder(builder, builder.model())
    motion, loads, sensors = parts.motions(), parts.loads(), parts.sensors()
    experiments = parts.experiments(motion, loads, sensors) if measured else {}
    builder.problems.raise_if_any()
    fit = parts.fit(experiments) if measured else {}
    designs = parts.designs(sensors)
    builder.problems.raise_if_any()
    return Study(parts.model, motion, loads, sensors, experiments, fit, designs, builder.files)
