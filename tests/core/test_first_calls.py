"""What first calls enter, by a profile: a reader who follows one has as many files to open.
`pytest -m long -s tests/core/test_first_calls.py` prints them."""

import json
import subprocess
import sys

import pytest

CALLS = """
import json
import sys
from pathlib import Path

import diffrax
import jax
import numpy as np

jax.config.update("jax_enable_x64", True)
import jaxbody as jb
from jaxbody.model.elements import second_derivatives

HERE = str(Path(jb.__file__).parent)
files, frames = {}, {}


def ours(frame):
    return frame.f_code.co_filename.startswith(HERE) and frame.f_code.co_name != "<module>"


def first(function, *args, **named):
    entered = files[function.__name__] = set()

    def note(frame, event, _):
        if event == "call" and ours(frame):
            entered.add(frame.f_code.co_filename.removeprefix(HERE + "/"))

    sys.setprofile(note)
    try:
        return function(*args, **named)
    finally:
        sys.setprofile(None)


def count_frames_to(module, name, what):
    inner = getattr(module, name)

    def counting(*args, **named):
        stack = [sys._getframe(1)]
        while stack[-1].f_back:
            stack.append(stack[-1].f_back)
        frames.setdefault(what, sum(map(ours, stack)))
        return inner(*args, **named)

    setattr(module, name, counting)


car, full = jb.presets.quarter_car(damping=1500.0), jb.presets.full_car()
count_frames_to(diffrax, "diffeqsolve", "simulate to diffeqsolve")
times = np.linspace(0, 1, 51)
push = {"push": jb.Force("body", force=[0, 0, 100.0])}
run = first(jb.simulate, car, times, loads=push)
rest = first(jb.equilibrium, full)
count_frames_to(second_derivatives, "_states_held", "linearize to a spring's Hessian")
lin = first(jb.linearize, full, rest)
first(jb.modes, lin)
lin = jb.linearize(car, jb.equilibrium(car))
pull = {"pull": jb.PointForce("body", direction="z")}
stroke = {"stroke": jb.Elongation("suspension")}
density = {"pull": jb.vibration.PowerLaw(3.0, unit="N2/Hz")}
first(jb.random_response, lin, jb.vibration.Band(0.1, 100.0), pull, stroke, density)
read = {"z": jb.Position("body", axis=[0, 0, 1])}
track = jb.Experiment(times, sensors=read, measured=jb.measure(run, read), loads=push)
first(jb.fit, car, {"track": track}, free=["suspension.stiffness"])
sag = lambda model: {"sag": 3000.0 / model["suspension"].stiffness}
first(jb.tune, car, sag, free=["suspension.stiffness"], minimize="sag",
    bounds={"suspension.stiffness": (1e4, 5e4)})
print(json.dumps([{name: sorted(entered) for name, entered in files.items()}, frames]))
"""
FILES = {
    "simulate": 40,
    "equilibrium": 41,
    "linearize": 31,
    "modes": 12,
    "random_response": 35,
    "fit": 57,
    "tune": 24,
}  # at most
FRAMES = {"simulate to diffeqsolve": 4, "linearize to a spring's Hessian": 11}


@pytest.mark.long
def test_first_calls_enter_few_files():
    command = [sys.executable, "-c", CALLS]
    done = subprocess.run(command, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stderr
    files, frames = json.loads(done.stdout.splitlines()[-1])
    for name, entered in files.items():
        print(f"{name}: {len(entered)} files: {', '.join(entered)}")
    print(frames)
    assert all(len(files[name]) <= most for name, most in FILES.items())
    assert all(frames[name] <= most for name, most in FRAMES.items())
