"""The command `jaxbody`: computations on a model file from the command line. Arguments and the file
are checked before JAX is imported.

Exit codes: 0, done; 1, done, but the status of a result is not ok; 2, the arguments or the file are
not valid.
"""

import argparse
import shlex
import sys
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jaxbody as jb
from jaxbody.app.command_options import OF_ESTIMATE
from jaxbody.app.file_commands import COMMANDS
from jaxbody.core.errors import JaxbodyError, Problem, check_known
from jaxbody.core.printed_tables import text_in, unit_words
from jaxbody.files.documents import LARGEST, read_document, set_value
from jaxbody.files.schemas import checked_values

DESCRIPTION = (
    "Differentiable rigid bodies on springs with an imposed base motion: simulation, vibration, "
    "identification and design."
)
PRINTED = (".csv", ".png", ".svg", ".pdf")  # formats of what has tables and a picture
READY = Path(__file__).with_name("ready")  # files of models
EPILOG = """first steps:
  jaxbody new engine > engine.toml   # a file to edit; jaxbody new lists the ready models
  jaxbody check engine.toml
  jaxbody modes engine.toml

in Python:
  import jaxbody as jb
  model = jb.read_model("engine.toml")   # or jb.presets.full_car(), or your own: help(jb.Model)
  print(jb.equilibrium(model))
  jb.plots.draw_model(model)      # plots: dir(jb.plots); force laws: dir(jb.laws)
  help(jb.simulate)               # each public name has an example; all names: dir(jb)
"""


