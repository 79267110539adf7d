"""Times far from zero, such as Unix times: motions, steps, derivatives and fits are those of the
same run from zero.

All times are multiples of 1/128 s and START is a whole number, so that the times at START
are exact.
"""

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import rigs

import jaxbody as jb
from jaxbody.core.arrays import time_text
from jaxbody.geometry import rotations
from jaxbody.geometry.frames import Pose
from jaxbody.model.forces.force_elements import ForceInputs
from jaxbody.model.inputs.signals import Delayed, Samples, Sine

START = 1592423047.0
TIMES = np.arange(129) / 128
BEFORE = np.arange(-32, 161) / 128
UP = np.array([0, 0, 1.0])
ROWS = (
    2e-4
    * np.cumsum(
        np.convolve(np.random.default_rng(0).normal(size=len(BEFORE)), np.hanning(25), "same")
    )[:, None]
    * UP
)


def mass(stiffness=800.0):
    return rigs.on_shaken_base(stiffness)


def moved(motion):
    return {"motion": {"base": motion}}


def pushed(signal):
    return {"loads": {"push": jb.Force("mass", force=signal)}}


class Doubled(jb.Sampled):
    """A formula of its own on a motion that counts its samples from the first time."""

    def __call__(self, t):
        return super().__call__(t) * jnp.where((t > 1e9) | (t < 2.0), 2.0, 0.0)


class Pushing(jb.inputs.Load):
    """A load of its own, with a signal of the package."""

    push: Samples = jb.field()

    def at_point(self, now):
        return self.push(now.t), jnp.zeros(3)


class Halved(jb.Force):
    def at_point(self, now):
        F, M = super().at_point(now)
        return F / jnp.where(now.t > 1e9, 2.0, 2.0 + (now.t > 2.0)), M


EXACT = {
    "sampled": lambda t0: moved(jb.Sampled(t0 + BEFORE, translation=ROWS)),
    "accelerations": lambda t0: moved(
        jb.Sampled.from_accelerations(t0 + BEFORE, translation=100 * ROWS)
    ),
    "spline": lambda t0: moved(
        jb.inputs.Spline(
            t0 - 0.25,
            t0 + 1.25,
            interval=0.125,
            along=[UP],
            like=lambda t: 0.01 * jnp.zeros(6).at[2].set(jnp.sin(9 * (t - t0))),
        )
    ),
    "pulse": lambda t0: moved(jb.inputs.Trapezoid(10.0, 0.5, start=t0 + 0.25).motion("z")),
    "harmonic": lambda t0: moved(
        jb.Harmonic(
            frequency=[1, 2, 3, 4, 5, 6], translation=0.01 * UP, translation_phase=[0, 0, 0.4]
        )
    ),
    "sine": lambda t0: moved(Sine(amplitude=[0, 0, 0.01, 0, 0, 0], frequency=3.0, phase=0.4)),
    "road": lambda t0: moved(
        jb.inputs.Road(
            np.arange(32.0), 0.01 * np.cos(np.arange(32.0)), speed=16.0, position=8.0 - 16.0 * t0
        )
    ),
    "delays": lambda t0: moved(
        Delayed(jb.Sampled(t0 + BEFORE, translation=ROWS), 0.125)
        + Delayed(jb.inputs.HalfSine(10.0, 0.5, start=t0).motion("z"), 0.25)
    ),
    "hold": lambda t0: pushed(Samples(t0 + BEFORE[::32], 1e3 * ROWS[::32], kind="hold")),
    "linear": lambda t0: pushed(Samples(t0 + BEFORE, 1e3 * ROWS, kind="linear")),
    "cubic": lambda t0: pushed(Samples(t0 + BEFORE, 1e3 * ROWS, kind="cubic")),
    "unbalance": lambda t0: {
        "loads": {
            "rotor": jb.inputs.Unbalance("mass", axis="x", unbalance=0.01, frequency=4.0, phase=0.3)
        }
    },
}
ROUNDED = {
    "own motion": lambda t0: moved(Doubled(t0 + BEFORE, translation=ROWS)),
    "own load": lambda t0: {
        "loads": {"push": Pushing("mass", jnp.zeros(3), Samples(t0 + BEFORE, 1e3 * ROWS))}
    },
    "own force": lambda t0: {
        "loads": {"push": Halved("mass", force=Samples(t0 + BEFORE, 1e3 * ROWS))}
    },
}


