"""Commands on a study from a file: what each prints, draws and saves."""

from __future__ import annotations

import argparse
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from dataclasses import field as attribute
from typing import TYPE_CHECKING, Any

import jaxbody as jb
from jaxbody.app.command_options import (
    BAND,
    DESIGN,
    FREE,
    OF_MOTION,
    OF_RESPONSE,
    OF_STEPS,
    QUANTITIES,
    WRITE,
    above_zero,
    case_option,
    ports_options,
)
from jaxbody.core.errors import JaxbodyError, Problem, Problems, check_known

if TYPE_CHECKING:
    from jaxbody.files.studies.study_files import Study

FLAT = (".csv", ".parquet", ".nc", ".png", ".svg", ".pdf")
IN_SPACE = (*FLAT, ".html")  # a page in three dimensions


@dataclass(frozen=True)
class Command:
    """A command on a model file: a description, an example, the function that runs it, its options;
    `measured`: whether it needs the experiments of the file."""

    about: str
    example: str
    run: Callable[[Any, argparse.Namespace], Outcome]
    options: tuple[tuple[tuple[str, ...], dict[str, Any]], ...] = ()
    measured: bool = False
    formats: tuple[str, ...] = FLAT  # extensions for --out


@dataclass
class Outcome:
    """Results of a command, which print as tables, and functions for --out and --write."""

    results: list[Any]
    draw: Callable[[], Any] | None = None  # draws the picture that --out saves
    series: Callable[[], Any] | None = None  # table of numbers that --out saves in all formats
    text: Callable[[], Any] | None = None  # table that --out saves as .csv only
    space: Any = None  # space of the free parameters, for --write
    trees: dict[str, Any] = attribute(default_factory=dict)  # model and experiments to write
    saved: bool = False  # whether the command itself has saved the results
    view: Callable[[], Any] | None = None  # shows the results in three dimensions


def _check(study: Study, options: argparse.Namespace) -> Outcome:
    from jaxbody.core.tables import counted

    model = study.model
    parts = {
        "support": model.layout.supports,
        "element": model.element_names,
        "load": study.loads,
        "sensor": study.sensors,
        "experiment": study.experiments,
        "held-out experiment": study.held_out,
    }
    bodies = "1 body" if len(model.layout.bodies) == 1 else f"{len(model.layout.bodies)} bodies"
    counts = [bodies, *(counted(len(names), what) for what, names in parts.items() if names)]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the remarks are printed
        remarks = jb.fitting.plausibility(model, study.experiments).words if model.layout.nv else ()
    return Outcome(
        [
            f"{options.file.name}: {', '.join(counts)}, {counted(model.layout.nv, 'degree')} of "
            "freedom; no errors",
            *remarks,
        ]
    )


def _show(study: Study, options: argparse.Namespace) -> Outcome:
    return Outcome(
        [study.model], lambda: jb.plots.draw_model(study.model), view=lambda: jb.view(study.model)
    )


def _equilibrium(study: Study, options: argparse.Namespace) -> Outcome:
    equilibrium = jb.equilibrium(study.model)
    return Outcome(
        [equilibrium],
        lambda: jb.plots.draw_model(study.model, equilibrium.state),
        view=lambda: jb.view(equilibrium),
    )


def _modes(study: Study, options: argparse.Namespace) -> Outcome:
    lin, remarks = _linear(study)
    modes: Any = jb.complex_modes(lin) if options.damped else jb.modes(lin)
    energies = [jb.mode_energies(lin)] if options.energies and not options.damped else []
    return Outcome(
        [modes, *energies, *remarks],
        lambda: jb.plots.draw_mode(lin, modes, options.draw),
        view=lambda: jb.view(modes, number=options.draw, at=lin),
    )


