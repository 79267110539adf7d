"""The command on model files: the examples of its help, results as in Python, messages and exit codes."""

import contextlib
import importlib.util
import io
import re
import shlex
import subprocess
import sys

import numpy as np
import pytest

import jaxbody as jb
from jaxbody.app import commands

NAMES = list(commands.COMMANDS)


DESIGN = """
[sensors.seat]
type = "Acceleration"
on = "body"
axis = "z"
[sensors.travel]
type = "Elongation"
on = "suspension"
[designs.ride]
free = ["suspension.stiffness", "suspension.damping"]
minimize = "comfort"
limits = {travel = ["-inf", "50 mm"], bounce = ["0.8 Hz", "2 Hz"]}
bounds = {"suspension.damping" = ["0.1 N s/mm", "9 N s/mm"], "suspension.stiffness" = ["5 N/mm", "90 N/mm"]}
roads.road = {class = "C", speed = "72 km/h"}
[designs.ride.quantities]
comfort = {type = "comfort", weights = {seat = "Wk"}}
travel = {type = "stroke", sensor = "travel"}
bounce = {type = "frequency", mode = 1}
"""


@pytest.fixture(scope="module")
def record():
    """A text file of the motion of a quarter car with a softer suspension on a road, with noise of 0.1 mm."""
    times = np.arange(100) / 50
    base = np.stack([0 * times, 0 * times, 0.01 * (1 - np.cos(2 * np.pi * times))], 1)
    car = jb.replace(jb.presets.quarter_car(), {"suspension.stiffness": 30000.0, "suspension.damping": 1500.0})
    run = jb.simulate(car, times, motion={"road": jb.Sampled(times, translation=base)}, initial="rest")
    z = np.asarray(run.poses["body"].p)[:, 2] + np.random.default_rng(0).normal(0, 1e-4, 100)
    rows = [",".join(map(repr, row)) for row in np.stack([times, 1000 * z, 1000 * base[:, 2]], 1).tolist()]
    return "\n".join(["t [s],z [mm],base [mm]", *rows])


@pytest.fixture(scope="module")
def texts():
    """The files of two ready models, and of a car with a record, an experiment and a design."""
    printed = {}
    for name in ("engine", "quarter_car"):
        with contextlib.redirect_stdout(io.StringIO()) as out:
            assert commands.main(["new", name]) == 0
        printed[name] = out.getvalue()
    text = printed["quarter_car"]
    comment = text.index("# to fit it")
    measured = text[:comment] + re.sub("^# (?!to fit)", "", text[comment:], flags=re.M)
    measured = measured.replace("[elements.suspension]", "[elements.suspension]\ndamping = 1500.0") + DESIGN
    return {"engine.toml": printed["engine"], "car.toml": text, "measured.toml": measured}


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch, texts, record):
    monkeypatch.chdir(tmp_path)
    for name, text in (texts | {"run1.csv": record}).items():
        (tmp_path / name).write_text(text)
    return tmp_path


@pytest.mark.parametrize("name", NAMES)
def test_the_example_of_each_command_runs(name, capsys, folder):
    _, *words = shlex.split(commands.COMMANDS[name].example)
    assert words[0] == name and commands.main(words) == 0
    said = capsys.readouterr()
    assert said.out and not said.err
    if "--out" in words:
        assert (folder / words[-1]).stat().st_size > 100
    with pytest.raises(SystemExit):
        commands.main([name, "--help"])
    assert commands.COMMANDS[name].example in capsys.readouterr().out


@pytest.mark.parametrize("name", dir(jb.presets))
def test_every_ready_model_is_printed_and_read_again(name, capsys, folder):
    assert commands.main(["new", name]) == 0
    (folder / "model.toml").write_text(capsys.readouterr().out)
    model, again = getattr(jb.presets, name)(), jb.read_model("model.toml")
    assert jb.paths(model).keys() == jb.paths(again).keys()
    assert all(np.array_equal(x, jb.paths(again)[path]) for path, x in jb.paths(model).items())
    assert commands.main(["check", "model.toml"]) == 0 and "no errors" in capsys.readouterr().out


