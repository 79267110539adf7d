"""Readings of instruments against closed forms and differences of poses; delay and lag against
sines and SciPy; bad input."""

import sys
from pathlib import Path

import jax
import jax.flatten_util
import jax.numpy as jnp
import numpy as np
import pytest
import rigs
import scipy.signal
from rigs import turned
from scipy.spatial.transform import Rotation

import jaxbody as jb
from jaxbody.fitting.parameters.spaces import space_of
from jaxbody.motion.trajectories import Trajectory, read, readings
from jaxbody.sensors import sensors
from jaxbody.sensors.sensors import check_sensors

G = 9.81
RANDOM = np.random.default_rng(7)
# an instrument's orientation in its body
MOUNTED = np.array([0.5, -0.5, 0.1, 0.7]) / np.linalg.norm([0.5, -0.5, 0.1, 0.7])
R_S = turned(MOUNTED)
P = np.array([0.3, -0.2, 0.1])


# At a state: closed forms


@pytest.fixture(scope="module")
def pendulum():
    """A rod on a hinge about y through the world's origin, its frame in the hinge, at rest
    along -z."""
    rod = jb.Body(mass=2.0, inertia=[0.3, 0.4, 0.1], com=[0, 0, -0.6])
    return jb.Model(
        bodies={"rod": rod}, joints={"rod": jb.Hinge("world", axis=[0, 1, 0])}, gravity=[0, 0, -G]
    )


ON_ROD = {
    "tip": jb.Accelerometer("rod", [0, 0, -1.0]),
    "turned": jb.Accelerometer("rod", [0, 0, -1.0], orientation=MOUNTED),
    "along": jb.Accelerometer("rod", [0, 0, -1.0], axis=[0, 0, -2.0]),
    "gyro": jb.sensors.Gyro("rod", orientation=R_S),
    "rate": jb.sensors.Gyro("rod", axis=[0, 1, 0]),
    "tilt": jb.sensors.Inclinometer("rod", axis=[1, 0, 0]),
    "tilts": jb.sensors.Inclinometer("rod", orientation=Rotation.from_euler("z", 0.3).as_matrix()),
    "angle": jb.sensors.JointAngle("rod"),
    "held": jb.sensors.ForcePlate("world"),
}
read_all = jax.jit(
    lambda model, t, q, v, sensors, motions=(), loads=(): read(
        model, motions, t, jb.State(q, v), sensors, loads
    )
)


def at(model, q, v, sensors=ON_ROD):
    return {
        name: np.asarray(x)
        for name, x in read_all(
            model, jnp.array(0.0), jnp.array([q]), jnp.array([v]), sensors
        ).items()
    }


@pytest.mark.parametrize(("q", "w"), [(0.0, 0.0), (0.7, 0.0), (0.7, 3.0), (-2.2, -5.0), (9.0, 1.0)])
def test_instruments_on_a_pendulum_are_those_of_its_closed_form(pendulum, q, w):
    """At the radius r below the hinge f = (g sin q - w' r ..., g cos q + w^2 r) along the arcs and
    the rod; w' = -m g l sin q/(J + m l^2)."""
    result = at(pendulum, q, w)
    m, l, J = 2.0, 0.6, 0.4
    alpha = -m * G * l * np.sin(q) / (J + m * l**2)
    # of the tip, in the axes of the rod
    f = np.array([-alpha * 1.0 - G * np.sin(q), 0.0, w**2 * 1.0 + G * np.cos(q)])
    close = {"rtol": 0, "atol": 1e-12 * 40}
    np.testing.assert_allclose(result["tip"], f, **close)
    np.testing.assert_allclose(result["turned"], R_S.T @ f, **close)
    np.testing.assert_allclose(result["along"], -f[2], **close)
    np.testing.assert_allclose(result["gyro"], R_S.T @ [0, w, 0], rtol=0, atol=5e-15)
    assert result["rate"] == w and result["angle"] == q
    np.testing.assert_allclose(result["tilt"], np.arcsin(-np.sin(q)), rtol=0, atol=1e-12)
    axes = Rotation.from_euler("y", q).apply(Rotation.from_euler("z", 0.3).as_matrix().T[:2])
    np.testing.assert_allclose(result["tilts"], np.arcsin(axes[:, 2]), rtol=0, atol=1e-12)
    a_C = 0.6 * np.array(
        [-alpha * np.cos(q) + w**2 * np.sin(q), 0, alpha * np.sin(q) + w**2 * np.cos(q)]
    )
    np.testing.assert_allclose(result["held"], [*(-m * a_C - [0, 0, m * G]), 0, 0, 0], **close)


