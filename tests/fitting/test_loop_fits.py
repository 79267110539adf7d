"""Fits of models with closures: a slider-crank beside its one equation of motion, written out by
hand and integrated by SciPy."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

import jaxbody as jb
from jaxbody.fitting.experiments.experiments import Integration
from jaxbody.fitting.parameters.spaces import space_of
from jaxbody.fitting.residuals import Task, first_noise, residual_and_jacobian

CRANK, ROD, G = 0.1, 0.3, 9.81
# distances of the centers of mass of crank and rod from the pins that are nearer to the shaft
CENTERS = 0.04, 0.12
MASSES, INERTIAS = (0.8, 0.6, 1.5), (0.003, 0.006)
STIFFNESS, DAMPING, FREE_LENGTH = 400.0, 3.0, 0.35  # of the spring from the shaft to the slider
START = 0.9  # angle of the crank in the drawing, from which it is released
# of both ends of the spring, so that it is the spring that sets the size of the model, not the pin
ASIDE = np.array([0.05, 0, 0])
TIMES = np.linspace(0.0, 1.0, 81)
FREE = ["spring.stiffness", "spring.damping"]


def along_rod(angle, part):
    """x of a point of the rod, at this part of its length from the crank, and
    dx/dangle, d2x/dangle2."""
    s, c = np.sin(angle), np.cos(angle)
    D = np.sqrt(ROD**2 - (CRANK * s) ** 2)
    first = -CRANK * s - part * CRANK**2 * s * c / D
    second = -CRANK * c - part * CRANK**2 * ((c * c - s * s) / D + (CRANK * s * c) ** 2 / D**3)
    return CRANK * c + part * D, first, second


def felt_at_the_crank(angle):
    """Inertia m of the whole mechanism at the crank's angle, m'/2, and what its weights do
    in V'."""
    (m_crank, m_rod, m_slider), (J_crank, J_rod), part = MASSES, INERTIAS, CENTERS[1] / ROD
    s, c = np.sin(angle), np.cos(angle)
    D = np.sqrt(ROD**2 - (CRANK * s) ** 2)
    # of the rod, by the angle of the crank
    turn, turn_2 = CRANK * c / D, -CRANK * s / D + CRANK**3 * s * c**2 / D**3
    (_, x, x_2), (_, slid, slid_2) = along_rod(angle, part), along_rod(angle, 1.0)
    y, y_2 = CRANK * c * (1 - part), -CRANK * s * (1 - part)
    m = (
        J_crank
        + m_crank * CENTERS[0] ** 2
        + m_rod * (x * x + y * y)
        + J_rod * turn**2
        + m_slider * slid**2
    )
    return (
        m,
        m_rod * (x * x_2 + y * y_2) + J_rod * turn * turn_2 + m_slider * slid * slid_2,
        G * (m_crank * CENTERS[0] * c + m_rod * y),
    )


def moment(angle, k=STIFFNESS):
    """V'."""
    x, slid, _ = along_rod(angle, 1.0)
    return felt_at_the_crank(angle)[2] + k * (x - FREE_LENGTH) * slid


def by_hand(times, angle=START, rate=0.0):
    """Places of the slider, by m a'' + m' a'^2/2 + V' + c x'^2 a' = 0 for the angle a of
    the crank."""

    def rates(_, y):
        a, w = y
        m, half, _ = felt_at_the_crank(a)
        return [w, -(half * w * w + moment(a) + DAMPING * along_rod(a, 1.0)[1] ** 2 * w) / m]

    return along_rod(
        solve_ivp(
            rates, (times[0], times[-1]), [angle, rate], "DOP853", times, rtol=1e-12, atol=1e-13
        ).y[0],
        1.0,
    )[0]


def slider_crank(stiffness=STIFFNESS, damping=DAMPING):
    """Drawn closed with the crank at START; bodies have the axes of the world."""
    pin = CRANK * np.array([np.cos(START), np.sin(START), 0])
    end = np.array([along_rod(START, 1.0)[0], 0, 0])
    bar = lambda m, J, com: jb.Body(mass=m, inertia=[J] * 3, com=com)  # noqa: E731
    return jb.Model(
        bodies={
            "crank": bar(MASSES[0], INERTIAS[0], pin * CENTERS[0] / CRANK),
            "rod": bar(MASSES[1], INERTIAS[1], pin + (end - pin) * CENTERS[1] / ROD),
            "slider": bar(MASSES[2], 1.0, end),
        },
        joints={
            "crank": jb.Hinge("world", axis="z", at=[0, 0, 0]),
            "rod": jb.Hinge("crank", axis="z", at=pin),
            "slider": jb.Guide("world", axis="x"),
        },
        closures={"pin": jb.closures.Hinge(("rod", end), ("slider", end), axis="z")},
        elements={
            "spring": jb.Spring(
                ("slider", end + ASIDE),
                ("world", ASIDE),
                stiffness=stiffness,
                free_length=FREE_LENGTH,
                damping=damping,
            )
        },
        gravity=[0, -G, 0],
    )


def run_of(measured, times=TIMES, noise=1e-6, initial=None):
    sensors = {"x": jb.Position("slider", [along_rod(START, 1.0)[0], 0, 0], axis="x")}
    return jb.Experiment(
        times, sensors=sensors, measured={"x": measured}, noise=noise, initial=initial
    )


