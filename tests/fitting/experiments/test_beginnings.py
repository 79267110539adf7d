"""Runs that start at rest on a displaced or moving base, or whose first part is left out, against
closed forms and a fit by SciPy."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.optimize
from rigs import plate
from scipy.integrate import solve_ivp

import jaxbody as jb
from jaxbody.mechanics.quasi_static_states import rest_state

G, MASS, NOISE = 9.81, 2.0, 1e-4
TRUTH = np.array([80.0, 3.0])
FREE = ["s.stiffness", "s.damping"]
TIMES = np.linspace(0.0, 3.0, 151)
AMPLITUDE, FREQUENCY, PHASE = 0.05, 0.9, 0.7
MOTION = {
    "base": jb.Harmonic(frequency=FREQUENCY, translation=[0, 0, AMPLITUDE], translation_phase=PHASE)
}
SENSORS = {"x": jb.Position("box", axis=[0, 0, 1])}


def box(values=TRUTH, mass=MASS):
    """A box that goes up and down on a spring over a base, relaxed in the reference pose."""
    return jb.Model(
        bodies={"box": jb.Body(mass=mass, inertia=[1, 1, 1])},
        supports={"base": jb.Support()},
        joints={"box": jb.Guide("world", axis=[0, 0, 1])},
        elements={
            "s": jb.Spring(
                ("box", [0, 0, 0]),
                ("base", [0, 0, -1]),
                stiffness=values[0],
                free_length=1.0,
                damping=values[1],
            )
        },
        gravity=[0, 0, -G],
    )


def base(t):
    w = 2 * np.pi * FREQUENCY
    return AMPLITUDE * np.cos(w * t + PHASE), -w * AMPLITUDE * np.sin(w * t + PHASE)


def independent(values, start="rest"):
    """x'' = -g + (k (z - x) + c (z' - x'))/m, from the sag on the displaced base and its speed, or
    from another state."""
    k, c = values
    z, speed = base(0.0)
    y0 = [z - MASS * G / k, speed] if start == "rest" else start

    def rate(t, y):
        z, speed = base(t)
        return [y[1], -G + (k * (z - y[0]) + c * (speed - y[1])) / MASS]

    return solve_ivp(
        rate, (0, TIMES[-1]), y0, method="DOP853", rtol=1e-12, atol=1e-13, t_eval=TIMES
    ).y[0]


def run(x, **options):
    return {
        "run": jb.Experiment(TIMES, motion=MOTION, sensors=SENSORS, measured={"x": x}, **options)
    }


def values_of(result):
    return np.array([float(result.estimates[path]) for path in FREE])


def noisy(x, seed=0):
    return x + NOISE * np.random.default_rng(seed).normal(size=len(x))


def optimum(residual):
    result = scipy.optimize.least_squares(
        lambda u: residual(np.exp(u)),
        np.log(TRUTH),
        jac="3-point",
        xtol=1e-15,
        ftol=1e-15,
        gtol=1e-15,
    )
    return np.exp(result.x)


def test_a_simulation_at_rest_begins_in_the_sag_on_the_displaced_base_with_its_speed():
    result = jb.simulate(box(), TIMES, motion=MOTION, initial="rest")
    z, speed = base(0.0)
    np.testing.assert_allclose(
        [result.state.q[0, 0], result.state.v[0, 0]], [z - MASS * G / TRUTH[0], speed], rtol=1e-12
    )
    np.testing.assert_allclose(result.poses["box"].p[:, 2], independent(TRUTH), atol=1e-8)


@pytest.mark.long
def test_rest_on_a_base_that_is_turned_and_moves_is_carried_along_rigidly():
    """About the vertical and along: elongations are those of the equilibrium on the base in its
    reference pose, and none changes."""
    model = plate(damping=1.0)
    shaking = {
        "base": jb.Harmonic(
            frequency=0.5,
            translation=[0.3, 0.1, -0.2],
            rotation=[0, 0, 0.6],
            translation_phase=[0.2, 0.1, 0.4],
            rotation_phase=0.3,
        )
    }
    result, eq = (
        jb.simulate(model, [0.0, 1e-3], motion=shaking, initial="rest"),
        jb.equilibrium(model),
    )
    for name, e in eq.elongations.items():
        np.testing.assert_allclose(result.elongations[name][0], e, atol=1e-9)
    xi, rate = jax.jvp(shaking["base"], (jnp.array(0.0),), (jnp.array(1.0),))
    np.testing.assert_allclose(result.state.v[0, 3:], rate[3:], atol=1e-9)
    # from the origin of the base, which was at zero
    arm = np.asarray(result.state.q[0, :3]) - np.asarray(xi[:3])
    np.testing.assert_allclose(result.state.v[0, :3], rate[:3] + np.cross(rate[3:], arm), atol=1e-9)


@pytest.mark.long
def test_derivatives_at_rest_are_those_of_the_closed_form_in_both_modes():
    """x(0) = z - m g/k: its derivative with respect to k is m g/k^2; the speed is that of the base
    for any k."""
    t, motions = jnp.array(0.0), tuple(MOTION.values())

    def first(k):
        state = rest_state(jb.replace(box(), {"s.stiffness": k}), motions, t)[0]
        return jnp.concatenate([state.q, state.v])

    k = jnp.asarray(TRUTH[0])
    for slope in jax.jit(lambda k: (jax.jacfwd(first)(k), jax.jacrev(first)(k)))(k):
        np.testing.assert_allclose(slope, [MASS * G / k**2, 0.0], rtol=1e-9, atol=1e-12)


@pytest.mark.long
def test_the_gradient_of_a_motion_that_begins_at_rest_is_that_of_differences():
    """The rest state moves with the stiffness, and all that follows."""

    def squares(k):
        return jnp.sum(
            jb.simulate(
                jb.replace(box(), {"s.stiffness": k}), TIMES[:6], motion=MOTION, initial="rest"
            ).state.q
            ** 2
        )

    low, high = (np.sum(independent((TRUTH[0] + h, TRUTH[1]))[:6] ** 2) for h in (-0.01, 0.01))
    result = jb.jit(jax.grad(squares))(jnp.asarray(TRUTH[0]))
    np.testing.assert_allclose(result, (high - low) / 0.02, rtol=1e-6)


@pytest.mark.long
def test_a_fit_at_rest_moves_the_rest_state_with_its_parameters():
    """SciPy's optimum with the sag m g/k following k; a state that stays at the sag of the start
    leads elsewhere."""
    record = noisy(independent(TRUTH))
    start = box(TRUTH * [1.2, 0.7])
    result = jb.fit(start, run(record, initial="rest"), free=FREE, rtol=1e-11)
    expected = optimum(lambda p: (independent(p) - record) / NOISE)
    np.testing.assert_allclose(values_of(result), expected, rtol=1e-7)
    assert result.ok and not result.remarks


@pytest.mark.long
def test_what_is_left_out_of_the_beginning_does_not_count():
    """A knock in the first half second: with it left out the optimum is that of the samples
    after it."""
    knock = np.where(TIMES < 0.5, 0.02 * np.sin(20 * TIMES), 0.0)
    record = noisy(independent(TRUTH)) + knock
    late = run(record, initial="rest", leave_out=0.5)
    result = jb.fit(box(TRUTH * [1.1, 0.8]), late, free=FREE, rtol=1e-11)
    kept = TIMES >= 0.5
    expected = optimum(lambda p: ((independent(p) - record) / NOISE)[kept])
    np.testing.assert_allclose(values_of(result), expected, rtol=1e-7)
    assert (
        result.uncertainty.samples == kept.sum() and np.isnan(late["run"].measured["x"][:25]).all()
    )


@pytest.mark.parametrize("leave_out", [-1.0, 3.0, "0.5", np.nan, True])
def test_a_beginning_that_cannot_be_left_out_is_refused(leave_out):
    with pytest.raises(
        jb.JaxbodyError, match=r"Experiment.leave_out: is .* less than the 3 s of the record"
    ) as caught:
        run(TIMES, leave_out=leave_out)
    assert caught.value.code == "BAD_NUMBER"


@pytest.mark.long
def test_a_fit_that_begins_far_off_says_that_rest_would_do_better():
    """From the reference pose, 5 cm and a sag away from where the box stood."""
    record = noisy(independent(TRUTH))
    with pytest.warns(jb.JaxbodyWarning) as caught:
        result = jb.fit(box(), run(record), free=FREE)
    # the motion that follows explains less than half of the record
    (far,) = [w.message for w in caught if w.message.code == "FAR_OFF"]
    assert (
        not result.ok
        and "'run' begins" in str(far)
        and 'with initial="rest" only' in str(far)
        and "start it in equilibrium on its base" in str(far)
    )
    assert result.remarks[-1] in str(result)


@pytest.mark.long
def test_a_fit_to_a_recorded_base_motion_says_that_rest_would_do_better():
    """A base recorded by its accelerometer begins a few millimeters off its reference pose; an
    accelerometer on the box, which stood there, shows a transient, and estimates take it up."""
    times, rng = np.arange(0, 8, 0.02), np.random.default_rng(1)
    shaking = sum(
        0.3 * rng.normal() * np.sin(2 * np.pi * (0.5 + 0.2 * i) * times + rng.uniform(0, 6))
        for i in range(20)
    )
    motion = {
        "base": jb.inputs.base_motion(
            jb.Record(times, {"acc": (shaking, "m/s2")}), "acc", axis=[0, 0, 1]
        ).motion
    }
    assert 1e-3 < abs(float(motion["base"](jnp.array(0.0))[2])) < 0.02
    sensors = {"acc": jb.Accelerometer("box", axis=[0, 0, 1])}
    truth = box([80.0, 1.0])
    read = jb.measure(
        jb.simulate(truth, times, motion=motion, initial="rest"),
        sensors,
        noise=0.02,
        key=jax.random.key(0),
    )
    relaxed = jb.replace(
        truth, {"s.free_length": 1.0 + MASS * G / 80.0, "s.stiffness": 85.0}
    )  # its reference pose is at rest, but for the base
    with pytest.warns(jb.JaxbodyWarning) as caught:
        jb.fit(
            relaxed,
            {"run": jb.Experiment(times, motion=motion, sensors=sensors, measured=read)},
            free=FREE,
        )
    assert any(
        w.message.code == "INITIAL_TRANSIENT" and 'initial="rest"' in str(w.message) for w in caught
    )
    result = jb.fit(
        relaxed,
        {
            "run": jb.Experiment(
                times, motion=motion, sensors=sensors, measured=read, initial="rest"
            )
        },
        free=FREE,
    )
    assert not result.remarks and not any(result.uncertainty.orders.values())
    for path, value in zip(FREE, (80.0, 1.0), strict=True):
        assert abs(float(result.estimates[path]) - value) < 4 * float(result.standard_errors[path])


@pytest.mark.long
def test_a_fit_that_begins_far_off_at_rest_says_what_to_leave_out():
    """The box was knocked: neither rest nor the reference pose is where it begins, and the knock
    dies away with the damper."""
    z, speed = base(0.0)
    model = box([80.0, 12.0])
    record = noisy(independent([80.0, 12.0], start=[z - MASS * G / 80.0 + 0.1, speed]))
    with pytest.warns(jb.JaxbodyWarning) as caught:
        jb.fit(model, run(record, initial="rest"), free=FREE)
    (far,) = [str(w.message) for w in caught if w.message.code == "INITIAL_TRANSIENT"]
    seconds = float(far.split("leave_out=")[1].split()[0])
    assert 0.5 < seconds <= 1.6 and "rest" not in far


@pytest.mark.long
def test_rest_where_there_is_none_is_said_before_and_in_a_fit():
    loose = jb.Model(
        bodies={"box": jb.Body(mass=1.0, inertia=[1, 1, 1])},
        joints={"box": jb.Guide("world", axis=[0, 0, 1])},
        gravity=[0, 0, -G],
    )
    with pytest.raises(
        jb.JaxbodyError, match='is "rest", but there is no equilibrium: NO_EQUILIBRIUM'
    ):
        jb.simulate(loose, TIMES, initial="rest")
    track = jb.Experiment(TIMES, sensors=SENSORS, measured={"x": TIMES}, initial="rest")
    with pytest.raises(jb.JaxbodyError, match='is "rest", but there is no equilibrium') as caught:
        jb.fit(loose, {"run": track}, free=["box.mass"])
    assert caught.value.code == "NONFINITE_START"
    with pytest.raises(
        jb.JaxbodyError, match="begins at rest, which follows from the model: give it initial=State"
    ):
        jb.fit(box(), run(TIMES, initial="rest"), free=["run.initial.q"])
    with pytest.raises(jb.JaxbodyError, match="is a str"):
        jb.simulate(box(), TIMES, initial="at rest")