def test_a_sensor_at_rest_reads_g_upwards_whatever_its_axes(pendulum):
    box = jb.Body(mass=1.0, inertia=[1, 1, 1], orientation=MOUNTED, position=[1, 2, 3])
    model = jb.Model(
        bodies={"box": box},
        joints={"box": jb.Fixed("base")},
        supports={"base": jb.Support()},
        gravity=[0.3, -0.2, -G],
    )
    sensors = {
        "acc": jb.Accelerometer("box", P),
        "base": jb.Accelerometer("base", P, orientation=MOUNTED),
        "tilt": jb.sensors.Inclinometer("base"),
    }
    result = read_all(
        model, jnp.array(0.0), jnp.zeros(0), jnp.zeros(0), sensors, (jb.inputs.AtRest(),)
    )
    np.testing.assert_allclose(result["acc"], R_S.T @ [-0.3, 0.2, G], rtol=0, atol=1e-12)
    np.testing.assert_allclose(result["base"], R_S.T @ [-0.3, 0.2, G], rtol=0, atol=1e-12)
    np.testing.assert_allclose(
        result["tilt"], np.arcsin(np.array([-0.3, 0.2]) / np.linalg.norm([0.3, 0.2, G])), atol=1e-15
    )
    assert at(pendulum, 0.0, 0.0)["tip"].tolist() == [0.0, 0.0, G]


def test_an_offset_accelerometer_of_a_free_body_feels_loads_and_its_spin_but_not_gravity():
    """f at P: (F/m + alpha x r + w x (w x r)) with r from the center of mass, alpha = J^-1 (M - w x
    J w); axes of the body."""
    J, c, m = np.array([0.3, 0.5, 0.7]), np.array([0.05, 0.02, -0.01]), 3.0
    model = jb.Model(bodies={"box": jb.Body(mass=m, inertia=J, com=c)}, gravity=[0, 0, -G])
    w, F, at_P = np.array([1.5, -2.0, 0.7]), np.array([4.0, -3.0, 9.0]), np.array([0.4, 0.1, -0.2])
    q, R = np.array([0.2, 0.3, 0.4, *MOUNTED]), R_S
    load = jb.Force(("box", at_P), force=F, axes="body")
    v = np.concatenate([[0.1, -0.4, 2.0], R @ w])
    sensors = {
        "acc": jb.Accelerometer("box", P),
        "side": jb.Accelerometer("box", P, axis=[0, 1, 0]),
    }
    result = read_all(model, jnp.array(0.0), jnp.array(q), jnp.array(v), sensors, (), (load,))
    alpha = (np.cross(at_P - c, F) - np.cross(w, J * w)) / J
    f = F / m + np.cross(alpha, P - c) + np.cross(w, np.cross(w, P - c))
    np.testing.assert_allclose(result["acc"], f, rtol=0, atol=1e-12 * 10)
    np.testing.assert_allclose(result["side"], f[1], rtol=0, atol=1e-12 * 10)


# Along a trajectory: against differences of poses, written out


SHAKING = {name: x for name, x in rigs.SHAKING.items() if name != "frequency"} | {"frequency": 1.1}
GENERAL = {
    "acc": jb.Accelerometer("arm", P, orientation=MOUNTED),
    "floor": jb.Accelerometer("base", P),
    "gyro": jb.sensors.Gyro("arm"),
    "seen": jb.sensors.Displacement(("box", P), ("arm", [0.1, 0, 0.2])),
    "ruler": jb.sensors.Displacement(("box", P), ("base", [0.1, 0, 0.2]), axis=[3, 0, 4]),
    "velocity": jb.Velocity("box", P, relative_to="arm"),
    "geophone": jb.Velocity("box", P, axis=[0, 3, 4]),
    "wire": jb.sensors.StringPotentiometer(("box", P), ("base", [0.1, 0, 0.2])),
    "laser": jb.sensors.LaserVibrometer("box", P, axis=[0, 3, 4]),
    "beam": jb.sensors.LaserVibrometer(
        "box", P, axis=[0, 3, 4], origin=[0.1, -3, -4], normal=[0.2, 0.3, 1]
    ),
    "range": jb.sensors.LaserDistance(
        "box", P, axis=[0, 3, 4], origin=[0.1, -3, -4], normal=[0.2, 0.3, 1]
    ),
    "attitude": jb.sensors.Orientation("arm", orientation=MOUNTED),
    "cell": jb.sensors.LoadCell("s0"),
    "table": jb.sensors.ForcePlate("base"),
    "angle": jb.sensors.JointAngle("arm"),
    **{
        f"{kind.__name__} {to}": kind("box", *point, relative_to=to)
        for to in ("world", "arm", "base")
        for kind, point in (
            (jb.Position, (P,)),
            (jb.Velocity, (P,)),
            (jb.Acceleration, (P,)),
            (jb.sensors.Rotation, ()),
            (jb.sensors.AngularVelocity, ()),
            (jb.sensors.AngularAcceleration, ()),
        )
    },
    "rolled": jb.sensors.AngularAcceleration("box", axis="y", relative_to="arm"),
}
CENTERS, H = np.array([0.4, 0.9]), 2e-3
STENCIL = np.arange(-4, 5)


