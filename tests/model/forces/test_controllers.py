"""Controllers and drives: linear loops against closed forms, sampled ones against exact recursions,
limits, lags and delays, derivatives, bad input."""

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from controlled_cars import (
    OUTPUTS,
    ROAD,
    SPEED,
    WHITE,
    mass_on_drive,
    quarter_car,
    white_rms,
)
from scipy.integrate import solve_ivp

import jaxbody as jb

# REFERENCES2 3.2: rms of body acceleration, travel and tyre deflection by the skyhook's damping
SKYHOOK = {
    0.0: (0.629334190, 0.006743822, 0.002733093),
    1000.0: (0.568430844, 0.005413706, 0.002738455),
    2000.0: (0.545410749, 0.005456071, 0.002773294),
    4000.0: (0.522524753, 0.006334500, 0.002874029),
}


def linear(model, at=None):
    return jb.linearize(model, model.reference if at is None else at)


def poles_of(model):
    """The eigenvalues of A of the state space, without the road's integrator."""
    inputs = {"u": jb.Command("drive")}
    s = linear(model).state_space(inputs, {"u": jb.sensors.DriveCommand("drive")})
    return np.sort_complex(np.linalg.eigvals(np.asarray(s.A)))


@pytest.mark.everywhere
@pytest.mark.parametrize("damping", SKYHOOK)
def test_a_skyhook_actuator_gives_the_published_rms(damping):
    lin = linear(quarter_car(law=jb.control.skyhook(damping)))
    rms = white_rms(lin, ROAD, OUTPUTS, WHITE)
    # nine digits after the point of the acceleration are printed, nine of the others
    np.testing.assert_allclose(rms, SKYHOOK[damping], atol=6e-10)


def test_no_force_between_the_masses_changes_the_invariant_points():
    w1, w2 = np.sqrt(190e3 / 60), np.sqrt(190e3 / 360)
    for law in (jb.control.skyhook(3000.0), jb.control.PID(2e3, 1e3, 40.0)):
        lin = linear(quarter_car(law=law))
        H = jb.frequency_response(lin, np.array([w1, w2]) / 2 / np.pi, ROAD, OUTPUTS)
        assert abs(H["acceleration", "road"][0] + 11.254628677423j) < 1e-9
        # from the wheel to the body, so that the sign is that of xb - xw
        assert abs(H["travel", "road"][1] - 0.052234290007921j) < 1e-11


def test_passive_poles_are_those_of_the_published_car():
    expected = [-1.4318178582 + 6.9139600323j, -8.5681821418 + 57.5701977670j]
    poles = poles_of(quarter_car())
    for pole in expected:
        assert np.abs(poles - pole).min() < 1e-9


def test_one_freedom_on_a_skyhook():
    m, k, c, W = 300.0, 16e3, 3e3, 0.01  # REFERENCES2 3.1
    model = jb.Model(
        bodies={"body": jb.Body(mass=m, position=[0, 0, 1.0])},
        supports={"road": jb.Support()},
        joints={"body": jb.Guide("world", axis=[0, 0, 1])},
        elements={
            "spring": jb.Spring("road", "body", stiffness=k, free_length=1.0),
            "drive": jb.Actuator("road", "body"),
        },
        controllers={"ride": jb.Controller(SPEED, "drive", jb.control.skyhook(c))},
    )
    outputs = {name: OUTPUTS[name] for name in ("acceleration", "travel")}
    rms = white_rms(linear(model), ROAD, outputs, W)
    np.testing.assert_allclose(rms**2, [1.422222222222, 0.0014375], rtol=1e-11)


def test_groundhook_is_a_damper_between_wheel_and_ground():
    law, reads = jb.control.groundhook(900.0), {"speed": jb.Velocity("wheel", axis="z")}
    C = np.asarray(linear(quarter_car(law=law, reads=reads)).C)
    passive = np.asarray(linear(quarter_car()).C)
    np.testing.assert_allclose(C - passive, [[0, -900.0], [0, 900.0]], atol=1e-12)


