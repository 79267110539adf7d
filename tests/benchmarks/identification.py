"""A fit to instruments: 10 s at 1 kHz of three accelerometers and a gyro on a plate on five springs, twelve free parameters, start 30 % off.

`python tests/benchmarks/identification.py` prints what a fresh process takes for its first fit (cold), and the median of further fits (warm); to be
met: 15 s and 1 s. Beside it MuJoCo's sysid (pip install 'mujoco[sysid]') on the same record, where it can be imported.
"""

import time

import jax
import numpy as np

import jaxbody as jb

jax.config.update("jax_enable_x64", True)
TIMES = np.arange(10_001) * 1e-3
ROUNDS = 5
PLACES = {"left": [0.4, 0.3, 0.05], "right": [-0.4, 0.3, 0.05], "back": [0.0, -0.3, 0.0]}
PUSHED = [0.1, 0.05, 0.0]
FREQUENCIES, PUSHES = [0.7, 1.9, 3.1, 4.3], [[8.0, 3, 5], [-4, 9, 6], [5, -6, 9], [6, 5, -8]]  # [Hz], [N]
NOISE = {**dict.fromkeys(PLACES, 0.02), "gyro": 0.002}  # [m/s2], [rad/s]
FREE = ["s?.stiffness", "s?.damping", "plate.mass", "s4.free_length"]
OFF = np.array([1.3, 0.7, 1.3, 0.7, 1.3, 0.7, 1.3, 0.7, 1.3, 0.7, 1.3, 0.7])


CORNERS = np.array([[0.4, 0.3, 0.05], [-0.4, 0.3, 0.05], [-0.35, -0.3, 0.05], [0.45, -0.3, 0.05], [0.02, -0.03, -0.05]])
ENDS = np.array([[0.9, 0.4, 0.6], [-0.5, 0.9, 0.55], [-0.85, -0.2, 0.65], [0.4, -0.9, 0.6], [0.5, 0.5, -0.6]])
RELAXED = [0.62, 0.6, 0.64, 0.61, 0.8]


def plate():
    """6 kg on five springs that go out obliquely, so that their dampers feel every motion: 1.5 to 5 Hz, 2 to 10 % of critical damping."""
    ends = enumerate(zip(CORNERS, ENDS, RELAXED, strict=True))
    springs = {f"s{i}": jb.Spring(("plate", a), ("world", b), stiffness=900 + 60 * i, free_length=l, damping=12 + i) for i, (a, b, l) in ends}
    body = jb.Body(mass=6.0, inertia=[0.25, 0.35, 0.55], com=[0.05, -0.03, 0.02])
    return jb.Model(bodies={"plate": body}, elements=springs, gravity=[0, 0, -9.81])


def truth(model):
    found = {path: x for pattern in FREE for path, x in jb.paths(model, pattern).items()}
    return {path: float(x) for path, x in found.items()}


def loads():
    rows = zip(FREQUENCIES, PUSHES, strict=True)
    return {f"push{i}": jb.Force(("plate", PUSHED), force=jb.signals.Sine(amplitude=F, frequency=f, phase=0.5 * i)) for i, (f, F) in enumerate(rows)}


def experiment(model, seed=0):
    sensors = {name: jb.Accelerometer("plate", place) for name, place in PLACES.items()} | {"gyro": jb.Gyro("plate")}
    trajectory = jb.simulate(model, TIMES, loads=loads(), rtol=1e-11)
    measured = jb.measure(trajectory, sensors, noise=NOISE, key=jax.random.key(seed))
    return jb.Experiment(TIMES, loads=loads(), sensors=sensors, measured=measured, noise=NOISE)


def fitted(model, run):
    begin = time.perf_counter()
    found = jb.fit(model, {"run": run}, free=FREE)
    return found, time.perf_counter() - begin


def main():
    model = plate()
    values = truth(model)
    run = experiment(model)
    start = jb.replace(model, dict(zip(values, OFF * list(values.values()), strict=True)))
    found, cold = fitted(start, run)
    print(found)
    seeds = [experiment(model, seed) for seed in range(1, 1 + ROUNDS)]
    warm = [fitted(start, other)[1] for other in seeds]
    errors = [abs(float(found.estimates[path]) - x) / float(found.standard_errors[path]) for path, x in values.items()]
    print(f"cold {cold:.2f} s, to be met 15 s; warm {np.median(warm):.2f} s (least {min(warm):.2f}), to be met 1 s; {found.evaluations} evaluations")
    print(f"largest error {max(errors):.2f} standard errors")


if __name__ == "__main__":
    main()
