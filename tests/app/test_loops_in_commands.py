"""Commands and reports on a file with controllers."""

import numpy as np
import pytest
from loops_in_files import LOOPS, loops

import jaxbody as jb
from jaxbody.app.commands import main


@pytest.fixture
def folder(tmp_path, monkeypatch):
    (tmp_path / "loops.toml").write_text(LOOPS)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def said(capsys, words):
    assert main(words.split()) == 0
    return capsys.readouterr().out


SAMPLED = LOOPS.replace('drives = "actuator"', 'drives = "actuator"\nevery = "4 ms"')


def test_a_check_counts_controllers(folder, capsys):
    counts = "2 bodies, 1 support, 4 elements, 2 controllers, 2 sensors, 2 degrees of freedom"
    assert counts in said(capsys, "check loops.toml")
    (folder / "sampled.toml").write_text(SAMPLED)
    assert counts in said(capsys, "check sampled.toml")


@pytest.mark.long
def test_equilibrium_and_modes_are_those_of_python(folder, capsys):
    """The actuator holds the body at 1 m, and its force is what the spring lacks."""
    printed = said(capsys, "equilibrium loops.toml")
    force = 20e3 * (0.747 - 1.0 + float(jb.equilibrium(loops()).state.q[1]) + 0.4)
    rows = [line.split() for line in printed.splitlines()]
    state = {" ".join(row[:-1]): row[-1] for row in rows if row}
    found = float(state["actuator, force [N]"])
    np.testing.assert_allclose(found, 300 * 9.81 - force, atol=0.5)
    assert "ride, filtered error" in state and "[]" not in printed
    modes = said(capsys, "modes loops.toml")  # integral control has no static stiffness
    lin = jb.linearize(loops(), jb.equilibrium(loops()))
    first = float(jb.complex_modes(lin).frequency[0])
    assert "Complex modes" in modes and f"{first:.4g}" in modes


def test_the_response_to_a_command_is_that_of_python(folder, capsys):
    words = (
        "response loops.toml --input actuator --output body.z --output asked --frequencies 1:10 "
        "--points 5 --out response.csv"
    )
    assert "mm per N" in said(capsys, words)
    model, f = loops(), np.geomspace(1, 10, 5)
    outputs = {"body": jb.Position("body", axis="z")}
    expected = jb.frequency_response(
        jb.linearize(model, jb.equilibrium(model)), f, {"push": jb.Command("actuator")}, outputs
    )["body", "push"]
    table = np.loadtxt(folder / "response.csv", delimiter=",", skiprows=1)
    found = table[:, 1] * np.exp(1j * np.radians(table[:, 2]))
    np.testing.assert_allclose(1e-3 * found, expected, rtol=3e-3)  # four digits, mm


@pytest.mark.long
def test_a_motion_has_the_readings_of_drives(folder, capsys):
    (folder / "loops.toml").write_text(SAMPLED)
    said(capsys, "simulate loops.toml --duration 0.1 --interval 0.001 --out motion.csv")
    head, *rows = (folder / "motion.csv").read_text().splitlines()
    numbers = np.array([row.split(",") for row in rows], float)
    asked, force = (numbers[:, head.split(",").index(f"{x} [N]")] for x in ("asked", "force"))
    assert np.ptp(force) > 10
    after = np.flatnonzero(np.diff(asked)) + 1  # the command is held between samples
    assert len(after) > 10 and set(after % 4) <= {0, 1}


@pytest.mark.long
def test_a_report_lists_drives_and_controllers(folder, capsys):
    said(capsys, "report loops.toml --part model --part modes --part motion --duration 0.2 --view")
    page = (folder / "loops.html").read_text()
    for text in (
        "4 elements (spring, tyre, actuator, damper); 2 controllers (ride, sky).",
        "height to actuator",
        "speed to damper",
        "rate [N/s]",
        "soft",
        "Complex modes",
        "Proportional(-1.2 N s/mm)",
    ):
        assert text in page


@pytest.mark.long
def test_a_report_of_sampled_controllers_leaves_modes_out(folder, capsys):
    (folder / "loops.toml").write_text(SAMPLED)
    said(capsys, "report loops.toml")
    page = (folder / "loops.html").read_text()
    assert "every [s]" in page and "Plausibility" in page and "Small motions" not in page
    assert main(["modes", "loops.toml"]) == 2
    assert "has sampled controllers: ride" in capsys.readouterr().err