def test_a_law_may_read_the_force_of_a_drive_with_a_bandwidth():
    """Force feedback: m x'' + k x = F, F' = w (-g F - F), of which the pole w (1 + g) is apart."""
    g, f, below = 2.0, 4.0, ("world", [0, 0, -1.0])
    law, reads = jb.control.skyhook(g), {"F": jb.sensors.DriveForce("drive")}
    slow = jb.Actuator(below, "m", bandwidth=f)
    model = mass_on_drive(law, reads, slow, stiffness=100.0)
    assert np.abs(poles_of(model) + 2 * np.pi * f * (1 + g)).min() < 1e-10
    asked = {"u": jb.sensors.DriveCommand("drive")}
    for drive, each in ((None, reads), (None, asked), (slow, asked)):
        with pytest.raises(jb.JaxbodyError, match="-> command -> drive") as e:
            mass_on_drive(law, each, drive, stiffness=100.0)
        assert e.value.code == "ALGEBRAIC_LOOP"


def test_the_command_of_a_law_that_reads_accelerations_is_measured():
    reads = {"a": jb.Acceleration("m", axis="z")}
    drive = jb.Actuator(("world", [0, 0, -1.0]), "m", bandwidth=8.0)
    model = mass_on_drive(jb.control.skyhook(5.0), reads, drive, stiffness=400.0)
    start = jb.State(jnp.array([0.1]), jnp.array([0.0]), jnp.zeros(1))
    run = jb.simulate(model, np.linspace(0, 0.2, 5), initial=start)
    seen = jb.measure(run, reads | {"u": jb.sensors.DriveCommand("drive")})
    np.testing.assert_allclose(seen["u"], -5.0 * seen["a"], rtol=1e-12)


def test_another_law_takes_the_place_of_a_law():
    model = jb.replace(
        quarter_car(law=jb.control.skyhook(1.0)), {"ride.law": jb.control.PID(900.0)}
    )
    expected = quarter_car(law=jb.control.PID(900.0))
    np.testing.assert_array_equal(linear(model).C, linear(expected).C)
    assert model.layout.states == ("ride, integral", "ride, filtered error")


def test_a_command_is_the_input_of_a_force_between_the_ends():
    lin = linear(quarter_car())
    ends = {name: jb.PointForce(name, direction="z") for name in ("body", "wheel")}
    s = lin.state_space({"u": jb.Command("drive"), **ends}, OUTPUTS)
    for X in (np.asarray(s.B), np.asarray(s.D)):
        np.testing.assert_allclose(X[:, 0], X[:, 1] - X[:, 2], atol=1e-15)
    slow = linear(quarter_car(jb.Actuator("wheel", "body", bandwidth=5.0)))
    H = jb.frequency_response(slow, np.array([2.0]), {"u": jb.Command("drive")}, OUTPUTS)
    quick = jb.frequency_response(lin, np.array([2.0]), {"u": jb.Command("drive")}, OUTPUTS)
    np.testing.assert_allclose(H.values, quick.values / (1 + 2j / 5), rtol=1e-12)


def test_a_lag_of_a_sensor_is_a_state():
    T, c = 0.03, 900.0
    law = jb.control.skyhook(c)
    lagged = {"speed": jb.Velocity("m", axis="z", lag=T, gain=2.0)}
    model = mass_on_drive(law, lagged, mass=3.0, stiffness=2000.0)
    assert model.layout.states == ("law, speed filtered 1",)
    # 3 s^2 + 2000 + 2 c s/(1 + T s)
    expected = np.roots(np.polyadd(np.polymul([3.0, 0, 2000.0], [T, 1]), [0, 2 * c, 0]))
    np.testing.assert_allclose(poles_of(model), np.sort_complex(expected), rtol=1e-11)


@pytest.mark.parametrize("order", [1, 2, 5])
def test_a_delay_is_a_pade_form_of_stated_order(order):
    control, (d, T, c) = pytest.importorskip("control"), (0.05, 0.02, 25.0)
    sensor = {"speed": jb.Velocity("m", axis="z", delay=d, lag=T)}
    model = mass_on_drive(jb.control.skyhook(c), sensor, mass=3.0, stiffness=2000.0, pade=order)
    num, den = control.pade(d, order)
    expected = np.roots(
        np.polyadd(np.polymul(np.polymul([3.0, 0, 2000.0], [T, 1]), den), np.polymul([c, 0], num))
    )
    found, expected = poles_of(model), np.sort_complex(expected)
    # coefficients of the form span many powers of ten at order 5
    np.testing.assert_allclose(found, expected, rtol=1e-9)


