"""Where a fit has got to, in a file: u, the noise levels in use, and what each number is called."""

from __future__ import annotations

import contextlib
import os
import tempfile
import zipfile
from pathlib import Path

import jax.numpy as jnp
import numpy as np

from jaxbody.errors import JaxbodyError, Problem
from jaxbody.tasks import Levels, Task


def _names(task: Task) -> list[str]:
    """Of all numbers that a checkpoint holds, in their order."""
    return [*task.labels, *(f"noise of {run}.{name}" for run, levels in task.noise.items() for name in levels)]


def save(path: str | os.PathLike, task: Task, u: np.ndarray) -> None:
    """Into a file beside it, which then takes its place: a crash or a full disk leaves the old one as it was."""
    path = Path(path)
    if path.exists() and not path.is_file():
        raise JaxbodyError(
            Problem("NOT_SAVED", str(path), "is there already and no file", limit="a file or nothing", hint="Choose another path.")
        )
    levels = [np.asarray(level) for each in task.noise.values() for level in each.values()]
    arrays = {"names": np.array(_names(task)), "u": np.asarray(u), **{f"noise{i}": level for i, level in enumerate(levels)}}
    temporary = None
    try:
        with tempfile.NamedTemporaryFile(dir=path.parent, prefix=path.name, suffix=".part", delete=False) as file:
            temporary = file.name
            np.savez(file, **arrays)  # pyright: ignore[reportArgumentType]
            file.flush()
            os.fsync(file.fileno())
        os.replace(temporary, path)
    except OSError as error:
        if temporary is not None:
            with contextlib.suppress(OSError):
                os.unlink(temporary)
        needed = sum(a.nbytes for a in arrays.values())
        told = f"cannot be written: {error.strerror or error}; {needed} bytes are needed"
        raise JaxbodyError(Problem("NOT_SAVED", str(path), told, hint="What was there before is still there.")) from None


def load(path: str | os.PathLike, task: Task) -> tuple[np.ndarray, Levels]:
    """u and the noise levels, of a checkpoint of the same task."""
    try:
        with np.load(path) as file:
            names, arrays = file["names"].tolist(), {key: file[key] for key in file.files if key != "names"}
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
        hint = "Leave resume out to start anew."
        raise JaxbodyError(Problem("NO_CHECKPOINT", str(path), f"is no checkpoint that can be read: {error}", hint=hint)) from None
    check_same(names, task, str(path))
    places = [(run, name) for run, levels in task.noise.items() for name in levels]
    noise: Levels = {run: {} for run in task.noise}
    for i, (run, name) in enumerate(places):
        noise[run][name] = jnp.asarray(arrays[f"noise{i}"])
    return arrays["u"], noise


def check_same(names: list[str], task: Task, where: str) -> None:
    """What is resumed is a fit of the same parameters to the same channels."""
    mine = _names(task)
    if names != mine:
        other = [f"'{name}'" for name in [*names, *mine] if (name in names) != (name in mine)] or ["another order"]
        told = f"is of another fit: they differ in {', '.join(other[:3])}"
        raise JaxbodyError(Problem("OTHER_FIT", where, told, hint="Resume with the free parameters and experiments that it began with."))


def resumed(earlier, task: Task) -> tuple[np.ndarray, Levels]:
    """u and the noise levels of an earlier fit, or of a file."""
    if isinstance(earlier, str | os.PathLike):
        return load(earlier, task)
    check_same(_names(earlier.task), task, "fit.resume")
    return np.asarray(earlier.u), earlier.task.noise
