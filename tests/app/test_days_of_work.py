"""Three days of an engineer without Python, by commands alone: a compressor on its mounts, a
quarter car from a data sheet, and a record of a shaker from which the stiffness of a mount is read.
The numbers are compared with those of NumPy and SciPy."""

import csv
import itertools
import shlex
from pathlib import Path

import numpy as np
import pytest
from scipy import integrate, interpolate, linalg, optimize, signal

from jaxbody.app import commands

MOUNTS = """name; a; b; x [mm]; y [mm]; z [mm]; kx [N/mm]; ky [N/mm]; kz [N/mm]; cz [N s/mm]
front left; compressor; floor; 300; 200; 0; 40; 40; 60; 0.1
front right; compressor; floor; 300; -200; 0; 40; 40; 60; 0.1
rear left; compressor; floor; -300; 200; 0; 40; 40; 80; 0.1
rear right; compressor; floor; -300; -200; 0; 40; 40; 80; 0.1
"""
CAR = """jaxbody = 1
units = {length = "mm", mass = "kg", force = "N", time = "s", angle = "deg"}
bodies.body = {mass = 300, inertia = "1, 1, 1 kg m2", position = [0, 0, 600]}
bodies.wheel = {mass = 40, inertia = "1, 1, 1 kg m2", position = [0, 0, 300]}
joints.body = {type = "Guide", parent = "world", axis = "z"}
joints.wheel = {type = "Guide", parent = "world", axis = "z"}
supports.road = {}
elements.tyre = {type = "Spring", a = "wheel", b = "road", stiffness = 180, free_length = 300}
[elements.strut]
type = "Spring"
a = "body"
b = "wheel"
stiffness = 20
free_length = 300
damping = 1.2
[sensors]
seat = {type = "Acceleration", on = "body", axis = "z"}
[designs.ride]
free = ["strut.damping"]
minimize = "shaking"
bounds = {"strut.damping" = [0.3, 5]}
roads.road = {class = "C", speed = "20 m/s"}
band = "0.2, 50 Hz"
quantities.shaking = {type = "rms", sensor = "seat"}
"""
SHAKER = """jaxbody = 1
units = {length = "mm", mass = "kg", force = "N", time = "s", angle = "deg"}
bodies.box = {mass = 12, inertia = "1, 1, 1 kg m2", position = [0, 0, 200]}
joints.box = {type = "Guide", parent = "world", axis = "z"}
supports.table = {}
[elements.mount]
type = "Spring"
a = "box"
b = "table"
free_length = 200
stiffness = 30
damping = 0.05
[records.run]
file = "run.csv"
time = "t"
channels = {lift = "a", table = "table"}
[sensors]
lift = {type = "Acceleration", on = "box", axis = "z"}
[experiments.run]
record = "run"
initial = "rest"
motion.table = {type = "Sampled", record = "run", translation = "table", axis = "z"}
[fit]
free = ["mount.stiffness", "mount.damping"]
"""


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def run(words: str) -> None:
    """Run a command line, which must succeed."""
    assert commands.main(shlex.split(words)) == 0, words


def table(name: str) -> dict[str, list[str]]:
    """Return the first table of a text file by column."""
    lines = [line for line in Path(name).read_text().splitlines() if line[:1] != "#"]
    rows = [*csv.reader(lines)]
    rows = [row for row in rows if len(row) == len(rows[0])]
    return {head: [row[i] for row in rows[1:]] for i, head in enumerate(rows[0])}


def numbers(name: str, column: str) -> np.ndarray:
    return np.array(table(name)[column], float)


