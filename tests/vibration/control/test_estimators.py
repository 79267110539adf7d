"""Kalman filters and output feedback: reference cases, cost in the loop, what is not seen."""

import jax
import numpy as np
import pytest
import scipy.linalg
from quarter_cars import OUTPUTS, SENSORS, Q, R, W, linear, with_actuator

import jaxbody as jb
from jaxbody.vibration.control.estimators import estimator_of, kalman
from jaxbody.vibration.control.regulators import regulator_of

NOISE, SENSOR_NOISE = {"road": W}, {"stroke": 1e-8, "speed": 1e-6}


def oscillator(stiffness=(2 * np.pi) ** 2, damping=0.25):
    spring = jb.Spring(
        ("mass", [0, 0, 0]),
        ("world", [0, 0, -1]),
        stiffness=stiffness,
        damping=damping,
        free_length=1.0,
    )
    model = jb.Model(
        bodies={"mass": jb.Body(mass=1.0, inertia=[1, 1, 1])},
        joints={"mass": jb.Guide("world", axis=[0, 0, 1])},
        elements={"s": spring},
    )
    return jb.linearize(model, model.reference)


def watched(variance, every=None, sensor=None, lin=None, **noise):
    return kalman(
        lin or oscillator(),
        {"place": sensor or jb.Position("mass", axis="z")},
        inputs={"wind": jb.PointForce("mass")},
        noise=noise or {"wind": 1.0},
        sensor_noise={"place": variance},
        every=every,
    )


def test_sampled_and_continuous_filter_of_the_reference():
    """REFERENCES3 7, to the digits given; the continuous gains in closed form."""
    sampled = watched(1e-4, 0.02)
    np.testing.assert_allclose(sampled.L[:, 0], [0.5163626720, 9.1475639440], rtol=1e-9)
    np.testing.assert_allclose(
        sampled.prior, [[1.067665050e-4, 0.001891409826], [0.001891409826, 0.0606831150]], rtol=1e-9
    )
    np.testing.assert_allclose(sampled.innovation, 0.01437937777, rtol=1e-9)
    np.testing.assert_allclose(sampled.covariance[0, 0], 0.5163626720e-4, rtol=1e-9)
    continuous = watched(2e-6)
    np.testing.assert_allclose(continuous.L[:, 0], [36.3221427913, 659.649028478], rtol=1e-11)
    assert "place [1/(m)]" in str(continuous)


@pytest.fixture(scope="module")
def car():
    return linear()


def designs(lin, every=None, sensor_noise=SENSOR_NOISE):
    regulator = regulator_of(with_actuator(lin, OUTPUTS), (), Q, R, NOISE, every)
    return regulator, estimator_of(with_actuator(lin, SENSORS), NOISE, sensor_noise, every)


def test_output_feedback_of_the_reference(car):
    """REFERENCES3 5: cost and rms acceleration; by the trace and by the closed loop."""
    regulator, estimator = designs(car)
    np.testing.assert_allclose(estimator.cost(regulator), 1.2535843147, rtol=1e-10)
    space, sensed = with_actuator(car, OUTPUTS), with_actuator(car, SENSORS)
    Ac, Bc, Cc = map(np.asarray, estimator.feedback(regulator))
    B, drift = np.asarray(space.B), np.array([1.0, 1, 0, 0, 1])
    loop = np.block([[np.asarray(space.A), B[:, 1:] @ Cc], [Bc @ sensed.C, Ac]])
    noise = np.block(
        [
            [W * B[:, :1] @ B[:, :1].T, np.zeros((5, 5))],
            [np.zeros((5, 5)), Bc @ np.diag([1e-8, 1e-6]) @ Bc.T],
        ]
    )
    # without the drift of everything, which outputs and sensors do not see
    rest = np.linalg.svd(np.outer(drift, drift))[0][:, 1:]
    keep = scipy.linalg.block_diag(rest, np.eye(5))
    X = scipy.linalg.solve_continuous_lyapunov(keep.T @ loop @ keep, -keep.T @ noise @ keep)
    y = np.block([np.asarray(space.C), np.asarray(space.D)[:, 1:] @ Cc])
    y = np.concatenate([y, np.block([np.zeros((1, 5)), Cc])]) @ keep
    squares = np.diag(y @ X @ y.T)
    np.testing.assert_allclose(np.sqrt(squares[0]), 0.6684328622, rtol=1e-9)
    np.testing.assert_allclose(squares @ [1, 1e4, 1e5, 1e-6], estimator.cost(regulator), rtol=1e-9)


@pytest.mark.long
def test_sampled_output_feedback_costs_what_the_trace_says(car):
    """By the covariances of the closed loop at the samples, in the weights of the regulator."""
    T = 0.01
    regulator, estimator = designs(car, T, {"stroke": 1e-6, "speed": 1e-4})
    Ac, Bc, Cc = map(np.asarray, estimator.feedback(regulator))
    A, B, C = (np.asarray(x) for x in (estimator.A, estimator.B, estimator.C))
    np.testing.assert_allclose(A, regulator.A, rtol=1e-12, atol=1e-12)
    # (x, z) to the next sample: x by u = C_c z, then z by the next reading
    loop = np.block([[A, B @ Cc], [Bc @ C @ A, Ac + Bc @ C @ B @ Cc]])
    road = np.asarray(with_actuator(car, SENSORS).B)[:, :1]
    n = len(A)
    nodes, weights = np.polynomial.legendre.leggauss(10)
    Ad = np.asarray(with_actuator(car, SENSORS).A)
    each = [scipy.linalg.expm(Ad * T * (x + 1) / 2) @ road for x in nodes]
    spread = sum(W * w * T / 2 * e @ e.T for e, w in zip(each, weights, strict=True))
    V = np.diag([1e-6, 1e-4])
    both = np.block([[np.eye(n)], [Bc @ C]])
    noise = both @ spread @ both.T + scipy.linalg.block_diag(np.zeros((n, n)), Bc @ V @ Bc.T)
    drift = np.array([1.0, 1, 0, 0, 1])
    rest = np.linalg.svd(np.outer(drift, drift))[0][:, 1:]
    keep = scipy.linalg.block_diag(rest, np.eye(n))
    X = (
        keep
        @ scipy.linalg.solve_discrete_lyapunov(keep.T @ loop @ keep, keep.T @ noise @ keep)
        @ keep.T
    )
    K = np.asarray(regulator.K)
    # the feedback differs from that of the states by e = K (x - z)
    e = np.concatenate([K, -K], 1)
    more = np.trace(np.asarray(regulator.weight) @ e @ X @ e.T) / T
    np.testing.assert_allclose(estimator.cost(regulator) - regulator.cost, more, rtol=1e-8)


