"""The command on model files: the examples of its help, results as in Python, messages and
exit codes."""

import contextlib
import csv
import io
import json
import os
import re
import shlex
import subprocess
import sys

import numpy as np
import pytest

import jaxbody as jb
from jaxbody.app import commands
from jaxbody.files.model_files import toml_of, values_of

NAMES = list(commands.COMMANDS)

STUDY = """
[motion]
road = {type = "Harmonic", frequency = "1.5 Hz", translation = "0, 0, 5 mm"}

[sensors]
reading = {type = "Position", on = "body", axis = "z"}

[designs.first]
free = ["suspension.stiffness"]
minimize = "bounce"
limits = {sag = ["-120 mm", inf]}        # lower and upper
bounds = {"suspension.stiffness" = ["10 N/mm", "90 N/mm"]}
[designs.first.quantities]
bounce = {type = "frequency", mode = 1}
sag = {type = "deflection", on = "suspension"}  # negative in compression

# [records.run1]
# file = "run1.csv"
# time = "t"
# channels = {reading = "x", base = "base"}
# [experiments.run1]
# record = "run1"                        # a channel is read by the sensor of the same name
# initial = "rest"
# motion.road = {type = "Sampled", record = "run1", translation = "base", axis = "z"}
# [experiments.modal]
# type = "MeasuredModes"
# frequency = "1.41, 8.8 Hz"
# noise = {frequency = "0.02 Hz"}
# [fit]
# free = ["suspension.stiffness"]
"""
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
"""  # noqa: E501


@pytest.fixture(scope="module")
def record():
    """A text file of the motion of a quarter car with a softer suspension on a road, with noise
    of 0.1 mm."""
    times = np.arange(100) / 50
    base = np.stack([0 * times, 0 * times, 0.01 * (1 - np.cos(2 * np.pi * times))], 1)
    car = jb.replace(
        jb.presets.quarter_car(), {"suspension.stiffness": 30000.0, "suspension.damping": 1500.0}
    )
    run = jb.simulate(
        car, times, motion={"road": jb.Sampled(times, translation=base)}, initial="rest"
    )
    z = np.asarray(run.poses["body"].p)[:, 2] + np.random.default_rng(0).normal(0, 1e-4, 100)
    rows = [
        ",".join(map(repr, row))
        for row in np.stack([times, 1000 * z, 1000 * base[:, 2]], 1).tolist()
    ]
    return "\n".join(["t [s],x [mm],base [mm]", *rows])


def uncommented(text, without="nothing"):
    """The text of a new file with its measured data, but for one section."""
    start = text.index("\n# [records.run1]")
    sections = [
        "[" + section for section in re.sub("^# ", "", text[start:], flags=re.M).split("\n[")[1:]
    ]
    return "\n".join(
        [text[:start], *(section for section in sections if not section.startswith(without))]
    )


@pytest.fixture(scope="module")
def texts():
    """The files of an engine and a car, and the car with a record, an experiment and a design."""
    with contextlib.redirect_stdout(io.StringIO()) as out:
        assert commands.main(["new", "engine"]) == 0
    text = toml_of(values_of(jb.presets.quarter_car()), units=True) + STUDY
    measured = uncommented(text, without="[experiments.modal]")
    measured = (
        measured.replace("[elements.suspension]", "[elements.suspension]\ndamping = 1500.0")
        + DESIGN
    )
    return {"engine.toml": out.getvalue(), "car.toml": text, "measured.toml": measured}


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch, texts, record):
    monkeypatch.chdir(tmp_path)
    for name, text in (texts | {"run1.csv": record}).items():
        (tmp_path / name).write_text(text)
    return tmp_path


@pytest.mark.long
@pytest.mark.filterwarnings("ignore::jaxbody.JaxbodyWarning")  # of a record of a softer car
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


SHEET = """name; a; b; x [mm]; y [mm]; z [mm]; kx [N/mm]; ky [N/mm]; kz [N/mm]; rz [deg]; cz [N s/mm]; krx; kry; krz
left; engine; frame; 1100; 250; 500; 200; 210; 400; 45; 0.5; 30 N m/deg; 0; 0
right; engine; frame; 1100; -250; 50 cm; 200; 210; 400; ; 0.5; 0; 0; 0
rear; engine; sub frame; 700; 0; 400; 100; 100; 150; ; 0.5; 0; 0; 0
link; sub frame; world; 700; 0; 400; 900; 900; 900; ; 0.5; 90 kN m/rad; 90 kN m/rad; 90 kN m/rad
"""  # noqa: E501


@pytest.mark.long
def test_a_data_sheet_of_mounts_becomes_a_file(capsys, folder):
    """The mounts are those that Python reads, with points in the axes of the sheet, and their
    numbers can be set; the masses are marked as placeholders in each line, and said to be."""
    (folder / "mounts.csv").write_text(SHEET)
    assert commands.main(["new", "--mounts", "mounts.csv"]) == 0
    said = capsys.readouterr()
    assert (
        "not in mounts.csv: replace the placeholders" in said.err
        and said.out.count(": a placeholder") == 6
        and "-0.0]" not in said.out
    )
    (folder / "mounts.toml").write_text(said.out)
    assert (
        commands.main(["check", "mounts.toml"]) == 0
        and "2 bodies, 1 support, 4 elements, 2 sensors" in capsys.readouterr().out
    )
    model = jb.read_model("mounts.toml")
    frames = {"engine": model["engine"], "frame": model["frame"], "sub frame": model["sub frame"]}
    for name, mount in jb.files.read_mounts("mounts.csv", frames).items():
        assert model[name].between == mount.between
        for field in ("a", "b", "stiffness", "damping", "orientation", "orientation_b"):
            np.testing.assert_array_equal(getattr(model[name], field), getattr(mount, field))
    assert model["right"].a.tolist() == [1.1, -0.25, 0.5]
    words = [
        "modes",
        "mounts.toml",
        "--set",
        "engine.mass=180 kg",
        "--set",
        "engine.com=1, 0, 0.6 m",
        "--set",
        "rear.stiffness=90, 90, 90 N/mm",
    ]
    assert commands.main(words) == 0 and "engine" in capsys.readouterr().out
    (folder / "mounts.csv").write_text(
        SHEET.replace("kx [N/mm]", "kx [mm]").replace("right;", "left;")
    )
    assert commands.main(["new", "--mounts", "mounts.csv"]) == 2
    said = capsys.readouterr()
    assert (
        not said.out
        and "mounts.csv:2 kx: is '200 mm', in m" in said.err
        and "mounts.csv:3: 'left' is the name of a mount above" in said.err
    )


def test_a_data_sheet_without_names_of_bodies_is_of_an_engine_on_a_frame(capsys, folder):
    (folder / "mounts.csv").write_text(
        "name,x [mm],y [mm],z [mm],kx [N/mm],ky [N/mm],kz [N/mm]\nm,0,0,10,1,2,3\n"
    )
    assert commands.main(["new", "--mounts", "mounts.csv"]) == 0
    (folder / "mounts.toml").write_text(capsys.readouterr().out)
    assert jb.read_model("mounts.toml")["m"].between == ("engine", "frame")


@pytest.mark.long
def test_a_fit_is_that_of_python_and_is_written_into_the_file(capsys, folder):
    before = (folder / "measured.toml").read_text()
    assert (
        commands.main(
            [
                "fit",
                "measured.toml",
                "--free",
                "suspension.stiffness",
                "--write",
                "--out",
                "fit.csv",
            ]
        )
        == 0
    )
    said = capsys.readouterr().out
    (folder / "before.toml").write_text(before)
    study = jb.read_study("before.toml")
    fit = jb.fit(study.model, study.experiments, free="suspension.stiffness")
    assert fit.summary(units="SI") in said and "wrote measured.toml" in said
    estimate = float(fit.estimates["suspension.stiffness"])
    assert abs(estimate / 30000 - 1) < 0.01  # noise of 0.1 mm in motions of 10 mm
    changed = [
        (a, b)
        for a, b in zip(
            before.splitlines(), (folder / "measured.toml").read_text().splitlines(), strict=True
        )
        if a != b
    ]
    assert changed == [("stiffness = 35000.0 # N/m", f"stiffness = {estimate!r} # N/m")]
    assert "suspension.stiffness" in (folder / "fit.csv").read_text()


def test_a_fit_without_data_or_parameters_says_both(capsys, folder):
    assert commands.main(["fit", "car.toml"]) == 2
    said = capsys.readouterr().err
    assert "has no experiments" in said and "does not say what is free" in said


def held_out(text):
    """The text of a file with a second experiment, the second half of the record from a free start,
    which is held out."""
    return (
        text
        + """
