"""What a report says: sentences on each result, all inputs of a model, and tables that fit on
paper."""

import re
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from itertools import groupby
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from jaxbody.core.errors import JaxbodyError
from jaxbody.core.printed_tables import PrintedTable, Words, in_units, printed_unit, text_in
from jaxbody.core.tables import counted, number, without_dust
from jaxbody.design.tuning_results import Tuning
from jaxbody.fitting import fit_results, validations
from jaxbody.fitting.planning.further_measurements import further_measurements
from jaxbody.geometry.fields import MATRICES, Described, kind_of, text_of, units_of
from jaxbody.mechanics import equilibria, forces_at_rest, static_load_cases
from jaxbody.model.models import Model
from jaxbody.motion.trajectories import Trajectory
from jaxbody.vibration import (
    frequency_responses,
    linearizations,
    modal_energies,
    natural_modes,
    random_responses,
)

MOST_COLUMNS = 7  # of a table, besides those of names; a wider one is broken up
MOST_LISTED = 8  # names or sentences of one kind in a summary
ENDS = {"a": "from", "b": "to", "c": "on"}  # what the points of elements are called
SIX = ("x", "y", "z", "about x", "about y", "about z")

Say = Callable[..., str]  # returns a number with its unit, in the printed units


def in_words(value: Any, unit: str, words: Words, digits: int = 4) -> str:
    """Return a number with its unit, in the printed units.

    >>> in_words(0.0123456, "m", {"m": "mm"})
    '12.35 mm'
    """
    printed, factor = printed_unit(unit, words)
    return f"{float(f'{float(value) * factor:.{digits}g}') + 0.0:g} {printed}".strip()


def sentences(result: Any, words: Words) -> list[str]:
    """Return what a single result says, in the printed units; nothing for a batch."""
    part = result.unloaded if isinstance(result, static_load_cases.LoadCases) else result
    batch = np.ndim(getattr(part, "status", 0)) or np.ndim(getattr(part, "gravity", [0])) > 1
    say = partial(in_words, words=words)
    says = [says for kind, says in SENTENCES.items() if isinstance(result, kind)]
    return says[0](result, say)[:MOST_LISTED] if says and not batch else []


def tables_of(result: Any) -> list[PrintedTable]:
    """Return the tables of a result; for a fit also which further measurements would help most, or
    a note that says why this is not known."""
    shown = result._tables()
    if not isinstance(result, fit_results.Fit) or result.uncertainty is None:
        return shown
    try:
        return [*shown, *further_measurements(result)._tables()]
    except JaxbodyError as error:
        nothing = PrintedTable("Further measurements", ("measurement",), [], f"not known: {error}")
        return [*shown, nothing]


def _listed(names: Any, what: str = "") -> str:
    """Return names, and if `what` they are is given, their number: "2 bodies (car, wheel)"."""
    text = ", ".join([*[*names][:MOST_LISTED], *(["..."] if len(names) > MOST_LISTED else [])])
    return f"{counted(len(names), what).replace('bodys', 'bodies')} ({text})" if what else text


def _largest(names: Any, sizes: Any, unit: str, say: Say) -> str:
    """Return the largest of some sizes with its name; those below 1e-12 are rounding errors."""
    i = int(np.argmax(np.nan_to_num(sizes, nan=-1.0)))
    return f"{say(np.round(sizes[i], 12), unit)} ({[*names][i]})"


def _forces(model: Model, forces: dict[str, Any]) -> dict[str, np.ndarray]:
    """Return {element: sizes of its force over cases or times}; moments are left out."""
    along = {
        name: forces_at_rest.along_and_about(model, name, np.asarray(f))[0]
        for name, f in forces.items()
    }
    return {
        name: np.linalg.norm(f.reshape(len(f), -1), axis=1)
        for name, f in along.items()
        if f is not None
    }


def _over_cases(
    cases: static_load_cases.LoadCases, sizes: dict[str, Any], unit: str, say: Say
) -> str:
    names = [f"{name}, {case}" for name in sizes for case in cases.names]
    return _largest(names, np.ravel([*sizes.values()]), unit, say)