@pytest.fixture(scope="module")
def flight():
    """A box and an arm on a shaken base, pushed; nine samples about each of two times, so that
    derivatives can be taken."""
    times = jnp.concatenate([jnp.zeros(1), jnp.asarray((CENTERS[:, None] + H * STENCIL).ravel())])
    model = rigs.rig()
    push = jb.Force(
        ("box", [0.1, 0, 0]), force=jb.signals.Sine(amplitude=[3.0, 1.0, -2.0], frequency=2.0)
    )
    motion = {"base": jb.Harmonic(**SHAKING)}
    return jb.simulate(model, times, motion=motion, loads={"push": push}, rtol=1e-12)


@pytest.fixture(scope="module")
def recorded(flight):
    return {name: np.asarray(x) for name, x in jb.measure(flight, GENERAL).items()}


def rate(x, order=1):
    """Derivatives at the centers, to eighth order in H."""
    first = np.array([1 / 280, -4 / 105, 1 / 5, -4 / 5, 0, 4 / 5, -1 / 5, 4 / 105, -1 / 280]) / H
    second = (
        np.array([-1 / 560, 8 / 315, -1 / 5, 8 / 5, -205 / 72, 8 / 5, -1 / 5, 8 / 315, -1 / 560])
        / H**2
    )
    return np.tensordot(
        np.reshape(x[1:], (2, 9, *x.shape[1:])), first if order == 1 else second, (1, 0)
    )


def center(x):
    return np.reshape(x[1:], (2, 9, *x.shape[1:]))[:, 4]


def points(flight, name, a):
    pose = flight.poses[name]
    return np.asarray(pose.p + np.asarray(pose.R) @ a)


@pytest.mark.long
def test_accelerations_and_angular_velocities_are_the_derivatives_of_poses(flight, recorded):
    """Differences of positions good to 1e-13 m over 2 ms leave 1e-7 m/s2."""
    g = np.asarray(flight.model.gravity)
    for name, on, axes in (("acc", "arm", R_S), ("floor", "base", np.eye(3))):
        R = center(np.asarray(flight.poses[on].R)) @ axes
        f = np.einsum("nji,nj->ni", R, rate(points(flight, on, P), 2) - g)
        np.testing.assert_allclose(center(recorded[name]), f, rtol=0, atol=1e-6, err_msg=name)
    R = np.asarray(flight.poses["arm"].R)
    spin = np.einsum("nji,njk->nik", center(R), rate(R))
    np.testing.assert_allclose(
        center(recorded["gyro"]),
        np.stack([spin[:, 2, 1], spin[:, 0, 2], spin[:, 1, 0]], -1),
        rtol=0,
        atol=1e-9,
    )


@pytest.mark.parametrize("to", ["world", "arm", "base"])
def test_kinematic_sensors_are_derivatives_of_each_other_as_seen_from_a_body(flight, recorded, to):
    """Seen from B, in its axes: of R_B' (p - p_B) and of R_B' R, whose rate is [w] R_B' R."""
    R, B = (
        np.asarray(flight.poses[name].R) if name != "world" else np.eye(3)[None]
        for name in ("box", to)
    )
    origin = np.zeros(3) if to == "world" else np.asarray(flight.poses[to].p)
    seen = np.einsum("nji,nj->ni", np.broadcast_to(B, R.shape), points(flight, "box", P) - origin)
    np.testing.assert_allclose(recorded[f"Position {to}"], seen, rtol=0, atol=1e-12)
    np.testing.assert_allclose(center(recorded[f"Velocity {to}"]), rate(seen), rtol=0, atol=1e-9)
    np.testing.assert_allclose(
        center(recorded[f"Acceleration {to}"]), rate(seen, 2), rtol=0, atol=1e-6
    )
    Q = np.einsum("nji,njk->nik", np.broadcast_to(B, R.shape), R)
    spin = np.einsum("nij,nkj->nik", rate(Q), center(Q))
    np.testing.assert_allclose(
        center(recorded[f"AngularVelocity {to}"]),
        np.stack([spin[:, 2, 1], spin[:, 0, 2], spin[:, 1, 0]], -1),
        rtol=0,
        atol=1e-9,
    )
    np.testing.assert_allclose(
        center(recorded[f"AngularAcceleration {to}"]),
        rate(recorded[f"AngularVelocity {to}"]),
        rtol=0,
        atol=1e-6,
    )
    turns = {
        "world": np.eye(3),
        **{name: rigs.turned(flight.model[name].orientation) for name in ("box", "arm", "base")},
    }
    Q_0 = turns[to].T @ turns["box"]
    for phi, now in zip(recorded[f"Rotation {to}"][1::4], Q[1::4], strict=True):
        np.testing.assert_allclose(rigs.rodrigues(phi), now @ Q_0.T, rtol=0, atol=1e-12)


def test_one_component_of_a_kinematic_sensor_is_along_its_axis(recorded):
    np.testing.assert_allclose(
        recorded["rolled"], recorded["AngularAcceleration arm"][:, 1], rtol=1e-14
    )