[records.run2]
file = "run1.csv"
time = "t"
channels = {reading = "x", base = "base"}
part = "0.4, 1.6 s"
[experiments.run2]
record = "run2"
validate = true
initial = "rest"
motion.road = {type = "Sampled", record = "run2", translation = "base", axis = "z"}
"""
    )


@pytest.mark.long
@pytest.mark.filterwarnings("ignore::jaxbody.JaxbodyWarning")
def test_a_fit_is_validated_by_the_experiments_that_are_held_out(capsys, folder):
    """The fit is that without them; the comparison is that of `validate`, printed, saved and drawn
    in the report."""
    words = ["measured.toml", "--free", "suspension.stiffness", "--out"]
    assert commands.main(["fit", *words, "fit.csv"]) == 0
    alone = capsys.readouterr().out.replace("saved fit.csv\n", "")
    (folder / "measured.toml").write_text(held_out((folder / "measured.toml").read_text()))
    assert (
        commands.main(["check", "measured.toml"]) == 0
        and "1 experiment, 1 held-out experiment" in capsys.readouterr().out
    )
    assert commands.main(["fit", *words, "fit.csv"]) == 0
    said = capsys.readouterr().out
    study = jb.read_study("measured.toml")
    assert list(study.experiments) == ["run1"] and list(study.held_out) == ["run2"]
    validation = jb.validate(
        jb.fit(study.model, study.experiments, free="suspension.stiffness"), study.held_out
    )
    assert alone in said and validation.summary(units="SI") in said and "run2.reading" not in alone
    (row,) = [
        line
        for line in (folder / "fit.csv").read_text().splitlines()
        if line.startswith("run2.reading,")
    ]
    assert float(row.split(",")[3]) == pytest.approx(validation.rms["run2.reading"], rel=5e-4)
    assert (
        commands.main(
            [
                "report",
                "measured.toml",
                "--part",
                "fit",
                "--free",
                "suspension.stiffness",
                "--out",
                "fit.html",
            ]
        )
        == 0
    )
    text = (folder / "fit.html").read_text()
    assert (
        "<h2>Validation</h2>" in text
        and "run2, reading: measured, and predicted without a fit to it" in text
    )


def test_a_fit_needs_an_experiment_that_is_not_held_out(capsys, folder):
    text = (folder / "measured.toml").read_text()
    (folder / "measured.toml").write_text(
        text.replace('record = "run1"  ', 'validate = true\nrecord = "run1"  ')
    )
    assert commands.main(["fit", "measured.toml"]) == 2
    assert "measured.toml: has validate = true in all experiments" in capsys.readouterr().err


@pytest.mark.long
def test_a_design_is_that_of_python_and_is_written_into_the_file(capsys, folder):
    car = jb.read_model("measured.toml")

    def drive(car):
        lin = jb.linearize(car, jb.equilibrium(car))
        outputs = {"seat": jb.Acceleration("body", axis="z"), "travel": jb.Elongation("suspension")}
        spectra = {"road": jb.vibration.RoadRoughness.iso("C").at_speed(20.0)}
        ride = jb.random_response(
            lin,
            jb.vibration.Band(0.1, 100.0),
            {"road": jb.BaseMotion("road", "z")},
            outputs,
            spectra,
        )
        comfort, travel = (
            jb.objectives.comfort(ride, {"seat": "Wk"}),
            jb.objectives.stroke(ride, "travel"),
        )
        return {"comfort": comfort, "travel": travel, "bounce": jb.modes(lin).frequency[0]}

    free = ["suspension.stiffness", "suspension.damping"]
    bounds = {"suspension.damping": (100.0, 9000.0), "suspension.stiffness": (5e3, 9e4)}
    limits = {"travel": (None, 0.05), "bounce": (0.8, 2.0)}
    expected = jb.tune(car, drive, free=free, minimize="comfort", limits=limits, bounds=bounds)
    assert commands.main(["tune", "measured.toml", "--design", "ride", "--write"]) == 0
    assert "wrote measured.toml" in capsys.readouterr().out
    tuned = jb.parameter_paths(jb.read_model("measured.toml"))
    for path in free:
        np.testing.assert_allclose(tuned[path], expected.values[path], rtol=1e-6)  # of the search
    assert abs(float(expected.after["comfort"]) - float(expected.before["comfort"])) > 0.1


@pytest.mark.long
@pytest.mark.parametrize(
    "words", ["show", "modes --mode 2", "simulate --duration 0.2", "equilibrium"]
)
def test_a_page_in_three_dimensions_is_saved(words, capsys, folder):
    pytest.importorskip("viser")
    name, *options = words.split()
    assert (
        commands.main([name, "car.toml", *options, "--out", "page.html"]) == 0
        and "saved page.html" in capsys.readouterr().out
    )
    assert "viser" in (folder / "page.html").read_text()


def test_the_package_for_pages_is_named_when_it_is_missing(capsys, monkeypatch, folder):
    monkeypatch.setitem(sys.modules, "viser", None)
    assert commands.main(["show", "car.toml", "--out", "page.html"]) == 2
    said = capsys.readouterr().err
    assert (
        "MISSING_EXTRA" in said
        and "pip install 'jaxbody[view]'" in said
        and not (folder / "page.html").exists()
    )


@pytest.mark.filterwarnings("ignore::jaxbody.JaxbodyWarning")
def test_a_motion_that_fails_keeps_what_it_had(capsys, folder):
    """Of a free body, whose orientation is not known after the failure."""
    words = "simulate engine.toml --duration 2 --max-steps 20 --out motion.csv"
    assert commands.main(words.split()) == 1
    head, first, *_, last = (folder / "motion.csv").read_text().splitlines()
    turn = head.split(",").index("rotation of engine y [deg]")
    assert np.isfinite(float(first.split(",")[turn])) and last.split(",")[turn] == "nan"


@pytest.mark.long
def test_readings_of_sensors_are_saved_with_a_motion(capsys, folder):
    assert (
        commands.main(["simulate", "measured.toml", "--duration", "0.1", "--out", "motion.csv"])
        == 0
    )
    head, *rows = (folder / "motion.csv").read_text().splitlines()
    columns = dict(
        zip(head.split(","), np.array([row.split(",") for row in rows], float).T, strict=True)
    )
    assert len(rows) == 11
    assert np.array_equal(columns["reading [m]"], columns["position of body z [m]"])


def test_the_numbers_are_those_of_python(capsys, folder):
    assert (
        commands.main(
            ["modes", "car.toml", "--set", "suspension.stiffness=30 N/mm", "--out", "modes.csv"]
        )
        == 0
    )
    model = jb.replace(jb.presets.quarter_car(), {"suspension.stiffness": 3e4})
    modes = jb.modes(jb.linearize(model, jb.equilibrium(model)))
    assert modes.summary(units="SI") in capsys.readouterr().out
    rows = [
        line.split(",")
        for line in (folder / "modes.csv").read_text().splitlines()
        if line[0] != "#"
    ]
    column = rows[0].index("frequency [Hz]")
    np.testing.assert_allclose(
        [float(row[column]) for row in rows[1:]], modes.frequency, rtol=5e-4
    )  # four digits


def test_the_motion_is_that_of_python(folder):
    """From rest on the road, which is at its highest at the start."""
    words = (
        "simulate car.toml --duration 0.5 --interval 0.05 --set 'motion.road.frequency=2 "
        "Hz' --out motion.csv"
    )
    assert commands.main(shlex.split(words)) == 0
    road = {"road": jb.Harmonic(frequency=2.0, translation=[0, 0, 0.005])}
    expected = jb.simulate(
        jb.presets.quarter_car(), np.linspace(0, 0.5, 11), motion=road, initial="rest"
    )
    table = np.genfromtxt(
        folder / "motion.csv", delimiter=",", comments="#", names=True, deletechars=""
    )
    z = np.asarray(expected.poses["body"].p[:, 2])
    span = np.ptp(z)  # four digits of the variation, as of the numbers
    np.testing.assert_allclose(table["position_of_body_z_[m]"], z, atol=1e-3 * span)
    np.testing.assert_allclose(
        table["position_of_road_z_[m]"], 0.005 * np.cos(4 * np.pi * table["time_[s]"]), rtol=5e-4
    )
    np.testing.assert_allclose(table["force_of_tyre_[N]"], expected.forces["tyre"], rtol=5e-4)
    np.testing.assert_allclose(
        table["stroke_of_suspension_[m]"], expected.elongations["suspension"], atol=1e-3 * span
    )


def test_the_response_is_that_of_python(folder):
    words = (
        "response car.toml --input road.z --output body.z --frequencies 1:10 --points 5 --quantity "
        "acceleration --out response.csv"
    )
    assert commands.main(words.split()) == 0
    car = jb.presets.quarter_car()
    ports = {"road": jb.BaseMotion("road", "z")}, {"body": jb.Acceleration("body", axis="z")}
    f = np.geomspace(1, 10, 5)
    expected = jb.frequency_response(jb.linearize(car, jb.equilibrium(car)), f, *ports)[
        "body", "road"
    ]
    table = np.loadtxt(folder / "response.csv", delimiter=",", skiprows=1)
    np.testing.assert_allclose(table[:, 0], f, rtol=1e-7)
    # four digits of size and phase [deg]
    np.testing.assert_allclose(
        table[:, 1] * np.exp(1j * np.radians(table[:, 2])), expected, rtol=3e-3
    )


@pytest.mark.long
def test_the_random_response_and_load_cases_are_those_of_python(capsys, folder):
    damped = ["--set", "suspension.damping=1500"]
    words = (
        "random car.toml --input road.z --output body.z --quantity acceleration --frequencies "
        "0.2:40 --speed 15 --out psd.csv"
    )
    assert commands.main([*words.split(), *damped]) == 0
    car = jb.presets.quarter_car(damping=1500.0)
    lin = jb.linearize(car, jb.equilibrium(car))
    ports = {"road.z": jb.BaseMotion("road", "z")}, {"body.z": jb.Acceleration("body", axis="z")}
    expected = jb.random_response(
        lin,
        jb.vibration.Band(0.2, 40.0),
        *ports,
        {"road.z": jb.vibration.RoadRoughness.iso("C").at_speed(15.0)},
    )
    assert expected.summary(units="SI") in capsys.readouterr().out
    table = np.loadtxt(folder / "psd.csv", delimiter=",", skiprows=1)
    np.testing.assert_allclose(
        table, np.stack([expected.frequencies, expected.psd[0]], 1), rtol=5e-4
    )  # four digits
    assert (
        commands.main(
            ["load-cases", "car.toml", *damped, "--case", "bump=0,0,2", "--out", "cases.csv"]
        )
        == 0
    )
    cases = jb.load_cases(car, {"bump": jb.LoadCase(acceleration=[0, 0, 2])})
    assert cases.summary(units="SI") in capsys.readouterr().out
    (row,) = csv.DictReader((folder / "cases.csv").read_text().splitlines())
    expected = {
        "displacement of body z [m]": cases.displacements["body"][0, 2],
        "stroke of tyre [m]": cases.strokes["tyre"][0],
        "force of suspension [N]": cases.forces["suspension"][0],
    }
    assert row["case"] == "bump"
    for head, value in expected.items():
        np.testing.assert_allclose(float(row[head]), value, rtol=5e-4)  # four digits
    words = ["report", "car.toml", *damped, "--part", "load-cases", "--out", "cases.html"]
    assert commands.main(words) == 2 and "--case: is missing" in capsys.readouterr().err
    assert commands.main([*words, "--case", "bump=0,0,2"]) == 0
    assert (
        "<h2>Load cases</h2>" in (folder / "cases.html").read_text()
        and "<figcaption>" in (folder / "cases.html").read_text()
    )
    for wrong in ("bump", "bump=1,2", "=1,2,3", "bump=x,0,0"):
        with pytest.raises(SystemExit):
            commands.main(["load-cases", "car.toml", "--case", wrong])
        assert "name and three numbers" in capsys.readouterr().err


def test_one_law_of_several_is_set(capsys, folder):
    words = ["show", "engine.toml", "--set", "strut.spring.0=80 N/mm"]
    assert commands.main([*words, "--set", "strut.spring.1.gap=20 mm"]) == 0
    said = capsys.readouterr().out
    assert "Linear(80 N/mm) + BumpStop(gap=20 mm, stiffness=2000 N/mm" in said
    assert commands.main([*words[:3], "strut.spring=80 N/mm"]) == 2
    assert "strut.spring.0 strut.spring.1" in capsys.readouterr().err
    assert commands.main([*words[:3], "strut.spring.2=80 N/mm"]) == 2
    assert "names nothing that has entries" in capsys.readouterr().err


def test_values_are_set_by_name_and_pattern(capsys):
    assert (
        commands.main(
            [
                "show",
                "car.toml",
                "--set",
                "*.stiffness=30 kN/m",
                "--set",
                "body.mass=300",
                "--set",
                "gravity=[0, 0, 0]",
            ]
        )
        == 0
    )
    shown = capsys.readouterr().out
    assert shown.count(" 30000 ") == 2 and " 300 " in shown


@pytest.mark.parametrize(
    "words, message",
    [
        ("check missing.toml", "missing.toml: cannot be read"),
        (
            "check car.toml --set bodi.mass=3",
            "bodi.mass=3: 'bodi.mass' is unknown. Did you mean 'body.mass'?",
        ),
        (
            "check car.toml --set 'body.mass=3 m'",
            "car.toml with body.mass=3 m: is '3 m', in m (allowed: a unit such as kg)",
        ),
        (
            "check car.toml --set body.mass=-3",
            "car.toml with body.mass=-3: is -3 kg (allowed: > 0)",
        ),
        ("check car.toml --set body.weight=3", "car.toml with body.weight=3: 'weight' is unknown"),
        ("check car.toml --set motion.table.frequency=2", "names nothing that has entries"),
        (
            "check car.toml --set motion.road.frequency='2 m'",
            "is '2 m', in m (allowed: a unit such as 1/s)",
        ),
        ("check car.toml --set car", "car: is not a path and a value"),
        ("check car.toml --set body.mass.x=3", "body.mass.x=3: names nothing that has entries"),
        (
            "modes car.toml --out modes.xls",
            "--out: is modes.xls (allowed: .csv .png .svg .pdf .html)",
        ),
        (
            "check car.toml --out car.png",
            "--out: is no text table, nor a picture that this command draws",
        ),
        ("show car.toml --out none/car.png", "none/car.png: cannot be written"),
        (
            "response car.toml --input z --output body.z",
            "--input: is 'z' (allowed: a name and a direction, such as road.z)",
        ),
        ("response car.toml --input road.z --output cat.z", "'cat' is unknown"),
    ],
)
def test_what_is_wrong_is_said_without_a_traceback(words, message, capsys):
    assert commands.main(shlex.split(words)) == 2
    said = capsys.readouterr()
    assert (
        said.err.startswith(f"jaxbody {words.split()[0]}: ")
        and message in said.err
        and "Traceback" not in said.err
    )


def test_frequencies_are_in_order(capsys):
    for wrong in ("20:1", "0:1", "x", "1"):
        with pytest.raises(SystemExit) as stopped:
            commands.main(
                [
                    "response",
                    "car.toml",
                    "--input",
                    "road.z",
                    "--output",
                    "body.z",
                    "--frequencies",
                    wrong,
                ]
            )
        assert (
            stopped.value.code == 2
            and "two frequencies in ascending order" in capsys.readouterr().err
        )


@pytest.mark.filterwarnings("ignore::jaxbody.JaxbodyWarning")
@pytest.mark.nan
def test_a_result_that_is_not_ok_is_told_by_the_exit_code(capsys):
    """A car without springs falls."""
    assert (
        commands.main(
            ["equilibrium", "car.toml", "--set", "*.stiffness=0", "--set", "*.free_length=0"]
        )
        == 1
    )
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


OWN_PROCESS = """
import gc, json, sys
sys.argv[1:] = json.loads(sys.argv[1])
import jaxbody as jb
from jaxbody.app import commands
with jb.compile_times() as times:
    code = commands.main()
