"""Ready models have the published frequencies and the matrices that are written out here."""

import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg

import jaxbody as jb
from jaxbody import presets


def frequencies(model, **state):
    eq = jb.equilibrium(model, **state)
    assert eq.ok or int(eq.status) == jb.Status.SINGULAR_K
    return eq, jb.linearize(model, eq)


def full_car_matrices(
    mass=1100.0,
    inertia=(450.0, 1500.0),
    front=1.2,
    rear=1.4,
    track=1.5,
    mu=(40.0, 35.0),
    k=(22000.0, 24000.0),
    c=(1500.0, 1600.0),
    kt=190000.0,
    bar=(12000.0, 6000.0),
):
    """M, C, K and the excitation by the roads of the seven degree car, by hand: coordinates z,
    pitch (front down), roll (right down), the wheels."""
    corners = [
        (front, track / 2, 0),
        (front, -track / 2, 0),
        (-rear, track / 2, 1),
        (-rear, -track / 2, 1),
    ]
    M = np.diag([mass, inertia[1], inertia[0], mu[0], mu[0], mu[1], mu[1]])
    K, C, T = np.zeros((7, 7)), np.zeros((7, 7)), np.zeros((7, 4))
    for i, (x, y, axle) in enumerate(corners):
        stroke = np.zeros(7)
        stroke[:3], stroke[3 + i] = (1, -x, y), -1  # corner of the body minus wheel
        K += k[axle] * np.outer(stroke, stroke)
        C += c[axle] * np.outer(stroke, stroke)
        K[3 + i, 3 + i] += kt
        T[3 + i, i] = kt
    for axle, (left, right) in enumerate(((3, 4), (5, 6))):
        twist = np.zeros(7)
        twist[left], twist[right], twist[2] = 1, -1, -track
        K += bar[axle] * np.outer(twist, twist)
    return M, C, K, T


def test_the_full_car_is_the_seven_degree_car_written_here():
    """The reference pose is the equilibrium; M, C, K and K~ are equal, so all follows."""
    car = presets.full_car()
    eq, lin = frequencies(car)
    assert eq.ok
    assert abs(eq.state.q).max() <= 1e-12
    M, C, K, T = full_car_matrices()
    order = [lin.coordinates.index(name) for name in lin.coordinates]
    assert order == list(range(7))
    np.testing.assert_allclose(lin.M, M, atol=1e-9)
    np.testing.assert_allclose(lin.C, C, atol=1e-9)
    np.testing.assert_allclose(lin.K, K, atol=1e-6)
    up = [
        lin.base_coordinates.index(f"road {wheel} move along z")
        for wheel in ("fl", "fr", "rl", "rr")
    ]
    np.testing.assert_allclose(lin.K_tilde[:, up], T, atol=1e-6)
    w = np.sqrt(scipy.linalg.eigh(K, M, eigvals_only=True))
    np.testing.assert_allclose(2 * np.pi * jb.modes(lin).frequency, w, rtol=1e-12)


@pytest.mark.long
def test_four_wheels_on_a_road_with_the_delay_of_the_wheelbase():
    """A low kerb: the exact motion against the linear car by SciPy, each wheel driven by its own
    support; second order in the height."""
    from scipy.integrate import solve_ivp

    car, h, speed = presets.full_car(), 1e-3, 8.0
    at = {"fl": 1.2, "fr": 1.2, "rl": -1.4, "rr": -1.4}
    roads = {
        name: jb.inputs.Road(
            [0, 3, 3.4, 9],
            [0, 0, h * (1 + (name == "fl")), h],
            speed=speed,
            position=x,
            footprint=0.2,
        )
        for name, x in at.items()
    }
    times = np.linspace(0, 1.0, 101)
    run = jb.simulate(
        car, times, motion={f"road {name}": road for name, road in roads.items()}, rtol=1e-9
    )
    M, C, K, T = full_car_matrices()

    def felt(name, t):
        s = at[name] + speed * t + np.linspace(-0.1, 0.1, 2001)
        return (
            np.trapezoid(np.interp(s, [0, 3, 3.4, 9], [0, 0, h * (1 + (name == "fl")), h]), s) / 0.2
        )

    def rate(t, y):
        return np.concatenate(
            [y[7:], np.linalg.solve(M, T @ [felt(name, t) for name in at] - K @ y[:7] - C @ y[7:])]
        )

    y = (
        solve_ivp(rate, (0, 1), np.zeros(14), t_eval=times, rtol=1e-8, atol=1e-10, max_step=5e-3)
        .y[:7]
        .T
    )
    assert abs(run.state.q - y).max() <= 2e-3 * abs(y).max()  # 1 mm against lengths of 0.25 m
    front, rear = run.poses["fr"].p[:, 2], run.poses["rr"].p[:, 2]
    assert (
        np.argmax(front > 0.3 + h / 2) + 30
        <= np.argmax(rear > 0.3 + h / 2)
        <= np.argmax(front > 0.3 + h / 2) + 36
    )  # 2.6 m at 8 m/s