def test_gauges_and_beams_are_those_of_points_and_their_derivatives(flight, recorded):
    p, other, base = (
        points(flight, "box", P),
        points(flight, "arm", [0.1, 0, 0.2]),
        points(flight, "base", [0.1, 0, 0.2]),
    )
    R_arm, R_base, R_box = (np.asarray(flight.poses[name].R) for name in ("arm", "base", "box"))
    n = np.array([0, 0.6, 0.8])
    seen = np.einsum("nji,nj->ni", R_arm, p - other)
    same = {"rtol": 0, "atol": 1e-13}
    np.testing.assert_allclose(recorded["seen"], seen, **same)
    np.testing.assert_allclose(
        recorded["ruler"], np.einsum("nji,nj->ni", R_base, p - base) @ [0.6, 0, 0.8], **same
    )
    np.testing.assert_allclose(recorded["wire"], np.linalg.norm(p - base, axis=1), **same)
    normal = R_box @ (np.array([0.2, 0.3, 1]) / np.linalg.norm([0.2, 0.3, 1]))
    d = ((p - [0.1, -3, -4]) * normal).sum(1) / (normal @ n)
    np.testing.assert_allclose(recorded["range"], d, rtol=0, atol=1e-12)
    fine = {"rtol": 0, "atol": 1e-9}
    np.testing.assert_allclose(center(recorded["velocity"]), rate(seen), **fine)
    np.testing.assert_allclose(center(recorded["geophone"]), rate(p @ n), **fine)
    np.testing.assert_allclose(center(recorded["laser"]), rate(p @ n), **fine)
    spots = np.array([0.1, -3, -4]) + center(d)[:, None] * n
    at_spot = np.einsum(
        "nji,nj->ni", center(R_box), spots - center(np.asarray(flight.poses["box"].p))
    )  # where on the body the beam is
    moved = np.stack([rate(points(flight, "box", a))[i] for i, a in enumerate(at_spot)])
    np.testing.assert_allclose(center(recorded["beam"]), moved @ n, **fine)


def test_forces_angles_and_attitudes_are_those_of_the_trajectory(flight, recorded):
    np.testing.assert_allclose(recorded["cell"], flight.forces["s0"], rtol=1e-13)
    F, M = (np.asarray(x) for x in flight.reactions["base"])
    R = np.asarray(flight.poses["base"].R)
    table = np.concatenate([np.einsum("nji,nj->ni", R, x) for x in (F, M)], 1)
    np.testing.assert_allclose(recorded["table"], table, rtol=0, atol=1e-12 * np.abs(table).max())
    np.testing.assert_array_equal(recorded["angle"], flight.state.q[:, 7])
    np.testing.assert_allclose(
        turned(recorded["attitude"]), np.asarray(flight.poses["arm"].R) @ R_S, rtol=0, atol=1e-14
    )


def derivatives_agree(model, motions, t, state, sensors, loads=()):
    """Forward, backward and differences, by the state and by every number of the instruments."""
    x0, rebuild = jax.flatten_util.ravel_pytree((state.q, state.v, sensors))

    @jax.jit
    def reading(x):
        q, v, sensors = rebuild(x)
        result = read(model, motions, t, jb.State(q, v), sensors, loads)
        return jnp.concatenate([x.ravel() for x in result.values()])

    towards, onto = RANDOM.normal(size=x0.size), RANDOM.normal(size=len(reading(x0)))
    forward = jax.jit(lambda x: jax.jvp(reading, (x,), (towards,))[1])(x0)
    backward = jax.jit(jax.grad(lambda x: reading(x) @ onto))(x0)
    np.testing.assert_allclose(forward @ onto, backward @ towards, rtol=1e-11)
    h = 1e-3
    one, two, three = (
        (reading(x0 + k * h * towards) - reading(x0 - k * h * towards)) / (2 * k * h)
        for k in (1, 2, 3)
    )
    np.testing.assert_allclose(
        forward, 1.5 * one - 0.6 * two + 0.1 * three, rtol=1e-7, atol=1e-8 * np.abs(forward).max()
    )


def test_derivatives_of_readings_agree_forward_backward_and_with_differences(pendulum):
    derivatives_agree(
        pendulum, (), jnp.array(0.0), jb.State(jnp.array([0.7]), jnp.array([1.3])), ON_ROD
    )


@pytest.mark.long
def test_derivatives_of_all_instruments_agree_in_general_position(flight):
    derivatives_agree(
        flight.model,
        flight.motions,
        flight.times[5],
        jax.tree.map(lambda x: x[5], flight.state),
        GENERAL,
        flight.loads,
    )


@pytest.mark.long
def test_zero_length_has_derivatives_of_zero_and_is_refused_as_a_beginning(pendulum):
    wire = jb.sensors.StringPotentiometer(("rod", [0, 0, 0]), ("world", [0, 0, 0]))

    def length(q, a):
        moved = jb.sensors.StringPotentiometer(("rod", a), ("world", [0, 0, 0]))
        return read(pendulum, (), jnp.array(0.0), jb.State(q, jnp.zeros(1)), {"wire": moved})[
            "wire"
        ]

    value, slopes = jax.value_and_grad(length, (0, 1))(jnp.array([0.3]), jnp.zeros(3))
    assert value == 0 and not np.any(slopes[0]) and not np.any(slopes[1])
    result = problems_of(check_sensors, {"wire": wire}, pendulum, "sensors")
    assert [p.code for p in result] == ["ZERO_LENGTH"] and "sensors['wire']" in result[0].where