libraries = [name for name in {libraries} if name in sys.modules]
print(json.dumps([code, times.count, times.cached, libraries, gc.isenabled()]))
"""
SLOW_TO_IMPORT = (
    "diffrax",
    "lineax",
    "matplotlib",
    "optax",
    "optimistix",
    "pandas",
    "scipy.optimize",
    "scipy.signal",
    "scipy.stats",
)


@pytest.mark.long
@pytest.mark.everywhere
def test_a_second_process_imports_and_compiles_no_more_than_it_needs(folder, monkeypatch):
    """The modes of a model without experiments: three programs, compiled by the first process; the
    numbers are the same, also with other stiffnesses."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(folder / "cache"))
    monkeypatch.delenv("JAX_COMPILATION_CACHE_DIR", raising=False)
    (folder / "cache").mkdir()

    def process(*words):
        program = OWN_PROCESS.replace("{libraries}", repr(SLOW_TO_IMPORT))
        command = [sys.executable, "-c", program, json.dumps(words)]
        done = subprocess.run(command, capture_output=True, text=True, timeout=600)
        assert done.returncode == 0, done.stderr
        *table, state = done.stdout.strip().splitlines()
        return table, json.loads(state)

    modes = "modes", "engine.toml"
    first, (code, count, cached, libraries, collecting) = process(*modes)
    assert (code, count, cached, libraries, collecting) == (0, 3, 0, [], True)
    second, (code, count, cached, libraries, collecting) = process(*modes)
    assert second == first and (code, count, cached, libraries, collecting) == (0, 3, 3, [], True)
    other, (code, count, cached, *_) = process(*modes, "--set", "*.stiffness=100, 200, 900 N/mm")
    assert other != first and (code, count, cached) == (0, 3, 3)


