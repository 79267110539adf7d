"""Checkpoints of a fit: files with the best transformed parameters u so far, the noise levels, and
a name for each of these numbers."""

import os
from pathlib import Path
from typing import Any

import numpy as np

from jaxbody.core.arrays import device_array
from jaxbody.core.errors import JaxbodyError, Problem
from jaxbody.core.source_files import replacing
from jaxbody.fitting.residuals import Levels, Task

RESTART = "Leave out resume= to start again."


def _names(task: Task) -> list[str]:
    """Return the names of all numbers in a checkpoint, in the order in which they are stored."""
    return [
        *task.space.names,
        *(f"noise of {run}.{name}" for run, levels in task.noise.items() for name in levels),
    ]


def save(path: str | os.PathLike, task: Task, u: np.ndarray) -> None:
    """Write a checkpoint to a temporary file and rename it, so that a crash or a full disk leaves
    the old checkpoint intact. Error: NOT_SAVED."""
    path = Path(path)
    if path.exists() and not path.is_file():
        raise JaxbodyError(
            Problem(
                "NOT_SAVED",
                str(path),
                "exists and is not a regular file",
                hint="Choose another path.",
            )
        )
    levels = [np.asarray(level) for each in task.noise.values() for level in each.values()]
    arrays = {
        "names": np.array(_names(task)),
        "u": np.asarray(u),
        **{f"noise{i}": level for i, level in enumerate(levels)},
    }
    try:
        with replacing(path) as new, new.open("wb") as file:
            np.savez(file, **arrays)  # pyright: ignore[reportArgumentType]
            file.flush()
            os.fsync(file.fileno())
    except OSError as error:
        raise JaxbodyError(
            Problem(
                "NOT_SAVED",
                str(path),
                f"cannot be written: {error.strerror or error}; "
                f"{sum(a.nbytes for a in arrays.values())} bytes are needed",
                hint="An earlier checkpoint there is unchanged.",
            )
        ) from None


def load(path: str | os.PathLike, task: Task) -> tuple[np.ndarray, Levels]:
    """Read u and the noise levels from the checkpoint of a fit with the same parameters and
    channels. Errors: NO_CHECKPOINT, OTHER_FIT."""
    where = str(path)
    if not Path(path).is_file():
        raise JaxbodyError(Problem("NO_CHECKPOINT", where, "is not a regular file", hint=RESTART))
    try:
        with Path(path).open("rb") as opened, np.load(opened, allow_pickle=False) as file:
            arrays = {key: file[key] for key in file.files}
    except Exception:
        # damaged files raise many kinds of exceptions, some with the advice to allow pickles
        raise JaxbodyError(
            Problem(
                "NO_CHECKPOINT",
                where,
                "cannot be read: it is damaged or not a checkpoint",
                hint=RESTART,
            )
        ) from None
    if missing := [name for name in ("names", "u") if name not in arrays]:
        raise JaxbodyError(
            Problem(
                "NO_CHECKPOINT",
                where,
                f"is not a checkpoint: it lacks {', '.join(missing)}",
                hint=RESTART,
            )
        )
    check_same(np.ravel(arrays["names"]).tolist(), task, where)
    noise: Levels = {run: {} for run in task.noise}
    for i, (run, name) in enumerate(
        (run, name) for run, levels in task.noise.items() for name in levels
    ):
        noise[run][name] = device_array(
            _numbers(
                arrays.get(f"noise{i}"),
                np.shape(task.noise[run][name]),
                f"{where}: noise of {run}.{name}",
                positive=True,
            )
        )
    return _numbers(arrays["u"], (task.space.size,), f"{where}: u"), noise


def _numbers(
    value: Any, shape: tuple[int, ...], where: str, *, positive: bool = False
) -> np.ndarray:
    """Return `value` after checking that it holds finite (or positive) numbers and has this shape.
    Error: NO_CHECKPOINT."""
    limit = f"{'positive' if positive else 'finite'} numbers of shape {shape}"
    if value is None:
        message = "is missing"
    elif value.dtype.kind != "f" or value.shape != shape:
        message = f"has shape {value.shape} of {value.dtype.name}"
    elif not np.isfinite(value).all() or (positive and not (value > 0).all()):
        message = f"is {value.tolist()!r:.60}"
    else:
        return value
    raise JaxbodyError(Problem("NO_CHECKPOINT", where, message, value, limit, RESTART))


def check_same(names: list[str], task: Task, where: str) -> None:
    """Check that a checkpoint with these `names` belongs to a fit of the same parameters to the
    same channels as `task`. Error: OTHER_FIT."""
    own = _names(task)
    if names != own:
        differences = [
            f"'{name}'" for name in [*names, *own] if (name in names) != (name in own)
        ] or ["the order of names"]
        raise JaxbodyError(
            Problem(
                "OTHER_FIT",
                where,
                f"is from another fit: they differ in {', '.join(differences[:3])}",
                hint="Resume with the same free parameters and experiments.",
            )
        )


def resumed(earlier, task: Task) -> tuple[np.ndarray, Levels]:
    """Return u and the noise levels of an earlier fit, given as its result or as the path of its
    checkpoint. Errors: WRONG_KIND, NO_CHECKPOINT, OTHER_FIT."""
    if isinstance(earlier, str | os.PathLike):
        return load(earlier, task)
    if not isinstance(getattr(earlier, "task", None), Task):
        raise JaxbodyError(
            Problem(
                "WRONG_KIND",
                "fit.resume",
                f"is a {type(earlier).__name__}",
                earlier,
                "a fit, or the path of its checkpoint",
                "Give the result of fit(...) or the path given as checkpoint=.",
            )
        )
    check_same(_names(earlier.task), task, "fit.resume")
    return _numbers(np.asarray(earlier.u), (task.space.size,), "fit.resume: u"), earlier.task.noise