# The chain


lag = jax.jit(sensors.lagged)
delay = jax.jit(
    lambda times, x, tau: jax.jvp(
        lambda tau: sensors.delayed(times, x, tau), (tau,), (jnp.ones_like(tau),)
    )
)


def sine(f, t, phase=0.3):
    return np.sin(2 * np.pi * f * t + phase)


TIMES = jnp.arange(200) * 0.01
UNEVEN = jnp.sort(TIMES + 0.002 * RANDOM.uniform(size=200))


@pytest.mark.parametrize("times", [TIMES, UNEVEN], ids=["even", "uneven"])
@pytest.mark.parametrize(("f", "limit"), [(5.0, 1e-9), (10.0, 1e-6), (20.0, 1e-3)])
def test_a_delay_is_exact_well_below_the_sampling_rate(times, f, limit):
    """At a tenth of the rate, 10 Hz, to 1e-6; within five samples of the ends of the record less
    so, as polynomials are one-sided there."""
    x = np.stack([sine(f, times), sine(f, times, 1.0)], 1)
    for tau in (0.005, -0.0033, 0.0271):
        expected = np.stack([sine(f, times - tau), sine(f, times - tau, 1.0)], 1)
        result, slope = delay(times, x, tau)
        np.testing.assert_allclose(result[10:-10], expected[10:-10], rtol=0, atol=limit)
        rates = (
            -2
            * np.pi
            * f
            * np.stack([np.cos(2 * np.pi * f * (times - tau) + p) for p in (0.3, 1.0)], 1)
        )
        np.testing.assert_allclose(
            slope[10:-10], rates[10:-10], rtol=0, atol=10 * limit * 2 * np.pi * f
        )


@pytest.mark.long
def test_at_the_ends_a_delay_goes_on_for_a_sample_and_then_does_not_count():
    tau, step = 0.0271, 0.01
    result, weight = (
        delay(TIMES, np.stack([sine(3.0, TIMES)] * 2, 1), tau)[0],
        sensors.known(TIMES, tau),
    )
    np.testing.assert_allclose(result[2:8, 0], sine(3.0, TIMES - tau)[2:8], rtol=0, atol=1e-6)
    np.testing.assert_allclose(weight[:4], [0, 0, 1 - (tau - 2 * step) / step, 1], atol=1e-12)
    np.testing.assert_array_equal(weight[3:], 1)
    np.testing.assert_allclose(sensors.known(TIMES, -tau), weight[::-1], atol=1e-9)
    # three samples: the parabola through them
    line = sensors.delayed(jnp.arange(3.0), jnp.arange(3.0) ** 2, 0.5)
    np.testing.assert_allclose(line, (np.arange(3.0) - 0.5) ** 2, atol=1e-14)


@pytest.mark.parametrize("T", [1e-4, 3e-3, 0.02, 0.5, 30.0])
def test_a_lag_is_that_of_the_closed_form_for_a_sine(T):
    """T y' + y = sin(2 pi f t + p), from y_0: the steady sine and what decays."""
    for times in (TIMES, UNEVEN):
        t, f, y0 = times - times[0], 5.0, 0.2
        H = np.exp(1j * (2 * np.pi * f * t + 0.3)) / (1 + 2j * np.pi * f * T)
        expected = H.imag + (y0 - H.imag[0]) * np.exp(-t / T)
        result = lag(times, sine(f, t), T, y0)
        np.testing.assert_allclose(result, expected, rtol=0, atol=1e-7)
        np.testing.assert_allclose(
            result[12:-12], expected[12:-12], rtol=0, atol=1e-8 if T < 1 else 2e-9
        )


@pytest.mark.long
def test_a_lag_is_that_of_scipy_for_noise_of_few_frequencies_and_its_derivative_too():
    """lsim takes straight lines between samples; given sixty-four times as many, 1e-6 of what it
    has to say remains."""
    T, frequencies = 0.013, np.array([1.0, 2.7, 4.1])
    fine = np.arange(64 * 199 + 1) * 0.01 / 64
    x = sum(sine(f, fine, f) for f in frequencies)
    expected = scipy.signal.lsim(([1.0], [T, 1.0]), x, fine, X0=[T * x[0]])[1][::64]
    x = jnp.asarray(x[::64])
    np.testing.assert_allclose(lag(TIMES, x, T, x[0]), expected, rtol=0, atol=3e-6)
    onto = RANDOM.normal(size=200)
    slope, backward = jax.jit(
        lambda T: (
            jax.jacfwd(lag, 2)(TIMES, x, T, x[0]),
            jax.grad(lambda T: lag(TIMES, x, T, x[0]) @ onto)(T),
        )
    )(T)
    near = [lag(TIMES, x, T + h, x[0]) for h in (1e-6, -1e-6)]
    np.testing.assert_allclose(
        slope, (near[0] - near[1]) / 2e-6, rtol=0, atol=1e-6 * np.abs(slope).max()
    )
    np.testing.assert_allclose(backward, slope @ onto, rtol=1e-10)