def test_a_law_may_read_accelerations_of_a_drive_with_a_bandwidth():
    k, f, gain = 2000.0, 8.0, 5.0

    class Accelerations(jb.control.ControlLaw):
        gain: jax.Array

        def command(self, now):
            return -self.gain * now.readings["a"]

    reads = {"a": jb.Acceleration("m", axis="z")}
    drive = jb.Actuator(("world", [0, 0, -1.0]), "m", bandwidth=f)
    model = mass_on_drive(Accelerations(jnp.array(gain)), reads, drive, mass=3.0, stiffness=k)
    w = 2 * np.pi * f  # 3 s^2 + k + gain s^2 w/(s + w)
    expected = np.roots(np.polyadd(np.polymul([3.0, 0, k], [1, w]), [gain * w, 0, 0]))
    np.testing.assert_allclose(poles_of(model), np.sort_complex(expected), rtol=1e-11)
    with pytest.raises(jb.JaxbodyError, match=r"law.command -> acceleration -> reads\['a'\]") as e:
        mass_on_drive(Accelerations(jnp.array(gain)), reads)
    assert e.value.code == "ALGEBRAIC_LOOP"
    reads = {"x": jb.Position("m", axis="z")} | reads
    with pytest.raises(jb.JaxbodyError, match=r"law.command -> acceleration -> reads\['a'\]"):
        mass_on_drive(jb.control.state_feedback([[1.0, 2.0]]), reads)


@pytest.mark.parametrize("equations", ["structured", "lagrange"])
def test_limits_of_force_and_rate_against_scipy(equations):
    f, most, fastest, k = 6.0, 40.0, 900.0, 400.0
    drive = jb.Actuator(("world", [0, 0, -1.0]), "m", bandwidth=f, limit=most, rate=fastest)
    model = mass_on_drive(jb.control.state_feedback([[900.0, 30.0]]), None, drive, stiffness=k)
    times = np.linspace(0, 0.6, 31)
    start = jb.State(jnp.array([0.2]), jnp.array([0.0]), jnp.zeros(1))
    run = jb.simulate(model, times, initial=start, rtol=1e-10, equations=equations)

    def rate(t, y):
        x, v, F = y
        asked = np.clip(-900 * x - 30 * v, -most, most)
        return [v, F - k * x, np.clip(2 * np.pi * f * (asked - F), -fastest, fastest)]

    exact = solve_ivp(rate, (0, 0.6), [0.2, 0, 0], "DOP853", times, rtol=1e-11, atol=1e-12).y
    np.testing.assert_allclose(run.state.q[:, 0], exact[0], atol=2e-9)
    np.testing.assert_allclose(run.state.z[:, 0], exact[2], atol=2e-6)
    force = jb.measure(run, {"F": jb.sensors.DriveForce("drive")})["F"]
    np.testing.assert_allclose(force, run.state.z[:, 0], rtol=0)
    assert np.abs(force).max() < most + 1e-9


def test_a_limited_rate_does_not_hold_an_equilibrium():
    """The rate of the start is far above its limit, which does not matter at rest."""
    drive = jb.Actuator(("world", [0, 0, -1.0]), "m", bandwidth=5.0, rate=1.0, limit=500.0)
    law, reads = jb.control.PID(50.0, 0.0, 10.0, target=0.1), {"x": jb.Position("m", axis="z")}
    eq = jb.equilibrium(mass_on_drive(law, reads, drive, stiffness=1e3))
    assert abs(eq.state.q[0] - 1 / 210) < 1e-12 and eq.status == jb.Status.OK


def test_an_integral_levels_and_waits_at_its_limits():
    pid = jb.control.PID(3e3, 8e3, 300.0, low=-50.0, high=50.0, reset=0.2, target=0.01)
    reads = {"x": jb.Position("m", axis="z")}
    model = jb.replace(
        mass_on_drive(pid, reads, mass=2.0, stiffness=1e3), {"gravity": [0, 0, -9.0]}
    )
    eq = jb.equilibrium(model)
    assert abs(eq.state.q[0] - 0.01) < 1e-12
    assert abs(eq.state.z[0] - 28.0) < 1e-9  # 2 x 9 N + 1000 N/m x 0.01 m
    times = np.linspace(0, 1.0, 21)

    def rate(t, y):
        x, v, w, s = y
        e = 0.01 - x
        d = (e - s) / 0.01
        asked = 3e3 * e + w + 300 * d
        u = np.clip(asked, -50, 50)
        return [v, (u - 1e3 * x - 18) / 2, 8e3 * e + (u - asked) / 0.2, d]

    start = jb.State(jnp.array([-0.05]), jnp.zeros(1), jnp.zeros(2))
    run = jb.simulate(model, times, initial=start, rtol=1e-10)
    exact = solve_ivp(rate, (0, 1), [-0.05, 0, 0, 0], "DOP853", times, rtol=1e-11, atol=1e-12).y
    np.testing.assert_allclose(run.state.q[:, 0], exact[0], atol=1e-9)