LOADS = [
    jb.inputs.Unbalance("mass", axis="x", unbalance=0.01, frequency=4.0, run_up=0.7, phase=0.3),
    jb.inputs.EngineTorque(
        "mass",
        axis="x",
        frequency=2.3,
        mean=1.0,
        orders=[0.5, 2.0],
        amplitudes=[3.0, 4.0],
        phases=[0.1, 0.2],
    ),
    Pushing("mass", jnp.ones(3), Samples(BEFORE, ROWS)),
    Halved("mass", force=Samples(BEFORE, ROWS)),
    jb.Force(
        ("mass", [1, 2, 3]),
        force=lambda t: t * UP,
        moment=Sine(amplitude=[1, 2, 3], frequency=2.0),
        axes="body",
    ),
]


def shifted(part, value):
    """after(t0)(t) is the same function at t0 + t, also in its slope by t0."""
    t0, t, one = jnp.array(0.3), jnp.array(0.37), jnp.ones(())
    both = jax.jvp(lambda s: value(part.after(s), t), (t0,), (one,))
    known = jax.jvp(lambda s: value(part, s), (t0 + t,), (one,))
    np.testing.assert_allclose(both, known, rtol=1e-11, atol=1e-13)


def test_a_signal_and_a_load_after_a_time():
    frame = Pose(UP, rotations.exp(jnp.array([0.1, 0.2, 0.3]))).at_rest()
    inputs = [made(0.0) for made in (*EXACT.values(), *ROUNDED.values())]
    for signal in [given["motion"]["base"] for given in inputs if "motion" in given] + [
        LOADS[3].force,
        LOADS[4].force,
        LOADS[4].moment,
    ]:
        shifted(signal, lambda signal, t: signal(t))
    for load in LOADS:
        shifted(
            load,
            lambda load, t: jnp.concatenate(
                load.forces(ForceInputs((frame,), {}, jnp.zeros(0), t))[0]
            ),
        )


def run(t0, inputs, **options):
    return jb.simulate(mass(), t0 + TIMES, **inputs(t0), **options)


@pytest.mark.parametrize("case", EXACT)
def test_a_motion_and_its_steps_are_those_from_zero(case):
    zero, far = (run(t0, EXACT[case]) for t0 in (0.0, START))
    size = np.abs(zero.state.q).max()
    assert far.ok and size > 1e-5 and far.times[0] == START
    assert abs(far.statistics["num_accepted_steps"] - zero.statistics["num_accepted_steps"]) <= 2
    np.testing.assert_allclose(far.state.q, zero.state.q, rtol=0, atol=1e-7 * size)


@pytest.mark.parametrize("case", ROUNDED)
def test_functions_of_time_of_the_users_own_get_the_time_that_they_know(case):
    zero, far = (run(t0, ROUNDED[case], rtol=1e-5) for t0 in (0.0, START))
    np.testing.assert_allclose(
        far.state.q, zero.state.q, rtol=0, atol=2e-5 * np.abs(zero.state.q).max()
    )


@pytest.mark.long
@pytest.mark.parametrize(
    "options",
    [
        lambda t0: {"solver": diffrax.Tsit5()},
        lambda t0: {"stepsize_controller": diffrax.ConstantStepSize(), "dt0": 1 / 512},
        lambda t0: {
            "stepsize_controller": diffrax.ConstantStepSize(),
            "dt0": 1 / 512,
            "solver": jb.Gauss(),
        },
        lambda t0: {
            "stepsize_controller": diffrax.StepTo(jnp.asarray(t0 + np.arange(513) / 512)),
            "solver": diffrax.Tsit5(),
        },
        lambda t0: {
            "stepsize_controller": diffrax.ClipStepSizeController(
                diffrax.PIDController(rtol=1e-8, atol=1e-11), step_ts=jnp.asarray(t0 + TIMES[::16])
            )
        },
    ],
    ids=["Tsit5", "constant", "Gauss", "StepTo", "clipped"],
)
def test_every_way_to_integrate_counts_from_the_first_sample(options):
    zero, far = (run(t0, EXACT["delays"], **options(t0)) for t0 in (0.0, START))
    assert (
        far.ok
        and abs(far.statistics["num_accepted_steps"] - zero.statistics["num_accepted_steps"]) <= 2
    )
    np.testing.assert_allclose(
        far.state.q, zero.state.q, rtol=0, atol=1e-7 * np.abs(zero.state.q).max()
    )


@pytest.mark.long
def test_loops_far_from_zero():
    four_bar, times = jb.presets.four_bar(gravity=9.81), np.arange(65) / 128
    zero, far = (jb.simulate(four_bar, t0 + times, dt0=1e-3) for t0 in (0.0, START))
    np.testing.assert_allclose(far.state.q, zero.state.q, rtol=0, atol=1e-9)