@pytest.mark.long
def test_stiffness_and_damping_of_a_slider_crank_from_its_equation_by_hand():
    noise = 1e-6 * np.random.default_rng(4).normal(size=len(TIMES))
    fit = jb.fit(slider_crank(360.0, 4.0), {"run": run_of(by_hand(TIMES) + noise)}, free=FREE)
    assert fit.ok
    for path, truth in zip(FREE, (STIFFNESS, DAMPING), strict=True):
        assert abs(fit.estimates[path] - truth) < 4 * fit.standard_errors[path] < 1e-3 * truth
    exact = jb.fit(slider_crank(360.0, 4.0), {"run": run_of(by_hand(TIMES))}, free=FREE)
    print(exact)
    for path, truth in zip(FREE, (STIFFNESS, DAMPING), strict=True):
        # rtol 1e-8 of the motion, in a motion of 7 % of the size
        np.testing.assert_allclose(exact.estimates[path], truth, rtol=1e-6)


@pytest.mark.long
def test_a_record_in_segments():
    """The gaps between segments hold the dependent coordinates of their initial states, too."""
    times, rng = np.linspace(0.0, 3.0, 121), np.random.default_rng(1)
    run = run_of(by_hand(times) + 1e-5 * rng.normal(size=len(times)), times, 1e-5)
    fit = jb.fitting.multiple_shooting(
        slider_crank(330.0, 4.0), {"run": run}, free=FREE, segments=3
    )
    assert fit.ok
    for path, truth in zip(FREE, (STIFFNESS, DAMPING), strict=True):
        assert abs(fit.estimates[path] - truth) < 4 * fit.standard_errors[path] < 1e-2 * truth


OPEN = jb.State(np.array([0.01, -0.02, 0.004]), np.array([0.5, 0.2, -0.3]))


@pytest.mark.long
def test_an_open_start_is_moved_onto_the_closures_as_simulate_does():
    model, run = slider_crank(), run_of(by_hand(TIMES), initial=OPEN)
    with pytest.warns(jb.JaxbodyWarning, match="NOT_CLOSED"):
        trajectory = jb.simulate(model, TIMES, initial=OPEN)
    readings = eqx.filter_jit(run.readings)(model, Integration(), None)
    np.testing.assert_allclose(readings["x"], jb.measure(trajectory, run.sensors)["x"], atol=1e-12)
    # of rtol 1e-8
    np.testing.assert_allclose(readings["x"], by_hand(TIMES, *crank_of(trajectory)), atol=1e-9)


def crank_of(trajectory):
    """Angle and rate of the crank at the start."""
    return float(trajectory.state.q[0, 0]) + START, float(trajectory.state.v[0, 0])


@pytest.mark.long
def test_residuals_have_the_derivatives_of_differences():
    """By stiffness, damping, a point of the closure, which opens the loop as it is drawn, and by
    the open initial state. Only out of the plane no place of the point closes the loop."""
    times = TIMES[:31]
    runs = {"run": run_of(by_hand(times), times, noise=1.0, initial=OPEN)}
    space = space_of(
        slider_crank(), [*FREE, "pin.a", "rod.com", "run.initial.*"], "test", runs=runs
    )
    task = Task(space, first_noise(runs, absolute=False)[0], Integration(rtol=1e-11))
    _, J, _ = residual_and_jacobian(task, jnp.zeros(space.size))
    h = 1e-5
    for i, name in [(i, name) for i, name in enumerate(space.labels) if name != "pin.a[2]"]:
        ahead, behind = (
            residual_and_jacobian(task, jnp.zeros(space.size).at[i].set(step))[0]
            for step in (h, -h)
        )
        np.testing.assert_allclose(
            J[:, i], (ahead - behind) / (2 * h), atol=1e-6 * np.abs(J).max(), err_msg=name
        )
    # of three coordinates one is free, and its rate
    assert np.linalg.matrix_rank(J[:, -6:], tol=1e-6 * np.abs(J).max()) == 2


@pytest.mark.long
def test_modes_and_responses_of_a_closed_loop():
    """About its equilibrium the slider crank is an oscillator of the crank's angle; two numbers of
    it are those of spring and damper."""
    angle = brentq(moment, 0.3, 1.5, xtol=1e-15)
    m, slid = felt_at_the_crank(angle)[0], along_rod(angle, 1.0)[1]
    K, C = moment(angle + 1e-30j).imag / 1e-30, DAMPING * slid**2
    test = jb.MeasuredModes(
        frequency=[(K / m) ** 0.5 / (2 * np.pi)],
        damping_ratio=[C / (2 * (K * m) ** 0.5)],
        noise={"frequency": 1e-4, "damping_ratio": 1e-4},
    )
    f = np.array([0.5, 2.0, 3.0, 8.0])
    w, end = 2 * np.pi * f, [along_rod(START, 1.0)[0], 0, 0]
    hammer = jb.MeasuredResponse(
        f,
        inputs={"push": jb.PointForce("slider", end, direction="x")},
        outputs={"x": jb.Position("slider", end, axis="x")},
        measured={("x", "push"): slid**2 / (K + 1j * w * C - w**2 * m)},
        noise=1e-6,
    )
    for measurement in (test, hammer):
        fit = jb.fit(slider_crank(360.0, 4.0), {"test": measurement}, free=FREE)
        for path, truth in zip(FREE, (STIFFNESS, DAMPING), strict=True):
            np.testing.assert_allclose(fit.estimates[path], truth, rtol=1e-8)


@pytest.mark.long
def test_a_record_that_is_too_short_is_said_to_be():
    times = np.linspace(0.0, 0.02, 21)
    with pytest.warns(
        jb.JaxbodyWarning, match="a small part of the first natural period of 0.* s: record longer"
    ):
        jb.fit(
            slider_crank(),
            {"run": run_of(by_hand(times), times, noise=1e-3)},
            free=[*FREE, "*.mass"],
        )
