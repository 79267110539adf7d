"""An instrument on rubber isolators against the closed forms of a Prony series."""

import numpy as np
import pytest

import jaxbody as jb

PRONY = ((0.25, 0.1), (0.25, 0.01), (0.25, 0.001))
FREQUENCIES = np.array([0.5, 2.0, 8.0, 10.4, 30.0, 200.0])
S = 2j * np.pi * FREQUENCIES


def series(s, k, prony=PRONY):
    """k (1 + sum g s tau/(1 + s tau))."""
    return k * (1 + sum(g * s * tau / (1 + s * tau) for g, tau in prony))


@pytest.fixture(scope="module")
def isolated():
    model = jb.presets.rubber_isolators()
    return model, jb.linearize(model, jb.equilibrium(model))


@pytest.mark.long
def test_the_stiffness_of_an_isolator_is_the_series(isolated):
    for direction, k in (("x", 1e4), ("z", 4e4)):
        K = jb.vibration.dynamic_stiffness(
            isolated[0]["isolator 2"], FREQUENCIES, direction=direction
        )
        np.testing.assert_allclose(K.stiffness, series(S, k), rtol=1e-12)
    angle = np.rad2deg(np.angle(series(2j * np.pi * np.geomspace(1, 200, 100), 1.0)))
    assert angle.min() > 4.9 and angle.max() < 8  # as the docstring says


@pytest.mark.long
def test_transmissibilities_by_hand(isolated):
    """z by itself; x with pitch: the isolators are 0.1 m below the center of mass."""
    inputs = {axis: jb.BaseMotion("floor", axis) for axis in "xz"}
    outputs = {axis: jb.Position("instrument", axis=axis) for axis in "xz"} | {
        "ry": jb.sensors.Rotation("instrument", axis="y")
    }
    response = jb.frequency_response(isolated[1], FREQUENCIES, inputs, outputs)
    m, J, a, h = 50.0, 50.0 * 0.3**2, 0.3, 0.1
    k_x, k_z = 4 * series(S, 1e4), 4 * series(S, 4e4)
    np.testing.assert_allclose(response["z", "z"], k_z / (k_z + m * S**2), rtol=1e-10)
    for i, s in enumerate(S):
        D = np.array(
            [
                [k_x[i] + m * s**2, -h * k_x[i]],
                [-h * k_x[i], J * s**2 + h**2 * k_x[i] + a**2 * k_z[i]],
            ]
        )
        x, turn = np.linalg.solve(D, np.array([1.0, -h]) * k_x[i])
        np.testing.assert_allclose(
            [response["x", "x"][i], response["ry", "x"][i]], [x, turn], rtol=1e-10
        )


@pytest.mark.long
def test_equal_isolators_have_no_mode_of_relaxations_alone(isolated):
    """Poles -1/tau of 12 directions less 6 motions, for each branch: repeated, and real although
    rounding splits them."""
    damped = jb.complex_modes(isolated[1])
    assert (
        damped.frequency.shape == (6,)
        and (np.asarray(damped.frequency) > 4).all()
        and damped.relaxations.shape == (36,)
    )
    for _, tau in PRONY:
        assert np.sum(np.abs(damped.relaxations * tau + 1) < 1e-9) == 6
    k = np.array([1.75e4, 0.25e4, 0.25e4, 0.25e4]) * 16  # of z: four isolators of 4e4
    A = np.zeros((5, 5))  # z, its rate, three branches
    A[0, 1] = 1
    A[1] = [-k[0] / 50, 0, *(k[1:] / 50)]
    for i, (_, tau) in enumerate(PRONY, 2):
        A[i, 0], A[i, i] = 1 / tau, -1 / tau
    exact = np.linalg.eigvals(A)
    found = np.concatenate([np.asarray(damped.poles).ravel(), damped.relaxations])
    np.testing.assert_allclose(
        [found[np.argmin(np.abs(found - s))] for s in exact], exact, rtol=1e-9
    )


@pytest.mark.long
def test_one_branch_is_the_standard_linear_solid():
    """Poles of 50 kg on 2e4 N/m beside 6e4 N/m in series with a dashpot of 0.01 s (roots of its
    cubic), and the weight carried."""
    model = jb.presets.rubber_isolators(
        stiffness=(1e3, 2e3, 5e3), prony=[(3.0, 0.01)], gravity=9.81
    )
    eq = jb.equilibrium(model)
    np.testing.assert_allclose(eq.state.q[2], -50 * 9.81 / 2e4, rtol=1e-10)
    damped = jb.complex_modes(jb.linearize(model, model.reference))
    found = np.concatenate([np.asarray(damped.poles).ravel(), damped.relaxations])
    for s in (-86.883424586956, -6.558287706522 + 20.429779039925j):
        assert np.abs(found - s).min() < 1e-10 * abs(s)
