"""Ready models of `jaxbody new`: each runs through all commands as it is printed, and its numbers
are those of the preset, of closed forms, and of matrices written here."""

import re

import numpy as np
import pytest
import scipy.linalg

import jaxbody as jb
from jaxbody.app import commands

# {name: (input and output of the response, the same model as a preset)}
READY = {
    "engine": ("frame.z", "engine.z", None),
    "compressor": ("floor.z", "compressor.z", None),
    "cabinet": ("floor.x", "rack.x", None),
    "quarter_car": ("road.z", "body.z", lambda: jb.presets.quarter_car(damping=1500.0)),
    "half_car": (
        "front.z",
        "body.z",
        lambda: jb.presets.half_car(front_damping=1400.0, rear_damping=1600.0),
    ),
    "full_car": ("road fl.z", "car.z", jb.presets.full_car),
    "hydraulic_engine_mounts": (
        "frame.z",
        "engine.z",
        lambda: jb.presets.hydraulic_engine_mounts(gravity=9.81),
    ),
    "rubber_isolators": (
        "floor.z",
        "instrument.z",
        lambda: jb.presets.rubber_isolators(gravity=9.81),
    ),
    "stewart_table": ("base.z", "table.z", lambda: jb.presets.stewart_table(damping=60.0)),
}


def printed(name, capsys):
    capsys.readouterr()  # of what ran before
    assert commands.main(["new", name]) == 0
    return capsys.readouterr().out


def written(name, folder, capsys):
    path = folder / f"{name}.toml"
    path.write_text(printed(name, capsys))
    return path


def frequencies(M, K):
    return np.sqrt(scipy.linalg.eigh(K, M, eigvals_only=True)) / (2 * np.pi)


def modes_of(path):
    model = jb.read_model(path)
    return np.asarray(jb.modes(jb.linearize(model, jb.equilibrium(model))).frequency)


def test_new_lists_the_ready_models_with_a_line_each(capsys):
    assert commands.main(["new"]) == 0
    _, *lines = capsys.readouterr().out.splitlines()
    assert {line.split()[0] for line in lines} == set(READY)
    assert all(len(line.split()) > 4 and len(line) <= 100 for line in lines)
    assert commands.main(["new", "quarter_cat"]) == 2
    assert "Did you mean 'quarter_car'?" in capsys.readouterr().err


@pytest.mark.parametrize("name", READY)
def test_a_ready_file_says_its_units_and_is_short(name, capsys):
    text = printed(name, capsys)
    assert 'units = {length = "mm", mass = "kg", force = "N", time = "s", angle = "deg"}' in text
    assert text.isascii() and len(text.splitlines()) < 90
    assert "gravity = " in text and ("damping = " in text or "Maxwell" in text)


@pytest.mark.long
@pytest.mark.parametrize("name", [name for name in READY if READY[name][2]])
def test_the_numbers_of_a_ready_file_are_those_of_its_preset(name, tmp_path, capsys):
    """To the digits that the file states, a micrometer in lengths."""
    read, preset = jb.read_model(written(name, tmp_path, capsys)), READY[name][2]()
    ours, theirs = jb.parameter_paths(read), jb.parameter_paths(preset)
    assert ours.keys() == theirs.keys()
    for path, x in theirs.items():
        np.testing.assert_allclose(ours[path], x, rtol=1e-5, atol=1e-6, err_msg=path)


@pytest.mark.long
@pytest.mark.parametrize("name", READY)
def test_a_ready_file_runs_through_all_commands(name, tmp_path, capsys):
    """The response at a low frequency is that of a rigid body, 1, or the share of one of several
    supports; the design meets its limits."""
    path, (of, to, _) = str(written(name, tmp_path, capsys)), READY[name]
    assert commands.main(["check", path]) == 0 and "no errors" in capsys.readouterr().out
    assert commands.main(["modes", path]) == 0 and "frequency [Hz]" in capsys.readouterr().out
    out = str(tmp_path / "response.csv")
    words = ["--input", of, "--output", to, "--frequencies", "0.01:20", "--points", "9"]
    assert commands.main(["response", path, *words, "--out", out]) == 0
    first = np.loadtxt(out, delimiter=",", skiprows=1)[0, 1]
    assert abs(first - {"half_car": 0.6, "full_car": 0.35 / 1.3}.get(name, 1.0)) < 1e-3
    capsys.readouterr()
    assert commands.main(["tune", path, "--write"]) == 0
    assert "ok" in capsys.readouterr().out
    page = tmp_path / "page.html"
    parts = ["--part", "model", "--part", "modes", "--part", "design"]
    assert commands.main(["report", path, *parts, "--out", str(page)]) == 0
    assert page.stat().st_size > 10_000


