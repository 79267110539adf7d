"""Numbers over frequency, time or load case as one table each, which --out saves."""

from __future__ import annotations

from typing import Any

import numpy as np

import jaxbody as jb
from jaxbody.core.arrays import indices
from jaxbody.core.tables import PrintedTable


def over_frequency(response: Any) -> PrintedTable:
    """Magnitude and phase of each output, over the frequencies."""
    columns = {"frequency [Hz]": response.frequencies}
    for output in response.outputs:
        for name in response.inputs:
            value, unit = np.asarray(response[output, name]), response.unit(output, name)
            columns |= {
                f"{output} / {name} [{unit or '1'}]": np.abs(value),
                f"phase of {output} / {name} [rad]": np.angle(value),
            }
    return series(columns)


def densities(response: Any) -> PrintedTable:
    """The density of each output over the frequencies."""
    names = zip(response.outputs, response.units, strict=True)
    columns = {f"{name} [({unit})2/Hz]": response.psd[i] for i, (name, unit) in enumerate(names)}
    return series({"frequency [Hz]": response.frequencies, **columns})


def by_case(cases: Any) -> PrintedTable:
    """A row for each case, a column for each number."""
    from jaxbody.views.plots.motion_plots import components, forces_and_moments  # slow to import

    (strokes, turns), (forces, moments) = (
        forces_and_moments(cases.unloaded.model, x, "") for x in (cases.strokes, cases.forces)
    )
    moves, rotations = components(cases.displacements), components(cases.rotations)
    of_bodies = {"displacement of {} [m]": moves, "rotation of {} [rad]": rotations}
    of_elements = {
        "stroke of {} [m]": strokes,
        "turn of {} [rad]": turns,
        "force of {} [N]": forces,
        "moment of {} [N m]": moments,
    }
    columns = {
        label.format(name): x
        for label, values in {**of_bodies, **of_elements}.items()
        for name, x in values.items()
    }
    rows = list(zip(cases.names, *(map(float, column) for column in columns.values()), strict=True))
    return PrintedTable("", ("case", *columns), rows)


def over_time(trajectory: Any, sensors: dict[str, Any]) -> PrintedTable:
    """Places of the origins of bodies and supports, forces of elements and readings of sensors,
    over time."""
    columns = {"time [s]": trajectory.times}
    for name, pose in trajectory.poses.items():
        columns |= {f"{name} {axis} [m]": np.asarray(pose.p)[:, i] for i, axis in enumerate("xyz")}
    for name, force in trajectory.forces.items():
        columns |= {f"force of {name} [N]": force} if np.ndim(force) == 1 else {}
    for name, reading in (jb.measure(trajectory, sensors) if sensors else {}).items():
        parts = np.asarray(reading).reshape(len(trajectory.times), -1)
        unit = sensors[name].unit_on(trajectory.model)
        columns |= {
            f"{name}{index} [{unit}]": parts[:, i]
            for i, index in enumerate(indices(reading.shape[1:]))
        }
    return series(columns)


def series(columns: dict[str, Any]) -> PrintedTable:
    """Columns of numbers as one table."""
    return PrintedTable(
        "",
        tuple(columns),
        list(zip(*(map(float, column) for column in columns.values()), strict=True)),
    )
