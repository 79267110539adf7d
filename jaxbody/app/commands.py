"""The command `jaxbody`: a model file on one line. Arguments and the file are checked before JAX is imported.

Exit codes: 0, done; 1, done, but the result has another status than ok; 2, the arguments or the file are not valid.
"""

from __future__ import annotations

import argparse
import sys
import warnings
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jaxbody as jb
from jaxbody.core.errors import JaxbodyError, Problem, unknown
from jaxbody.files.changes import set_value
from jaxbody.files.documents import Document, read_document
from jaxbody.files.schemas import checked_values

DESCRIPTION = "Differentiable rigid bodies on springs with an imposed base motion: simulation, vibration, identification and design."
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
PICTURES = (".png", ".svg", ".pdf")
QUANTITIES = {"displacement": ("Position", "Rotation"), "velocity": ("Velocity", "AngularVelocity"),
              "acceleration": ("Acceleration", "AngularAcceleration")}  # fmt: skip


@dataclass(frozen=True)
class Command:
    """A command on a model file: what it does, an example, and the function that does it and returns what is printed and drawn."""

    about: str
    example: str
    run: Callable[[Any, argparse.Namespace], Outcome]
    options: tuple[tuple[tuple[str, ...], dict[str, Any]], ...] = ()


@dataclass
class Outcome:
    """Results, which print as tables, and a function that draws them into a picture."""

    results: list[Any]
    draw: Callable[[], Any] | None = None


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; without a command, print the help."""
    parser = _parser()
    options = parser.parse_args(arguments)
    if options.command is None:
        parser.print_help()
        return 0
    own_process = arguments is None
    try:
        return options.run(options, own_process)
    except JaxbodyError as error:
        print(f"jaxbody {options.command}: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        return 130


def _parser() -> argparse.ArgumentParser:
    form = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(prog="jaxbody", description=DESCRIPTION, epilog=EPILOG, formatter_class=form)
    parser.add_argument("--version", action="version", version=f"jaxbody {jb.__version__}")
    commands = parser.add_subparsers(dest="command", title="commands", metavar="command")
    new = commands.add_parser(
        "new", help="print the file of a ready model", epilog="example:\n  jaxbody new quarter_car > car.toml", formatter_class=form
    )
    new.add_argument("model", nargs="?", help="name of a ready model; without it, their names are printed")
    new.set_defaults(run=_new)
    for name, command in COMMANDS.items():
        epilog = f"example:\n  {command.example}"
        sub = commands.add_parser(
            name, help=command.about, description=command.about.capitalize() + ".", epilog=epilog, formatter_class=form
        )
        sub.add_argument("file", type=Path, help="model file, .toml or .json")
        sub.add_argument("--set", action="append", default=[], metavar="PATH=VALUE", help='another value, such as left.stiffness="30 N/mm"')
        sub.add_argument("--allow", action="append", default=[], metavar="MODULE", help="module of yours whose classes the file may use")
        sub.add_argument("--out", type=Path, metavar="FILE", help="save the tables as .csv, or a picture as .png, .svg or .pdf")
        for flags, more in command.options:
            sub.add_argument(*flags, **more)
        sub.set_defaults(run=_on_file)
    demo = commands.add_parser("demo", help="a plate on three springs and a shaking base, from the drawing to fitted stiffnesses")
    demo.add_argument("--out", type=Path, default=Path("jaxbody-demo"), help="folder for the figures (default: ./jaxbody-demo)")
    demo.add_argument("--seed", type=int, default=0, help="seed of the measurement noise (default: 0)")
    demo.set_defaults(run=_demo)
    return parser


def _demo(options: argparse.Namespace, own_process: bool) -> int:
    from jaxbody.app import demos

    if own_process:
        _prepare()
    with ThreadPoolExecutor(max_workers=1) as executor:
        return demos.run(options.out, options.seed, executor)


def _prepare() -> None:
    """Fast loops, programs kept for the next run, warnings without lines of code."""
    warnings.showwarning = lambda message, *_, **__: print(f"warning: {message}", file=sys.stderr)
    jb.fast_loops()
    try:
        jb.keep_programs()
    except JaxbodyError as error:
        print(f"Programs are not kept for the next run: {error}", file=sys.stderr)


def _new(options: argparse.Namespace, own_process: bool) -> int:
    ready = [name for name in dir(jb.presets) if name[0] != "_"]
    if options.model is None:
        print("Ready models: " + ", ".join(ready))
        return 0
    chosen = [name for name in ready if name.startswith(options.model)]
    if len(chosen) != 1:
        raise JaxbodyError(unknown(options.model, "new", tuple(ready)))
    _use_x64()
    from jaxbody.files.writers import toml_of, values_of

    print(toml_of(values_of(getattr(jb.presets, chosen[0])()), units=True), end="")
    return 0


def _on_file(options: argparse.Namespace, own_process: bool) -> int:
    """Read the file, run the command, print its tables, save them or a picture."""
    if options.out is not None and options.out.suffix not in (".csv", *PICTURES):
        raise JaxbodyError(Problem("UNKNOWN_FORMAT", "--out", f"is {options.out}", options.out, ".csv " + " ".join(PICTURES)))
    document = read_document(options.file)
    for text in options.set:
        set_value(document, text)
    values = checked_values(document)
    _use_x64()
    if own_process:
        _prepare()
    outcome = COMMANDS[options.command].run(_model(document, values, options), options)
    for result in outcome.results:
        print(result)
    if options.out is not None:
        _save(outcome, options.out)
    return 0 if all(bool(getattr(result, "ok", True)) for result in outcome.results) else 1


def _model(document: Document, values: dict[str, Any], options: argparse.Namespace) -> Any:
    from jaxbody.files.builders import Builder

    return Builder(document, values, options.file.parent, options.allow).model()


def _use_x64() -> None:
    import jax

    jax.config.update("jax_enable_x64", True)


def _save(outcome: Outcome, path: Path) -> None:
    """Save the tables as text, or the picture."""
    from jaxbody.core.tables import in_numpy

    try:
        if path.suffix == ".csv":
            tables = [table for result in outcome.results if hasattr(result, "_tables") for table in in_numpy(result)._tables()]
            path.write_text("\n".join(_csv(table) for table in tables), encoding="utf-8")
        elif outcome.draw is None:
            raise JaxbodyError(Problem("UNKNOWN_FORMAT", "--out", "is a picture, which this command does not draw", path, ".csv"))
        else:
            outcome.draw().figure.savefig(path, dpi=130)
    except OSError as error:
        raise JaxbodyError(Problem("NOT_SAVED", str(path), f"cannot be written: {error.strerror}", path)) from None
    print(f"saved {path}")


def _csv(table: Any) -> str:
    """A table as lines of comma-separated values, with its title and note as comments."""
    import csv
    import io

    lines = io.StringIO()
    rows = csv.writer(lines, lineterminator="\n")
    for comment in (table.title, table.note):
        lines.write(f"# {comment}\n" if comment else "")
    rows.writerow(table.columns)
    rows.writerows(table.rows)
    return lines.getvalue()


# Commands


def _check(model: Any, options: argparse.Namespace) -> Outcome:
    counts = {"body": len(model.layout.bodies), "support": len(model.layout.supports), "element": len(model.element_names)}
    plural = {"body": "bodies", "support": "supports", "element": "elements"}
    said = ", ".join(f"{n} {name if n == 1 else plural[name]}" for name, n in counts.items())
    return Outcome([f"{options.file.name}: {said}, {model.layout.nv} degrees of freedom; no errors"])


def _show(model: Any, options: argparse.Namespace) -> Outcome:
    return Outcome([model], lambda: jb.plots.draw_model(model))


def _equilibrium(model: Any, options: argparse.Namespace) -> Outcome:
    equilibrium = jb.equilibrium(model)
    return Outcome([equilibrium], lambda: jb.plots.draw_model(model, equilibrium.state))


def _modes(model: Any, options: argparse.Namespace) -> Outcome:
    lin = jb.linearize(model, jb.equilibrium(model))
    if options.damped:
        modes: Any = jb.complex_modes(lin)
        return Outcome([modes], lambda: jb.plots.draw_mode(lin, modes, options.draw))
    modes = jb.modes(lin)
    return Outcome([modes, *([jb.mode_energies(lin)] if options.energies else [])], lambda: jb.plots.draw_mode(lin, modes, options.draw))


def _response(model: Any, options: argparse.Namespace) -> Outcome:
    import numpy as np

    lin = jb.linearize(model, jb.equilibrium(model))
    low, high = options.frequencies
    inputs = {text: jb.BaseMotion(*_place(text, "--input"), kind=options.kind) for text in options.input}
    outputs = {text: _sensor(text, options.quantity, model.element_names) for text in options.output}
    response = jb.frequency_response(lin, np.geomspace(low, high, options.points), inputs, outputs)
    return Outcome([response], lambda: jb.plots.plot_frequency_response(response))


def _place(text: str, where: str) -> tuple[str, str]:
    """A name and a direction of "road.z"."""
    name, _, direction = text.rpartition(".")
    if not name:
        raise JaxbodyError(Problem("BAD_DIRECTION", where, f"is '{text}'", text, "a name and a direction, such as road.z"))
    return name, direction


def _sensor(text: str, quantity: str, elements: tuple[str, ...]) -> Any:
    """What "car.z" or the name of an element measures."""
    name, direction = (text, "") if text in elements else _place(text, "--output")
    line, turn = QUANTITIES[quantity]
    sensor: Any = getattr(jb, "Elongation" if not direction else turn if direction[0] == "r" else line)
    return sensor(name, axis=[float(direction[-1] == axis) for axis in "xyz"]) if direction else sensor(name)


def _band(text: str) -> tuple[float, float]:
    low, _, high = text.partition(":")
    if not 0 < float(low) < float(high):
        raise ValueError
    return float(low), float(high)


_band.__name__ = "two frequencies in ascending order, 0.5:20,"  # in messages of argparse
COMMANDS = {
    "check": Command("check a model file", "jaxbody check engine.toml", _check),
    "show": Command("print and draw a model", "jaxbody show engine.toml --out engine.png", _show),
    "equilibrium": Command("the static equilibrium", "jaxbody equilibrium engine.toml --set 'gravity=0, 0, -9.81 m/s2'", _equilibrium),
    "modes": Command(
        "natural frequencies and modes about the equilibrium",
        "jaxbody modes engine.toml --energies --out modes.csv",
        _modes,
        (
            (("--damped",), {"action": "store_true", "help": "complex modes, with their damping ratios"}),
            (("--energies",), {"action": "store_true", "help": "the shares of the energy of each mode"}),
            (("--draw",), {"type": int, "default": 1, "metavar": "N", "help": "the mode that --out draws (default: 1)"}),
        ),
    ),
    "response": Command(
        "the response to a harmonic motion of supports",
        "jaxbody response car.toml --input road.z --output body.z --frequencies 0.5:20 --out response.png",
        _response,
        (
            (("--input",), {"action": "append", "required": True, "metavar": "SUPPORT.z", "help": "support and x, y, z, rx, ry or rz"}),
            (("--output",), {"action": "append", "required": True, "metavar": "BODY.z", "help": "body and direction, or an element"}),
            (("--frequencies",), {"type": _band, "default": (0.1, 50.0), "metavar": "LOW:HIGH", "help": "[Hz] (default: 0.1:50)"}),
            (("--points",), {"type": int, "default": 400, "metavar": "N", "help": "number of frequencies (default: 400)"}),
            (("--kind",), {"choices": list(QUANTITIES), "default": "displacement", "help": "of the input (default: displacement)"}),
            (("--quantity",), {"choices": list(QUANTITIES), "default": "displacement", "help": "of the output (default: displacement)"}),
        ),
    ),
}  # fmt: skip