def test_attitudes_are_delayed_as_one_turning_whatever_the_signs_of_their_quaternions():
    rate = np.array([0.3, -2.0, 1.1])
    q = Rotation.from_rotvec(np.array(TIMES)[:, None] * rate).as_quat()[
        :, [3, 0, 1, 2]
    ] * RANDOM.choice([-1, 1], size=(200, 1))
    sensor = jb.sensors.Orientation("rod", delay=0.0123, bias=[0.01, 0.02, -0.03])
    result = jax.jit(lambda t, q: sensor.transduced(t, q))(TIMES, jnp.asarray(q))
    expected = Rotation.from_rotvec([0.01, 0.02, -0.03]) * Rotation.from_rotvec(
        (np.array(TIMES) - 0.0123)[:, None] * rate
    )
    np.testing.assert_allclose(turned(result)[2:], expected.as_matrix()[2:], rtol=0, atol=1e-12)


def swinging(model):
    """A trajectory that need not be simulated."""
    q, v = 0.4 * jnp.cos(3 * TIMES), -1.2 * jnp.sin(3 * TIMES)
    state = jb.State(q[:, None], v[:, None])
    return Trajectory(
        TIMES, state, jnp.array(0), {}, (TIMES[-1], jax.tree.map(lambda x: x[-1], state)), model, ()
    )


@pytest.mark.nan
def test_the_chain_of_a_record_is_gain_lag_delay_and_bias(pendulum):
    """Of a pendulum's swing, small enough to be smooth: each stage by what stands above, on what
    the bare instrument reads."""
    run = swinging(pendulum)
    chain = {
        "gain": np.array([1.1, 0.9, -1.0]),
        "bias": 0.3,
        "delay": 0.0123,
        "lag": 0.02,
        "start": np.array([1.0, 2.0, 3.0]),
    }
    bare, acc = (
        jb.Accelerometer("rod", [0, 0, -1.0]),
        jb.Accelerometer("rod", [0, 0, -1.0], **chain),
    )
    result = jb.measure(run, {"bare": bare, "acc": acc})
    x = jax.jit(
        lambda x: sensors.lagged(TIMES, sensors.delayed(TIMES, x, 0.0123), 0.02, chain["start"])
    )(result["bare"])
    expected = np.asarray(chain["gain"] * x + 0.3)
    # 0.0123 s: the first sample is known a sample too early, the second extrapolated
    assert np.isnan(result["acc"][:1]).all()
    np.testing.assert_allclose(result["acc"][1:], expected[1:], rtol=0, atol=1e-12)
    record = readings(run, {"acc": acc})["acc"]
    np.testing.assert_allclose(record, expected, rtol=0, atol=1e-12)
    np.testing.assert_allclose(
        acc.misfit(run.times, record, record - 1.0)[:3, 0], [0, 0.77, 1], atol=1e-12
    )
    noisy = jb.measure(run, {"acc": acc}, noise=0.1, key=jax.random.key(0))["acc"] - result["acc"]
    assert np.isnan(noisy[0]).all() and abs(np.std(noisy[1:]) / 0.1 - 1) < 4 / np.sqrt(2 * 597)


# Errors


def problems_of(function, *arguments, **options):
    with pytest.raises(jb.JaxbodyError) as caught:
        function(*arguments, **options)
    return caught.value.problems


@pytest.mark.parametrize(
    ("make", "codes"),
    [
        (
            lambda: jb.Accelerometer("rod", [0, 0], axis=[0, 0, 0], gain=np.nan, lag=0.0),
            ["BAD_SHAPE", "ZERO_AXIS", "NON_FINITE", "BAD_LAG"],
        ),
        (
            lambda: jb.Accelerometer(
                "rod", axis=[1, 0, 0], orientation=[1, 0, 0, 0], gain=[1, 1, 1]
            ),
            ["TWO_AXES", "BAD_SHAPE"],
        ),
        (
            lambda: jb.sensors.Gyro("rod", orientation=[1, 0, 0, 1], bias=[0, 0]),
            ["BAD_QUATERNION", "BAD_SHAPE"],
        ),
        (
            lambda: jb.sensors.Inclinometer("rod", orientation=2 * np.eye(3), delay=[0.1, 0.1]),
            ["BAD_ROTATION", "BAD_SHAPE"],
        ),
        (
            lambda: jb.sensors.Displacement("rod", "rod", axis=[0, 0, np.inf]),
            ["SELF_SPRING", "NON_FINITE"],
        ),
        (lambda: jb.Velocity(3.0, gain="loud"), ["WRONG_KIND", "NOT_A_NUMBER"]),
        (
            lambda: jb.sensors.LaserVibrometer("rod", axis=[0, 0, 1], normal=[0, 0, 1]),
            ["NO_SURFACE"],
        ),
        (lambda: jb.sensors.LoadCell("s", start=1.0), ["BAD_CHAIN"]),
        (
            lambda: jb.sensors.Orientation("rod", gain=2.0, lag=0.1, bias=1.0),
            ["BAD_CHAIN", "BAD_CHAIN", "BAD_SHAPE"],
        ),
    ],
)
def test_an_instrument_reports_all_that_is_wrong_with_its_numbers(make, codes):
    result = problems_of(make)
    assert [problem.code for problem in result] == codes
    assert all(
        problem.where.split(".")[0].split(",")[0] in type_names and "joint" not in str(problem)
        for problem in result
    )


