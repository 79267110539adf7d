"""Motions with couplings of coordinates: a rack, gears, a screw and a cam against one equation of
motion integrated by scipy, reactions in closed form, moving supports, derivatives."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import jaxbody as jb
from jaxbody.model.joints.joints import Joint

G = 9.81
# of the rack, of the pinion about its axis, and of the spring at the pinion
MASS, ABOUT, RADIUS, STIFFNESS = 6.0, 0.02, 0.05, 8.0
TIMES = np.linspace(0.0, 3.0, 61)
RTOL = 1e-10


def part(mass=1.0, about=ABOUT):
    return jb.Body(mass=mass, inertia=[about] * 3)


def integrated(rate, start):
    """y of y' = rate(t, y) at TIMES."""
    return solve_ivp(
        rate, (0.0, TIMES[-1]), start, t_eval=TIMES, method="DOP853", rtol=1e-12, atol=1e-13
    ).y


def on_slide(closures, elements=None, *, base="world", supports=None):
    """A follower that slides downwards on a frame and a wheel that turns on it about y."""
    return jb.Model(
        bodies={"follower": part(MASS), "wheel": part()},
        joints={"follower": jb.Guide(base, axis=[0, 0, -1]), "wheel": jb.Hinge(base, axis="y")},
        closures=closures,
        elements=elements or {},
        supports=supports or {},
        gravity=[0, 0, -G],
    )


def rack_and_pinion(base="world", supports=None):
    spring = jb.Torsion(base, "wheel", axis="y", spring=STIFFNESS)
    return on_slide(
        {"mesh": jb.closures.Coupling("follower.q", "wheel.q", ratio=RADIUS)},
        {"spring": spring},
        base=base,
        supports=supports,
    )


def closed_to(trajectory, gap):
    """The largest gap of coordinates and its largest rate."""
    q, v = (np.asarray(x) for x in (trajectory.state.q, trajectory.state.v))
    _, rates = jax.vmap(lambda q, v: jax.jvp(gap, (q,), (v,)))(q, v)
    return np.abs(jax.vmap(gap)(q)).max(), np.abs(rates).max()


@pytest.mark.long
def test_a_rack_swings_on_the_spring_of_its_pinion():
    """(J + m r^2) y'' = m g r - k y; the teeth carry lambda = m (g - r y''), the hinge of the
    pinion the moment r lambda about y."""
    model = rack_and_pinion()
    start = jb.State(jnp.array([RADIUS * 2.0, 2.0]), jnp.array([RADIUS * 30.0, 30.0]))
    motion = jb.simulate(model, TIMES, initial=start, rtol=RTOL)
    inertia = ABOUT + MASS * RADIUS**2
    pull = MASS * G * RADIUS
    turn, speed = integrated(lambda t, y: [y[1], (pull - STIFFNESS * y[0]) / inertia], [2.0, 30.0])
    np.testing.assert_allclose(motion.state.q, np.stack([RADIUS * turn, turn], -1), atol=1e-8)
    np.testing.assert_allclose(motion.state.v, np.stack([RADIUS * speed, speed], -1), atol=1e-6)
    gap, rate = closed_to(motion, lambda q: q[0] - RADIUS * q[1])
    assert gap < 1e-12 and rate < 1e-11
    energies = motion.energies
    np.testing.assert_allclose(
        energies["total"], energies["total"][0], atol=100 * RTOL * np.ptp(energies["kinetic"])
    )
    acceleration = (pull - STIFFNESS * turn) / inertia
    teeth = MASS * (G - RADIUS * acceleration)
    np.testing.assert_allclose(motion.closure_reactions["mesh"]["move"], teeth, atol=1e-5)
    read = jb.measure(
        motion, {"pinion": jb.sensors.Reaction("wheel"), "rack": jb.sensors.Reaction("follower")}
    )
    # of a coupling, in the joint
    np.testing.assert_allclose(read["pinion"][:, 4], RADIUS * teeth, atol=1e-6)
    np.testing.assert_allclose(read["rack"][:, 2], teeth, atol=1e-5)