@pytest.mark.long
@pytest.mark.parametrize("transform", [jax.jacfwd, jax.jacrev])
def test_derivatives_by_parameters_samples_and_times(transform):
    """By the stiffness, the samples of the motion and all times: of the samples and of the
    first one."""

    def ends(t0):
        def end(stiffness, values, sampled, times):
            motion = jb.Sampled(sampled, translation=values)
            return jb.simulate(mass(stiffness), times, motion={"base": motion}).state.q[
                jnp.array([40, -1]), 0
            ]

        return transform(end, (0, 1, 2, 3))(800.0, ROWS[::4], t0 + BEFORE[::4], t0 + TIMES)

    for zero, far in zip(ends(0.0), ends(START), strict=True):
        np.testing.assert_allclose(far, zero, rtol=0, atol=1e-6 * np.abs(zero).max())
        assert np.abs(zero).max() > 0


@pytest.mark.long
def test_a_base_motion_and_a_fit_of_a_record():
    """The record of an accelerometer on the base, integrated; the mass on it fitted."""
    sensors = {"a": jb.Acceleration("mass", axis=UP)}
    estimates, motions = [], []
    for t0 in (0.0, START):
        record = jb.Record(t0 + BEFORE, {"base": (1e4 * ROWS[:, 2] / 50, "m/s2")})
        motion = jb.inputs.base_motion(record, "base", axis=UP).motion
        measured = jb.measure(
            run(0.0, lambda _: moved(jb.Sampled(BEFORE, translation=ROWS))),
            sensors,
            noise=1e-3,
            key=jax.random.key(0),
        )
        experiment = jb.Experiment(
            t0 + TIMES,
            motion={"base": jb.Sampled(t0 + BEFORE, translation=ROWS)},
            sensors=sensors,
            measured=measured,
        )
        estimates.append(
            jb.fit(mass(700.0), {"run": experiment}, free=["spring.stiffness", "spring.damping"])
        )
        motions.append(np.asarray(jax.vmap(motion)(jnp.asarray(t0 + TIMES))))
    assert estimates[1].ok
    for name, value in estimates[0].estimates.items():
        np.testing.assert_allclose(estimates[1].estimates[name], value, rtol=1e-7)
    np.testing.assert_allclose(motions[1], motions[0], rtol=0, atol=1e-9 * np.abs(motions[0]).max())


def test_times_are_printed_with_the_digits_that_tell_them_apart():
    assert (
        time_text(0.25, TIMES) == "0.25"
        and time_text(2 / 3, TIMES) == "0.666667"
        and time_text(123.4567891, [100, 200]) == "123.457"
    )
    assert time_text(START + 0.40625, START + TIMES) == "1592423047.40625"
    assert time_text(START, [START]) == "1.59242e+09" and time_text(1.0, [-np.inf, 2.0]) == "1"
    motion = jb.Sampled(START + TIMES[:100], translation=ROWS[:100])
    with pytest.raises(
        jb.JaxbodyError,
        match=(
            r"covers 1592423047 to 1592423047.7734375 s, requested 1592423047 to "
            r"1592423048 s.*T_RANGE"
        ),
    ):
        jb.simulate(mass(), START + TIMES, motion={"base": motion})
    with pytest.raises(
        jb.JaxbodyError,
        match=r"goes back at index 2: 1592423047.0078125 s, then 1592423047 s.*UNSORTED_TIME",
    ):
        jb.simulate(mass(), START + TIMES[[0, 1, 0]])


@pytest.mark.nan
def test_a_failed_run_names_the_time_and_its_rounding():
    own = jb.signals.Function(lambda t: 0.1 * jnp.zeros(6).at[2].set(jnp.sin(40 * (t - START))))
    with pytest.warns(
        jb.JaxbodyWarning,
        match=r"MAX_STEPS.*at t = 15924230\d\d\.\d{3,} s of 1592423048 s.*rounded to 2.4e-07 s",
    ):
        jb.simulate(mass(), START + TIMES, motion={"base": own}, max_steps=200)


def test_times_that_float32_cannot_tell_apart_are_an_error():
    with jax.enable_x64(False):
        with pytest.raises(
            jb.JaxbodyError,
            match=(
                r"repeats in float32 at index 1: 1592423047 s, then 1592423047.0078125 "
                r"s.*subtract the first"
            ),
        ):
            jb.Sampled(START + TIMES, translation=ROWS[:129])
        record = jb.Record(START + TIMES, {"x": (ROWS[:129, 2], "m")})
        assert record.times[1] - record.times[0] == 1 / 128
