"""Results of a command, saved with --out: tables as text; a picture; or a page with a view in three
dimensions."""

import csv
import io
from pathlib import Path
from typing import Any

import numpy as np

import jaxbody as jb
from jaxbody.core.arrays import indices
from jaxbody.core.errors import JaxbodyError, Problem
from jaxbody.core.printed_tables import Words, printed_unit, unit_words
from jaxbody.core.source_files import writing
from jaxbody.core.tables import PrintedTable, in_numpy, tables_in
from jaxbody.records.text_tables import split_unit
from jaxbody.views.plots.plot_units import label_in
from jaxbody.views.scenes.poses import turns


def over_frequency(response: Any) -> PrintedTable:
    """Return a table of magnitude and phase of each output over frequency."""
    columns = {"frequency [Hz]": response.frequencies}
    for output in response.outputs:
        for name in response.inputs:
            value, unit = np.asarray(response[output, name]), response.unit(output, name)
            columns |= {
                f"{output} / {name} [{unit or '1'}]": np.abs(value),
                f"phase of {output} / {name} [deg]": np.degrees(np.angle(value)),
            }
    return series(columns)


def densities(response: Any) -> PrintedTable:
    """Return a table of the power spectral density of each output over frequency."""
    outputs = zip(response.outputs, response.units, response.psd, strict=True)
    columns = {f"{name} [({unit})2/Hz]": psd for name, unit, psd in outputs}
    return series({"frequency [Hz]": response.frequencies} | columns)


def by_case(cases: Any) -> PrintedTable:
    """Return a table with a row for each load case and a column for each number."""
    moves = "displacement", cases.displacements, cases.rotations
    columns = _columns(cases.unloaded.model, moves, cases.strokes, cases.forces)
    rows = [(name, *x) for name, x in zip(cases.names, series(columns).rows, strict=True)]
    return PrintedTable("", ("case", *columns), rows)


def _columns(
    model: Any, moves: tuple[str, Any, Any], strokes: dict[str, Any], forces: dict[str, Any]
) -> dict[str, Any]:
    """Return a column for each number: of positions or displacements, by their word, and rotations
    of bodies, and of strokes and forces of elements."""
    from jaxbody.views.plots.motion_plots import components, forces_and_moments  # slow to import

    word, positions, rotations = moves
    (strokes, turns), (forces, moments) = (
        forces_and_moments(model, x, "") for x in (strokes, forces)
    )
    parts = {
        word + " of {} [m]": components(positions),
        "rotation of {} [rad]": components(rotations),
        "stroke of {} [m]": strokes,
        "turn of {} [rad]": turns,
        "force of {} [N]": forces,
        "moment of {} [N m]": moments,
    }
    return {label.format(name): x for label, of in parts.items() for name, x in of.items()}


def over_time(trajectory: Any, sensors: dict[str, Any]) -> PrintedTable:
    """Return a table over time: positions and rotations of bodies and supports, deformations and
    forces of elements, readings of sensors."""
    poses = trajectory.poses
    positions = {name: pose.p for name, pose in poses.items()}
    start = np.array([1.0, 0.0, 0.0, 0.0])
    rotations = {name: turns(np.asarray(pose.R), start) for name, pose in poses.items()}
    moves, columns = ("position", positions, rotations), {"time [s]": trajectory.times}
    columns |= _columns(trajectory.model, moves, trajectory.elongations, trajectory.forces)
    for name, reading in (jb.measure(trajectory, sensors) if sensors else {}).items():
        unit = sensors[name].unit_on(trajectory.model)
        parts = np.asarray(reading).reshape(len(trajectory.times), -1).T
        labels = [f"{name}{index} [{unit}]" for index in indices(reading.shape[1:])]
        columns |= dict(zip(labels, parts, strict=True))
    return series(columns)


def series(columns: dict[str, Any]) -> PrintedTable:
    """Return a table of columns of numbers."""
    return PrintedTable(
        "",
        tuple(columns),
        list(zip(*(map(float, column) for column in columns.values()), strict=True)),
    )


def save(outcome: Any, path: Path, units: Any) -> None:
    """Save an outcome in the format of the path's extension, in these units. Errors:
    UNKNOWN_FORMAT, MISSING_EXTRA, NOT_SAVED."""
    with writing(path):
        match path.suffix:
            case ".csv":
                path.write_text("\n".join(map(_text, _tables(outcome, units))), encoding="utf-8")
            case ".html":
                outcome.view().save(path)
            case ".png" | ".svg" | ".pdf" if draw := (
                outcome.draw or getattr(outcome.results[0], "plot", None)
            ):
                figure = draw().figure
                label_in(figure, unit_words(units))
                figure.savefig(path, dpi=130)
            case _:
                raise JaxbodyError(
                    Problem(
                        "UNKNOWN_FORMAT",
                        "--out",
                        "is no text table, nor a picture that this command draws",
                        path,
                        ".csv",
                    )
                )


def _tables(outcome: Any, units: Any) -> list[PrintedTable]:
    """Return the tables of an outcome in these units."""
    if outcome.series:
        return [_series_in(outcome.series(), unit_words(units))]
    if outcome.text:
        return tables_in([outcome.text()], units)
    tables = [
        table
        for result in outcome.results
        if hasattr(result, "_tables")
        for table in in_numpy(result)._tables()
    ]
    return tables_in(tables, units)


def _series_in(table: PrintedTable, words: Words) -> PrintedTable:
    """Return a series in printed units: the first column as it is, the others with six significant
    digits of each number and of the variation of its column, so that it may serve as a record."""
    heads, columns = [], []
    for head, column in zip(table.columns, np.array(table.rows, float).T, strict=True):
        name, unit = split_unit(head)
        unit, factor = printed_unit(unit or "", words)
        heads.append(f"{name} [{unit}]" if unit else head)
        columns.append(column * factor)
    columns[0] = [float(f"{x:.8g}") for x in columns[0].tolist()]
    for i, column in enumerate(columns[1:], start=1):
        sizes = np.minimum(np.abs(column), np.ptp(column) or np.inf)
        digits = 5 - np.floor(np.log10(np.where(sizes > 0, sizes, 1.0)))
        columns[i] = [round(x, int(n)) + 0.0 for x, n in zip(column.tolist(), digits, strict=True)]
    return PrintedTable(table.title, tuple(heads), [*zip(*columns, strict=True)], table.note)


def _text(table: PrintedTable) -> str:
    """Return a table as lines of comma-separated values, with its title and note as comments."""
    lines = io.StringIO()
    rows = csv.writer(lines, lineterminator="\n")
    for comment in (table.title, table.note):
        lines.write(f"# {comment}\n" if comment else "")
    rows.writerow(table.columns)
    rows.writerows(table.rows)
    return lines.getvalue()