ON_FILES: tuple[Any, ...] = (  # options of all commands on model files
    (("file",), {"type": Path, "help": "model file, .toml or .json"}),
    (
        ("--set",),
        {
            "action": "append",
            "default": [],
            "metavar": "PATH=VALUE",
            "help": 'another value, such as left.stiffness="30 N/mm"',
        },
    ),
    (
        ("--allow",),
        {
            "action": "append",
            "default": [],
            "metavar": "MODULE",
            "help": "module of yours whose classes the file may use",
        },
    ),
    (
        ("--largest",),
        {
            "type": float,
            "default": LARGEST,
            "metavar": "N",
            "help": "largest size of the file [bytes] (default: 2e7)",
        },
    ),
)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command and return its exit code; without a command, print the help."""
    parser = _parser()
    options = parser.parse_args(arguments)
    if options.command is None:
        parser.print_help()
        return 0
    options.own_process, options.words = arguments is None, {}
    if options.own_process:
        warnings.showwarning = lambda message, *_, **__: print(
            f"warning: {text_in(str(message), options.words)}", file=sys.stderr
        )  # without the line of code that issues the warning
    options.typed = shlex.join(["jaxbody", *(sys.argv[1:] if arguments is None else arguments)])
    try:
        return options.run(options)
    except JaxbodyError as error:
        words = text_in(str(error), options.words)
        print(f"jaxbody {options.command}: {words}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        return 130


def _parser() -> argparse.ArgumentParser:
    """Return the parser of the arguments of all commands."""
    form = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(
        prog="jaxbody", description=DESCRIPTION, epilog=EPILOG, formatter_class=form
    )
    parser.add_argument("--version", action="version", version=f"jaxbody {jb.__version__}")
    commands = parser.add_subparsers(dest="command", title="commands", metavar="command")
    about = "print the file of a ready model, or of a body on the mounts of a data sheet"
    new = commands.add_parser(
        "new",
        help=about,
        description=f"{about[0].upper()}{about[1:]}.",
        epilog="examples:\n  jaxbody new quarter_car > car.toml\n"
        "  jaxbody new --mounts mounts.csv > engine.toml",
        formatter_class=form,
    )
    chosen = new.add_mutually_exclusive_group()
    chosen.add_argument(
        "model", nargs="?", help="name of a ready model; without it, all are listed"
    )
    chosen.add_argument(
        "--mounts",
        type=Path,
        metavar="FILE",
        help="data sheet: name, x [mm], y [mm], z [mm], kx [N/mm], ky [N/mm], kz [N/mm], ...",
    )
    new.set_defaults(run=_new)
    for name, command in COMMANDS.items():
        sub = commands.add_parser(
            name,
            help=command.about,
            description=f"{command.about[0].upper()}{command.about[1:]}.",
            epilog=f"example:\n  {command.example}",
            formatter_class=form,
        )
        for flags, more in (*ON_FILES, _out(command.formats), *command.options):
            sub.add_argument(*flags, **more)
        sub.set_defaults(run=_on_file)
    about = "frequency responses and modes of a test, from its records"
    estimate = commands.add_parser(
        "estimate",
        help=about,
        description=f"{about[0].upper()}{about[1:]}.",
        epilog="examples:\n  jaxbody estimate shaker.csv --time t --input force --output left "
        "--output right --segment 8 --out responses.png\n"
        "  jaxbody estimate hammer.csv --rate 512 --input force "
        "--output acc --unit acc=g --segment 2 --pulse 0.02 --decay 0.5 --draw modes "
        "--out modes.png",
        formatter_class=form,
    )
    for flags, more in (*OF_ESTIMATE, _out(PRINTED)):
        estimate.add_argument(*flags, **more)
    estimate.set_defaults(run=_estimate)
    about = "an engine on its mounts: modes, transmissibility, a fit, tuned mounts and a report"
    demo = commands.add_parser("demo", help=about, description=f"{about[0].upper()}{about[1:]}.")
    demo.add_argument(
        "--out",
        type=Path,
        default=Path("jaxbody-demo"),
        help="folder for what it writes (default: ./jaxbody-demo)",
    )
    demo.add_argument(
        "--seed", type=int, default=0, help="seed of the measurement noise (default: 0)"
    )
    demo.add_argument("--open", action="store_true", help="open the report in the browser")
    demo.set_defaults(run=_demo)
    return parser


def _out(formats: tuple[str, ...]) -> tuple[Any, ...]:
    """Return the option that saves the result in one of these formats."""
    text = f"save the result: {' '.join(formats)}"
    return ("--out",), {"type": Path, "metavar": "FILE", "help": text}


def _check_out(path: Path | None, formats: tuple[str, ...]) -> None:
    """Error: UNKNOWN_FORMAT."""
    if path is not None and path.suffix not in formats:
        raise JaxbodyError(
            Problem("UNKNOWN_FORMAT", "--out", f"is {path}", path, " ".join(formats))
        )


def _demo(options: argparse.Namespace) -> int:
    _prepare(options)
    from jaxbody.app import demos

    return demos.run(options.out, options.seed, options.open)


def _use_x64() -> None:
    import jax

    jax.config.update("jax_enable_x64", True)


def _prepare(options: argparse.Namespace) -> None:
    """Switch JAX to double precision; in the command's own process, keep compiled programs for the
    next run."""
    _use_x64()
    if options.own_process:
        try:
            jb.keep_programs()
        except JaxbodyError as error:
            print(f"Programs are not kept for the next run: {error}", file=sys.stderr)


def _new(options: argparse.Namespace) -> int:
    """Print the file of a ready model or of a mount table, or list the ready models."""
    if options.mounts is not None:
        _use_x64()
        from jaxbody.app.new_files import text_of_mounts

        print(text_of_mounts(options.mounts), end="")
        print(
            f"Mass, center of mass and inertia are not in {options.mounts.name}: replace the "
            "placeholders in the file.",
            file=sys.stderr,
        )
        return 0
    ready = {path.stem: path.read_text("utf-8") for path in sorted(READY.glob("*.toml"))}
    if options.model is None:
        print("Ready models, for `jaxbody new NAME > FILE`:")
        for name, text in ready.items():
            print(f"  {name:25}{text.partition(chr(10))[0].removeprefix('# ')}")
        return 0
    check_known(options.model, "name", ready)
    print(ready[options.model], end="")
    return 0


def _estimate(options: argparse.Namespace) -> int:
    """Print the responses of records and the modes that they show, and save tables or a picture,
    the responses also where no mode is found."""
    _check_out(options.out, PRINTED)
    _use_x64()
    from jaxbody.app.outcomes import Outcome
    from jaxbody.app.saved_results import save

    inputs, outputs = (",".join(names).split(",") for names in (options.input, options.output))
    units, times = dict(options.unit), [options.time] if options.time else []
    for name in units:
        check_known(name, "--unit", (*times, *inputs, *outputs))
    records = [
        jb.read_record(
            path,
            time=(options.time, units.get(options.time)) if times else None,
            channels={name: (name, units.get(name)) for name in (*inputs, *outputs)},
            rate=options.rate,
            decimal=options.decimal,
        )
        for path in options.file
    ]
    hammer = options.pulse is not None or options.decay is not None
    window = jb.modal.ImpactWindow(options.pulse, options.decay) if hammer else options.window
    responses = jb.modal.estimate_responses(
        records,
        inputs=inputs,
        outputs=outputs,
        method=options.method,
        segment=options.segment,
        window=window,
        band=options.band,
    )
    results: list[Any] = [responses]
    try:
        results.append(jb.modal.identify_modes(responses, order=options.order))
    finally:
        for result in results:
            print(_text(result, None))
        if options.out is not None:
            drawn = results[0] if options.draw == "responses" else results[-1]
            save(Outcome(results, drawn.plot), options.out, "SI")
            print(f"saved {options.out}")
    return 0


def _text(result: Any, units: Any) -> str:
    """Return a remark, a table or a result as text in these units."""
    from jaxbody.core.tables import PrintedTable, tables_in, text

    if isinstance(result, str):
        return text_in(result, unit_words(units))
    if isinstance(result, PrintedTable):
        return text(*tables_in([result], units)) + "\n"
    return result.summary(units=units) + "\n"


def _on_file(options: argparse.Namespace) -> int:
    """Read the file, run the command, print its tables, and save them or a picture."""
    command = COMMANDS[options.command]
    _check_out(options.out, command.formats)
    document = read_document(options.file, options.largest)
    for stated in options.set:
        set_value(document, stated)
    values = checked_values(document)
    _prepare(options)
    import numpy as np

    from jaxbody.files.studies.study_files import study_of

    study = study_of(
        document, values, options.file.parent, options.allow, measured=command.measured
    )
    options.words = unit_words(study.printed_units)
    outcome = command.run(study, options)
    for result in outcome.results:
        print(_text(result, study.printed_units))
    if options.out is not None and not outcome.saved:
        from jaxbody.app.saved_results import save

        save(outcome, options.out, study.printed_units)
        print(f"saved {options.out}")
    ok = all(np.all(getattr(result, "ok", True)) for result in outcome.results)
    if outcome.space is not None and options.write:
        if ok:
            from jaxbody.app.file_updates import update

            left = update(options.file, document, outcome.space, outcome.trees)
            print(f"wrote {options.file}" + (f"; not in it: {', '.join(left)}" if left else ""))
        else:
            print(f"{options.file} stays as it was, as the status is not ok")
    return 0 if ok else 1