# what results of each class say
SENTENCES: dict[type, Callable[[Any, Say], list[str]]] = {
    Model: lambda model, say: [
        "; ".join(
            _listed(names, what)
            for what, names in (
                ("body", model.layout.bodies),
                ("support", model.layout.supports),
                ("element", model.owner_names + model.force_names),
                ("controller", model.controller_names),
            )
            if names
        )
        + ".",
        f"{say(sum(np.ravel(model.bodies.rows.mass)), 'kg')} in all; "
        f"{counted(len(model.independent or ()), 'degree')} of freedom.",
    ],
    equilibria.Equilibrium: lambda rest, say: [
        *(
            f"Largest {what} from the drawn pose: {_largest(rest.layout.bodies, sizes, unit, say)}."
            for what, unit, sizes in zip(
                ("displacement", "rotation"),
                ("m", "rad"),
                np.asarray(rest.from_drawn).T,
                strict=True,
            )
            if unit == "m" or sizes.max() > 1e-12
        ),
        *(
            f"Largest force on a support: "
            f"{_largest(rest.reactions, np.linalg.norm(forces[:, :3], axis=1), 'N', say)}."
            for forces in [np.asarray(rest.on_supports)]
            if len(forces)
        ),
    ],
    natural_modes.ModalResult: lambda modes, say: [
        f"{counted(len(modes.frequency), 'mode')}: "
        + " to ".join(
            f"{modes.frequency[i]:.4g} Hz ({modes.names[i]})"
            for known in [np.flatnonzero(np.isfinite(modes.frequency)).tolist()]
            for i in dict.fromkeys(known[:1] + known[-1:])
        )
        + ".",
        f"Damping ratios: {np.nanmin(modes.damping_ratio):.3g} to "
        f"{np.nanmax(modes.damping_ratio):.3g}.",
    ],
    modal_energies.ModeEnergies: lambda energies, say: [
        "Most strain energy: "
        + _listed(
            [
                f"mode {i + 1} in {[*shares][j]} ({rows[j, i]:.0f} %)"
                for shares in [energies.strain | energies.other_strain]
                for rows in [np.array([*shares.values()])]
                for i, j in enumerate(np.nan_to_num(rows).argmax(0))
            ]
        )
        + "."
    ],
    frequency_responses.FrequencyResponse: lambda response, say: [
        f"Largest magnitude of {output} per {name}: {say(largest, unit.strip('-'))} at {f:.4g} Hz."
        for output, name, unit, _, largest, f in sorted(
            response._tables()[0].rows, key=lambda row: -np.nan_to_num(row[4])
        )
    ],
    random_responses.RandomResponse: lambda response, say: [
        f"Rms of {name}: {say(rms, unit)}."
        for name, rms, unit in zip(response.outputs, response.rms, response.units, strict=True)
    ],
    static_load_cases.LoadCases: lambda cases, say: [
        f"Largest {what}: {_over_cases(cases, sizes, unit, say)}."
        for what, unit, sizes in (
            (
                "displacement",
                "m",
                {n: np.linalg.norm(x, axis=-1) for n, x in cases.displacements.items()},
            ),
            ("force of an element", "N", _forces(cases.unloaded.model, cases.forces)),
        )
        if sizes
    ],
    Trajectory: lambda run, say: [
        f"{len(run.times)} samples from {run.times[0]:.4g} to {run.times[-1]:.4g} s.",
        *(
            f"Largest force of an element: "
            f"{_largest(sizes, [np.nanmax(size) for size in sizes.values()], 'N', say)}."
            for sizes in [_forces(run.model, run.forces)]
            if sizes
        ),
    ],
    fit_results.Fit: lambda fit, say: [
        f"{counted(sum(map(len, fit.predicted.values())), 'record')} of "
        f"{counted(len(fit.predicted), 'run')}.",
        *(
            f"{name}: {say(value, unit, digits=6)}, "
            + (f"95 % interval {' to '.join(ends)}." if len(ends) == 2 else f"{error}.")
            for name, value, unit, error, _, interval, *_ in fit._tables()[0].rows
            for ends in [[say(end, unit, digits=6) for end in interval.split(" to ") if end]]
        ),
    ],
    validations.Validation: lambda validation, say: [
        f"{counted(len(validation.nrmse), 'record')}; largest NRMSE: "
        f"{_largest(validation.nrmse, [100 * x for x in validation.nrmse.values()], '%', say)}."
    ],
    Tuning: lambda tuning, say: [
        f"{tuning.minimize}: {number(np.asarray(tuning.before[tuning.minimize]))} before, "
        f"{number(np.asarray(tuning.after[tuning.minimize]))} after.",
        *([f"Active limits: {_listed(tuning.active)}."] if tuning.active else []),
    ],
}


def inputs(model: Model, words: Words) -> list[PrintedTable]:
    """Return tables of all numbers of a model, in the printed units and with six digits."""
    layout, joints = model.layout, {name: model.joint(name) for name in model.layout.bodies}
    groups: list[tuple[str, dict[str, str], Any]] = [
        ("joint", {n: f"{_kind(joint)} on {joint.parent}" for n, joint in joints.items()}, model),
        ("", dict.fromkeys(layout.supports, ""), model),
        *(("on", {name: joints[name].parent for name in t.names}, joints) for t in model.joints),
        *(
            (
                ", ".join([*ENDS.values()][: len(t.links[0])]) if len(t.links[0]) > 1 else "on",
                {name: ", ".join(link) for name, link in zip(t.names, t.links, strict=True)},
                model,
            )
            for t in (*model.elements, *model.forces, *model.closures)
            if t.names[0] not in model.controller_names
        ),
        ("reads to drives", {n: _loop(model[n]) for n in model.controller_names}, model),
    ]
    shown = []
    for head, links, parts in groups:
        rows = {name: _cells(parts[name], words) for name in links}
        heads = dict.fromkeys(each for cells in rows.values() for each in cells)
        cells = [(n, links[n], *(row.get(each, "") for each in heads)) for n, row in rows.items()]
        kind = _kind(parts[next(iter(links))]) if links else ""
        shown += _broken(PrintedTable("", (kind, head, *heads), cells), 2) if heads else []
    gravity = ", ".join(in_words(x, "m/s2", words) for x in model.gravity)
    shown[-1].note = (
        f"Gravity along x, y, z: {gravity}. Positions in world axes, as drawn; centers of mass, "
        "inertia about them and ends of elements in the axes of their body or support."
    )
    return shown


