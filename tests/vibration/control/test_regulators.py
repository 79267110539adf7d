"""Regulators: reference cases, derivatives, samples, gains on readings, refusals."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg
from quarter_cars import OUTPUTS, PUSHES, ROAD, Q, R, W, linear, with_actuator

import jaxbody as jb
from jaxbody.vibration.control.regulators import lqr, regulator_of

NOISE = {"road": W}
# of the states xb - xw, xb', xw - w, xw' of the reference, in those of the state space
TO_FOUR = np.array([[1.0, -1, 0, 0, 0], [0, 0, 1, 0, 0], [0, 1, 0, 0, -1], [0, 0, 0, 1, 0]])
K_FOUR = [13100.2695532774, 3240.4407605746, -13398.552433777, -545.0114400843]


def design(lin, every=None, **changed):
    return regulator_of(with_actuator(lin, OUTPUTS), (), Q | changed, R, NOISE, every)


@pytest.fixture(scope="module")
def car():
    return linear()


@pytest.fixture(scope="module")
def ride(car):
    return design(car)


def test_quarter_car_as_in_the_reference(ride):
    """REFERENCES2 3.3, to the digits given; the displacement of everything is no matter."""
    np.testing.assert_allclose(ride.K[0], np.array(K_FOUR) @ TO_FOUR, rtol=3e-13)
    np.testing.assert_allclose(ride.cost, 1.2364099793358, rtol=1e-13)
    poles = [-5.9600249185 + 7.1380681985j, -13.9824716832 + 57.9366405424j]
    np.testing.assert_allclose(np.sort(ride.poles[ride.poles.imag > 0])[::-1], poles, rtol=1e-11)
    assert abs(ride.poles[0]) < 1e-12 and ride.ok
    drift = np.array([1.0, 1, 0, 0, 1])
    np.testing.assert_allclose(ride.unseen @ drift, drift, atol=1e-13)
    np.testing.assert_allclose(np.linalg.svd(ride.unseen)[1][1:], 0, atol=1e-13)
    assert "actuator [N]" in str(ride) and "cost 1.23641" in str(ride)


def test_rms_of_the_reference(car, ride):
    space = with_actuator(car, OUTPUTS)
    A = TO_FOUR @ np.asarray(ride.A - ride.B @ ride.K) @ np.linalg.pinv(TO_FOUR)
    drive = TO_FOUR @ np.asarray(space.B)[:, :1]
    X = scipy.linalg.solve_continuous_lyapunov(A, -W * drive @ drive.T)
    y = np.concatenate([space.C - space.D[:, 1:] @ ride.K, ride.K]) @ np.linalg.pinv(TO_FOUR)
    rms = [0.68789702740, 0.0045992662549, 0.0023330511925, 85.804262844]
    np.testing.assert_allclose(np.sqrt(np.diag(y @ X @ y.T)), rms, rtol=1e-10)


@pytest.mark.long
def test_derivatives_of_the_cost():
    """REFERENCES3 5, the weights by differences; forward and reverse mode agree."""

    def cost(x):
        return design(linear(x[0], x[1], x[2]), tyre=x[3]).cost

    x, value = jnp.array([16000.0, 1000.0, 60.0, 1e5]), jax.jit(cost)
    slope = jax.jit(jax.grad(cost))(x)
    np.testing.assert_allclose(slope[:3], [1.752180e-7, -1.722243e-5, 0.00838039], rtol=3e-7)
    np.testing.assert_allclose(jax.jit(jax.jacfwd(cost))(x), slope, rtol=1e-9)
    # differences of a cost of 1.2 with steps of a thousandth
    for i, step in enumerate(np.diag(1e-3 * x)):
        np.testing.assert_allclose(
            slope[i], (value(x + step) - value(x - step)) / (2 * step[i]), rtol=1e-6
        )
    best = jnp.array([11661.41, 1000.0, 60.0, 1e5])
    np.testing.assert_allclose(value(best), 1.236029335, rtol=1e-9)
    # its bend is 2e-11, and the best stiffness is known to 0.01 N/m
    assert abs(jax.jit(jax.grad(cost))(best)[0]) < 1e-12


def single(stiffness=16000.0, mass=300.0):
    model = jb.Model(
        bodies={"mass": jb.Body(mass=mass, inertia=[1, 1, 1])},
        supports={"base": jb.Support()},
        joints={"mass": jb.Guide("world", axis=[0, 0, 1])},
        elements={
            "s": jb.Spring(
                ("mass", [0, 0, 0]), ("base", [0, 0, -1]), stiffness=stiffness, free_length=1.0
            )
        },
    )
    return jb.linearize(model, model.reference)


def test_the_optimum_of_one_freedom():
    """REFERENCES2 3.1: the whole force on the mass is -m sqrt(rho) (x - w) - m sqrt(2) rho^(1/4) x'
    of a spring that is there already and of the drive; nearly without its weight."""
    regulator = lqr(
        single(),
        {"acceleration": 1.0, "stroke": 2500.0},
        {"push": 1e-16},
        inputs={"base": jb.BaseMotion("base", "z", kind="velocity"), "push": jb.PointForce("mass")},
        outputs={
            "acceleration": jb.Acceleration("mass", axis="z"),
            "stroke": jb.Elongation("s"),
        },
        noise={"base": 0.01},
    )
    np.testing.assert_allclose(regulator.K[0], [15000 - 16000, 3000, 16000 - 15000], rtol=1e-8)
    np.testing.assert_allclose(regulator.cost, 5.0, rtol=1e-8)


def chain(every=None, noise=None):
    return lqr(
        single(),
        {"place": 4.0, "speed": 1.0},
        [1e-6],
        inputs={"wind": jb.PointForce("mass"), "push": jb.PointForce("mass")},
        outputs={"place": jb.Position("mass", axis="z"), "speed": jb.Velocity("mass", axis="z")},
        noise=noise or {"wind": 2.0},
        every=every,
    )


def test_sampled_cost_is_that_of_quadrature_over_a_sample():
    """System, cost and noise of a held drive, by SciPy's expm at Gauss points."""
    T, k, m = 0.05, 16000.0, 300.0
    sampled = chain(T)
    A, B, n = np.array([[0, 1], [-k / m, 0]]), np.array([[0], [1 / m]]), 2
    whole = np.block([[A, B], [np.zeros((1, 3))]])
    J, noise = np.diag([4.0, 1.0, 1e-6]), 2.0 * B @ B.T
    nodes, weights = np.polynomial.legendre.leggauss(12)
    times, weights = T * (nodes + 1) / 2, T * weights / 2
    steps = [scipy.linalg.expm(whole * t) for t in times]
    cost = sum(w * F.T @ J @ F for F, w in zip(steps, weights, strict=True))
    spread = sum(w * F[:2, :2] @ noise @ F[:2, :2].T for F, w in zip(steps, weights, strict=True))
    inner = sum(
        w * (T - t) * np.trace(F[:2, :2] @ noise @ F[:2, :2].T @ J[:2, :2])
        for F, w, t in zip(steps, weights, times, strict=True)
    )
    F = scipy.linalg.expm(whole * T)
    P = scipy.linalg.solve_discrete_are(
        F[:n, :n], F[:n, n:], cost[:n, :n], cost[n:, n:], s=cost[:n, n:]
    )
    np.testing.assert_allclose(sampled.P, P, rtol=1e-10)
    np.testing.assert_allclose(sampled.cost, (np.trace(P @ spread) + inner) / T, rtol=1e-11)
    assert sampled.cost > chain().cost  # a held drive can do less
    np.testing.assert_allclose(chain(1e-4).cost, chain().cost, rtol=1e-3)


