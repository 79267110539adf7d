"""State spaces for other programs: a MATLAB file of the matrices, with the names and units of
inputs, outputs and states."""

from pathlib import Path
from typing import Any

import numpy as np
from scipy.io import savemat

from jaxbody.core.errors import JaxbodyError, Problem
from jaxbody.core.source_files import extension_of, writing
from jaxbody.vibration.state_spaces import StateSpace


def write_state_space(system: StateSpace, path: Any) -> None:
    """Write x' = A x + B u, y = C x + D u to a MATLAB file (version 5): the matrices A, B, C, D,
    and inputs, outputs, states, input_units and output_units as cell arrays of text. In MATLAB:
    load plant.mat; plant = ss(A, B, C, D, 'InputName', inputs, 'OutputName', outputs).

    Args:
        system: `lin.state_space(inputs, outputs)`
        path: path of the file, .mat; a file of the same name is replaced

    Errors: UNKNOWN_FORMAT, BAD_SHAPE for a batch, NOT_SAVED, that of a system whose status is
    not ok.

    >>> import pathlib, tempfile
    >>> model = jb.presets.quarter_car(damping=1500.0)
    >>> small = jb.linearize(model, jb.equilibrium(model))
    >>> road, body = (
    ...     {"road": jb.BaseMotion("road", "z", kind="acceleration")},
    ...     {"body": jb.Acceleration("body", axis="z")},
    ... )
    >>> path = pathlib.Path(tempfile.mkdtemp(), "plant.mat")
    >>> jb.files.write_state_space(small.state_space(road, body), path)
    >>> import scipy.io
    >>> scipy.io.loadmat(path)["A"].shape
    (6, 6)
    """
    path = Path(path)
    extension_of(path, ".mat")
    if system.A.ndim > 2:
        raise JaxbodyError(
            Problem(
                "BAD_SHAPE",
                "write_state_space",
                f"is a batch of {len(system.A)} systems",
                limit="one system",
                hint="Write one of them: jax.tree.map(lambda x: x[0], systems).",
            )
        )
    system.raise_if_failed()
    values: dict[str, Any] = {
        name: np.asarray(getattr(system, name)) for name in ("A", "B", "C", "D")
    }
    values |= {
        name: np.array(getattr(system, name), dtype=object)
        for name in ("inputs", "outputs", "states", "input_units", "output_units")
    }
    with writing(path), path.open("wb") as file:
        savemat(file, values)