type_names = (
    "Accelerometer",
    "Gyro",
    "Inclinometer",
    "Displacement",
    "Velocity",
    "LaserVibrometer",
    "LoadCell",
    "Orientation",
)


def test_an_argument_that_there_is_not_is_named():
    with pytest.raises(TypeError, match="Gyro has no argument 'gian'"):
        jb.sensors.Gyro("rod", gian=1.0)


def test_what_does_not_fit_a_model_is_reported_at_once(pendulum):
    still = jb.replace(pendulum, {"gravity": [0, 0, 0.0]})
    sensors = {
        "a": jb.sensors.Inclinometer("rod"),
        "b": jb.sensors.Displacement(("rod", P), "base"),
        "c": jb.sensors.LoadCell("s"),
        "d": jb.sensors.ForcePlate("rod"),
        "e": jb.sensors.JointAngle("rod", component=1),
        "f": jb.sensors.LaserDistance("rod", origin=[0, 0, 0], axis=[0, 0, 1], normal=[1, 0, 0]),
        "g": jb.sensors.StringPotentiometer(("rod", [0, 0, 0]), ("world", [0, 0, 0])),
    }
    result = problems_of(check_sensors, sensors, still, "sensors")
    assert [p.code for p in result] == [
        "NO_GRAVITY",
        "UNKNOWN_NAME",
        "UNKNOWN_NAME",
        "UNKNOWN_NAME",
        "BAD_COMPONENT",
        "GRAZING",
        "ZERO_LENGTH",
    ]
    assert [p.where for p in result] == [f"sensors['{name}']" for name in sensors] and all(
        p.hint for p in result
    )
    free = jb.Model(
        bodies={"rod": jb.Body(mass=1.0, inertia=[1, 1, 1])},
        elements={"m": jb.Bushing(("rod", [0, 0, 0]), ("world", [0, 0, 0]), stiffness=[1, 1, 1])},
    )
    result = problems_of(
        check_sensors,
        {
            "a": jb.sensors.JointAngle("rod"),
            "b": jb.sensors.LoadCell("m"),
            "c": jb.sensors.LoadCell("m", component=6),
        },
        free,
        "sensors",
    )
    assert [p.code for p in result] == ["BAD_COMPONENT"] * 3 and "Free" in result[0].message


def test_a_cell_in_a_bushing_reads_one_of_its_six_forces():
    mount = jb.Bushing(
        ("box", [0, 0, 0]), ("world", [0, 0, 0]), stiffness=[10, 20, 30], damping=[1, 2, 3]
    )
    model = jb.Model(bodies={"box": jb.Body(mass=1.0, inertia=[1, 1, 1])}, elements={"m": mount})
    q, v = jnp.array([0.1, 0.2, 0.3, 1, 0, 0, 0]), jnp.array([1.0, 2, 3, 0, 0, 0])
    result = read_all(
        model, jnp.array(0.0), q, v, {i: jb.sensors.LoadCell("m", component=i) for i in range(6)}
    )
    # from the box to the world
    np.testing.assert_allclose([result[i] for i in range(3)], [-1 - 1, -4 - 4, -9 - 9], rtol=1e-13)


# Fits


@pytest.fixture(scope="module")
def cart():
    model = jb.Model(
        bodies={"cart": jb.Body(mass=2.0, inertia=[1, 1, 1])},
        supports={"base": jb.Support()},
        joints={"cart": jb.Guide("base", axis=[1, 0, 0])},
        elements={
            "s": jb.Spring(
                ("cart", [0, 0, 0]),
                ("base", [1, 0.2, 0]),
                stiffness=400.0,
                free_length=1.0,
                damping=4.0,
            )
        },
    )
    base = jb.Harmonic(frequency=0.9, translation=[0.03, 0, 0]) + jb.Harmonic(
        frequency=2.3, translation=[0.01, 0, 0], translation_phase=1.0
    )
    return model, {"base": base}


CHAIN = {"gain": -1.2, "bias": 0.05, "delay": 0.0031, "lag": 0.012, "start": 0.4}