PRINTED = {
    "quarter_car": (np.array([8.8671, 55.2694]) / (2 * np.pi), 1e-5),
    "half_car": (np.array([5.8593, 9.4341]) / (2 * np.pi), 1e-5),
    "engine_on_mounts": (
        [7.50256052, 8.63234374, 10.0551899, 11.6890922, 20.4491842, 26.4512989],
        1e-7,
    ),
    "isolated_table": (sorted([3.618009, 7.349698, 3.734370, 7.354211, 5.097929, 6.366198]), 1e-6),
    "elastic_pendulum": ([0.5, 0.5, 1.0], 1e-9),  # Lynch's resonance
}


@pytest.mark.long
@pytest.mark.parametrize("name", PRINTED)
def test_frequencies_are_those_that_the_sources_print(name):
    printed, last_digit = PRINTED[name]
    _, lin = frequencies(getattr(presets, name)())
    np.testing.assert_allclose(jb.modes(lin).frequency, printed, atol=last_digit)


@pytest.mark.long
def test_the_stewart_table_stands_on_legs_of_equal_tension():
    """Six legs, by symmetry each a sixth of the weight over its slope; z and yaw by hand: K = 6 k
    (h/L)^2 and so on, with tension T/L across."""
    model = presets.stewart_table()
    eq, lin = frequencies(model)
    assert eq.ok
    np.testing.assert_allclose(eq.state.q, [0, 0, 0.5, 1, 0, 0, 0], atol=1e-10)
    a, b = np.asarray(model["leg 1"].a), np.asarray(model["leg 1"].b)
    d = b - a - [0, 0, 0.5]
    L, T = np.linalg.norm(d), -50.0 * 9.81 / 6 / (0.5 / np.linalg.norm(d))
    k = 1e4
    np.testing.assert_allclose(
        [float(lin.K[2, 2])], 6 * (k * (0.5 / L) ** 2 + T / L * (1 - (0.5 / L) ** 2)), rtol=1e-9
    )
    lever = np.cross(a, d)[2] / L
    yaw = 6 * (k * lever**2 + T / L * (a[:2] @ (a + d)[:2] - lever**2))
    np.testing.assert_allclose(float(lin.K[5, 5]), yaw, rtol=1e-9)
    lengths = [
        np.linalg.norm(np.asarray(model[leg].b) - np.asarray(model[leg].a) - [0, 0, 0.5])
        for leg in model.element_names
    ]
    np.testing.assert_allclose(lengths, L, rtol=1e-12)


@pytest.mark.long
def test_the_double_pendulum_and_the_gliders():
    model = presets.double_pendulum()
    _, lin = frequencies(model)
    np.testing.assert_allclose(
        lin.M, [[1 / 3 + 1 + 1 + 1 / 3, 1 / 2 + 1 / 3], [1 / 2 + 1 / 3, 1 / 3]], rtol=1e-12
    )  # the lower one's angle is from the upper
    np.testing.assert_allclose(lin.K, 9.81 * np.array([[2, 0.5], [0.5, 0.5]]), rtol=1e-12)
    _, lin = frequencies(
        presets.coupled_gliders(
            masses=(0.3, 0.5), stiffness=(3.0, 4.0, 5.0), damping=(0.1, 0.2, 0.3)
        )
    )
    np.testing.assert_allclose(lin.K, [[7, -4], [-4, 9]], rtol=1e-12)
    np.testing.assert_allclose(lin.C, [[0.3, -0.2], [-0.2, 0.5]], rtol=1e-12)
    np.testing.assert_allclose(np.diag(lin.M), [0.3, 0.5])


