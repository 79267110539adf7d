"""A fit to three accelerometers and a gyro on a plate on six legs, 10 s at 1 kHz: twelve free
parameters that start 30 % off.

`python tests/benchmarks/identification.py` prints the time of the first fit of a new process (cold)
and the median of further fits (warm). The targets are 15 s and 1 s. `--peer` fits a free decay
of the same plate, 10 s at 1 kHz, with jaxbody and with MuJoCo's sysid
(pip install 'mujoco[sysid]>=4'): its default optimizer, finite differences over threads, RK4 at
1 ms, and residuals divided by the noise, as here. The target is 20 times faster.
"""

import argparse
import time
import warnings

import jax
import numpy as np

import jaxbody as jb

TIMES = np.arange(10_001) * 1e-3
ROUNDS = 5
PLACES = {"left": [0.4, 0.3, 0.05], "right": [-0.4, 0.3, 0.05], "back": [0.0, -0.3, 0.0]}
PUSHED = [0.1, 0.05, 0.0]
# [Hz], [N]
FREQUENCIES, PUSHES = [0.7, 1.9, 3.1, 4.3], [[8.0, 3, 5], [-4, 9, 6], [5, -6, 9], [6, 5, -8]]
NOISE = {**dict.fromkeys(PLACES, 0.02), "gyro": 0.002}  # [m/s2], [rad/s]
FREE = ["s?.stiffness", "s?.damping"]
OFF = np.array([1.3, 0.7, 1.3, 0.7, 1.3, 0.7, 1.3, 0.7, 1.3, 0.7, 1.3, 0.7])


BODY = dict(mass=6.0, inertia=[0.25, 0.35, 0.55], com=[0.05, -0.03, 0.02])
# of the legs' upper and lower ends
AROUND = np.deg2rad([-17, 14, 103, 134, 223, 254]), np.deg2rad([-49, 51, 71, 171, 191, 291])
UPPER = np.stack([0.4 * np.cos(AROUND[0]), 0.35 * np.sin(AROUND[0]), np.full(6, -0.05)], 1)
LOWER = np.stack([0.6 * np.cos(AROUND[1]), 0.6 * np.sin(AROUND[1]), np.full(6, -0.5)], 1)
RELAXED = 1.03 * np.linalg.norm(UPPER - LOWER, axis=1)
STIFFNESS, DAMPERS = 900.0 + 90.0 * np.arange(6), 12.0 + 1.2 * np.arange(6)


def plate():
    """A plate on six legs, 2.0 to 5.1 Hz at 10 to 22 % of critical damping."""
    rows = enumerate(zip(UPPER, LOWER, STIFFNESS, RELAXED, DAMPERS, strict=True))
    springs = {
        f"s{i}": jb.Spring(("plate", a), ("world", b), stiffness=k, free_length=l, damping=c)
        for i, (a, b, k, l, c) in rows
    }
    return jb.Model(bodies={"plate": jb.Body(**BODY)}, elements=springs, gravity=[0, 0, -9.81])


def truth(model):
    result = {path: x for pattern in FREE for path, x in jb.parameter_paths(model, pattern).items()}
    return {path: float(x) for path, x in result.items()}


def loads():
    rows = zip(FREQUENCIES, PUSHES, strict=True)
    return {
        f"push{i}": jb.Force(
            ("plate", PUSHED), force=jb.signals.Sine(amplitude=F, frequency=f, phase=0.5 * i)
        )
        for i, (f, F) in enumerate(rows)
    }


def experiment(model, seed=0):
    sensors = {name: jb.Accelerometer("plate", place) for name, place in PLACES.items()} | {
        "gyro": jb.sensors.Gyro("plate")
    }
    trajectory = jb.simulate(model, TIMES, loads=loads(), rtol=1e-11)
    measured = jb.measure(trajectory, sensors, noise=NOISE, key=jax.random.key(seed))
    return jb.Experiment(TIMES, loads=loads(), sensors=sensors, measured=measured, noise=NOISE)


def fitted(model, run):
    begin = clocks()
    result = jb.fit(model, {"run": run}, free=FREE)
    return result, clocks() - begin


def clocks():
    """Seconds by the wall and of the processor, all threads: on a busy machine the
    latter compare."""
    return np.array([time.perf_counter(), time.process_time()])


def off(model):
    values = truth(model)
    return jb.replace(model, dict(zip(values, OFF * list(values.values()), strict=True)))


def shaken():
    model = plate()
    values, start = truth(model), off(model)
    result, cold = fitted(start, experiment(model))
    print(result)
    warm = [fitted(start, experiment(model, seed))[1] for seed in range(1, 1 + ROUNDS)]
    print(
        f"cold {seconds_of(cold)} (target 15 s); warm {seconds_of(np.median(warm, 0))} (target 1 "
        f"s); {result.evaluations} evaluations"
    )
    print(
        f"largest error {worst(result.estimates, result.standard_errors, values):.2f} standard "
        "errors"
    )


def seconds_of(seconds):
    return f"{seconds[0]:.2f} s ({seconds[1]:.2f} s of the processor)"


def worst(estimates, errors, values):
    return max(abs(float(estimates[path]) - x) / float(errors[path]) for path, x in values.items())


THROWN = np.array([0.5, -0.3, 0.4, 2.0, -1.5, 1.0])


def decay(model):
    """The plate thrown from its reference pose: smooth, so that no program's way with sampled
    forces matters."""
    sensors = {name: jb.Accelerometer("plate", place) for name, place in PLACES.items()} | {
        "gyro": jb.sensors.Gyro("plate")
    }
    initial = jb.State(model.reference.q, jax.numpy.asarray(THROWN))
    measured = jb.measure(
        jb.simulate(model, TIMES, initial=initial, rtol=1e-11),
        sensors,
        noise=NOISE,
        key=jax.random.key(9),
    )
    return jb.Experiment(TIMES, initial=initial, sensors=sensors, measured=measured, noise=NOISE)