def _response(study: Study, options: argparse.Namespace) -> Outcome:
    import numpy as np

    from jaxbody.app import saved_results

    lin, remarks = _linear(study)
    low, high = options.frequencies
    inputs, outputs = _ports(study, options, options.kind)
    response = jb.frequency_response(lin, np.geomspace(low, high, options.points), inputs, outputs)
    return Outcome(
        [response, *remarks],
        lambda: jb.plots.plot_frequency_response(response),
        lambda: saved_results.over_frequency(response),
    )


def _random(study: Study, options: argparse.Namespace) -> Outcome:
    from jaxbody.app import saved_results

    lin, remarks = _linear(study)
    inputs, outputs = _ports(study, options, "displacement")
    spectra: Any = dict.fromkeys(
        inputs, jb.vibration.RoadRoughness.iso(options.road).at_speed(options.speed)
    )
    response = jb.random_response(
        lin, jb.vibration.Band(*options.frequencies), inputs, outputs, spectra
    )
    return Outcome(
        [response, *remarks],
        lambda: jb.plots.plot_psd(response),
        lambda: saved_results.densities(response),
    )


def _load_cases(study: Study, options: argparse.Namespace) -> Outcome:
    from jaxbody.app import saved_results

    if not options.case:  # a report does not require cases
        raise JaxbodyError(
            Problem(
                "NO_DATA",
                "--case",
                "is missing",
                limit="at least one",
                hint="Give --case bump=0,0,3, an acceleration in g.",
            )
        )
    cases = {name: jb.LoadCase(acceleration=acceleration) for name, acceleration in options.case}
    result = jb.load_cases(study.model, cases)
    return Outcome([result], lambda: result.plot(), text=lambda: saved_results.by_case(result))


def _simulate(study: Study, options: argparse.Namespace) -> Outcome:
    import numpy as np

    from jaxbody.app import saved_results

    times = np.linspace(0.0, options.duration, round(options.duration / options.interval) + 1)
    trajectory = jb.simulate(
        study.model,
        times,
        motion=study.motion,
        loads=study.loads,
        initial="rest",
        **_steps(options),
    )
    return Outcome(
        [trajectory],
        lambda: jb.plots.plot_trajectory(trajectory),
        lambda: saved_results.over_time(trajectory, study.sensors),
        view=lambda: jb.view(trajectory),
    )


def _fit(study: Study, options: argparse.Namespace) -> Outcome:
    results = _fitted(study, options)
    fit = results["Fit"]
    return Outcome(
        list(results.values()),
        lambda: jb.plots.plot_fit(fit),
        space=fit.task.space,
        trees={"": fit.model, **fit.experiments},
    )


def _fitted(study: Study, options: argparse.Namespace) -> dict[str, Any]:
    """Return the results of a fit by heading: the fit, its optima if it has several starts, and its
    validation by the held-out experiments if there are some."""
    arguments = study.fit | ({"free": options.free} if options.free else {}) | _steps(options)
    with Problems() as problems:
        if not study.experiments:
            message, hint = (
                (
                    "has validate = true in all experiments",
                    "Leave it out of those that the fit is made of.",
                )
                if study.held_out
                else (
                    "has no experiments",
                    "State [records], [sensors] and [experiments]: help(jaxbody.read_study).",
                )
            )
            problems.add(
                "NO_DATA", options.file.name, message, limit="at least one to fit", hint=hint
            )
        if "free" not in arguments:
            problems.add(
                "NOTHING_FREE",
                options.file.name,
                "does not say what is free",
                limit="at least one path",
                hint='Give --free "spring.stiffness", or free = [...] below [fit] in the file.',
            )
    if "starts" in arguments:
        optima = jb.fitting.multistart(study.model, study.experiments, **arguments)
        results: dict[str, Any] = {"Fit": optima.best, "Optima from several starts": optima}
    else:
        results = {"Fit": jb.fit(study.model, study.experiments, **arguments)}
    if study.held_out:
        results["Validation"] = jb.validate(results["Fit"], study.held_out)
    return results