def test_modes_of_the_quarter_car_are_those_of_its_matrices(tmp_path, capsys):
    M, K = np.diag([375.0, 75.0]), np.array([[35e3, -35e3], [-35e3, 35e3 + 193e3]])
    modes = modes_of(written("quarter_car", tmp_path, capsys))
    np.testing.assert_allclose(modes, frequencies(M, K), rtol=1e-6)


@pytest.mark.long
def test_modes_of_other_ready_models_are_those_of_closed_forms(tmp_path, capsys):
    """Compressor and frame bounce on their own, by symmetry. The engine bounces nearly so, as the
    stiffnesses of its mounts and strut have nearly no moment about its center of mass."""
    cabinet = frequencies(np.diag([600.0, 200.0]), np.array([[26e4, -2e5], [-2e5, 2e5]]))
    np.testing.assert_allclose(modes_of(written("cabinet", tmp_path, capsys)), cabinet, rtol=1e-6)
    k, f = np.array([18e3, 22e3]), np.array([1.0, -1.5])
    pitch = frequencies(np.diag([1000.0, 810.0]), np.array([[sum(k), -k @ f], [-k @ f, k @ f**2]]))
    np.testing.assert_allclose(
        modes_of(written("half_car", tmp_path, capsys)), pitch, rtol=1e-3
    )  # the springs carry the weight
    bounce = frequencies(np.diag([85.0, 140.0]), np.array([[72e4, -72e4], [-72e4, 1e6]]))
    compressor = modes_of(written("compressor", tmp_path, capsys))
    assert all(abs(compressor / x - 1).min() < 1e-4 for x in bounce)
    engine = modes_of(written("engine", tmp_path, capsys))
    assert abs(engine[4] / (np.sqrt(1050e3 / 180) / (2 * np.pi)) - 1) < 1e-3


@pytest.mark.long
def test_designs_of_ready_files_reach_their_target(tmp_path, capsys):
    """The cabinet slides at 0.9 Hz, the heave and pitch of half a car are uncoupled where the
    spring forces have no moment, k a = k b."""
    cabinet = written("cabinet", tmp_path, capsys)
    assert commands.main(["tune", str(cabinet), "--write"]) == 0
    k = float(jb.read_model(cabinet)["isolators"].stiffness)
    K = np.array([[k + 2e5, -2e5], [-2e5, 2e5]])
    assert abs(frequencies(np.diag([600.0, 200.0]), K)[0] - 0.9) < 1e-5
    half = written("half_car", tmp_path, capsys)
    assert commands.main(["tune", str(half), "--write"]) == 0
    assert abs(float(jb.read_model(half)["front spring"].stiffness) / 33e3 - 1) < 1e-3


def uncommented(text):
    start = text.index("\n# [records.run1]")
    return text[:start] + re.sub("^# ", "", text[start:], flags=re.M)


@pytest.mark.long
@pytest.mark.parametrize("name", READY)
def test_measured_data_of_a_ready_file_are_read_when_they_are_there(name, tmp_path, capsys):
    text = printed(name, capsys)
    (tmp_path / "model.toml").write_text(uncommented(text))
    heads = re.search(r"with the columns (.*)", text)[1].split(", ")
    rows = [",".join(map(repr, (t, *[0.1 * t] * (len(heads) - 1)))) for t in (0.0, 0.1, 0.2, 0.3)]
    (tmp_path / "run1.csv").write_text("\n".join([",".join(heads), *rows]))
    study = jb.read_study(tmp_path / "model.toml")
    assert set(study.experiments) == {"run1", "modal"} and study.fit["free"]
    measured = study.experiments["modal"].measured["frequency"]
    found = jb.modes(jb.linearize(study.model, jb.equilibrium(study.model))).frequency[:2]
    np.testing.assert_allclose(found, measured, atol=0.006)  # two decimals