def xml():
    sites = "".join(
        f'<site name="a{i}" pos="{" ".join(map(str, p))}"/>' for i, p in enumerate(UPPER)
    )
    sites += (
        "".join(
            f'<site name="{name}" pos="{" ".join(map(str, p))}"/>' for name, p in PLACES.items()
        )
        + '<site name="gyro"/>'
    )
    ends = "".join(
        f'<site name="b{i}" pos="{" ".join(map(str, p))}"/>' for i, p in enumerate(LOWER)
    )
    mass, inertia, com = (
        " ".join(map(str, np.ravel(BODY[name]))) for name in ("mass", "inertia", "com")
    )
    legs = "".join(
        (
            f'<spatial name="s{i}" stiffness="{STIFFNESS[i]}" damping="{DAMPERS[i]}" '
            f'springlength="{RELAXED[i]}"><site site="a{i}"/><site site="b{i}"/></spatial>'
        )
        for i in range(6)
    )
    read = (
        "".join(f'<accelerometer name="{name}" site="{name}"/>' for name in PLACES)
        + '<gyro name="gyro" site="gyro"/>'
    )
    return f"""<mujoco><option timestep="0.001" integrator="RK4" gravity="0 0 -9.81"><flag contact="disable"/></option>
    <worldbody>{ends}<body name="plate"><freejoint/><inertial pos="{com}" mass="{mass}" diaginertia="{inertia}"/>{sites}</body></worldbody>
    <tendon>{legs}</tendon><sensor>{read}</sensor></mujoco>"""  # noqa: E501


def by_mujoco(run, start):
    """Estimates, standard errors, cost and seconds of sysid."""
    import mujoco
    from mujoco import sysid

    spec = mujoco.MjSpec.from_string(xml())
    model = spec.compile()
    params = sysid.ParameterDict()

    def setter(leg, field):
        def write(spec, parameter):
            current = getattr(spec.tendon(leg), field)
            setattr(
                spec.tendon(leg),
                field,
                parameter.value[0]
                if np.ndim(current) == 0
                else [parameter.value[0], *np.ravel(current)[1:]],
            )

        return write

    for path, x in truth(start).items():
        leg, field = path.split(".")
        params.add(sysid.Parameter(path, x, 0.1 * x, 10 * x, modifier=setter(leg, field)))
    measured = np.concatenate([np.asarray(run.measured[name]) for name in (*PLACES, "gyro")], 1)
    level = np.repeat([NOISE[name] for name in (*PLACES, "gyro")], 3)
    mapping = sysid.TimeSeries.compute_all_sensor_mapping(model)
    data = sysid.TimeSeries(TIMES, measured, mapping)
    control = sysid.TimeSeries(TIMES, np.zeros((len(TIMES), 0)), {})
    # its sensors are those at the beginning of each step
    initial = sysid.create_initial_state(model, model.qpos0.copy(), THROWN)

    def over_noise(params, predicted, measured, model, return_pred_all, **rest):
        return (
            (predicted.data[: len(TIMES)] - data.data[: len(predicted.data)]) / level,
            predicted,
            predicted,
        )

    sequences = [sysid.ModelSequences("plate", spec, "decay", initial, control, data)]
    residual = sysid.build_residual_fn(models_sequences=sequences, modify_residual=over_noise)
    begin = clocks()
    outcome, result = sysid.optimize(params, residual, verbose=False)
    seconds = clocks() - begin
    r, _, _ = residual(result.x, outcome)
    covariance, _ = sysid.calculate_intervals(r, np.asarray(result.jac))
    names = list(truth(start))
    return (
        dict(zip(names, result.x, strict=True)),
        dict(zip(names, np.sqrt(np.diag(covariance)), strict=True)),
        0.5 * float(np.sum(np.concatenate(r) ** 2)),
        seconds,
    )


def beside_mujoco():
    model = plate()
    values, start, run = truth(model), off(model), decay(model)
    _, cold = fitted(start, run)
    mine = [fitted(start, run) for _ in range(ROUNDS)]
    result, warm = mine[0][0], np.median([seconds for _, seconds in mine], 0)
    estimates, errors, cost, seconds = by_mujoco(run, start)
    print(f"{'':16s}{'true':>8s}{'jaxbody':>12s}{'+-':>9s}{'sysid':>12s}{'+-':>9s}")
    for path, x in values.items():
        print(
            f"{path:16s}{x:8.2f}{float(result.estimates[path]):12.4f}"
            f"{float(result.standard_errors[path]):9.4f}{estimates[path]:12.4f}{errors[path]:9.4f}"
        )
    print(
        f"cost {float(result.cost):.2f} and {cost:.2f}; largest error "
        f"{worst(result.estimates, result.standard_errors, values):.2f} and "
        f"{worst(estimates, errors, values):.2f} standard errors"
    )
    print(f"jaxbody {seconds_of(warm)} warm, {seconds_of(cold)} cold; sysid {seconds_of(seconds)}")
    ratio = seconds / warm
    print(
        f"sysid takes {ratio[0]:.0f} times as long, {ratio[1]:.0f} times of the "
        "processor; target 20"
    )


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--peer", action="store_true")
    options = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    warnings.simplefilter("ignore", jb.JaxbodyWarning)
    beside_mujoco() if options.peer else shaken()


if __name__ == "__main__":
    main()