def test_a_compressor_on_its_mounts(folder, capsys):
    """Modes, response to the unbalance and static sag are those of M and K put together by hand."""
    (folder / "mounts.csv").write_text(MOUNTS)
    run("new --mounts mounts.csv")
    text = capsys.readouterr().out
    text += '\n[loads]\nrotor = {type = "Unbalance", on = "compressor", axis = "y", '
    text += 'unbalance = "3 kg mm", frequency = "25 Hz"}\n'
    (folder / "comp.toml").write_text(text)
    of_body = {"mass": "85 kg", "inertia": "3, 5, 6 kg m2", "com": "0, 0, 250 mm"}
    values = " ".join(f"--set 'compressor.{name}={value}'" for name, value in of_body.items())
    run(f"check comp.toml {values}")
    run(f"modes comp.toml {values} --set 'gravity=0, 0, 0' --out modes.csv")
    run(
        f"response comp.toml {values} --set 'gravity=0, 0, 0' --input rotor --output compressor.z "
        "--frequencies 5:40 --points 9 --out response.csv"
    )
    run(f"equilibrium comp.toml {values} --out rest.csv")

    m, com = 85.0, np.array([0, 0, 0.25])
    K, C = np.zeros((6, 6)), np.zeros((6, 6))
    for x, y, kz in ((0.3, 0.2, 6e4), (0.3, -0.2, 6e4), (-0.3, 0.2, 8e4), (-0.3, -0.2, 8e4)):
        # displacement of the mount by displacement and rotation of the body about O
        J = np.hstack([np.eye(3), [[0, 0, -y], [0, 0, x], [y, -x, 0]]])
        K += J.T @ np.diag([4e4, 4e4, kz]) @ J
        C += J.T @ np.diag([0, 0, 100.0]) @ J
    S = np.array([[0, -com[2], com[1]], [com[2], 0, -com[0]], [-com[1], com[0], 0]])
    M = np.block([[m * np.eye(3), -m * S], [m * S, np.diag([3.0, 5, 6]) - m * S @ S]])
    expected = np.sqrt(linalg.eigh(K, M, eigvals_only=True)) / (2 * np.pi)
    np.testing.assert_allclose(numbers("modes.csv", "frequency [Hz]"), expected, rtol=5e-4)

    f = numbers("response.csv", "frequency [Hz]")
    # the shaft is along y, so n1 = x and n2 = -z: u w^2 (x cos + z sin of the opposite angle)
    u = 3e-3
    lift = []
    for w in 2 * np.pi * f:
        force = u * w**2 * np.array([1, 0, 1j, 0, 0, 0])
        lift.append(np.linalg.solve(K + 1j * w * C - w**2 * M, force)[2])
    read = numbers("response.csv", "compressor.z / rotor [m]")
    np.testing.assert_allclose(read, np.abs(lift), rtol=5e-4)

    weight = np.array([0, 0, -m * 9.81, 0, 0, 0])
    weight[3:] = np.cross(com, weight[:3])
    for _ in range(3):  # gravity turns with the body: its moment about O grows with the tilt
        sag = np.linalg.solve(K, weight)
        weight[3:] = np.cross(com + np.cross(sag[3:], com), weight[:3])
    names = table("rest.csv")["coordinate"]
    at_rest = dict(zip(names, numbers("rest.csv", "at rest"), strict=True))
    np.testing.assert_allclose(at_rest["compressor move along z"], sag[2], rtol=2e-3)
    np.testing.assert_allclose(
        at_rest["compressor turn about y"], sag[4], rtol=5e-3
    )  # of first order in the tilt of 0.1 degrees