@pytest.mark.long
@pytest.mark.parametrize(
    ("soft", "hard", "rms"),
    [(300, 3000, 0.56895), (300, 300, 1.893555), (3000, 3000, 0.6584666)],
)
def test_the_on_off_skyhook_of_the_references(soft, hard, rms):
    """REFERENCES3 5: periodic motion over a road 0.01 sin(2 pi 1.3 t), found there by split
    events to 2e-5; the tolerance asked for is 5e-4."""
    damper = jb.forces.ControlledDamper("wheel", "body", soft=float(soft), hard=float(hard))
    model = quarter_car(
        damper, jb.control.on_off_skyhook(), mb=300.0, mw=40.0, ks=18e3, bs=0.0, kt=180e3
    )
    period, samples = 1 / 1.3, 400
    times = np.concatenate([[0.0], 30 * period + np.arange(samples) * period / samples])
    road = jb.Harmonic(frequency=1.3, translation=[0, 0, 0.01])
    run = jb.simulate(model, times, motion={"road": road}, rtol=1e-6)
    a = np.asarray(jb.measure(run, {"a": OUTPUTS["acceleration"]})["a"])[1:]
    assert abs(np.sqrt(np.mean(a**2)) - rms) < 5e-4


def test_a_controlled_damper_takes_only_what_it_can_dissipate():
    damper = jb.forces.ControlledDamper(
        "wheel", "body", soft=jb.laws.TwoSided(bump=200.0, rebound=400.0), hard=4000.0
    )
    model = quarter_car(damper, jb.control.skyhook(3000.0), bs=0.0)
    road = jb.Harmonic(frequency=1.5, translation=[0, 0, 0.02])
    run = jb.simulate(model, np.linspace(0, 2, 201), motion={"road": road}, rtol=1e-6)
    seen = jb.measure(
        run, {"F": jb.sensors.DriveForce("drive"), "u": jb.sensors.DriveCommand("drive")}
    )
    v = np.asarray(run.state.v)
    rate, F, u = v[:, 0] - v[:, 1], np.asarray(seen["F"]), np.asarray(seen["u"])
    soft = np.where(rate < 0, 200.0, 400.0) * rate
    expected = -np.clip(-u, np.minimum(soft, 4000 * rate), np.maximum(soft, 4000 * rate))
    np.testing.assert_allclose(F, expected, atol=1e-9)
    assert (F * rate <= 0).all() and np.ptp(F) > 100
    C = np.asarray(linear(model).C)  # about rest the mean of both curves, no command
    assert C[0, 0] == pytest.approx((300.0 + 4000.0) / 2, rel=0.1)


def recursion(K, T, delay, steps):
    """A unit mass under u = -K (x, v) of the last sample; exact, as u is held."""
    x, u, out = np.array([0.3, -0.2]), 0.0, []

    def after(x, u, h):
        return np.array([x[0] + h * x[1] + u * h * h / 2, x[1] + h * u])

    for _ in range(steps):
        computed = -float(np.dot(K, x))
        first = 0.0 if delay is None else delay
        x = after(after(x, u, first), computed, T - first)
        u = computed
        out.append(x)
    return np.array(out)


@pytest.mark.everywhere
@pytest.mark.parametrize("delay", [None, 0.03, 0.1])
def test_sampled_feedback_is_held_and_delayed_exactly(delay):
    K, T = [10.0, 5.0], 0.1
    model = mass_on_drive(jb.control.state_feedback([K]), every=T, delay=delay)
    start = jb.State(jnp.array([0.3]), jnp.array([-0.2]))
    run = jb.simulate(model, np.arange(7) * T, initial=start)
    x = np.stack([run.state.q[:, 0], run.state.v[:, 0]], 1)[1:]
    np.testing.assert_allclose(x, recursion(K, T, delay, 6), atol=1e-13)