@pytest.mark.long
def test_what_is_too_large_is_refused_with_its_estimate_and_the_setting(capsys, folder):
    size = (folder / "car.toml").stat().st_size
    assert commands.main(["check", "car.toml", "--largest", "500"]) == 2
    said = capsys.readouterr().err
    assert (
        f"car.toml: has {size} bytes (allowed: 500 bytes). Set largest={1.1 * size:.2g} "
        f"(--largest {1.1 * size:.2g})"
    ) in said
    assert f"about {60 * size / 1e9:.2g} GB of memory" in said and "TOO_LARGE" in said
    assert commands.main(["check", "car.toml", "--largest", f"{1.1 * size:.2g}"]) == 0
    # ten matrices of 12 000 x 12 000 numbers
    many = {f"b{i}": {"mass": 1, "inertia": [1, 1, 1]} for i in range(2000)}
    (folder / "many.json").write_text(json.dumps({"jaxbody": 1, "units": "SI", "bodies": many}))
    capsys.readouterr()
    assert commands.main(["modes", "many.json"]) == 2
    said = capsys.readouterr().err
    assert (
        "12000 coordinates and 0 elements, whose matrices need about 11.5 GB (allowed: 8 GB)"
        in said
        and "MOST_MEMORY" in said
    )


SPRINGS = """
import pathlib, resource, sys
import jaxbody as jb

lines = ['jaxbody = 1', 'bodies.box = {mass = "2 kg", inertia = "1, 1, 1 kg m2"}']
lines += ['joints.box = {type = "Guide", parent = "world", axis = [0, 0, 1]}']
for i in range(100_000):
    lines += [f'[elements.s{i}]', 'type = "Spring"', 'a = ["box", "1, 0, 0 mm"]', 'b = ["world", "1, 0, -400 mm"]', 'stiffness = "20 N/mm"']
path = pathlib.Path(sys.argv[1])
path.write_text("\\n".join(lines))
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
model = jb.read_model(path)
equilibrium = jb.equilibrium(model)
stiffness = float(jb.linearize(model, equilibrium).K[0, 0])
print(path.stat().st_size, 1024 * (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before), stiffness)
"""  # noqa: E501


