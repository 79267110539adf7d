"""Regulators and estimators as laws of controllers: the quarter car of the references with its
actuator, its cost and derivatives, sampled laws, nested design."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from controlled_cars import OUTPUTS, ROAD, WHITE, quarter_car, rms_of, white_rms
from scipy.linalg import expm

import jaxbody as jb

INPUTS = {"u": jb.Command("drive")} | ROAD
WEIGHTS = {"acceleration": 1.0, "travel": 1e4, "tyre": 1e5}
READS = {
    "travel": jb.Elongation("spring"),
    "body": jb.Velocity("body", axis="z"),
    "tyre": jb.Elongation("tyre"),
    "wheel": jb.Velocity("wheel", axis="z"),
}
MEASURED = {name: READS[name] for name in ("travel", "body")}
PATHS = ("spring.spring.coefficient", "spring.damper.coefficient", "wheel.mass")


def regulator(lin, weights=WEIGHTS, **options):
    return jb.control.lqr(
        lin, weights, {"u": 1e-6}, inputs=INPUTS, outputs=OUTPUTS, noise={"road": WHITE}, **options
    )


def linear(model):
    return jb.linearize(model, model.reference)


def cost(p, model=None):
    model = quarter_car() if model is None else model
    return regulator(linear(jb.replace(model, dict(zip(PATHS, p, strict=True))))).cost


@pytest.mark.everywhere
def test_the_regulator_of_the_references_as_a_controller():
    """REFERENCES2 3.3, at the digits given."""
    lin = linear(quarter_car())
    found = regulator(lin)
    K = [[13100.2695532774, 3240.4407605746, -13398.552433777, -545.0114400843]]
    np.testing.assert_allclose(found.gains(lin, READS), K, rtol=1e-12)
    assert float(found.cost) == pytest.approx(1.2364099793358, rel=1e-12)
    closed = linear(quarter_car(law=found.law(lin, READS), reads=READS))
    rms = white_rms(closed, ROAD, OUTPUTS | {"u": jb.sensors.DriveForce("drive")}, WHITE)
    expected = [0.68789702740, 0.0045992662549, 0.0023330511925, 85.804262844]
    np.testing.assert_allclose(rms, expected, rtol=1e-9)
    poles = np.asarray(jb.complex_modes(closed).poles)
    for pole in (-5.9600249185 + 7.1380681985j, -13.9824716832 + 57.9366405424j):
        assert np.abs(poles - pole).min() < 1e-8


@pytest.mark.long
def test_derivatives_of_the_cost_by_plant_and_weights():
    """REFERENCES3 5: dJ/dks, dJ/dbs, dJ/dmw at the digits given; all against differences."""
    p = jnp.array([16e3, 1e3, 60.0])
    reverse, forward = jax.grad(cost)(p), jax.jacfwd(cost)(p)
    np.testing.assert_allclose(reverse, [1.752180e-7, -1.722243e-5, 0.00838039], rtol=1e-6)
    np.testing.assert_allclose(reverse, forward, rtol=1e-9)
    h = 1e-4 * np.diag(p)
    central = [(cost(p + d) - cost(p - d)) / (2 * d.max()) for d in h]
    np.testing.assert_allclose(forward, central, rtol=1e-6, atol=1e-11)
    lin = linear(quarter_car())

    def of_weights(q):
        return regulator(lin, {"acceleration": 1.0, "travel": q[0], "tyre": q[1]}).cost

    q = jnp.array([1e4, 1e5])
    slopes = jax.grad(of_weights)(q)  # the mean squares, as a minimum's slope is that of the cost
    np.testing.assert_allclose(slopes, [0.0045992662549**2, 0.0023330511925**2], rtol=1e-8)


@pytest.mark.long
def test_a_spring_is_tuned_with_its_optimal_controller_nested():
    tuned = jb.tune(
        quarter_car(),
        lambda model: {"cost": regulator(linear(model)).cost},
        free=[PATHS[0]],
        minimize="cost",
        tolerance=1e-15,
    )
    best = float(tuned.model["spring"].spring.coefficient)
    assert best == pytest.approx(11661.41, abs=0.3)  # J changes there by 1e-14
    assert float(cost(jnp.array([best, 1e3, 60.0]))) == pytest.approx(1.236029335, rel=1e-9)


@pytest.mark.long
@pytest.mark.parametrize("every", [None, 0.01])
def test_feedback_of_an_estimate_as_a_controller(every):
    """REFERENCES3 5: cost and rms acceleration of the continuous one; sampled, the loop of the
    simulation settles to the response of the exact recursion."""
    lin, noise = linear(quarter_car()), {"travel": 1e-8, "body": 1e-6}
    if every is not None:
        noise = {name: level / every for name, level in noise.items()}
    found = regulator(lin, every=every)
    estimator = jb.control.kalman(
        lin, MEASURED, inputs=INPUTS, noise={"road": WHITE}, sensor_noise=noise, every=every
    )
    law = estimator.law(lin, MEASURED, found)
    model = quarter_car(law=law, reads=MEASURED, every=every)
    if every is None:
        assert float(estimator.cost(found)) == pytest.approx(1.2535843147, rel=1e-10)
        A, B = (np.asarray(x) for x in (estimator.A, estimator.B))
        s = linear(quarter_car()).state_space(INPUTS, OUTPUTS)
        C, D, road = np.asarray(s.C)[0], np.asarray(s.D)[0, 0], np.asarray(s.B)[:, 1:]
        A_c, B_c, C_c = (np.asarray(x) for x in estimator.feedback(found))
        whole = np.block([[A, B @ C_c], [B_c @ np.asarray(estimator.C), A_c]])
        enters = np.block([[road, np.zeros((len(A), 2))], [np.zeros((len(A), 1)), B_c]])
        levels = np.diag([WHITE, 1e-8, 1e-6])
        row = np.concatenate([C, D * C_c[0]])[None]
        assert rms_of(whole, enters, row, levels)[0] == pytest.approx(0.6684328622, rel=1e-9)
        poles = np.linalg.eigvals(whole)
        loop = np.asarray(jb.complex_modes(linear(model)).poles).ravel()
        assert all(np.abs(poles - pole).min() < 1e-7 for pole in loop)
    else:
        start = jb.State(jnp.array([0.02, 0.0]), jnp.array([0.0, 0.3]))
        run = jb.simulate(model, np.arange(41) * every, initial=start, rtol=1e-10)
        s = linear(quarter_car()).state_space({"u": jb.Command("drive")}, MEASURED)
        A, B, C = (np.asarray(x) for x in (s.A, s.B, s.C))
        whole = expm(every * np.block([[A, B], [np.zeros((1, 5))]]))
        A_c, B_c, C_c = (np.asarray(x) for x in estimator.feedback(found))
        x, z = np.array([0.02, 0, 0, 0.3]), np.zeros(5)
        for _ in range(40):
            z = A_c @ z + B_c @ (C @ x)
            x = (whole @ np.concatenate([x, C_c @ z]))[:4]
        found = np.concatenate([run.state.q[-1], run.state.v[-1]])
        np.testing.assert_allclose(found, x, atol=1e-10)


def test_a_law_acts_about_rest():
    """With weight the readings at rest are not zero; the controller leaves the equilibrium."""
    passive = jb.replace(quarter_car(), {"gravity": [0, 0, -9.81]})
    eq = jb.equilibrium(passive)
    lin = jb.linearize(passive, eq)
    law = regulator(lin).law(lin, READS)
    model = quarter_car(law=law, reads=READS)
    controlled = jb.equilibrium(jb.replace(model, {"gravity": [0, 0, -9.81]}))
    np.testing.assert_allclose(controlled.state.q, eq.state.q, atol=1e-12)
    assert np.abs(law.rest).max() > 0.1
