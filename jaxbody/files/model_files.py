"""Models in TOML and JSON files: `read_model` builds a model with the constructors, `write_model`
writes every number exactly."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from jaxbody.core.source_files import extension_of, writing
from jaxbody.files.builders import Builder
from jaxbody.files.documents import LARGEST, read_document
from jaxbody.files.schemas import checked_values
from jaxbody.files.writers import json_of, toml_of, values_of
from jaxbody.model.models import Model


def read_model(path: Any, *, allow: Sequence[str] = (), largest: float = LARGEST) -> Model:
    """Read a model from a TOML or JSON file.

    Numbers are written as text with a unit, "21 N/mm"; if the file states `units`, numbers without
    a unit are in that system. Entries have the names of the arguments of the constructors. All
    problems are reported at once, each with its line. Nothing in the file is executed.

    Args:
        path: path of the file, .toml or .json
        allow: names of your modules whose elements, joints, closures and laws the file may use:
            type = "mine.laws:Cubic"
        largest: largest size of the file [bytes]

    Errors: NO_FILE, IS_DIRECTORY, NOT_A_FILE, EMPTY_FILE, TOO_LARGE, ENCODING,
    UNKNOWN_FORMAT, SYNTAX, DUPLICATE_NAME, FILE_VERSION, UNKNOWN_NAME, MISSING_ENTRY,
    WRONG_KIND, NO_UNIT, UNKNOWN_UNIT, WRONG_DIMENSION, NOT_A_NUMBER, NOT_ALLOWED,
    OUTSIDE_FOLDER, and those of the constructors.

    >>> import pathlib, tempfile
    >>> path = pathlib.Path(tempfile.mkdtemp(), "pendulum.toml")
    >>> _ = path.write_text('''jaxbody = 1
    ... gravity = "0, -9.81, 0 m/s2"
    ... bodies.bob = {mass = "200 g0", com = "0, -50, 0 cm"}
    ... joints.bob = {type = "Hinge", parent = "world", axis = [0, 0, 1]}
    ... ''')
    >>> jb.read_model(path)  # doctest: +NORMALIZE_WHITESPACE
    Traceback (most recent call last):
    jaxbody.core.errors.JaxbodyError: pendulum.toml:3 bodies.bob.mass: is '200 g0', in m/s2
    (allowed: a unit such as kg). ...
    >>> _ = path.write_text(path.read_text().replace("200 g0", "0.2 kg"))
    >>> float(jb.read_model(path)["bob"].com[1])
    -0.5
    """
    path = Path(path)
    document = read_document(path, largest)
    return Builder(document, checked_values(document), path.parent, allow).model()


def write_model(model: Model, path: Any, *, allow: Sequence[str] = ()) -> None:
    """Write a model to a TOML or JSON file, from which `read_model` reads exactly the same numbers.

    Args:
        model: the model
        path: path of the file, .toml or .json; a file of the same name is replaced
        allow: names of your modules whose elements, joints, closures and laws may be written
            by name

    Errors: UNKNOWN_FORMAT, OWN_CODE, NOT_ALLOWED, BAD_SHAPE for a batch of models,
    TRACED, NOT_SAVED.

    >>> import pathlib, tempfile
    >>> car, path = jb.presets.quarter_car(), pathlib.Path(tempfile.mkdtemp(), "car.toml")
    >>> jb.write_model(car, path)
    >>> bool(jnp.all(jb.read_model(path)["tyre"].stiffness == car["tyre"].stiffness))
    True
    """
    path = Path(path)
    values = values_of(model, allow)
    text_of = toml_of if extension_of(path, ".toml", ".json") == ".toml" else json_of
    with writing(path):
        path.write_text(text_of(values), encoding="utf-8")
