"""Results in files: fits, motions, linear systems, designs and models in one archive of arrays and
text, with every number exact."""

import io
import json
import zipfile
from collections.abc import Sequence
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

import jax
import numpy as np

from jaxbody.core.arrays import is_concrete
from jaxbody.core.compilation.plain_data import Unnamed, text_of, value_of
from jaxbody.core.errors import JaxbodyError, Problem
from jaxbody.core.source_files import check_file, check_size, extension_of, replacing, writing

FORMAT = 2  # format 1 has names of classes from before 2026-11-29
CONTENTS = "results.json"
# date of all members, so that files of equal results differ only in the time in their text
EPOCH = (1980, 1, 1, 0, 0, 0)


def write_results(results: Any, path: Any, *, allow: Sequence[str] = ()) -> None:
    """Write results to a file, from which `read_results` reads them again.

    The file is a zip archive: `results.json` holds the names of classes and fields and all values
    except arrays, and each array is a .npy file.

    Args:
        results: a result of jaxbody, such as a fit, a trajectory or a design, or a dict of them by
            name; models and records too
        path: path of the file, .zip; it replaces one of the same name once it is written
        allow: names of your modules whose elements, laws, sensors and motions the results may hold

    Errors: UNKNOWN_FORMAT, OWN_CODE, TRACED, NOT_SAVED.

    >>> import pathlib, tempfile
    >>> car, path = jb.presets.quarter_car(), pathlib.Path(tempfile.mkdtemp(), "car.zip")
    >>> jb.write_results({"modes": jb.modes(jb.linearize(car, car.reference))}, path)
    >>> [round(float(f), 3) for f in jb.read_results(path)["modes"].frequency]
    [1.411, 8.796]
    """
    path = Path(path)
    extension_of(path, ".zip")
    if not is_concrete(results):
        raise JaxbodyError(
            Problem(
                "TRACED",
                "write_results",
                "cannot be called inside jit, vmap or grad",
                hint="Write what the compiled or batched function returns.",
            )
        )
    arrays: list[Any] = []
    try:
        text = text_of(results, arrays, allow)
    except Unnamed as error:
        raise JaxbodyError(
            Problem(
                "OWN_CODE",
                "write_results",
                f"holds {error} of your own Python",
                hint="Name its module in allow=[...]; a function has no text: "
                "write a class with fields.",
            )
        ) from None
    contents = {
        "format": FORMAT,
        "jaxbody": version("jaxbody"),
        "written": datetime.now(UTC).isoformat(timespec="seconds"),
        "results": json.loads(text),
    }
    with (
        writing(path),
        replacing(path) as new,
        zipfile.ZipFile(new, "w", zipfile.ZIP_DEFLATED) as archive,
    ):
        _add(archive, CONTENTS, json.dumps(contents).encode())
        for i, array in enumerate(arrays):
            data = io.BytesIO()
            np.lib.format.write_array(data, np.asarray(array), allow_pickle=False)
            _add(archive, f"{i}.npy", data.getvalue())


def _add(archive: zipfile.ZipFile, name: str, data: bytes) -> None:
    archive.writestr(zipfile.ZipInfo(name, EPOCH), data, zipfile.ZIP_DEFLATED)


def read_results(path: Any, *, allow: Sequence[str] = (), largest: float = 1e9) -> Any:
    """Read the results in a file that `write_results` wrote. Nothing in the file is executed.

    Args:
        path: path of the file
        allow: names of your modules whose classes the file may name
        largest: largest size of the file and of what it holds [bytes]

    Errors: NO_FILE, IS_DIRECTORY, NOT_A_FILE, EMPTY_FILE, TOO_LARGE, WRONG_FORMAT, FILE_VERSION,
    NOT_ALLOWED, FLOAT32 for results in double precision while JAX is set to single precision.

    >>> import pathlib, tempfile
    >>> path = pathlib.Path(tempfile.mkdtemp(), "car.zip")
    >>> jb.write_results(jb.presets.quarter_car(), path)
    >>> jb.read_results(path).layout.bodies
    ('body', 'wheel')
    """
    path = Path(path)
    check_file(path, largest)
    try:
        with zipfile.ZipFile(path) as archive:
            check_size(
                path.name,
                sum(member.file_size for member in archive.infolist()),
                largest,
                "bytes in all",
            )
            contents = json.loads(archive.read(CONTENTS))
            _check_version(contents, path.name)
            names = sorted(
                (name for name in archive.namelist() if name.endswith(".npy")),
                key=lambda name: int(name[:-4]),
            )
            arrays = [_array(archive.read(name)) for name in names]
    except JaxbodyError:
        raise
    except Exception as error:  # zipfile, zlib, json, numpy and tokenize raise many kinds
        raise JaxbodyError(
            Problem(
                "WRONG_FORMAT",
                path.name,
                f"is no archive of results: {str(error).partition(chr(10))[0]:.100}",
                hint="Was it copied whole? Write it again with write_results.",
            )
        ) from None
    if not jax.config.read("jax_enable_x64") and any(
        array.dtype in (np.float64, np.complex128) for array in arrays
    ):
        raise JaxbodyError(
            Problem(
                "FLOAT32",
                path.name,
                "holds numbers in double precision",
                "float64",
                "float32 as JAX is set",
                'jax.config.update("jax_enable_x64", True) before anything else.',
            )
        )
    try:
        return value_of(json.dumps(contents["results"]), arrays, allow)
    except ValueError as error:
        raise JaxbodyError(
            Problem(
                "NOT_ALLOWED",
                path.name,
                f"cannot be read: {error!s:.200}",
                hint=(
                    "Read it with the jaxbody that wrote it"
                    + f", {contents.get('jaxbody')}, or allow=[...] the module that it names."
                ),
            )
        ) from None


def _check_version(contents: Any, name: str) -> None:
    stated = contents.get("format") if isinstance(contents, dict) else None
    if stated != FORMAT or "results" not in contents:
        raise JaxbodyError(
            Problem(
                "FILE_VERSION",
                name,
                f"is of format {stated!r:.20}",
                stated,
                str(FORMAT),
                (
                    f"This jaxbody, {version('jaxbody')}, reads format {FORMAT}: install "
                    "the one that wrote it."
                ),
            )
        )


def _array(data: bytes) -> np.ndarray:
    """Return the array in the bytes of a .npy file. The size in its header is compared with the
    number of bytes before memory is allocated."""
    file = io.BytesIO(data)
    if np.lib.format.read_magic(file) != (1, 0):
        raise ValueError("an array of another version")
    shape, _, dtype = np.lib.format.read_array_header_1_0(file)
    if (
        dtype.kind not in "biufc"
        or int(np.prod(shape, dtype=object)) * dtype.itemsize != len(data) - file.tell()
    ):
        raise ValueError("an array whose size is not that of its data")
    file.seek(0)
    return np.lib.format.read_array(file, allow_pickle=False)
