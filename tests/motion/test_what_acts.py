"""Motions do not pass over what acts: contacts, shocks after long quiet, loads on a state that is
zero up to rounding. A few random cases of each kind against judges of their own;
benchmarks/what_acts.py has hundreds."""

import diffrax
import jax.numpy as jnp
import numpy as np
import pytest
import random_drops
import random_rests
import random_shocks

import jaxbody as jb

QUARTER, HALF = "quarter_car", "half_car"
# how many, and of which structure: each is compiled once, but for plain functions of time
SHOCKS = (
    (5, HALF, "sampled", "default"),
    (4, HALF, "hold", "default"),
    (4, HALF, "cubic", "default"),
    (1, HALF, "function of force", "default"),
    (3, HALF, "sampled", "Tsit5"),
    (3, HALF, "sampled", "PIDController"),
)
LONG = (
    (2, "engine_on_mounts", "sampled", "default"),
    (1, HALF, "sampled", "Kvaerno5"),
    (3, QUARTER, "half sine", "default"),
)  # to compile
CASES = [(i, *kind) for count, *kind in SHOCKS for i in range(count)]
CASES += [
    pytest.param(i, *kind, marks=pytest.mark.long) for count, *kind in LONG for i in range(count)
]


@pytest.mark.parametrize("seed", [*range(20), 313])  # 313: a second contact of 1 ms in steps of 1 s
def test_a_drop_turns_where_it_must_and_gains_no_energy(seed):
    drop = random_drops.random_drop(seed)
    assert random_drops.faults(random_drops.judged(drop)) == [], str(drop)


@pytest.mark.parametrize("seed, preset, given, solver", CASES)
def test_a_shock_after_quiet_is_not_missed(seed, preset, given, solver):
    """A function of time that JAX cannot look into may be missed where the run says so; nothing
    else may."""
    shock = random_shocks.random_shock(
        seed, preset, given, solver, layout="uneven", longest=25.0
    )  # of longer motions the program is optimized
    result = random_shocks.judged(shock)
    verdicts = ("right", "said") if given.startswith("function") else ("right",)
    assert result["verdict"] in verdicts, (str(shock), result)


STARTS = [(seed, ("car", "mass", "base")[seed % 3]) for seed in range(20)] + [
    pytest.param(7, "four_bar", marks=pytest.mark.long)
]


@pytest.mark.parametrize("seed, kind", STARTS)
def test_a_start_that_is_zero_up_to_rounding_moves(seed, kind):
    start = random_rests.random_start(seed, kind)
    assert random_rests.faults(random_rests.judged(start)) == [], str(start)


def test_a_stop_that_is_met_once_turns_a_fall_also_between_sparse_samples():
    """Down to 0.09 m, where m g (1 - z) is the energy k (d - w/2)^2/2 + k w^2/24 of the
    contact, d = 0.1 - z."""
    ball = jb.Model(
        bodies={"ball": jb.Body(10.0, position=[0, 0, 1.0])},
        joints={"ball": jb.Guide("world", axis="z")},
        elements={
            "floor": jb.Contact(
                ("ball", [0, 0, 0]), ("world", [0, 0, 0]), distance=0.1, stiffness=1e6
            )
        },
        gravity=[0, 0, -9.81],
    )
    run = jb.simulate(ball, np.linspace(0, 3, 3001))
    z, E = 1 + np.asarray(run.state.q)[:, 0], np.asarray(run.energies["total"])
    d, w = np.linspace(0.0, 0.1, 100001), 1e-3
    energy = np.where(
        d < w, 1e6 * d**3 / (6 * w), 1e6 * (d**2 / 2 - d * w / 2 + w**2 / 6)
    ) - 98.1 * (0.9 + d)
    assert z.min() > 0.1 - d[np.argmax(energy > 0)] - 1e-6 and z[1000:].max() > 0.9
    assert np.abs(E - E[0]).max() < 1e-6 * 98.1


PULSE = {"road": jb.inputs.HalfSine(50.0, 0.011, start=2.0).motion("z")}


@pytest.mark.nan
def test_what_a_run_cannot_resolve_is_named():
    car, times = jb.presets.quarter_car(), np.linspace(0, 4, 41)
    with pytest.warns(
        jb.JaxbodyWarning,
        match=(
            "MAX_STEPS.*at t = .*'(tyre|road|suspension)' changes most there, by .* "
            "N.*a larger max_steps"
        ),
    ):
        jb.simulate(car, times, motion=PULSE, max_steps=20)
    free = jb.Model(bodies={"m": jb.Body(1.0)}, joints={"m": jb.Guide("world", axis="z")})
    # without end at 1 s
    growing = {"f": jb.Force("m", force=lambda t: jnp.array([0.0, 0.0, 1e6]) / (1.0 - t) ** 2)}
    with pytest.warns(
        jb.JaxbodyWarning, match="DT_MIN.*a load, Force, on 'm' changes most there, by .*try dt0"
    ):
        jb.simulate(free, times, loads=growing)


def test_constant_steps_that_pass_over_a_pulse_warn():
    car, times, constant = (
        jb.presets.quarter_car(),
        np.linspace(0, 4, 41),
        diffrax.ConstantStepSize(),
    )
    with pytest.warns(
        jb.JaxbodyWarning,
        match=(
            r"0.02 s reach over what motion\['road'\] does in 0.011 s from t = 2 s.*STEP_TOO_LONG"
        ),
    ):
        jb.simulate(car, times, motion=PULSE, stepsize_controller=constant, dt0=0.02)
    jb.simulate(car, times, motion=PULSE, stepsize_controller=constant, dt0=0.011)