def test_new_without_a_name_lists_the_ready_models(capsys):
    assert commands.main(["new"]) == 0
    assert set(dir(jb.presets)) == set(re.findall(r"\w+", capsys.readouterr().out.partition(":")[2]))
    assert commands.main(["new", "quarter_cat"]) == 2
    assert "Did you mean 'quarter_car'?" in capsys.readouterr().err


def test_a_fit_is_that_of_python_and_is_written_into_the_file(capsys, folder):
    before = (folder / "measured.toml").read_text()
    assert commands.main(["fit", "measured.toml", "--free", "suspension.stiffness", "--write", "--out", "fit.csv"]) == 0
    said = capsys.readouterr().out
    (folder / "before.toml").write_text(before)
    study = jb.read_study("before.toml")
    fit = jb.fit(study.model, study.experiments, free="suspension.stiffness")
    assert str(fit) in said and "wrote measured.toml" in said
    estimate = float(fit.estimates["suspension.stiffness"])
    assert abs(estimate / 30000 - 1) < 0.01  # noise of 0.1 mm in motions of 10 mm
    changed = [(a, b) for a, b in zip(before.splitlines(), (folder / "measured.toml").read_text().splitlines(), strict=True) if a != b]
    assert changed == [("stiffness = 35000.0 # N/m", f"stiffness = {estimate!r} # N/m")]
    assert "suspension.stiffness" in (folder / "fit.csv").read_text()


@pytest.mark.parametrize(
    "words, column, label",
    [
        (["modes", "car.toml"], "frequency", "mode"),
        (["modes", "car.toml", "--damped"], "decay_rate", "mode"),
        (["response", "car.toml", "--input", "road.z", "--output", "body.z", "--points", "9"], "body.z / road.z [1]", "frequency [Hz]"),
        (["load-cases", "car.toml", "--case", "bump=0,0,3"], "load_factor", "case"),
        (["simulate", "car.toml", "--duration", "0.1"], "body z [m]", "time [s]"),
    ],
)
def test_numbers_are_saved_as_parquet_and_netcdf(words, column, label, capsys, folder):
    pandas, xarray = pytest.importorskip("pandas"), pytest.importorskip("xarray")
    assert commands.main([*words, "--out", "numbers.csv"]) == 0
    assert commands.main([*words, "--out", "numbers.nc"]) == 0
    data = xarray.open_dataset("numbers.nc", engine="scipy")
    read = np.asarray(data[column.replace("/", " per ")])
    assert read.size and label in data[column.replace("/", " per ")].dims
    if importlib.util.find_spec("pyarrow"):
        assert commands.main([*words, "--out", "numbers.parquet"]) == 0
        np.testing.assert_array_equal(pandas.read_parquet("numbers.parquet")[column], read)
    else:
        assert commands.main([*words, "--out", "numbers.parquet"]) == 2 and "MISSING_EXTRA" in capsys.readouterr().err
    if "[" in label:
        head, *rows = [row.split(",") for row in (folder / "numbers.csv").read_text().splitlines()]
        np.testing.assert_array_equal(np.array(rows, float)[:, head.index(column)], read)


def test_a_fit_without_data_or_parameters_says_both(capsys, folder):
    assert commands.main(["fit", "car.toml"]) == 2
    said = capsys.readouterr().err
    assert "has no experiments" in said and "does not say what is free" in said


def test_a_design_is_that_of_python_and_is_written_into_the_file(capsys, folder):
    car = jb.read_model("measured.toml")

    def drive(car):
        lin = jb.linearize(car, jb.equilibrium(car))
        outputs = {"seat": jb.Acceleration("body", axis="z"), "travel": jb.Elongation("suspension")}
        spectra = {"road": jb.Unevenness.iso("C").at_speed(20.0)}
        ride = jb.random_response(lin, jb.Band(0.1, 100.0), {"road": jb.BaseMotion("road", "z")}, outputs, spectra)
        comfort, travel = jb.objectives.comfort(ride, {"seat": "Wk"}), jb.objectives.stroke(ride, "travel")
        return {"comfort": comfort, "travel": travel, "bounce": jb.modes(lin).frequency[0]}

    free = ["suspension.stiffness", "suspension.damping"]
    bounds = {"suspension.damping": (100.0, 9000.0), "suspension.stiffness": (5e3, 9e4)}
    limits = {"travel": (None, 0.05), "bounce": (0.8, 2.0)}
    expected = jb.tune(car, drive, free=free, minimize="comfort", limits=limits, bounds=bounds)
    assert commands.main(["tune", "measured.toml", "--write"]) == 0
    assert "wrote measured.toml" in capsys.readouterr().out
    tuned = jb.paths(jb.read_model("measured.toml"))
    for path in free:
        np.testing.assert_allclose(tuned[path], expected.values[path], rtol=1e-6)  # of the search
    assert abs(float(expected.after["comfort"]) - float(expected.before["comfort"])) > 0.1