def _steps(options: argparse.Namespace) -> dict[str, Any]:
    """Return the given options of the integration, as arguments of `simulate`."""
    return {
        name: given
        for name in ("rtol", "max_steps")
        if (given := getattr(options, name)) is not None
    }


def _tune(study: Study, options: argparse.Namespace) -> Outcome:
    if not study.designs:
        raise JaxbodyError(
            Problem(
                "NOTHING_FREE",
                options.file.name,
                "has no designs",
                limit="at least one",
                hint="State free, minimize, quantities and limits below [designs.NAME]: "
                "help(jaxbody.read_study).",
            )
        )
    name = options.design or next(iter(study.designs))
    check_known(name, "--design", study.designs)
    tuning = jb.tune(study.model, **study.designs[name])
    return Outcome(
        [tuning], lambda: jb.plots.plot_tuning(tuning), space=tuning.space, trees={"": tuning.model}
    )


def _report(study: Study, options: argparse.Namespace) -> Outcome:
    """Write a report with a section for each part named on the command line, and one for the
    response if inputs or outputs are given."""
    import numpy as np

    path, results = options.out or options.file.with_suffix(".html"), {}
    for part in options.part or ("model", "equilibrium", "modes"):
        results |= PARTS[part](study, options)
    if options.input or options.output:
        results["Response"] = _response(study, options).results[0]
    path = jb.report(
        results,
        path,
        title=options.title or options.file.stem,
        files=[options.file, *study.files],
        command=options.typed,
    )
    failed = [result for result in results.values() if not np.all(getattr(result, "ok", True))]
    return Outcome([f"saved {path}", *failed], saved=True)


def _parts_of_modes(study: Study, options: argparse.Namespace) -> dict[str, Any]:
    lin, _ = _linear(study)
    return {
        "Small motions": lin,
        "Modes": jb.modes(lin),
        "Energies of modes": jb.mode_energies(lin),
    }


def _linear(study: Study) -> tuple[Any, list[str]]:
    """Return the linearization at the equilibrium, and the remarks on the equilibrium."""
    equilibrium = jb.equilibrium(study.model)
    return jb.linearize(study.model, equilibrium), equilibrium.remarks


