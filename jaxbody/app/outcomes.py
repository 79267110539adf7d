"""What the commands on a study from a file compute: results to print, pictures to draw, series to
save."""

from __future__ import annotations

import argparse
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from dataclasses import field as attribute
from typing import TYPE_CHECKING, Any

import jaxbody as jb
from jaxbody.app.command_options import QUANTITIES
from jaxbody.core.errors import JaxbodyError, Problem, Problems, Status, check_known
from jaxbody.core.printed_tables import printed_unit

if TYPE_CHECKING:
    from jaxbody.files.studies.study_files import Study

NO_MODES = (Status.NOT_SYMMETRIC, Status.NONFINITE)  # without natural modes


@dataclass
class Outcome:
    """Results of a command, which print as tables, and functions for --out and --write."""

    results: list[Any]
    draw: Callable[[], Any] | None = None  # the picture for --out; None: `plot` of the first result
    series: Callable[[], Any] | None = None  # table of numbers that --out saves in all formats
    text: Callable[[], Any] | None = None  # table that --out saves as .csv only
    space: Any = None  # space of the free parameters, for --write
    trees: dict[str, Any] = attribute(default_factory=dict)  # model and experiments to write
    saved: bool = False  # whether the command itself has saved the results
    view: Callable[[], Any] | None = None  # shows the results in three dimensions


def check(study: Study, options: argparse.Namespace) -> Outcome:
    """Count the parts of a file and say what is not plausible in its model and records."""
    from jaxbody.core.tables import counted

    model = study.model
    parts = {
        "support": model.layout.supports,
        "element": model.element_names + model.force_names,
        "controller": model.controller_names,
        "load": study.loads,
        "sensor": study.sensors,
        "experiment": study.experiments,
        "held-out experiment": study.held_out,
    }
    bodies = "1 body" if len(model.layout.bodies) == 1 else f"{len(model.layout.bodies)} bodies"
    counts = [bodies, *(counted(len(names), what) for what, names in parts.items() if names)]
    first = (
        f"{options.file.name}: {', '.join(counts)}, {counted(model.layout.nv, 'degree')} of "
        "freedom; no errors"
    )
    found = [jb.diagnose(model, study.experiments)] if study.experiments else []
    return Outcome([first, *_remarks(study), *found])


def _remarks(study: Study) -> tuple[str, ...]:
    """Return what is not plausible in a model and its experiments, in words."""
    if not study.model.layout.nv:
        return ()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the remarks are printed
        return jb.fitting.plausibility(study.model, study.experiments).words


def modes(study: Study, options: argparse.Namespace) -> Outcome:
    """Compute natural or complex modes at the equilibrium."""
    from jaxbody.vibration.natural_modes import Modes

    lin, remarks = _linear(study)
    modes: Any = jb.complex_modes(lin) if options.damped else fitting_modes(lin)
    shown = options.energies and isinstance(modes, Modes)
    energies = [jb.vibration.mode_energies(lin)] if shown else []
    return Outcome(
        [modes, *energies, *remarks],
        lambda: jb.plots.draw_mode(lin, modes, options.mode),
        view=lambda: jb.view(modes, number=options.mode, at=lin),
    )