def test_a_quarter_car_from_a_data_sheet(folder, capsys):
    """Response, ride on a road of class C and the best damper are those of a model of two masses;
    the road is 16e-6 m3 at 0.1 1/m, 256e-6 for class C, and its spectrum falls with n^2."""
    (folder / "car.toml").write_text(CAR)
    k, kt, m, mw, speed = 2e4, 1.8e5, 300.0, 40.0, 20.0

    def response(w, c):
        """Return the acceleration of the body per displacement of the road."""
        D = np.array([[k + 1j * w * c - w**2 * m, -k - 1j * w * c], [-k - 1j * w * c, k + kt + 1j * w * c - w**2 * mw]])  # fmt: skip  # noqa: E501
        return -(w**2) * np.linalg.solve(D, [0, kt])[0]

    run("modes car.toml --out modes.csv")
    squares = linalg.eigh([[k, -k], [-k, k + kt]], np.diag([m, mw]), eigvals_only=True)
    np.testing.assert_allclose(
        numbers("modes.csv", "frequency [Hz]"), np.sqrt(squares) / (2 * np.pi), rtol=5e-4
    )
    run(
        "response car.toml --input road.z --output seat --frequencies 0.5:20 --points 12 "
        "--out response.csv"
    )
    f = numbers("response.csv", "frequency [Hz]")
    np.testing.assert_allclose(
        numbers("response.csv", "seat / road.z [mm/s2 per mm]"),
        [abs(response(2 * np.pi * x, 1200.0)) for x in f],
        rtol=5e-4,
    )
    capsys.readouterr()

    def shaking(c):
        """Return the rms acceleration between 0.2 and 50 Hz."""

        def density(f):
            n = f / speed
            road = 256e-6 * (0.1 / n) ** 2 / speed
            return abs(response(2 * np.pi * f, c)) ** 2 * road

        edges = [0.2, 1, 2, 6, 10, 14, 25, 50]
        parts = [
            integrate.quad(density, a, b, epsrel=1e-8)[0] for a, b in itertools.pairwise(edges)
        ]
        return np.sqrt(sum(parts))

    run("tune car.toml --write")
    best = optimize.minimize_scalar(shaking, bounds=(300, 5000), method="bounded").x
    written = (folder / "car.toml").read_text().split("damping = ")[1].splitlines()[0]
    np.testing.assert_allclose(1e3 * float(written), best, rtol=2e-3)  # the minimum is flat
    printed = capsys.readouterr().out.split("shaking")[-1].split()
    np.testing.assert_allclose(float(printed[1]), 1e3 * shaking(best), rtol=1e-3)


@pytest.mark.filterwarnings("ignore::jaxbody.JaxbodyWarning")  # of a guess that is off by a quarter
def test_a_record_of_a_shaker_gives_the_stiffness_of_a_mount(folder, capsys):
    """The estimates are those of SciPy's least squares with a linear system simulated by SciPy."""
    rng = np.random.default_rng(1)
    t = np.arange(400) / 200
    base = 2e-3 * signal.chirp(t, 4, 2, 20) * np.sin(np.pi * t / 2) ** 2
    m = 12.0

    def lift(parameters):
        """Return the acceleration of the box on a base between whose samples is a spline."""
        k, c = parameters
        system = signal.StateSpace([[0, 1], [-k / m, -c / m]], [[0, 0], [k / m, c / m]], [[-k / m, -c / m]], [[k / m, c / m]])  # fmt: skip  # noqa: E501
        fine = np.arange(20 * len(t)) / (20 * 200)
        curve = interpolate.CubicSpline(t, base)
        inputs = np.stack([curve(fine), curve(fine, 1)], 1)
        return signal.lsim(system, inputs, fine)[1][::20]

    a = lift([4.1e4, 60.0]) + 0.05 * rng.standard_normal(len(t))
    columns = np.stack([t, 1e3 * base, a], 1)
    np.savetxt("run.csv", columns, delimiter=",", header="t [s],table [mm],a [m/s2]", comments="")
    (folder / "shaker.toml").write_text(SHAKER)
    run("check shaker.toml")
    assert "lift" in capsys.readouterr().out
    run("fit shaker.toml --out fit.csv")
    expected = optimize.least_squares(lambda p: lift(p) - a, [3e4, 50], x_scale=[1e4, 10])
    read = numbers("fit.csv", "estimate")
    np.testing.assert_allclose(1e3 * read, expected.x, rtol=1e-3)
    errors = 0.05 * np.sqrt(np.diag(np.linalg.inv(expected.jac.T @ expected.jac)))
    found = 1e3 * numbers("fit.csv", "standard error")
    # the spectrum of the noise at the resonance is estimated from 400 samples, to some 30 percent
    np.testing.assert_allclose(found, errors, rtol=0.4)
    assert np.all(np.abs(1e3 * read - [4.1e4, 60.0]) < 3 * found)
    run("report shaker.toml --part model --part fit --out shaker.html")
    assert "mount.stiffness" in (folder / "shaker.html").read_text()
