"""Studies in files: a model and what is done with it, the motions of its supports."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from jaxbody.files.builders import Builder
from jaxbody.files.documents import LARGEST, Document, read_document
from jaxbody.files.schemas import checked_values
from jaxbody.inputs.motions import Motion
from jaxbody.models.models import Model


@dataclass(frozen=True)
class Study:
    """A model, and the motions of its supports {support: motion}, as `simulate` takes them.

    >>> study = Study(jb.presets.quarter_car(), {"road": Harmonic(frequency=1.5, translation=[0, 0, 0.01])})
    >>> trajectory = simulate(study.model, [0.0, 0.1], motion=study.motion, initial="rest")
    """

    model: Model
    motion: dict[str, Motion]


def read_study(path: Any, *, allow: Sequence[str] = (), largest: float = LARGEST) -> Study:
    """The model in a file, as `read_model` reads it, and the motions of its supports:

        motion.road = {type = "Harmonic", frequency = "1.5 Hz", translation = "0, 0, 10 mm"}

    Args:
        path, allow, largest: as in `read_model`

    Errors: those of `read_model`.

    >>> import pathlib, tempfile
    >>> path = pathlib.Path(tempfile.mkdtemp(), "shaker.toml")
    >>> _ = path.write_text('''jaxbody = 1
    ... bodies.box = {mass = "2 kg", inertia = "1, 1, 1 kg m2"}
    ... supports.table = {}
    ... joints.box = {type = "Fixed", parent = "table"}
    ... motion.table = {type = "Harmonic", frequency = "1.5 Hz", translation = "0, 0, 10 mm"}
    ... ''')
    >>> float(read_study(path).motion["table"].translation[2])
    0.01
    """
    path = Path(path)
    document = read_document(path, largest)
    return study_of(document, checked_values(document), path.parent, allow)


def study_of(document: Document, values: dict[str, Any], folder: Path, allow: Sequence[str]) -> Study:
    """The study in a document that is checked; files that it names are in the folder."""
    builder = Builder(document, values, folder, allow)
    model = builder.model()
    return Study(model, builder.motion(model.layout.supports))