def test_readings_of_sensors_are_saved_with_a_motion(capsys, folder):
    assert commands.main(["simulate", "measured.toml", "--duration", "0.1", "--out", "motion.csv"]) == 0
    head, *rows = (folder / "motion.csv").read_text().splitlines()
    columns = dict(zip(head.split(","), np.array([row.split(",") for row in rows], float).T, strict=True))
    assert len(rows) == 11 and np.array_equal(columns["height [m]"], columns["body z [m]"])


def test_the_numbers_are_those_of_python(capsys, folder):
    assert commands.main(["modes", "car.toml", "--set", "suspension.stiffness=30 N/mm", "--out", "modes.csv"]) == 0
    model = jb.replace(jb.presets.quarter_car(), {"suspension.stiffness": 3e4})
    modes = jb.modes(jb.linearize(model, jb.equilibrium(model)))
    assert str(modes) in capsys.readouterr().out
    rows = [line.split(",") for line in (folder / "modes.csv").read_text().splitlines() if line[0] != "#"]
    column = rows[0].index("frequency [Hz]")
    np.testing.assert_allclose([float(row[column]) for row in rows[1:]], modes.frequency, rtol=1e-12)


def test_the_motion_is_that_of_python(folder):
    """From rest on the road, which is at its highest at the start."""
    words = "simulate car.toml --duration 0.5 --interval 0.05 --set 'motion.road.frequency=2 Hz' --out motion.csv"
    assert commands.main(shlex.split(words)) == 0
    road = {"road": jb.Harmonic(frequency=2.0, translation=[0, 0, 0.005])}
    expected = jb.simulate(jb.presets.quarter_car(), np.linspace(0, 0.5, 11), motion=road, initial="rest")
    table = np.genfromtxt(folder / "motion.csv", delimiter=",", comments="#", names=True, deletechars="")
    np.testing.assert_allclose(table["body_z_[m]"], expected.poses["body"].p[:, 2], rtol=1e-12)
    np.testing.assert_allclose(table["road_z_[m]"], 0.005 * np.cos(4 * np.pi * table["time_[s]"]), atol=1e-15)
    np.testing.assert_allclose(table["force_of_tyre_[N]"], expected.forces["tyre"], rtol=1e-9)


def test_the_response_is_that_of_python(folder):
    words = "response car.toml --input road.z --output body.z --frequencies 1:10 --points 5 --quantity acceleration --out response.csv"
    assert commands.main(words.split()) == 0
    car = jb.presets.quarter_car()
    ports = {"road": jb.BaseMotion("road", "z")}, {"body": jb.Acceleration("body", axis="z")}
    f = np.geomspace(1, 10, 5)
    expected = jb.frequency_response(jb.linearize(car, jb.equilibrium(car)), f, *ports)["body", "road"]
    table = np.loadtxt(folder / "response.csv", delimiter=",", skiprows=1)
    np.testing.assert_allclose(table[:, 0], f, rtol=1e-15)
    np.testing.assert_allclose(table[:, 1] * np.exp(1j * table[:, 2]), expected, rtol=1e-12)