def test_weights_as_names_vectors_and_matrices_are_the_same(car):
    space = with_actuator(car, OUTPUTS)
    forms = [(Q, R), (list(Q.values()), [1e-6]), (np.diag([1.0, 1e4, 1e5]), [[1e-6]])]
    first, *others = (regulator_of(space, (), *form, NOISE, None) for form in forms)
    for other in others:
        np.testing.assert_array_equal(other.K, first.K)
    assert chain(noise={"wind": 0.0}).cost == 0


def test_gains_on_readings_are_the_feedback(car):
    regulator = lqr(
        car, Q, [1e-6] * 2, inputs={"road": ROAD, **PUSHES}, outputs=OUTPUTS, noise=NOISE
    )
    reads = {
        "stroke": jb.Elongation("suspension"),
        "tyre": jb.Elongation("tyre"),
        "body": jb.Velocity("body", axis="z"),
        "wheel": jb.Velocity("wheel"),
    }
    G = regulator.gains(car, reads)
    space = car.state_space({"road": ROAD, **PUSHES}, reads)
    assert G.shape == (2, 6)
    np.testing.assert_allclose(G @ space.C, regulator.K, atol=1e-8)
    del reads["tyre"]
    with pytest.raises(jb.JaxbodyError, match="displacement of road") as error:
        regulator.gains(car, reads)
    assert error.value.code == "NOT_READ"