def fitting_modes(lin: Any) -> Any:
    """Return the natural modes, or the complex ones where a matrix is not symmetric, or the static
    stiffness not finite, as that of integral control."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "(?s).*(NOT_SYMMETRIC|NONFINITE)")
        natural = jb.modes(lin)
    return jb.complex_modes(lin) if int(natural.status) in NO_MODES else natural


def _over(study: Study, options: argparse.Namespace) -> tuple[str, str, Any]:
    """Return the path of the option --over, its SI unit, and equally spaced values in SI."""
    import numpy as np

    from jaxbody.files.quantities import in_SI, unit_system
    from jaxbody.fitting.parameters.spaces import units_of
    from jaxbody.model.leaf_paths import leaves_of

    path, *ends = options.over
    leaves = {leaf.path: leaf for leaf in leaves_of(study.model)}
    check_known(path, "--over", leaves)
    unit, *others = units_of(leaves[path], study.model, jb.parameter_paths(study.model, path)[path])
    with Problems() as problems:
        if others:
            problems.add("BAD_SHAPE", "--over", "is not one number", value=path)
        system = unit_system(study.units, "units", problems)
        low, high = (in_SI(end, unit, {}, system, "--over", problems) for end in ends)
    return path, unit, np.linspace(low, high, options.points)


def sweep(study: Study, options: argparse.Namespace) -> Outcome:
    """Compute the quantities of a design over a parameter."""
    from jaxbody.app import saved_results

    (path, unit, values), chosen = _over(study, options), design(study, options)
    found = jb.sweep(study.model, chosen["evaluate"], {path: values})
    columns = {f"{path} [{unit}]" if unit else path: values}
    heads = chosen["evaluate"].units
    columns |= {f"{x} [{heads[x]}]" if heads[x] else x: found[x] for x in heads}
    table = saved_results.series(columns)
    return Outcome([table], series=lambda: table)


def spectrum_response(study: Study, options: argparse.Namespace) -> Outcome:
    """Compute the largest outputs under the elastic spectrum of Eurocode 8."""
    lin, remarks = _linear(study)
    _, outputs = _ports(study, options, "acceleration")
    spectrum = jb.shock.Eurocode8(options.acceleration, options.ground)
    bases: dict[Any, dict[str, Any]] = {}
    for text in options.input:
        support, direction = _place(text, "--input")
        bases.setdefault(support, {})[direction] = spectrum
    response = jb.shock.spectrum_response(lin, bases, outputs)
    return Outcome([response, *remarks])


def response(study: Study, options: argparse.Namespace) -> Outcome:
    """Compute frequency responses at the equilibrium."""
    import numpy as np

    from jaxbody.app import saved_results

    lin, remarks = _linear(study)
    low, high = options.frequencies
    inputs, outputs = _ports(study, options, options.kind)
    response = jb.frequency_response(lin, np.geomspace(low, high, options.points), inputs, outputs)
    return Outcome(
        [response, *remarks],
        series=lambda: saved_results.over_frequency(response),
    )


def random(study: Study, options: argparse.Namespace) -> Outcome:
    """Compute the response to an uneven road under each input."""
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
        series=lambda: saved_results.densities(response),
    )


def load_cases(study: Study, options: argparse.Namespace) -> Outcome:
    """Compute load cases. Error: NO_DATA if none is given."""
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
    return Outcome([result], text=lambda: saved_results.by_case(result))


def simulate(study: Study, options: argparse.Namespace) -> Outcome:
    """Simulate the motion from rest on the supports, and say where it is sampled too coarsely."""
    import numpy as np

    from jaxbody.app import saved_results

    highest = _highest_frequency(study, options.duration)
    interval = options.interval or min(0.01, 0.05 / max(highest, 1e-9))
    times = np.linspace(0.0, options.duration, round(options.duration / interval) + 1)
    trajectory = jb.simulate(
        study.model,
        times,
        motion=study.motion,
        loads=study.loads,
        initial="rest",
        **_steps(options),
    )
    samples = 1 / (interval * highest) if highest else np.inf
    remarks = [
        f"There are {samples:.1f} samples in a period of {highest:g} Hz, and peaks between them "
        f"are missed: give --interval {interval * samples / 20:.2g}."
    ] * (samples < 10)
    return Outcome(
        [trajectory, *remarks],
        series=lambda: saved_results.over_time(trajectory, study.sensors),
        view=lambda: jb.view(trajectory),
    )


def _highest_frequency(study: Study, duration: float) -> float:
    """Return the highest frequency [Hz] of harmonic motions and loads; 0 if there are none."""
    import numpy as np

    parts: list[Any] = [*study.motion.values(), *study.loads.values()]
    parts += [signal for load in study.loads.values() for signal in load.signals()]
    return max(
        (
            float(np.max(part.frequency + getattr(part, "run_up", 0.0) * duration))
            * float(np.max(getattr(part, "orders", 1)))
            for part in parts
            if hasattr(part, "frequency")
        ),
        default=0.0,
    )


def fit(study: Study, options: argparse.Namespace) -> Outcome:
    """Fit parameters to the experiments of the file."""
    results = fitted(study, options)
    fit = results["Fit"]
    return Outcome(
        [*results.values(), *_remarks(study)],
        space=fit.task.space,
        trees={"": fit.model, **fit.experiments},
    )


def fitted(study: Study, options: argparse.Namespace) -> dict[str, Any]:
    """Return the results of a fit by heading: the fit, its optima if it has several starts, and its
    validation by the held-out experiments if there are some."""
    arguments = study.fit | ({"free": options.free} if options.free else {}) | _steps(options)
    with Problems() as problems:
        problems.gather(lambda: check_measured(study, options))
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


def check_measured(study: Study, options: argparse.Namespace) -> None:
    """Error: NO_DATA for a study without experiments to fit."""
    if study.experiments:
        return
    message, hint = (
        ("has validate = true in all experiments", "Leave it out of those that are fitted.")
        if study.held_out
        else (
            "has no experiments",
            "State [records], [sensors] and [experiments]; "
            "`jaxbody new quarter_car` has lines to start from.",
        )
    )
    limit = "at least one to fit"
    raise JaxbodyError(Problem("NO_DATA", options.file.name, message, limit=limit, hint=hint))


def _steps(options: argparse.Namespace) -> dict[str, Any]:
    """Return the given options of the integration, as arguments of `simulate`."""
    return {
        name: given
        for name in ("rtol", "max_steps")
        if (given := getattr(options, name)) is not None
    }


def design(study: Study, options: argparse.Namespace) -> dict[str, Any]:
    """Return the design of the option --design, or the first one, as arguments of `tune`."""
    if not study.designs:
        raise JaxbodyError(
            Problem(
                "NOTHING_FREE",
                options.file.name,
                "has no designs",
                limit="at least one",
                hint="State free, minimize, quantities and limits below [designs.NAME]; "
                "`jaxbody new quarter_car` has one.",
            )
        )
    name = options.design or next(iter(study.designs))
    check_known(name, "--design", study.designs)
    return study.designs[name]


def report(study: Study, options: argparse.Namespace) -> Outcome:
    """Write a report with a section for each part named on the command line, and one for the
    response if inputs or outputs are given."""
    import numpy as np

    from jaxbody.model.forces.controllers import sampled_names

    path, results = options.out or options.file.with_suffix(".html"), {}
    modes = () if sampled_names(study.model) else ("modes",)
    for part in options.part or ("model", "plausibility", "equilibrium", *modes):
        results |= PARTS[part](study, options)
    if options.input or options.output:
        results["Response"] = response(study, options).results[0]
    path = jb.report(
        results,
        path,
        title=options.title or options.file.stem,
        files=[options.file, *study.files],
        command=options.typed,
        units=study.printed_units,
        view=options.view,
    )
    failed = [result for result in results.values() if not np.all(getattr(result, "ok", True))]
    return Outcome([f"saved {path}", *failed], saved=True)


def _parts_of_modes(study: Study, options: argparse.Namespace) -> dict[str, Any]:
    from jaxbody.vibration.natural_modes import Modes

    lin, _ = _linear(study)
    found = fitting_modes(lin)
    parts = {"Small motions": lin, "Modes": found}
    if isinstance(found, Modes):
        parts["Energies of modes"] = jb.vibration.mode_energies(lin)
    return parts


def at_equilibrium(compute: Callable[[Any], Any]) -> Callable[..., Outcome]:
    """Return the command that computes a result from the linearization at the equilibrium."""

    def run(study: Study, options: argparse.Namespace) -> Outcome:
        lin, remarks = _linear(study)
        return Outcome([compute(lin), *remarks])

    return run


def track_modes(study: Study, options: argparse.Namespace) -> Outcome:
    """Follow the modes over a parameter, whose values are in the printed units."""
    path, si, values = _over(study, options)
    unit, factor = printed_unit(si, options.words)

    def linearized(value: Any) -> Any:
        model = jb.replace(study.model, {path: value / factor})
        return jb.linearize(model, jb.equilibrium(model))

    branches = jb.vibration.track_modes(linearized, values * factor)
    return Outcome([branches, f"value: {path} [{unit}]"])


def dynamic_stiffness(study: Study, options: argparse.Namespace) -> Outcome:
    """Compute the dynamic stiffness of an element."""
    import numpy as np

    check_known(options.element, "--element", study.model.element_names)
    low, high = options.frequencies
    f, element = np.geomspace(low, high, options.points), study.model[options.element]
    return Outcome([jb.vibration.dynamic_stiffness(element, f, direction=options.direction)])


def diagnose(study: Study, options: argparse.Namespace) -> Outcome:
    """Compare the records with the model."""
    check_measured(study, options)
    return Outcome([jb.diagnose(study.model, study.experiments)])


def profile_likelihood(study: Study, options: argparse.Namespace) -> Outcome:
    """Fit, and compute the profile of one of the parameters."""
    fit = fitted(study, options)["Fit"]
    return Outcome([jb.fitting.profile_likelihood(fit, options.path or next(iter(fit.estimates)))])


def pareto(study: Study, options: argparse.Namespace) -> Outcome:
    """Compute the front of several quantities of a design."""
    chosen = design(study, options) | {"minimize": options.minimize, "points": options.points}
    return Outcome([jb.pareto(study.model, **chosen)])


def tune(study: Study, options: argparse.Namespace) -> Outcome:
    """Tune the chosen design."""
    tuning = jb.tune(study.model, **design(study, options))
    return Outcome([tuning], space=tuning.space, trees={"": tuning.model})


def equilibrium(study: Study, options: argparse.Namespace) -> Outcome:
    """Compute the equilibrium."""
    found = jb.equilibrium(study.model)
    return Outcome([found], view=lambda: jb.view(found))


def _linear(study: Study) -> tuple[Any, list[str]]:
    """Return the linearization at the equilibrium, and the remarks on the equilibrium."""
    equilibrium = jb.equilibrium(study.model)
    return jb.linearize(study.model, equilibrium), equilibrium.remarks


def _ports(
    study: Study, options: argparse.Namespace, kind: str
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the inputs, motions of supports being of this kind, and the outputs, both by name."""
    inputs = {text: _input(text, study, kind) for text in options.input}
    outputs: dict[str, Any] = {}
    for text in options.output:
        outputs |= _outputs(text, study, options.quantity)
    return inputs, outputs


