"""Results as labelled arrays: each function makes an xarray.Dataset with names, units and coordinates of one result.

xarray is imported here, on first use, and is an extra: `pip install 'jaxbody[xarray]'`. Leading axes of a batch become `sample`.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from jaxbody.core.errors import JaxbodyError, Problem
from jaxbody.models.leaf_paths import springs_of

AXES, QUATERNION = list("xyz"), list("wxyz")


def dataset(variables: dict[str, tuple[tuple[str, ...], Any, str]], coordinates: dict[str, Any], kind: str) -> Any:
    """{name: (dimensions, values, unit)} as a Dataset; values with one axis more than dimensions are a batch of samples."""
    xarray = _xarray()
    made = {}
    for name, (dimensions, values, unit) in variables.items():
        values = np.asarray(values)
        if values.ndim == len(dimensions) + 1:
            dimensions = ("sample", *dimensions)
        made[name] = xarray.DataArray(values, dims=dimensions, attrs={"units": unit} if unit else {})
    return xarray.Dataset(made, coords=coordinates, attrs={"title": kind})


def trajectory_dataset(trajectory: Any) -> Any:
    """Of a trajectory over `time`: position and quaternion by `frame`, elongation and force by `spring`, energies, and reactions by `support`."""
    model, poses, energies = trajectory.model, trajectory.poses, trajectory.energies
    elongations, forces, reactions = trajectory.elongations, trajectory.forces, trajectory.reactions if model.layout.supports else {}
    springs = springs_of(model)
    variables = {
        "position": (("time", "frame", "axis"), rows_of([pose.p for pose in poses.values()], -2), "m"),
        "quaternion": (("time", "frame", "part"), rows_of([pose.quaternion for pose in poses.values()], -2), ""),
        "kinetic_energy": (("time",), energies["kinetic"], "J"),
        "potential_energy": (("time",), energies["potential"], "J"),
    }
    coordinates = {"frame": list(poses), "axis": AXES, "part": QUATERNION}
    if springs:
        variables["elongation"] = (("time", "spring"), rows_of([elongations[name] for name in springs], -1), "m")
        variables["force"] = (("time", "spring"), rows_of([forces[name] for name in springs], -1), "N")
        coordinates["spring"] = springs
    if reactions:
        variables["reaction_force"] = (("time", "support", "axis"), rows_of([force for force, _ in reactions.values()], -2), "N")
        variables["reaction_moment"] = (("time", "support", "axis"), rows_of([moment for _, moment in reactions.values()], -2), "N m")
        coordinates["support"] = list(reactions)
    for name in (name for name, e in elongations.items() if name not in springs):
        variables[f"{name}_deformation"] = (("time", "component"), elongations[name], "m, rad")
        variables[f"{name}_force"] = (("time", "component"), forces[name], "N, N m")
    times = np.asarray(trajectory.times)
    if times.ndim == 1:
        coordinates["time"] = ("time", times, {"units": "s"})
    else:
        variables["times"] = (("time",), times, "s")
    made = dataset(variables, coordinates, "trajectory")
    return made.assign(status=(made["kinetic_energy"].dims[:-1], np.asarray(trajectory.status)))


def rows_of(arrays: list[Any], axis: int) -> np.ndarray:
    return np.stack([np.asarray(array) for array in arrays], axis)


def _xarray() -> Any:
    try:
        import xarray
    except ImportError:
        hint = "Install it: pip install 'jaxbody[xarray]'."
        raise JaxbodyError(Problem("MISSING_EXTRA", "to_xarray", "needs xarray, which is not installed.", "xarray", hint=hint)) from None
    return xarray