@pytest.mark.long
@pytest.mark.parametrize(
    "name",
    [
        "quarter_car",
        "half_car",
        "full_car",
        "engine_on_mounts",
        "isolated_table",
        "stewart_table",
        "elastic_pendulum",
        "double_pendulum",
        "coupled_gliders",
    ],
)
def test_every_ready_model_names_its_source(name):
    assert "Source:" in getattr(presets, name).__doc__
    assert bool(jnp.isfinite(getattr(presets, name)().reference.q).all())


# Braking and cornering


def pushed(car, acceleration):
    """Vertical forces of the road on the wheels, more than at rest, and the car's coordinates."""
    cases = jb.load_cases(car, {"case": jb.LoadCase(acceleration=acceleration)})
    names = [name for name in car.element_names if name.startswith("tyre") or car.layout.nv == 2]
    rest = {
        name: -float(car[name].stiffness) * float(cases.unloaded.elongations[name])
        for name in names
    }
    return (
        cases,
        {name: -float(cases.forces[name][0]) - rest[name] for name in names},
        np.asarray(cases.state.q[0]),
    )


@pytest.mark.long
def test_braking_and_cornering_load_the_wheels_by_the_height_of_the_center_of_mass():
    """m (a cos + g sin) h about the point on the road: m a h/(2 L) a wheel, and what the center of
    mass that goes forward adds."""
    car, m, h, a = presets.full_car(height=0.55), 1100.0, 0.55, 9.80665
    eq = jb.equilibrium(car)
    assert eq.ok and abs(eq.state.q).max() <= 1e-12
    cases, more, q = pushed(car, [-1, 0, 0])
    assert not cases.by_joints.any() and abs(sum(more.values())) <= 1e-6
    front = more["tyre fl"] + more["tyre fr"]
    # the struts' lower ends are off the road by what the tyres give, 4 mm
    np.testing.assert_allclose(
        front * 2.6, m * h * (a * np.cos(q[1]) + 9.81 * np.sin(q[1])), rtol=1e-3
    )
    # of which 0.04 is the weight's
    np.testing.assert_allclose(front / 2, m * a * h / (2 * 2.6), rtol=0.06)
    _, more, q = pushed(car, [0, 0.5, 0])
    right = more["tyre fr"] + more["tyre rr"]
    np.testing.assert_allclose(
        right * 1.5, m * h * (a / 2 * np.cos(q[2]) + 9.81 * np.sin(q[2])), rtol=3e-3
    )
    assert more["tyre fr"] > more["tyre rr"] > 0  # the stiffer bar takes more


@pytest.mark.long
def test_a_half_car_dives_when_it_brakes():
    car = presets.half_car(height=0.5)
    _, more, q = pushed(car, [-0.5, 0, 0])
    moment = 1000 * 0.5 * (9.80665 / 2 * np.cos(q[1]) + 9.81 * np.sin(q[1]))
    # their ends are displaced to the side of them
    np.testing.assert_allclose(more["front spring"], moment / 2.5, rtol=0.01)
    assert q[1] > 0


@pytest.mark.long
def test_a_load_case_that_joints_carry_alone_says_so():
    """Its table was zeros without a word."""
    cases, more, _ = pushed(presets.full_car(), [-1, 0, 0])
    assert cases.ok.all() and cases.by_joints.all() and max(abs(x) for x in more.values()) <= 1e-8
    assert (
        "'case' carried by the joints alone" in cases.report()
        and "carried by the joints alone" in str(cases)
    )
    assert not pushed(presets.full_car(), [0, 0, 1])[0].by_joints.any()
