"""Results as labelled arrays: each function makes an xarray.Dataset with names, units and coordinates of one result.

xarray is imported here, on first use, and is an extra: `pip install 'jaxbody[xarray]'`. Leading axes of a batch become `sample`.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from jaxbody.core.errors import JaxbodyError, Problem

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
    springs = _springs(model)
    variables = {
        "position": (("time", "frame", "axis"), _rows([pose.p for pose in poses.values()], -2), "m"),
        "quaternion": (("time", "frame", "part"), _rows([pose.quaternion for pose in poses.values()], -2), ""),
        "kinetic_energy": (("time",), energies["kinetic"], "J"),
        "potential_energy": (("time",), energies["potential"], "J"),
    }
    coordinates = {"frame": list(poses), "axis": AXES, "part": QUATERNION}
    if springs:
        variables["elongation"] = (("time", "spring"), _rows([elongations[name] for name in springs], -1), "m")
        variables["force"] = (("time", "spring"), _rows([forces[name] for name in springs], -1), "N")
        coordinates["spring"] = springs
    if reactions:
        variables["reaction_force"] = (("time", "support", "axis"), _rows([force for force, _ in reactions.values()], -2), "N")
        variables["reaction_moment"] = (("time", "support", "axis"), _rows([moment for _, moment in reactions.values()], -2), "N m")
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


def equilibrium_dataset(equilibrium: Any) -> Any:
    """Of an equilibrium: q by `part`, residual by `coordinate`, elongation by `spring`, energy, status."""
    layout, springs = equilibrium.model.layout, _springs(equilibrium.model)
    parts = [f"{name} {i}" for name, kind in zip(layout.bodies, layout.kinds, strict=True) for i in range(kind.nq)]
    variables = {
        "q": (("part",), equilibrium.state.q, ""),
        "residual": (("coordinate",), equilibrium.residual, "N or N m"),
        "energy": ((), equilibrium.energy, "J"),
        "stable": ((), equilibrium.stable, ""),
        "status": ((), equilibrium.status, ""),
    }
    coordinates = {"part": parts, "coordinate": list(layout.coordinates)}
    if springs:
        variables["elongation"] = (("spring",), _rows([equilibrium.elongations[name] for name in springs], -1), "m")
        coordinates["spring"] = springs
    return dataset(variables, coordinates, "equilibrium")


def linearization_dataset(lin: Any) -> Any:
    """M, C, K by `coordinate` and `coordinate_2`, their blocks towards the base by `base`."""
    own, base = list(lin.coordinates), list(lin.base_coordinates)
    variables = {}
    for name, unit in (("M", "kg, kg m, kg m2"), ("C", "N s/m, N s, N m s"), ("K", "N/m, N, N m")):
        variables[name] = (("coordinate", "coordinate_2"), getattr(lin, name), unit)
        if base:
            variables[f"{name}_tilde"] = (("coordinate", "base"), getattr(lin, f"{name}_tilde"), unit)
            variables[f"{name}_bb"] = (("base", "base_2"), getattr(lin, f"{name}_bb"), unit)
    coordinates = {"coordinate": own, "coordinate_2": own} | ({"base": base, "base_2": base} if base else {})
    return dataset(variables | {"status": ((), lin.status, "")}, coordinates, "linearization")


def modes_dataset(modes: Any) -> Any:
    """frequency, damping ratio and shapes by `mode` (from 1) and `coordinate`."""
    variables = {
        "frequency": (("mode",), modes.frequency, "Hz"),
        "damping_ratio": (("mode",), modes.damping_ratio, ""),
        "eigenvalue": (("mode",), modes.eigenvalues, "rad2/s2"),
        "shape": (("coordinate", "mode"), modes.shapes, "mass-normalized"),
        "cluster": (("mode",), modes.cluster, ""),
        "status": ((), modes.status, ""),
    }
    count = np.shape(modes.frequency)[-1]
    return dataset(variables, {"mode": list(range(1, count + 1)), "coordinate": list(modes.layout.coordinates)}, "modes")


def complex_modes_dataset(modes: Any) -> Any:
    """frequencies, damping ratio, decay rate, poles and shapes by `mode` (from 1) and `coordinate`."""
    variables = {
        "frequency": (("mode",), modes.frequency, "Hz"),
        "natural_frequency": (("mode",), modes.natural_frequency, "Hz"),
        "damping_ratio": (("mode",), modes.damping_ratio, ""),
        "decay_rate": (("mode",), modes.decay_rate, "1/s"),
        "pole": (("mode", "pair"), modes.poles, "1/s"),
        "shape": (("coordinate", "mode"), modes.shapes, "mass-normalized"),
        "cluster": (("mode",), modes.cluster, ""),
        "status": ((), modes.status, ""),
    }
    count = np.shape(modes.frequency)[-1]
    return dataset(variables, {"mode": list(range(1, count + 1)), "coordinate": list(modes.layout.coordinates)}, "complex modes")


def mode_energies_dataset(energies: Any) -> Any:
    """Shares [%] by `mode` (from 1): kinetic by `body` and `direction`, strain and dissipation by `element`, strain of `other` kinds."""
    variables = {
        "frequency": (("mode",), energies.frequency, "Hz"),
        "kinetic": (("body", "direction", "mode"), energies.kinetic_shares, "%"),
        "strain": (("element", "mode"), energies.strain_shares, "%"),
        "other_strain": (("other", "mode"), energies.other_shares, "%"),
        "dissipation": (("element", "mode"), energies.dissipation_shares, "%"),
        "status": ((), energies.status, ""),
    }
    model, count = energies.model, np.shape(energies.frequency)[-1]
    coordinates = {
        "mode": list(range(1, count + 1)),
        "body": list(model.layout.bodies),
        "direction": list(energies.directions),
        "element": list(model.element_names),
        "other": list(energies.other_strain),
    }
    return dataset(variables, coordinates, "energies of modes")


def elastic_axes_dataset(axes: Any) -> Any:
    """Directions, stiffness, points and pitch by `elastic_axis` (from 1, the softest first) and `axis`."""
    variables = {
        "center": (("axis",), axes.center, "m"),
        "direction": (("axis", "elastic_axis"), axes.directions, ""),
        "stiffness": (("elastic_axis",), axes.stiffness, "N/m"),
        "point": (("elastic_axis", "axis"), axes.points, "m"),
        "pitch": (("elastic_axis",), axes.pitch, "m"),
        "torsional_direction": (("axis", "elastic_axis"), axes.torsional_directions, ""),
        "torsional_stiffness": (("elastic_axis",), axes.torsional_stiffness, "N m/rad"),
        "status": ((), axes.status, ""),
    }
    return dataset(variables, {"axis": AXES, "elastic_axis": [1, 2, 3]}, f"elastic axes of {axes.body}")


def spin_dataset(lin: Any) -> Any:
    """M, C, G, K and the centrifugal part of K by `coordinate` and `coordinate_2`."""
    units = {"M": "kg, kg m, kg m2", "C": "N s/m, N s, N m s", "G": "N s/m, N s, N m s", "K": "N/m, N, N m", "K_centrifugal": "N/m, N, N m"}
    variables: dict[str, Any] = {name: (("coordinate", "coordinate_2"), getattr(lin, name), unit) for name, unit in units.items()}
    names = list(lin.coordinates)
    return dataset(variables | {"status": ((), lin.status, "")}, {"coordinate": names, "coordinate_2": names}, "linearization about a spin")


def branches_dataset(branches: Any) -> Any:
    """frequency, damping ratio, MAC, order and shape by `value` and `mode` (from 1)."""
    variables = {
        "frequency": (("value", "mode"), branches.frequency, "Hz"),
        "damping_ratio": (("value", "mode"), branches.damping_ratio, ""),
        "mac": (("value", "mode"), branches.mac, ""),
        "order": (("value", "mode"), branches.order, ""),
        "shape": (("value", "coordinate", "mode"), branches.shapes, "mass-normalized"),
        "status": (("value",), branches.status, ""),
    }
    count = np.shape(branches.frequency)[-1]
    coordinates = {"value": np.asarray(branches.values), "mode": list(range(1, count + 1)), "coordinate": list(branches.layout.coordinates)}
    return dataset(variables, coordinates, "branches")


def frequency_response_dataset(response: Any) -> Any:
    """The complex response by `output`, `input` and `frequency` [Hz]; `unit` by output and input."""
    units = [[response.unit(y, u) for u in response.inputs] for y in response.outputs]
    variables = {
        "response": (("output", "input", "frequency"), response.values, ""),
        "unit": (("output", "input"), np.array(units), ""),
        "status": ((), response.status, ""),
    }
    f = np.asarray(response.frequencies)
    coordinates = {
        "output": list(response.outputs),
        "input": list(response.inputs),
        "frequency": ("frequency", f.reshape(-1, f.shape[-1])[0], {"units": "Hz"}),
    }
    return dataset(variables, coordinates, "frequency response")


def random_response_dataset(response: Any) -> Any:
    """psd by `output` and `frequency` [Hz], rms and unit by `output`."""
    variables = {
        "psd": (("output", "frequency"), response.psd, "unit^2/Hz"),
        "rms": (("output",), response.rms, "unit"),
        "unit": (("output",), np.array(response.units), ""),
        "status": ((), response.status, ""),
    }
    f = np.asarray(response.frequencies)
    coordinates = {"output": list(response.outputs), "frequency": ("frequency", f.reshape(-1, f.shape[-1])[0], {"units": "Hz"})}
    return dataset(variables, coordinates, "random response")


def load_cases_dataset(cases: Any) -> Any:
    """By `case`: displacement and rotation by `body`, stroke and force by `spring` (of a bushing six each), status and load factor."""
    model = cases.unloaded.model
    springs = _springs(model)
    variables = {
        "displacement": (("case", "body", "axis"), cases.displaced, "m"),
        "rotation": (("case", "body", "axis"), cases.turned, "rad"),
        "status": (("case",), cases.status, ""),
        "load_factor": (("case",), cases.load_factor, ""),
    }
    coordinates = {"case": list(cases.names), "body": list(model.layout.bodies), "axis": AXES}
    strokes, forces = cases.strokes, cases.forces
    if springs:
        variables["stroke"] = (("case", "spring"), _rows([strokes[name] for name in springs], -1), "m")
        variables["force"] = (("case", "spring"), _rows([forces[name] for name in springs], -1), "N")
        coordinates["spring"] = springs
    for name in (name for name in strokes if name not in springs):
        variables[f"{name}_stroke"] = (("case", "component"), strokes[name], "m, rad")
        variables[f"{name}_force"] = (("case", "component"), forces[name], "N, N m")
    return dataset(variables, coordinates, "load cases")


def backbones_dataset(backbones: Any) -> Any:
    """frequency, curvature, derivatives of V and shapes by `mode` (from 1) and `coordinate`; amplitudes are of the coordinate `largest`."""
    layout, largest = backbones.layout, np.asarray(backbones.largest)
    variables = {
        "frequency": (("mode",), backbones.frequency, "Hz"),
        "curvature": (("mode",), backbones.curvature, "1/m2 or 1/rad2"),
        "stiffness": (("mode",), backbones.stiffness, "N/m or N m"),
        "third": (("mode",), backbones.third, "N/m2 or N m"),
        "fourth": (("mode",), backbones.fourth, "N/m3 or N m"),
        "largest": (("mode",), np.asarray(layout.coordinates)[largest], ""),
        "shape": (("coordinate", "mode"), backbones.shapes, "largest component 1"),
        "drift": (("coordinate", "mode"), backbones.drift, "per amplitude^2"),
        "second_harmonic": (("coordinate", "mode"), backbones.second_harmonic, "per amplitude^2"),
        "status": (("mode",), backbones.status, ""),
    }
    return dataset(variables, {"mode": list(range(1, largest.shape[-1] + 1)), "coordinate": list(layout.coordinates)}, "backbones")


def tuning_dataset(tuning: Any) -> Any:
    """Of a tuned design by `start`: objective, violation of limits, status, and every quantity and free parameter."""
    runs = tuning.runs
    variables = {
        "objective": (("start",), runs.objective, ""),
        "violation": (("start",), runs.violation, ""),
        "status": (("start",), runs.status, ""),
    }
    for name, values in {**runs.quantities, **runs.values}.items():
        axes = tuple(f"{name}_{i}" for i in range(np.ndim(values) - 1))
        variables.setdefault(name, (("start", *axes), values, ""))
    return dataset(variables, {"start": np.arange(len(runs.status))}, f"design of least {tuning.minimize}")


def sweep_dataset(columns: dict[str, Any], found: dict[str, Any], *, on_grid: bool) -> Any:
    """Of a sweep: each quantity over the axes of the grid, or over `sample`."""
    axes = tuple(columns) if on_grid else ("sample",)
    lengths = tuple(len(values) for values in columns.values()) if on_grid else (len(next(iter(columns.values()))),)
    variables = {}
    for name, values in found.items():
        own = values.shape[1:]
        variables[name] = ((*axes, *(f"{name}_{i}" for i in range(len(own)))), values.reshape(*lengths, *own), "")
    coordinates = {}
    for path, values in columns.items():
        over = path if on_grid else "sample"
        flat = np.ndim(values) == 1
        coordinates[path] = (over, values) if flat else (over, np.arange(len(values)))
        if not flat:
            coordinates[f"{path} values"] = ((over, *(f"{path}_{i}" for i in range(np.ndim(values) - 1))), values)
    return dataset(variables, coordinates, "sweep")


def front_dataset(front: Any) -> Any:
    """Of a front by `point`: every quantity and parameter, slopes, status."""
    variables = {"status": (("point",), front.status, "")}
    for name, values in {**front.quantities, **front.values}.items():
        axes = tuple(f"{name}_{i}" for i in range(np.ndim(values) - 1))
        variables.setdefault(name, (("point", *axes), values, ""))
    for name, slope in zip(list(front.objectives)[1:], front.slopes.T, strict=True):
        variables[f"slope over {name}"] = (("point",), slope, "")
    return dataset(variables, {"point": np.arange(1, 1 + len(front.status))}, "front")


def fit_dataset(fit: Any) -> Any:
    """Of a fit: estimate, standard error and 95 % interval by `parameter`, singular values, and `{run}_{channel}` predicted and measured over
    `{run}_time`, `{run}_frequency` or `{run}_mode`."""
    names, estimates, errors, intervals = [], [], [], fit.intervals(0.95)
    ends = [np.concatenate([np.ravel(interval[side]) for interval in intervals.values()]) for side in (0, 1)]
    for path, value in fit.estimates.items():
        value = np.asarray(value)
        names += [path] if value.ndim == 0 else [path + str(list(i)).replace(" ", "") for i in np.ndindex(value.shape)]
        estimates += value.ravel().tolist()
        errors += np.asarray(fit.standard_errors[path]).ravel().tolist()
    variables: dict[str, tuple[tuple[str, ...], Any, str]] = {
        "estimate": (("parameter",), estimates, ""),
        "standard_error": (("parameter",), errors, ""),
        "lower": (("parameter",), ends[0], ""),
        "upper": (("parameter",), ends[1], ""),
        "singular_value": (("direction",), fit.singular_values, ""),
        "status": ((), fit.status, ""),
    }
    coordinates: dict[str, Any] = {"parameter": names}
    for run, sensors in fit.predicted.items():
        experiment = fit.experiments[run]
        for name, values in sensors.items():
            over, where, unit = experiment.axis(name)
            row = f"{run}_{over}"
            coordinates[row] = (row, np.asarray(where), {"units": unit})
            dimensions, unit = (row, *(f"{run}_{name}_component",) * (np.ndim(values) - 1)), experiment.channels[name].unit
            variables[f"{run}_{name}_predicted"] = (dimensions, values, unit)
            variables[f"{run}_{name}_measured"] = (dimensions, experiment.measured[name], unit)
    return dataset(variables, coordinates, "fit")


def _springs(model: Any) -> list[str]:
    """Elements whose deformation is one number."""
    return [name for table in model.elements if table.rows.size == 1 for name in table.names]


def _rows(arrays: list[Any], axis: int) -> np.ndarray:
    return np.stack([np.asarray(array) for array in arrays], axis)


def _xarray() -> Any:
    try:
        import xarray
    except ImportError:
        hint = "Install it: pip install 'jaxbody[xarray]'."
        raise JaxbodyError(Problem("MISSING_EXTRA", "to_xarray", "needs xarray, which is not installed.", "xarray", hint=hint)) from None
    return xarray