@pytest.mark.long
def test_100_000_springs_are_read_within_the_estimate_of_memory(folder):
    words = [sys.executable, "-c", SPRINGS, str(folder / "springs.toml")]
    done = subprocess.run(
        words, capture_output=True, text=True, timeout=900, env=os.environ | {"JAX_ENABLE_X64": "1"}
    )
    assert done.returncode == 0, done.stderr
    size, memory, stiffness = map(float, done.stdout.split())
    assert size < 2e7 and memory < 60 * size + 3e8  # the second: JAX and its compiler
    assert stiffness == pytest.approx(1e5 * 20e3, rel=1e-12)


TWO_MOUNTS = """jaxbody = 1
units = {length = "mm", mass = "kg", force = "N", time = "s", angle = "deg"}
gravity = [0, 0, -9806.65]
bodies.compressor = {mass = 85, inertia = [2.1e6, 3.2e6, 2.9e6], com = [20, 10, 0], position = [0, 0, 260]}
supports.floor = {}
elements.fl = {type = "Bushing", a = ["compressor", [250, 180, -200]], b = ["floor", [250, 180, 60]], stiffness = [60, 60, 90]}
elements.rl = {type = "Bushing", a = ["compressor", [-250, 180, -200]], b = ["floor", [-250, 180, 60]], stiffness = [60, 60, 90]}
"""  # noqa: E501