@pytest.mark.long
def test_a_rack_and_pinion_moves_with_its_support():
    """The base rises by z: (J + m r^2) y'' = m r (g + z'') - k y, and carries
    (m_1 + m_2)(g + z'') - m r y''."""
    model = rack_and_pinion("base", {"base": jb.Support()})
    rise = jax.jit(jax.grad(jax.grad(lambda t: 0.05 * jnp.sin(4.0 * t) ** 2)))
    motion = {"base": lambda t: jnp.zeros(6).at[2].set(0.05 * jnp.sin(4.0 * t) ** 2)}
    trajectory = jb.simulate(model, TIMES, motion=motion, rtol=RTOL)
    inertia = ABOUT + MASS * RADIUS**2

    def acceleration(t, y):
        return (MASS * RADIUS * (G + float(rise(t))) - STIFFNESS * y) / inertia

    turn, _ = integrated(lambda t, y: [y[1], acceleration(t, y[0])], [0.0, 0.0])
    np.testing.assert_allclose(trajectory.state.q, np.stack([RADIUS * turn, turn], -1), atol=1e-8)
    carried = [
        (MASS + 1.0) * (G + float(rise(t))) - MASS * RADIUS * acceleration(t, y)
        for t, y in zip(TIMES, turn, strict=True)
    ]
    np.testing.assert_allclose(
        trajectory.reactions["base"][0][:, 2], np.negative(carried), atol=1e-5
    )


@pytest.mark.long
def test_gears_turn_with_a_pendulum_and_repeated_pairs_do_no_harm():
    """(J_1 + J_2 n_2^2 + J_3 n_3^2) y'' = -m g d sin y, by any two of three pairs; lambda of the
    first pair is shared."""
    mass, d, ratios = 2.0, 0.3, np.array([1.0, -23 / 17, 23 / 31])
    joints: dict[str, Joint] = dict.fromkeys(
        ["first", "second", "third"], jb.Hinge("world", axis="y")
    )
    bodies = dict.fromkeys(joints, part()) | {
        "first": jb.Body(mass=mass, inertia=[0.1] * 3, com=[0, 0, -d])
    }
    pairs = {
        "first pair": jb.closures.Coupling("second.q", "first.q", ratio=ratios[1]),
        "second pair": jb.closures.Coupling("third.q", "second.q", ratio=ratios[2] / ratios[1]),
        "both pairs": jb.closures.Coupling("third.q", "first.q", ratio=ratios[2]),
    }
    inertia = 0.1 + mass * d**2 + ABOUT * (ratios[1] ** 2 + ratios[2] ** 2)
    angle, speed = integrated(
        lambda t, y: [y[1], -mass * G * d * np.sin(y[0]) / inertia], [0.5, 8.0]
    )  # over the top
    start = jb.State(jnp.asarray(0.5 * ratios), jnp.asarray(8.0 * ratios))
    for count in (2, 3):
        model = jb.Model(
            bodies=bodies,
            joints=joints,
            closures=dict(list(pairs.items())[:count]),
            gravity=[0, 0, -G],
        )
        motion = jb.simulate(model, TIMES, initial=start, rtol=RTOL)
        np.testing.assert_allclose(motion.state.q, angle[:, None] * ratios, atol=1e-8)
        np.testing.assert_allclose(motion.state.v, speed[:, None] * ratios, atol=1e-7)
        assert max(closed_to(motion, lambda q: q - ratios * q[0])) < 1e-11
        reactions = motion.closure_reactions
        alpha = -mass * G * d * np.sin(angle) / inertia
        if count == 2:
            of_third = -ABOUT * ratios[2] * alpha  # resists an increase of the third angle
            np.testing.assert_allclose(reactions["second pair"]["turn"], of_third, atol=1e-7)
            of_second = -ABOUT * ratios[1] * alpha + ratios[2] / ratios[1] * of_third
            np.testing.assert_allclose(reactions["first pair"]["turn"], of_second, atol=1e-7)
        else:
            assert np.isnan(reactions["first pair"]["turn"]).all()


@pytest.mark.long
def test_a_nut_runs_down_its_screw():
    """(m + J/r^2) x'' = -m g."""
    r, mass, about = 0.02 / (2 * np.pi), 0.4, 3e-5
    model = jb.Model(
        bodies={"nut": jb.Body(mass=mass, inertia=[1.0, 1.0, about])},
        joints={"nut": jb.joints.Cylindrical("world", axis="z")},
        closures={"thread": jb.closures.Coupling("nut.q.0", "nut.q.1", ratio=r)},
        gravity=[0, 0, -G],
    )
    motion = jb.simulate(model, TIMES, rtol=RTOL)
    fallen = -mass * G / (mass + about / r**2) * TIMES**2 / 2
    np.testing.assert_allclose(
        motion.state.q, np.stack([fallen, fallen / r], -1), rtol=1e-9, atol=1e-12
    )


