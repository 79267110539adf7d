"""A machine on a shaker: the file that describes it, and its record by SciPy. Nothing of jaxbody
is used."""

import numpy as np
from scipy.integrate import solve_ivp

MASS, NOISE = 85.0, (3e-5, 0.15)  # [kg]; of the displacement [m] and of the acceleration [m/s2]
OMEGA = 2 * np.pi * np.array([3.1, 6.3, 9.7, 12.2, 17.9])
AMPLITUDES = np.array([0.8, 0.5, 0.25, 0.2, 0.1]) * 1e-3  # [m]
BEGIN = 0.5  # [s] in which the floor starts
FACTORS = {"s": 1.0, "ms": 1e3, "m": 1.0, "mm": 1e3, "m/s2": 1.0, "g": 1 / 9.80665}
FILE = """jaxbody = 1
units = {length = "mm", force = "N", time = "s", angle = "deg"}
bodies.machine = {mass = "85 kg"}
supports.floor = {position = [0, 0, -100]}
joints.machine = {type = "Guide", parent = "world", axis = "z"}
elements.mount = {type = "Spring", a = ["machine", [0, 0, 0]], b = ["floor", [0, 0, 0]], stiffness = 250, damping = 0.3, free_length = 100}
records.shaker = {file = "shaker.csv", time = "t", channels = {floor = "b", top = "x", acc = "a"}}
sensors.top = {type = "Position", on = "machine", axis = "z"}
sensors.acc = {type = "Acceleration", on = "machine", axis = "z"}
[experiments.shaker]
record = "shaker"
initial = "rest"
motion.floor = {type = "Sampled", record = "shaker", translation = "floor", axis = "z"}
[fit]
free = ["mount.stiffness", "mount.damping"]
"""  # noqa: E501


def floor(t, phases):
    """The motion of the floor and its speed: tones that begin within half a second, from rest."""
    s = np.pi / BEGIN
    ramp, slope = (0.5 * (1 - np.cos(s * t)), 0.5 * s * np.sin(s * t)) if t < BEGIN else (1.0, 0.0)
    b, rate = (
        AMPLITUDES @ np.sin(OMEGA * t + phases),
        (AMPLITUDES * OMEGA) @ np.cos(OMEGA * t + phases),
    )
    return ramp * b, slope * b + ramp * rate


def record(times, k, c, phases, floor_noise, rng):
    """Rows of t, b, x and a: m x'' + c (x' - b') + k (x - b) = 0, with noise on what is measured,
    and on the floor's motion too."""

    def rate(t, y):
        b, speed = floor(t, phases)
        return [y[1], (-k * (y[0] - b) - c * (y[1] - speed)) / MASS]

    y = solve_ivp(
        rate,
        (0, times[-1]),
        [0.0, 0.0],
        method="DOP853",
        t_eval=times,
        rtol=1e-10,
        atol=1e-13,
        max_step=0.02,
    ).y
    b, x, a = (
        [floor(t, phases)[0] for t in times],
        y[0],
        [rate(t, z)[1] for t, z in zip(times, y.T, strict=True)],
    )
    b, x, a = (
        column + size * rng.normal(size=len(times))
        for column, size in zip((b, x, a), (floor_noise, *NOISE), strict=True)
    )
    return np.column_stack([times, b, x, a])


def write_case(folder, rows, units=("ms", "mm", "m/s2"), more=""):
    """The record and the file, of which this is the path; `more` for its [fit]."""
    time, place, acceleration = units
    names = {"t": time, "b": place, "x": place, "a": acceleration}
    heads = ",".join(f"{name} [{unit}]" for name, unit in names.items())
    np.savetxt(
        folder / "shaker.csv",
        rows * [FACTORS[unit] for unit in names.values()],
        "%.9g",
        ",",
        header=heads,
        comments="",
    )
    (folder / "shaker.toml").write_text(FILE + more)
    return folder / "shaker.toml"