@pytest.mark.long
def test_check_says_what_the_numbers_mean(tmp_path, monkeypatch, capsys):
    """A machine on the mounts of one side alone hangs below them; in N/mm and kg its equilibrium is
    that of SI."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "two.toml").write_text(TWO_MOUNTS)
    assert commands.main(["check", "two.toml"]) == 0
    said = capsys.readouterr().out
    assert "no errors" in said and re.search(
        r"far from the drawn pose: 'compressor' is 49\d mm and 13\d degrees from it", said
    )
    assert (
        commands.main(["modes", "two.toml"]) == 0
        and "far from the drawn pose" in capsys.readouterr().out
    )
    model = jb.read_model("two.toml")
    assert (
        float(model["compressor"].inertia[0, 0]) == 2.1 and float(model["fl"].stiffness[0]) == 6e4
    )
    (tmp_path / "apart.toml").write_text(
        TWO_MOUNTS.replace("[250, 180, -200]", "[2500, 180, -200]")
    )
    commands.main(["check", "apart.toml", "--set", "gravity=[0, 0, -9.81]"])
    said = capsys.readouterr().out
    assert (
        "bushing 'fl' is drawn 2250 mm apart" in said
        and "gravity is 9.81 mm/s2, not 9700 to 9900 mm/s2: is it in m/s2?" in said
    )
