"""A fit to instruments: 10 s at 1 kHz of three accelerometers and a gyro on a plate on six legs, twelve free parameters, start 30 % off.

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
FREE = ["s?.stiffness", "s?.damping"]
OFF = np.array([1.3, 0.7, 1.3, 0.7, 1.3, 0.7, 1.3, 0.7, 1.3, 0.7, 1.3, 0.7])


BODY = dict(mass=6.0, inertia=[0.25, 0.35, 0.55], com=[0.05, -0.03, 0.02])
AROUND = np.deg2rad([-17, 14, 103, 134, 223, 254]), np.deg2rad([-49, 51, 71, 171, 191, 291])  # of the legs' upper and lower ends
UPPER = np.stack([0.4 * np.cos(AROUND[0]), 0.35 * np.sin(AROUND[0]), np.full(6, -0.05)], 1)
LOWER = np.stack([0.6 * np.cos(AROUND[1]), 0.6 * np.sin(AROUND[1]), np.full(6, -0.5)], 1)
RELAXED = 1.03 * np.linalg.norm(UPPER - LOWER, axis=1)
STIFFNESS, DAMPERS = 900.0 + 90.0 * np.arange(6), 12.0 + 1.2 * np.arange(6)


def plate():
    """A plate on six legs, 2.0 to 5.1 Hz at 10 to 22 % of critical damping."""
    rows = enumerate(zip(UPPER, LOWER, STIFFNESS, RELAXED, DAMPERS, strict=True))
    springs = {f"s{i}": jb.Spring(("plate", a), ("world", b), stiffness=k, free_length=l, damping=c) for i, (a, b, k, l, c) in rows}
    return jb.Model(bodies={"plate": jb.Body(**BODY)}, elements=springs, gravity=[0, 0, -9.81])


def truth(model):
    found = {path: x for pattern in FREE for path, x in jb.paths(model, pattern).items()}
    return {path: float(x) for path, x in found.items()}


def loads():
    rows = zip(FREQUENCIES, PUSHES, strict=True)
    return {
        f"push{i}": jb.Force(("plate", PUSHED), force=jb.signals.Sine(amplitude=F, frequency=f, phase=0.5 * i))
        for i, (f, F) in enumerate(rows)
    }


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
    print(
        f"cold {cold:.2f} s, to be met 15 s; warm {np.median(warm):.2f} s (least {min(warm):.2f}), to be met 1 s; {found.evaluations} evaluations"
    )
    print(f"largest error {max(errors):.2f} standard errors")


if __name__ == "__main__":
    main()