def _ports(
    study: Study, options: argparse.Namespace, kind: str
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the inputs, which are support motions of this kind, and the outputs, both by name."""
    return {text: jb.BaseMotion(*_place(text, "--input"), kind=kind) for text in options.input}, {
        text: study.sensors.get(text) or _sensor(text, options.quantity, study.model.element_names)
        for text in options.output
    }


def _place(text: str, where: str) -> tuple[str, str]:
    """Split "road.z" into a name and a direction. Error: BAD_DIRECTION."""
    name, _, direction = text.rpartition(".")
    if not name:
        raise JaxbodyError(
            Problem(
                "BAD_DIRECTION",
                where,
                f"is '{text}'",
                text,
                "a name and a direction, such as road.z",
            )
        )
    return name, direction


def _sensor(text: str, quantity: str, elements: tuple[str, ...]) -> Any:
    """Return the sensor of an output, "car.z" or the name of an element."""
    name, direction = (text, "") if text in elements else _place(text, "--output")
    sensor = QUANTITIES[quantity][direction[0] == "r"] if direction else "Elongation"
    axis = {"axis": [float(direction[-1] == axis) for axis in "xyz"]} if direction else {}
    return getattr(jb, sensor)(name, **axis)


PARTS: dict[str, Callable[[Any, argparse.Namespace], dict[str, Any]]] = {
    "model": lambda study, options: {"Model": study.model},
    "equilibrium": lambda study, options: {"Equilibrium": jb.equilibrium(study.model)},
    "modes": _parts_of_modes,
    "load-cases": lambda study, options: {"Load cases": _load_cases(study, options).results[0]},
    "motion": lambda study, options: {"Motion": _simulate(study, options).results[0]},
    "fit": _fitted,
    "design": lambda study, options: {
        f"Design {options.design or next(iter(study.designs), '')}": _tune(study, options).results[
            0
        ]
    },
}
COMMANDS = {
    "check": Command(
        "check a model file and the records that it names",
        "jaxbody check engine.toml",
        _check,
        measured=True,
    ),
    "show": Command(
        "print and draw a model; --out engine.html shows it in three dimensions",
        "jaxbody show engine.toml --out engine.png",
        _show,
        formats=IN_SPACE,
    ),
    "equilibrium": Command(
        "the static equilibrium",
        "jaxbody equilibrium engine.toml --set 'gravity=0, 0, -9.81 m/s2'",
        _equilibrium,
        formats=IN_SPACE,
    ),
    "modes": Command(
        "natural frequencies and modes about the equilibrium",
        "jaxbody modes engine.toml --energies --out modes.csv",
        _modes,
        (
            (
                ("--damped",),
                {"action": "store_true", "help": "complex modes, with their damping ratios"},
            ),
            (
                ("--energies",),
                {"action": "store_true", "help": "the shares of the energy of each mode"},
            ),
            (
                ("--draw",),
                {
                    "type": int,
                    "default": 1,
                    "metavar": "N",
                    "help": "the mode that --out draws (default: 1)",
                },
            ),
        ),
        formats=IN_SPACE,
    ),
    "random": Command(
        "the response to an uneven road, of class A to H by ISO 8608, under each input",
        "jaxbody random car.toml --input road.z --output body.z --speed 20 --set "
        "suspension.damping='1.5 N s/mm' --out psd.png",
        _random,
        (
            *ports_options(True),
            BAND,
            (
                ("--road",),
                {"default": "C", "metavar": "CLASS", "help": "A (smooth) to H (default: C)"},
            ),
            (
                ("--speed",),
                {
                    "type": above_zero,
                    "default": 20.0,
                    "metavar": "V",
                    "help": "[m/s] (default: 20)",
                },
            ),
        ),
    ),
    "load-cases": Command(
        "displacements, strokes and forces under steady accelerations of the whole",
        "jaxbody load-cases engine.toml --case braking=-1,0,0 --case bump=0,0,3 --out cases.csv",
        _load_cases,
        (case_option(True),),
    ),
    "simulate": Command(
        "the nonlinear motion on supports that move, from rest on them",
        "jaxbody simulate car.toml --duration 3 --out motion.csv",
        _simulate,
        (*OF_MOTION, *OF_STEPS),
        formats=IN_SPACE,
    ),
    "report": Command(
        "one HTML file of tables and pictures, which needs no network",
        "jaxbody report measured.toml --part model --part modes --part fit --free "
        "suspension.stiffness --out report.html",
        _report,
        (
            (
                ("--part",),
                {
                    "action": "append",
                    "choices": list(PARTS),
                    "help": "a section (default: model, equilibrium and modes)",
                },
            ),
            (("--title",), {"metavar": "TEXT", "help": "title (default: the name of the file)"}),
            *ports_options(False),
            *OF_RESPONSE,
            *OF_MOTION,
            *OF_STEPS,
            case_option(False),
            FREE,
            DESIGN,
        ),
        measured=True,
        formats=(".html",),
    ),
    "fit": Command(
        "estimate parameters from the experiments of a file, and validate them by "
        "those that it holds out",
        "jaxbody fit measured.toml --free suspension.stiffness --write --out fit.csv",
        _fit,
        (FREE, *OF_STEPS, WRITE),
        measured=True,
    ),
    "tune": Command(
        "choose parameters by a design of the file",
        "jaxbody tune measured.toml --design ride --write --out design.csv",
        _tune,
        (DESIGN, WRITE),
    ),
    "response": Command(
        "the response to a harmonic motion of supports",
        "jaxbody response car.toml --input road.z --output body.z --frequencies "
        "0.5:20 --out response.png",
        _response,
        (*ports_options(True), *OF_RESPONSE),
    ),
}