def test_limits_of_sampled_feedback():
    """REFERENCES3 5: (100, 15) is dead-beat, (10, 5) contracts by 0.7416198487 a sample; stable
    iff kd < 2/T and kp T < 2 kd."""
    T = 0.1
    model = mass_on_drive(jb.control.state_feedback([[1.0, 1.0]]), every=T)

    def after(K, x, samples):
        here = jb.replace(model, {"law.law.D": -jnp.array([K])})
        start = jb.State(jnp.array(x[:1]), jnp.array(x[1:]))
        run = jb.simulate(here, np.arange(samples + 1) * T, initial=start)
        return np.array([run.state.q[-1, 0], run.state.v[-1, 0]])

    def radius(K):
        A = np.stack([after(K, np.eye(2)[i], 1) for i in range(2)], 1)
        return np.abs(np.linalg.eigvals(A)).max()

    assert np.abs(after([100.0, 15.0], [0.3, -0.2], 2)).max() < 1e-13
    assert abs(radius([10.0, 5.0]) - 0.7416198487) < 1e-10
    for kp, kd in ((100.0, 20.0), (200.0, 10.0)):  # on the two limits
        assert abs(radius([kp, kd]) - 1) < 1e-12
        assert radius([0.999 * kp if kd < 20 else kp, 0.999 * kd if kd == 20 else kd]) < 1


@pytest.mark.long
def test_derivatives_through_sampled_loops():
    start = jb.State(jnp.array([0.3]), jnp.array([-0.2]))
    model = mass_on_drive(
        jb.control.state_feedback([[10.0, 5.0]]), stiffness=20.0, every=0.1, delay=0.02
    )

    @jax.jit
    def end(p):
        here = jb.replace(
            model, {"law.law.D": p[:2][None], "spring.stiffness": p[2], "m.mass": p[3]}
        )
        return jb.simulate(here, np.linspace(0, 0.35, 3), initial=start, rtol=1e-11).state.q[-1, 0]

    p = jnp.array([-10.0, -5.0, 20.0, 1.0])
    reverse, forward = jax.grad(end)(p), jax.jacfwd(end)(p)
    np.testing.assert_allclose(reverse, forward, rtol=1e-9, atol=1e-12)
    steps = 1e-4 * np.diag(np.abs(p))
    central = [(end(p + h) - end(p - h)) / (2 * h.max()) for h in steps]
    np.testing.assert_allclose(forward, central, rtol=1e-6, atol=1e-9)


def test_a_sampled_integral_is_at_rest_where_the_next_sample_leaves_it():
    pid = jb.control.PID(3e3, 8e3, 300.0, target=0.01)
    reads = {"x": jb.Position("m", axis="z")}
    model = mass_on_drive(pid, reads, mass=2.0, stiffness=1e3, every=0.01, delay=0.004)
    eq = jb.equilibrium(model)
    np.testing.assert_allclose([eq.state.q[0], *eq.state.z], [0.01, 10, 0, 10, 10], atol=1e-9)
    run = jb.simulate(model, np.linspace(0, 0.5, 6), initial="rest")
    np.testing.assert_allclose(run.state.q[:, 0], 0.01, atol=1e-9)


def test_what_sampled_loops_refuse_and_warn_of():
    model = mass_on_drive(jb.control.state_feedback([[10.0, 5.0]]), every=0.1)
    times, start = np.linspace(0, 1, 3), model.reference
    calls = [
        lambda: jb.linearize(model, start),
        lambda: jb.linearize(model, start, method="definition"),
        lambda: jb.equations_of_motion(model),
        lambda: jb.simulate(model, times, dt0=0.01, stepsize_controller=diffrax.ConstantStepSize()),
    ]
    for call in calls:
        with pytest.raises(jb.JaxbodyError) as e:
            call()
        assert e.value.code == "SAMPLED" and "law" in str(e.value)
    slow = mass_on_drive(jb.control.state_feedback([[1.0, 1.0]]), stiffness=4000.0, every=0.1)
    with pytest.warns(jb.JaxbodyWarning, match="'law' samples each 0.1 s.*SLOW_SAMPLING"):
        jb.simulate(slow, times)


class Net(jb.control.ControlLaw):
    """A network between the readings and the command."""

    net: eqx.nn.MLP

    def command(self, now):
        return self.net(jnp.stack([now.readings["x"], now.readings["v"]]))