@pytest.mark.long
def test_derivatives_of_the_cost_of_output_feedback():
    def cost(stiffness):
        regulator, estimator = designs(linear(stiffness))
        return estimator.cost(regulator)

    value, h = jax.jit(cost), 16.0
    slope = jax.jit(jax.grad(cost))(16000.0)
    np.testing.assert_allclose(slope, (value(16000 + h) - value(16000 - h)) / (2 * h), rtol=1e-5)
    np.testing.assert_allclose(jax.jit(jax.jacfwd(cost))(16000.0), slope, rtol=1e-8)


@pytest.mark.nan
@pytest.mark.parametrize("every", [None, 0.01])
def test_what_grows_unseen_is_refused_by_name(every):
    """A mass on a negative spring, of which a sensor elsewhere tells nothing."""
    ends = ("loose", [0, 0, 0]), ("world", [0, 0, -1])
    with pytest.warns(jb.JaxbodyWarning, match="NEGATIVE_STIFFNESS"):
        spring = jb.Spring(*ends, stiffness=-4.0, free_length=1.0, allow_negative=True)
    model = jb.Model(
        bodies={name: jb.Body(mass=1.0, inertia=[1, 1, 1]) for name in ("seen", "loose")},
        joints={name: jb.Guide("world", axis=[0, 0, 1]) for name in ("seen", "loose")},
        elements={"s": spring},
    )

    def of(body):
        return kalman(
            jb.linearize(model, model.reference),
            {"place": jb.Position(body, axis="z")},
            inputs={name: jb.PointForce(name) for name in ("seen", "loose")},
            noise={"seen": 1.0, "loose": 1.0},
            sensor_noise=[1e-4],
            every=every,
        )

    with pytest.warns(jb.JaxbodyWarning, match=r"do not see .*loose move.* pole 2(\.\d+)?\+0j 1/s"):
        failed = of("seen")
    assert failed.status == jb.Status.NOT_STABILIZABLE and np.isnan(failed.L).all()
    # the place of the other mass drifts unseen, and is left out
    drifting = of("loose")
    assert drifting.ok and np.isfinite(drifting.covariance).all()


@pytest.mark.long
def test_feedback_of_what_no_sensor_sees_is_refused(car):
    outputs = OUTPUTS | {"place": jb.Position("body", axis="z")}
    weights = Q | {"place": 1.0}
    with pytest.warns(jb.JaxbodyWarning, match="displacement of road.*NOT_STABILIZABLE"):
        regulator_of(with_actuator(car, outputs), (), weights, R, NOISE, None)
    free = jb.linearize(
        model := jb.Model(
            bodies={"mass": jb.Body(mass=1.0, inertia=[1, 1, 1])},
            joints={"mass": jb.Guide("world", axis=[0, 0, 1])},
        ),
        model.reference,
    )
    ports = {"push": jb.PointForce("mass"), "wind": jb.PointForce("mass")}
    space = free.state_space(ports, {"place": jb.Position("mass", axis="z")})
    regulator = regulator_of(space, (), [1.0], [1.0], {"wind": 1.0}, None)
    sensed = free.state_space(ports, {"speed": jb.Velocity("mass", axis="z")})
    estimator = estimator_of(sensed, {"wind": 1.0}, [1.0], None)
    assert estimator.ok
    with pytest.raises(jb.JaxbodyError, match="NOT_READ"):
        estimator.feedback(regulator)
    with pytest.raises(jb.JaxbodyError, match="OTHER_MODEL"):
        estimator.cost(regulator_of(space, (), [1.0], [1.0], {"wind": 1.0}, 0.1))
    with pytest.raises(jb.JaxbodyError, match="NO_NOISE"):
        estimator.cost(regulator_of(space, (), [1.0], [1.0, 1.0], None, None))


def test_a_sampled_sensor_of_white_noise_is_refused():
    """The acceleration that a force of white noise causes is infinite at an instant; continuous, it
    is noise of the sensor that the states share, and with a lag it is one of these."""
    sensor = jb.Acceleration("mass", axis="z")
    with pytest.warns(jb.JaxbodyWarning, match=r"give it a lag.*IMPROPER"):
        watched(1e-4, 0.02, sensor)
    assert watched(1e-4, 0.02, jb.Acceleration("mass", axis="z", lag=0.01)).ok
    A, b, V = np.array([[0, 1], [-((2 * np.pi) ** 2), -0.25]]), np.array([[0], [1.0]]), 1e-4 + 1.0
    C = A[1:]
    S = scipy.linalg.solve_continuous_are(A.T, C.T, b @ b.T, [[V]], s=b)
    expected = (S @ C.T + b) / V
    np.testing.assert_allclose(watched(1e-4, None, sensor).L, expected, rtol=1e-8, atol=1e-9)