def _input(text: str, study: Study, kind: str) -> Any:
    """Return the input of a text: a load of the file, the command of a drive, the motion of a
    support, "road.z", or a force or moment on a body, "engine.rx"."""
    if text in study.loads:
        return study.loads[text]
    if jb.Command(text).problem(study.model, "") is None:
        return jb.Command(text)
    name, direction = _place(text, "--input")
    layout = study.model.layout
    check_known(name, "--input", (*layout.supports, *layout.bodies, *study.loads))
    if name in layout.bodies:
        return jb.PointForce(name, direction=direction)
    return jb.BaseMotion(name, direction, kind=kind)


def _outputs(text: str, study: Study, quantity: str) -> dict[str, Any]:
    """Return the sensors of an output by name: a sensor of the file, "car.z", a component of an
    element, "mount.z", or an element, of which a bushing has three."""
    from jaxbody.geometry.points_and_orientations import DIRECTIONS

    if text in study.sensors:
        return {text: study.sensors[text]}
    along, about, of_element = QUANTITIES[quantity]
    elements = study.model.element_names
    if text in elements:
        if study.model[text].size == 1:
            return {text: getattr(jb.sensors, of_element)(text)}
        return {
            name: sensor
            for axis in "xyz"
            for name, sensor in _outputs(f"{text}.{axis}", study, quantity).items()
        }
    name, direction = _place(text, "--output")
    check_known(direction, "--output", DIRECTIONS)
    component = DIRECTIONS.index(direction)
    if name in elements or along == about:
        kind = of_element if name in elements else along
        return {text: getattr(jb.sensors, kind)(name, component=component)}
    axis = [float(direction[-1] == axis) for axis in "xyz"]
    return {text: getattr(jb.sensors, along if component < 3 else about)(name, axis=axis)}


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


PARTS: dict[str, Callable[[Any, argparse.Namespace], dict[str, Any]]] = {
    "model": lambda study, options: {"Model": study.model},
    "plausibility": lambda study, options: {
        "Plausibility": jb.fitting.plausibility(study.model, study.experiments)
    },
    "diagnosis": lambda study, options: {"Diagnosis": diagnose(study, options).results[0]},
    "equilibrium": lambda study, options: {"Equilibrium": jb.equilibrium(study.model)},
    "modes": _parts_of_modes,
    "load-cases": lambda study, options: {"Load cases": load_cases(study, options).results[0]},
    "motion": lambda study, options: {"Motion": simulate(study, options).results[0]},
    "fit": fitted,
    "design": lambda study, options: {
        f"Design {options.design or next(iter(study.designs), '')}": tune(study, options).results[0]
    },
}