def _kind(part: Any) -> str:
    return type(part).__name__.lower().replace("partial", "function")


def _loop(controller: Any) -> str:
    return f"{', '.join(controller.order)} to {', '.join(controller.drives)}"


def _cells(part: Any, words: Words) -> dict[str, Any]:
    """Return the numbers and laws of a part by heading, without zeros off the diagonal of a
    matrix and orientations that are not turned."""
    cells = {}
    for name in getattr(part, "__dataclass_fields__", ()):
        value, head = getattr(part, name, None), ENDS.get(name, name.replace("_", " "))
        if not hasattr(value, "shape"):
            if isinstance(value, Described) or callable(value):
                cells[head] = text_in(text_of(part, name), words)
            continue
        kind, x = kind_of(part, name), np.asarray(value)
        units = np.reshape(np.array(units_of(kind, x.shape), object), x.shape)
        if turned := kind.domain == "rotation":
            x, units = Rotation.from_quat(np.roll(x, -1)).as_rotvec(), np.array(["rad"] * 3)
        symmetric = kind.domain in MATRICES and x.ndim == 2
        for i in np.ndindex(x.shape):
            zero = abs(x[i]) < 1e-12 and (turned or (symmetric and i[0] != i[1]))
            if zero or (symmetric and i[0] > i[1]):
                continue
            axes = [SIX[k] if n in (3, 6) else f"{k + 1}" for k, n in zip(i, x.shape, strict=True)]
            unit, factor = printed_unit(str(units[i]), words)
            label = f"{head} {(' ' * (x.shape != (3, 3))).join(axes)}".strip()
            cells[f"{label} [{unit}]" if unit else label] = float(x[i]) * factor + 0.0
    return cells


def matrices(system: linearizations.LinearSystem, words: Words) -> list[PrintedTable]:
    """Return the matrices of small motions, rotations in rad, with their columns named; in SI where
    they have rows of states, whose units differ."""
    shown, names = system._tables(), [re.sub(" (move|turn) ", " ", n) for n in system.coordinates]
    turns = np.array([" turn " in name for name in system.coordinates], int)
    converted = (
        () if len(system.model.layout.first_order) else zip(shown, system.printed, strict=True)
    )
    for table, name in converted:
        units, factors = zip(
            *(printed_unit(unit, words) for unit in linearizations.UNITS[name].split(", ")),
            strict=True,
        )
        if len(table.columns) == 1 + len(names):
            values = getattr(system, name) * np.array(factors)[turns[:, None] + turns]
            table.rows = [*zip(names, *without_dust(values).T, strict=True)]
            table.title, table.columns = f"{name} [{', '.join(units)}]", ("", *names)
    return shown


def fitting(table: PrintedTable, words: Words | None) -> list[PrintedTable]:
    """Return a table as tables of one number in a cell that fit on paper: with words in the printed
    units, else in SI with six digits."""
    lead = table.lead
    table = table if words is not None else replace(table, digits=6)
    return [few for part in in_units(table, words or {}) for few in _broken(part, lead)]


def _columns(table: PrintedTable, kept: Any) -> PrintedTable:
    rows = [tuple(row[i] for i in kept) for row in table.rows]
    return PrintedTable("", tuple(table.columns[i] for i in kept), rows)


def _broken(table: PrintedTable, lead: int) -> list[PrintedTable]:
    """Return a wide table as several, each with the first `lead` columns; columns whose headings
    begin with the same word stay together."""
    heads, parts = table.columns, [[*range(lead)]]
    for _, same in groupby(range(lead, len(heads)), key=lambda i: heads[i].split(" ")[0]):
        group = [*same]
        for few in (group[i : i + MOST_COLUMNS] for i in range(0, len(group), MOST_COLUMNS)):
            parts += [[*range(lead)]] if len(parts[-1]) + len(few) > lead + MOST_COLUMNS else []
            parts[-1] += few
    shown = [_columns(table, kept) for kept in parts]
    shown[0].title, shown[-1].note = table.title, table.note
    return shown