def test_the_random_response_and_load_cases_are_those_of_python(capsys, folder):
    damped = ["--set", "suspension.damping=1500"]
    words = "random car.toml --input road.z --output body.z --quantity acceleration --frequencies 0.2:40 --speed 15 --out psd.csv"
    assert commands.main([*words.split(), *damped]) == 0
    car = jb.presets.quarter_car(damping=1500.0)
    lin = jb.linearize(car, jb.equilibrium(car))
    ports = {"road.z": jb.BaseMotion("road", "z")}, {"body.z": jb.Acceleration("body", axis="z")}
    expected = jb.random_response(lin, jb.Band(0.2, 40.0), *ports, {"road.z": jb.Unevenness.iso("C").at_speed(15.0)})
    assert str(expected) in capsys.readouterr().out
    table = np.loadtxt(folder / "psd.csv", delimiter=",", skiprows=1)
    np.testing.assert_allclose(table, np.stack([expected.frequencies, expected.psd[0]], 1), rtol=1e-9)
    assert commands.main(["load-cases", "car.toml", *damped, "--case", "bump=0,0,2"]) == 0
    assert str(jb.load_cases(car, {"bump": jb.LoadCase(acceleration=[0, 0, 2])})) in capsys.readouterr().out
    for wrong in ("bump", "bump=1,2", "=1,2,3", "bump=x,0,0"):
        with pytest.raises(SystemExit):
            commands.main(["load-cases", "car.toml", "--case", wrong])
        assert "name and three numbers" in capsys.readouterr().err


def test_values_are_set_by_name_and_pattern(capsys):
    assert commands.main(["show", "car.toml", "--set", "*.stiffness=30 kN/m", "--set", "body.mass=300", "--set", "gravity=[0, 0, 0]"]) == 0
    shown = capsys.readouterr().out
    assert shown.count(" 30000 ") == 2 and " 300 " in shown


@pytest.mark.parametrize(
    "words, message",
    [
        ("check missing.toml", "missing.toml: cannot be read"),
        ("check car.toml --set bodi.mass=3", "bodi.mass=3: 'bodi.mass' is unknown. Did you mean 'body.mass'?"),
        ("check car.toml --set 'body.mass=3 m'", "car.toml with body.mass=3 m: is '3 m', in m (allowed: a unit such as kg)"),
        ("check car.toml --set body.mass=-3", "car.toml with body.mass=-3: is -3 kg (allowed: > 0)"),
        ("check car.toml --set body.weight=3", "car.toml with body.weight=3: 'weight' is unknown"),
        ("check car.toml --set motion.table.frequency=2", "names nothing that has entries"),
        ("check car.toml --set motion.road.frequency='2 m'", "is '2 m', in m (allowed: a unit such as 1/s)"),
        ("check car.toml --set car", "car: is not a path and a value"),
        ("check car.toml --set body.mass.x=3", "body.mass.x=3: names nothing that has entries"),
        ("modes car.toml --out modes.xls", "--out: is modes.xls (allowed: .csv .parquet .nc .png .svg .pdf)"),
        ("check car.toml --out car.png", "--out: is a picture, which this command does not draw"),
        ("show car.toml --out none/car.png", "none/car.png: cannot be written"),
        ("response car.toml --input z --output body.z", "--input: is 'z' (allowed: a name and a direction, such as road.z)"),
        ("response car.toml --input road.z --output cat.z", "'cat' is unknown"),
    ],
)
def test_what_is_wrong_is_said_without_a_traceback(words, message, capsys):
    assert commands.main(shlex.split(words)) == 2
    said = capsys.readouterr()
    assert said.err.startswith(f"jaxbody {words.split()[0]}: ") and message in said.err and "Traceback" not in said.err


def test_frequencies_are_in_order(capsys):
    for wrong in ("20:1", "0:1", "x", "1"):
        with pytest.raises(SystemExit) as stopped:
            commands.main(["response", "car.toml", "--input", "road.z", "--output", "body.z", "--frequencies", wrong])
        assert stopped.value.code == 2 and "two frequencies in ascending order" in capsys.readouterr().err


@pytest.mark.filterwarnings("ignore::jaxbody.JaxbodyWarning")
def test_a_result_that_is_not_ok_is_told_by_the_exit_code(capsys):
    """A car without springs falls."""
    assert commands.main(["equilibrium", "car.toml", "--set", "*.stiffness=0", "--set", "*.free_length=0"]) == 1
    assert "ok" not in capsys.readouterr().out.splitlines()[1]


@pytest.mark.everywhere
def test_a_file_with_an_error_is_refused_before_JAX_is_imported(folder):
    text = (folder / "car.toml").read_text()
    (folder / "car.toml").write_text(text.replace("\nmass", "\nweight", 1))
    code = (
        "import sys; from jaxbody.app.commands import main; code = main(['modes', 'car.toml'])\n"
        "print(code, 'jax' in sys.modules, 'numpy' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["2", "False", "False"] and "car.toml:" in done.stderr
