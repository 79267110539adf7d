"""Commands on a model file, by name: a description, an example, the function that runs it, options
and formats."""

import argparse
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import jaxbody as jb
from jaxbody.app import outcomes
from jaxbody.app.command_options import (
    BAND,
    DESIGN,
    FREE,
    OF_MOTION,
    OF_RESPONSE,
    OF_STEPS,
    OVER,
    WRITE,
    above_zero,
    case_option,
    number_of,
    ports_options,
)
from jaxbody.app.outcomes import Outcome

FLAT = (".csv", ".png", ".svg", ".pdf")
IN_SPACE = (*FLAT, ".html")  # a page in three dimensions


@dataclass(frozen=True)
class FileCommand:
    """A command on a model file: a description, an example, the function that runs it, its options;
    `measured`: whether it needs the experiments of the file."""

    about: str
    example: str
    run: Callable[[Any, argparse.Namespace], Outcome]
    options: tuple[tuple[tuple[str, ...], dict[str, Any]], ...] = ()
    measured: bool = False
    formats: tuple[str, ...] = FLAT  # extensions for --out


COMMANDS = {
    "check": FileCommand(
        "check a model file and the records that it names",
        "jaxbody check engine.toml",
        outcomes.check,
        measured=True,
    ),
    "show": FileCommand(
        "print and draw a model; --out engine.html shows it in three dimensions",
        "jaxbody show engine.toml --out engine.png",
        lambda study, options: Outcome([study.model], view=lambda: jb.view(study.model)),
        formats=IN_SPACE,
    ),
    "plausibility": FileCommand(
        "numbers that a wrong unit changes, beside their usual ranges",
        "jaxbody plausibility engine.toml",
        lambda study, options: Outcome([jb.fitting.plausibility(study.model, study.experiments)]),
        measured=True,
        formats=(".csv",),
    ),
    "diagnose": FileCommand(
        "compare the records with the model: sign, axis, unit, delay of each channel",
        "jaxbody diagnose measured.toml",
        outcomes.diagnose,
        measured=True,
    ),
    "equilibrium": FileCommand(
        "the static equilibrium",
        "jaxbody equilibrium engine.toml --set 'gravity=0, 0, -9.81 m/s2'",
        outcomes.equilibrium,
        formats=IN_SPACE,
    ),
    "find-equilibria": FileCommand(
        "all equilibria that are found from many starts, with their stability",
        "jaxbody find-equilibria engine.toml --starts 16",
        lambda study, options: Outcome([jb.find_equilibria(study.model, starts=options.starts)]),
        (number_of("--starts", "number of starts", 64),),
    ),
    "preload": FileCommand(
        "free lengths with which the model stands still as it is drawn",
        "jaxbody preload car.toml --out preload.csv",
        lambda study, options: Outcome([jb.preload(study.model)]),
    ),
    "linearize": FileCommand(
        "mass, damping and stiffness matrices at the equilibrium",
        "jaxbody linearize engine.toml",
        outcomes.at_equilibrium(lambda lin: lin),
    ),
    "modes": FileCommand(
        "natural frequencies and modes about the equilibrium",
        "jaxbody modes engine.toml --energies --out modes.csv",
        outcomes.modes,
        (
            (
                ("--damped",),
                {"action": "store_true", "help": "complex modes, with their damping ratios"},
            ),
            (
                ("--energies",),
                {"action": "store_true", "help": "the shares of the energy of each mode"},
            ),
            number_of("--mode", "the mode that --out draws", 1),
        ),
        formats=IN_SPACE,
    ),
    "track-modes": FileCommand(
        "natural frequencies over a parameter, each mode followed by its shape",
        "jaxbody track-modes car.toml --over 'suspension.stiffness=10:90 N/mm' --out modes.png",
        outcomes.track_modes,
        OVER,
    ),
    "backbone-curves": FileCommand(
        "natural frequencies over the amplitude",
        "jaxbody backbone-curves car.toml",
        outcomes.at_equilibrium(lambda lin: jb.vibration.backbone_curves(lin)),
    ),
    "dynamic-stiffness": FileCommand(
        "stiffness and loss angle of an element over frequency",
        "jaxbody dynamic-stiffness car.toml --element suspension --frequencies 1:30",
        outcomes.dynamic_stiffness,
        (
            (("--element",), {"required": True, "metavar": "NAME", "help": "name of the element"}),
            (("--direction",), {"metavar": "z", "help": "of a Mount: x, y, z, rx, ry or rz"}),
            BAND,
            number_of("--points", "number of frequencies", 20),
        ),
    ),
    "random": FileCommand(
        "the response to an uneven road, of class A to H by ISO 8608, under each input",
        "jaxbody random car.toml --input road.z --output body.z --speed 20 --set "
        "suspension.damping='1.5 N s/mm' --out psd.png",
        outcomes.random,
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
    "spectrum-response": FileCommand(
        "the largest outputs under an earthquake, by the elastic spectrum of Eurocode 8",
        "jaxbody spectrum-response car.toml --input road.z --output suspension --acceleration 2.5 "
        "--ground C --set suspension.damping='1.5 N s/mm'",
        outcomes.spectrum_response,
        (
            *ports_options(True),
            (
                ("--acceleration",),
                {
                    "type": above_zero,
                    "required": True,
                    "metavar": "A",
                    "help": "of the ground, a_g [m/s2]",
                },
            ),
            (("--ground",), {"default": "A", "help": "A (rock) to E (default: A)"}),
        ),
    ),
    "load-cases": FileCommand(
        "displacements, strokes and forces under steady accelerations of the whole",
        "jaxbody load-cases engine.toml --case braking=-1,0,0 --case bump=0,0,3 --out cases.csv",
        outcomes.load_cases,
        (case_option(True),),
    ),
    "simulate": FileCommand(
        "the nonlinear motion on supports that move, from rest on them",
        "jaxbody simulate car.toml --duration 3 --out motion.csv",
        outcomes.simulate,
        (*OF_MOTION, *OF_STEPS),
        formats=IN_SPACE,
    ),
    "report": FileCommand(
        "one HTML file of tables and pictures, which needs no network",
        "jaxbody report measured.toml --part model --part modes --part fit --free "
        "suspension.stiffness --out report.html",
        outcomes.report,
        (
            (
                ("--part",),
                {
                    "action": "append",
                    "choices": list(outcomes.PARTS),
                    "help": "a section (default: model, plausibility, equilibrium and modes)",
                },
            ),
            (("--title",), {"metavar": "TEXT", "help": "title (default: the name of the file)"}),
            (("--view",), {"action": "store_true", "help": "with a view in three dimensions"}),
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
    "fit": FileCommand(
        "estimate parameters from the experiments of a file, and validate them by "
        "those that it holds out",
        "jaxbody fit measured.toml --free suspension.stiffness --write --out fit.csv",
        outcomes.fit,
        (FREE, *OF_STEPS, WRITE),
        measured=True,
    ),
    "profile-likelihood": FileCommand(
        "the interval of a parameter of a fit, by fits with this parameter held",
        "jaxbody profile-likelihood measured.toml --free suspension.stiffness",
        outcomes.profile_likelihood,
        (
            FREE,
            (("--path",), {"metavar": "PATH", "help": "the parameter (default: the first)"}),
            *OF_STEPS,
        ),
        measured=True,
    ),
    "sweep": FileCommand(
        "the quantities of a design over a parameter",
        "jaxbody sweep measured.toml --over 'suspension.stiffness=10:90 N/mm' --out sweep.csv",
        outcomes.sweep,
        (*OVER, DESIGN),
    ),
    "pareto": FileCommand(
        "designs between the least of one quantity of a design and the least of another",
        "jaxbody pareto measured.toml --design ride --minimize comfort --minimize travel "
        "--points 3",
        outcomes.pareto,
        (
            DESIGN,
            (("--minimize",), {"action": "append", "required": True, "metavar": "NAME"}),
            number_of("--points", "number of designs", 12),
        ),
    ),
    "tune": FileCommand(
        "choose parameters by a design of the file",
        "jaxbody tune measured.toml --design ride --write --out design.csv",
        outcomes.tune,
        (DESIGN, WRITE),
    ),
    "response": FileCommand(
        "the response to harmonic motions of supports, forces on bodies and unbalances",
        "jaxbody response car.toml --input road.z --output body.z --frequencies "
        "0.5:20 --out response.png",
        outcomes.response,
        (*ports_options(True), *OF_RESPONSE),
    ),
}