def taken(cart, seeds, chain, noise=0.0):
    """Experiments of one run, cut out of the motion so that a delayed instrument has seen what
    was before."""
    model, motion = cart
    times = 0.01 * np.arange(-1, 150)
    whole = jb.simulate(model, times, motion=motion, rtol=1e-11)
    acc, gap = (
        jb.Accelerometer("cart", axis=[1, 0, 0], **{**CHAIN, "start": None}),
        jb.sensors.Displacement("cart", "base", axis=[1, 0, 0]),
    )
    level = {"acc": max(noise, 1e-6), "gap": max(noise / 100, 1e-8)}
    initial = jax.tree.map(lambda x: x[1], whole.state)
    result = {}
    for seed in seeds:
        measured = jb.measure(
            whole,
            {"acc": acc, "gap": gap},
            noise={name: noise and x for name, x in level.items()},
            key=jax.random.key(seed),
        )
        measured = {name: x[1:] for name, x in measured.items()}
        sensors = {"acc": jb.Accelerometer("cart", axis=[1, 0, 0], **chain), "gap": gap}
        result[f"run{seed}"] = jb.Experiment(
            times[1:],
            motion=motion,
            initial=initial,
            sensors=sensors,
            measured=measured,
            noise=level,
        )
    return result


@pytest.mark.long
@pytest.mark.parametrize("seeds", [(0,), (0, 1)])
def test_a_fit_finds_gain_bias_delay_and_lag_of_each_run(cart, seeds):
    """From an instrument taken for a perfect one, of the wrong sign even; runs are side by side,
    and each has its own chain."""
    model, _ = cart
    runs = taken(cart, seeds, {"gain": 1.0, "bias": 0.0, "delay": 0.0, "lag": 0.02, "start": 0.0})
    start = jb.replace(model, {"s.stiffness": 480.0, "s.damping": 3.0})
    result = jb.fit(
        start,
        runs,
        free=[
            "s.stiffness",
            "s.damping",
            "run?.acc.gain",
            "run?.acc.bias",
            "run?.acc.delay",
            "run?.acc.lag",
            "run?.acc.start",
        ],
    )
    assert result.ok
    for run in runs:
        for name in ("gain", "bias", "delay", "lag"):
            np.testing.assert_allclose(
                result.estimates[f"{run}.acc.{name}"], CHAIN[name], rtol=2e-5, err_msg=name
            )
    np.testing.assert_allclose(
        [result.estimates[f"s.{name}"] for name in ("stiffness", "damping")],
        [400.0, 4.0],
        rtol=1e-6,
    )


@pytest.mark.long
def test_what_is_free_of_a_chain_moves_by_what_it_is_about_and_unknown_samples_do_not_count(cart):
    """A bias of zero by the size of the record, a delay of zero by a sample, a gain with
    its sign."""
    x = RANDOM.normal(size=50)
    chain = {"gain": 1.0, "bias": 0.0, "delay": 0.025, "lag": 0.02}
    run = jb.Experiment(
        0.01 * np.arange(50),
        sensors={"acc": jb.Accelerometer("cart", axis=[1, 0, 0], **chain)},
        measured={"acc": x},
    )
    run = jb.replace(run, {"acc.delay": 0.0})
    forms = {
        parameter.path: parameter.form
        for parameter in space_of(cart[0], "run.acc.*", "fit", runs={"run": run}).parameters
    }
    moved = [
        forms[f"run.acc.{name}"].value(jnp.ones(1)) for name in ("gain", "bias", "delay", "lag")
    ]
    np.testing.assert_allclose(moved, [2.0, np.sqrt(np.mean(x**2)), 0.01, 0.02 * np.e], rtol=1e-9)
    assert set(forms) == {
        f"run.acc.{name}" for name in ("gain", "bias", "delay", "lag", "point", "axis")
    }
    late = jb.replace(run, {"acc.delay": 0.025})
    np.testing.assert_allclose(late.residual("acc", x + 1.0)[:4], [0, 0, 0.5, 1], atol=1e-12)


@pytest.mark.long
def test_intervals_hold_where_delay_gain_and_bias_are_modeled_and_residuals_show_it_else():
    """A few of the replicates of tests/benchmarks/transducers.py; shares within four standard
    deviations of 95 %. That is no limit above, so there errors are held to standard errors, whose
    ratio n replicates know to 1/sqrt(2 n): intervals twice too wide would halve it."""
    sys.path.insert(0, str(Path(__file__).parents[1] / "benchmarks"))
    import transducers as benchmark

    study = benchmark.Study()
    n = 60
    modeled = study.replicates(n, True)
    with pytest.warns(jb.JaxbodyWarning, match="CORRELATED_RESIDUALS"):
        bare = study.replicates(10, False)
    print(modeled["held"].mean(0), modeled["white"].min(), bare["white"].max())
    assert (modeled["held"].mean(0) > 0.95 - 4 * np.sqrt(0.95 * 0.05 / n)).all()
    ratio = np.sqrt(np.mean((modeled["errors"] / modeled["stated"]) ** 2, 0))
    print(ratio)
    assert (np.abs(ratio - 1) < 4 / np.sqrt(2 * n)).all() and modeled["held"].mean() < 0.99
    delay = modeled["errors"][:, modeled["paths"].index("run.acc.delay")] / benchmark.STEP
    assert np.sqrt(np.mean(delay**2)) < 0.01 and not modeled["flagged"].any()
    assert bare["flagged"].all() and bare["white"].max() < 1e-6 and not bare["held"].all(0).any()