LIFT, CAM_SPRING, REST = 0.03, 2.0, 0.6
ANGLES = np.linspace(-10.0, 10.0, 2001)
PROFILES = {  # f, f', f''
    "function": (
        lambda y: LIFT * (1 - np.cos(y)),
        lambda y: LIFT * np.sin(y),
        lambda y: LIFT * np.cos(y),
    ),
    "table": (
        lambda y: LIFT * (y / 3 + np.sin(y) / 6),
        lambda y: LIFT * (1 / 3 + np.cos(y) / 6),
        lambda y: -LIFT * np.sin(y) / 6,
    ),
}
CAMS = {
    "function": lambda y: LIFT * (1 - jnp.cos(y)),
    "table": jb.laws.Tabulated(ANGLES, PROFILES["table"][0](ANGLES)),
}


def cam(kind):
    spring = jb.Torsion("world", "wheel", axis="y", spring=CAM_SPRING, free_angle=REST)
    return on_slide(
        {"contact": jb.closures.Coupling("follower.q", "wheel.q", function=CAMS[kind])},
        {"spring": spring},
    )


@pytest.mark.parametrize("kind", ["function", pytest.param("table", marks=pytest.mark.long)])
def test_a_cam_lifts_its_follower(kind):
    """x = f(y): (J + m f'^2) y'' + m f' f'' y'^2 = m g f' - k (y - y_0), and lambda = m (g - x'');
    of a table to its interpolation."""
    place, first, second = PROFILES[kind]

    def acceleration(y, speed):
        pull = (
            MASS * G * first(y) - CAM_SPRING * (y - REST) - MASS * first(y) * second(y) * speed**2
        )
        return pull / (ABOUT + MASS * first(y) ** 2)

    turn, speed = integrated(lambda t, y: [y[1], acceleration(*y)], [0.0, 6.0])
    start = jb.State(jnp.zeros(2), jnp.array([6.0 * first(0.0), 6.0]))
    motion = jb.simulate(cam(kind), TIMES, initial=start, rtol=RTOL)
    exact = kind == "function"
    np.testing.assert_allclose(motion.state.q[:, 1], turn, atol=1e-8 if exact else 1e-4)
    np.testing.assert_allclose(motion.state.q[:, 0], place(turn), atol=1e-8 if exact else 1e-5)
    change = first(turn) * acceleration(turn, speed) + second(turn) * speed**2
    np.testing.assert_allclose(
        motion.closure_reactions["contact"]["move"],
        MASS * (G - change),
        atol=1e-5 if exact else 0.05,
    )
    energies = motion.energies
    np.testing.assert_allclose(
        energies["total"], energies["total"][0], atol=100 * RTOL * np.ptp(energies["kinetic"])
    )
    if exact:
        assert closed_to(motion, lambda q: q[0] - LIFT * (1 - jnp.cos(q[1])))[0] < 1e-12


@pytest.mark.long
@pytest.mark.parametrize("kind", ["rack", "cam"])
def test_derivatives_of_a_motion(kind):
    """By the ratio or the inertia of the cam, and by the stiffness: forward, reverse
    and differences."""
    model = cam("function") if kind == "cam" else rack_and_pinion()
    path, value = (
        ("wheel.inertia", jnp.eye(3) * ABOUT)
        if kind == "cam"
        else ("mesh.ratio", jnp.array(RADIUS))
    )

    def end(x):
        changed = jb.replace(
            model, {path: value * (1 + x[0]), "spring.spring.coefficient": STIFFNESS * (1 + x[1])}
        )
        start = jb.State(jnp.zeros(2), jnp.array([0.0, 5.0]))
        state = jb.simulate(changed, TIMES[:11], initial=start, rtol=1e-11).state
        return state.q[-1] @ jnp.array([20.0, 1.0]) + state.v[4] @ jnp.array([3.0, 0.2])

    zero, of = jnp.zeros(2), jax.jit(end)
    forward, reverse = jax.jit(jax.jacfwd(end))(zero), jax.jit(jax.grad(end))(zero)
    np.testing.assert_allclose(forward, reverse, rtol=1e-9)
    h = 1e-3
    steps = [zero.at[i].set(h) for i in range(2)]
    differences = [(8 * (of(s) - of(-s)) - of(2 * s) + of(-2 * s)) / (12 * h) for s in steps]
    np.testing.assert_allclose(forward, differences, rtol=1e-6)