def test_an_output_that_reads_white_noise_costs_infinitely(car):
    pushed = lqr(
        car,
        {"wheel": 1.0},
        {"body": 1.0},
        inputs=PUSHES,
        outputs={"wheel": jb.Acceleration("wheel", axis="z")},
        noise={"wheel": 1.0},
    )
    assert np.isinf(pushed.cost) and np.isfinite(pushed.K).all()


TWO = jb.Model(
    bodies={
        name: jb.Body(mass=1.0, inertia=[1, 1, 1], position=[i, 0, 0])
        for i, name in enumerate(("left", "right"))
    },
    joints={name: jb.Guide("world", axis=[0, 0, 1]) for name in ("left", "right")},
)


@pytest.mark.nan
@pytest.mark.parametrize("every", [None, 0.1])
def test_what_cannot_be_reached_is_named(every):
    lin = jb.linearize(TWO, TWO.reference)
    outputs = {name: jb.Position(name, axis="z") for name in ("left", "right")}

    def of(weights):
        return lqr(
            lin,
            weights,
            {"push": 1.0},
            inputs={"push": jb.PointForce("left")},
            outputs=outputs,
            every=every,
        )

    with pytest.warns(
        jb.JaxbodyWarning, match="'push' cannot reach .*right move.*NOT_STABILIZABLE"
    ):
        failed = of({"left": 1.0, "right": 1.0})
    assert failed.status == jb.Status.NOT_STABILIZABLE and np.isnan(failed.K).all()
    assert "NOT_STABILIZABLE" in str(failed)
    fine = of({"left": 1.0})
    assert fine.ok and np.isfinite(fine.K).all() and fine.K[0, 1] == 0


def test_weights_that_are_not_positive_are_reported(car):
    space = with_actuator(car, OUTPUTS)
    for q, r in (([1, -1, 1], [1.0]), ([1, 1, 1], [0.0])):
        with pytest.warns(jb.JaxbodyWarning, match="NOT_POSITIVE"):
            regulator_of(space, (), q, r, NOISE, None)


@pytest.mark.parametrize(
    "code, changed",
    [
        ("UNKNOWN_NAME", {"Q": {"sky": 1.0}}),
        ("BAD_SHAPE", {"Q": [1.0]}),
        ("BAD_SHAPE", {"noise": None, "R": [1.0]}),  # two drives then
        ("NON_FINITE", {"R": [np.nan]}),
        ("UNKNOWN_NAME", {"noise": {"sky": 1.0}}),
        ("WRONG_KIND", {"noise": 1.0}),
        ("BAD_NUMBER", {"every": 0.0}),
    ],
)
def test_wrong_arguments(car, code, changed):
    given = {"Q": Q, "R": R, "noise": NOISE, "every": None} | changed
    with pytest.raises(jb.JaxbodyError) as error:
        regulator_of(with_actuator(car, OUTPUTS), (), *given.values())
    assert error.value.code == code


def test_many_designs_at_once(car):
    space = with_actuator(car, OUTPUTS)

    def cost(weight):
        return regulator_of(space, (), Q | {"tyre": weight}, R, NOISE, None).cost

    each = jax.jit(jax.vmap(cost))(jnp.array([1e4, 1e5, 1e6]))
    np.testing.assert_allclose(each[1], 1.2364099793358, rtol=1e-12)


@pytest.mark.nan
def test_margins_of_the_regulator_of_a_car(ride):
    """Of the loop with four states, in which nothing drifts, by python-control."""
    control = pytest.importorskip("control")
    back = np.linalg.pinv(TO_FOUR)
    A, B, K = TO_FOUR @ np.asarray(ride.A) @ back, TO_FOUR @ np.asarray(ride.B), ride.K @ back
    _, phase, _, _, crossing, _ = control.stability_margins(control.ss(A, B, K, 0))
    margins = ride.margins()
    np.testing.assert_allclose(np.rad2deg(margins.phase), phase, rtol=1e-9)
    np.testing.assert_allclose(2 * np.pi * margins.frequencies[0, 2], crossing, rtol=1e-9)
    assert margins.gain == np.inf and margins.lower_gain == 0 and margins.ok
    assert "actuator" in str(margins)