@pytest.mark.long
def test_a_network_is_a_law_and_is_tuned_with_the_plant():
    net = eqx.nn.MLP(2, 1, 4, 1, activation=jnp.tanh, key=jax.random.key(0))
    model = mass_on_drive(Net(net), stiffness=50.0)
    start = jb.State(jnp.array([0.3]), jnp.array([0.0]))

    def wandering(model):
        run = jb.simulate(model, np.linspace(0, 1, 21), initial=start, rtol=1e-6)
        return {"wandering": jnp.mean(run.state.q**2)}

    before = float(wandering(model)["wandering"])
    with pytest.warns(jb.JaxbodyWarning, match="NOT_CONVERGED"):  # five iterations do for this
        tuned = jb.tune(
            model,
            wandering,
            free=["law.law.net.layers.*.weight", "spring.stiffness"],
            minimize="wandering",
            max_iterations=5,
        )
    assert float(wandering(tuned.model)["wandering"]) < 0.8 * before


def test_fit_frees_gains_like_any_parameter():
    law = jb.control.state_feedback([[300.0, 25.0]])
    model = mass_on_drive(law, stiffness=100.0)
    times, start = np.linspace(0, 1, 51), jb.State(jnp.array([0.1]), jnp.array([0.0]))
    sensors = {"x": jb.Position("m", axis="z")}
    data = jb.measure(jb.simulate(model, times, initial=start), sensors)
    rng = np.random.default_rng(1)
    noisy = {"x": np.asarray(data["x"]) + 1e-5 * rng.normal(size=51)}
    run = jb.Experiment(times, sensors=sensors, measured=noisy, initial=start)
    guess = jb.replace(model, {"law.law.D": jnp.array([[-200.0, -40.0]])})
    fit = jb.fit(guess, {"run": run}, free=["law.law.D"])
    found, error = np.asarray(fit.model["law"].law.D).ravel(), 4 * 25.0 * 1e-3
    np.testing.assert_allclose(found, [-300.0, -25.0], rtol=0.01, atol=error)


def test_bad_input_of_controllers_and_drives():
    law, skyhook = jb.control.state_feedback([[1.0, 2.0]]), jb.control.skyhook(1.0)
    ends = ("world", [0, 0, -1.0]), "m"
    cases = {
        "UNKNOWN_NAME": [
            lambda: mass_on_drive(skyhook, {"v": jb.Velocity("car", axis="z")}),
            lambda: jb.Model(
                **mass_on_drive().parts()
                | {"controllers": {"c": jb.Controller(SPEED, "spring", skyhook)}}
            ),
        ],
        "DUPLICATE_NAME": [
            lambda: jb.Model(
                **mass_on_drive().parts()
                | {
                    "controllers": {
                        name: jb.Controller({"v": jb.Velocity("m", axis="z")}, "drive", skyhook)
                        for name in "ab"
                    }
                }
            )
        ],
        "BAD_SHAPE": [
            lambda: mass_on_drive(jb.control.state_feedback([[1.0, 2.0, 3.0]])),
            lambda: mass_on_drive(jb.control.state_feedback([[1.0, 2.0], [3.0, 4.0]])),
            lambda: mass_on_drive(skyhook),
        ],
        "NOT_POSITIVE": [
            lambda: jb.Actuator(*ends, limit=-1.0),
            lambda: jb.Actuator(*ends, bandwidth=0.0),
            lambda: jb.Controller(SPEED, "drive", skyhook, every=0.0),
        ],
        "WRONG_KIND": [
            lambda: jb.Controller(SPEED, "drive", 3.0),
            lambda: jb.Controller([1], "drive", skyhook),
        ],
        "BAD_CHAIN": [
            lambda: jb.Actuator(*ends, rate=5.0),
            lambda: jb.Controller(SPEED, "drive", skyhook, delay=0.01),
            lambda: jb.Controller(SPEED, "drive", skyhook, every=0.01, delay=0.02),
            lambda: mass_on_drive(skyhook, {"v": jb.Velocity("m", axis="z", delay=0.01)}),
        ],
        "ZERO_LENGTH": [lambda: mass_on_drive(law, drive=jb.Actuator("world", "m"))],
    }
    for code, calls in cases.items():
        for call in calls:
            with pytest.raises(jb.JaxbodyError) as e:
                call()
            assert e.value.code == code and len(e.value.problems) == 1, str(e.value)
