"""Motions of closed loops: one equation of motion in closed form integrated by scipy, published
mechanisms, derivatives, and failures."""

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline

import jaxbody as jb
from jaxbody.mechanics.closed_loops import ClosedLoops
from jaxbody.mechanics.hessians import matrices
from jaxbody.mechanics.quasi_static_states import rest_state
from jaxbody.model.joints.frame_tables import gaps
from jaxbody.model.joints.joints import Joint
from jaxbody.model.joints.kinematics import Coordinates
from jaxbody.motion.simulations import motions_of

G = 9.81
CRANK, COUPLER, ROCKER, BASE = 0.12, 0.36, 0.24, 0.3
# mass, distance of its center, inertia
BAR = {"crank": (0.8, 0.05, 0.002), "coupler": (1.5, 0.2, 0.02), "rocker": (1.1, 0.1, 0.008)}
# of the torsion spring at the crank; angle of the crank in the drawing
TORQUE, REST, START = 30.0, 0.4, 0.5


def angles(crank, foot):
    """Angles of coupler and rocker, open circuit, from where the foot of the rocker is."""
    x, y = foot - CRANK * jnp.cos(crank), -CRANK * jnp.sin(crank)
    d = jnp.sqrt(x * x + y * y)
    coupler = jnp.arctan2(y, x) + jnp.arccos((COUPLER**2 + d * d - ROCKER**2) / (2 * COUPLER * d))
    end = (
        CRANK * jnp.cos(crank) + COUPLER * jnp.cos(coupler) - foot,
        CRANK * jnp.sin(crank) + COUPLER * jnp.sin(coupler),
    )
    return coupler, jnp.arctan2(end[1], end[0])


def places(crank, foot):
    """Centers of mass and angles of the bars."""
    coupler, rocker = angles(crank, foot)
    along = lambda r, a: r * jnp.stack([jnp.cos(a), jnp.sin(a)])  # noqa: E731
    d = [distance for _, distance, _ in BAR.values()]
    centers = (
        along(d[0], crank),
        along(CRANK, crank) + along(d[1], coupler),
        jnp.stack([foot, 0 * foot]) + along(d[2], rocker),
    )
    return jnp.stack(centers), jnp.stack([crank, coupler, rocker])


def four_bar(cut="head", *, support=False):
    """Drawn closed with the crank at START; bodies have the axes of the world. The closure is
    between coupler and rocker, or of the rocker and the ground."""
    center, (_, coupler, _) = (np.asarray(x) for x in places(START, jnp.array(BASE)))
    pin = CRANK * np.array([np.cos(START), np.sin(START), 0.0])
    end = pin + COUPLER * np.array([np.cos(coupler), np.sin(coupler), 0.0])
    foot, ground = np.array([BASE, 0.0, 0.0]), "base" if support else "world"
    joints: dict[str, Joint] = {
        "crank": jb.Hinge("world", axis="z", at=[0, 0, 0]),
        "coupler": jb.Hinge("crank", axis="z", at=pin),
    }
    joints["rocker"] = (
        jb.Hinge(ground, axis="z", at=foot)
        if cut == "head"
        else jb.Hinge("coupler", axis="z", at=end)
    )
    ends = (
        (("coupler", end), ("rocker", end)) if cut == "head" else ((ground, foot), ("rocker", foot))
    )
    bodies = {
        name: jb.Body(mass=BAR[name][0], inertia=[BAR[name][2]] * 3, com=np.append(c, 0.0))
        for name, c in zip(BAR, center, strict=True)
    }
    return jb.Model(
        bodies=bodies,
        joints=joints,
        closures={"pin": jb.closures.Hinge(*ends, axis="z")},
        elements={
            "spring": jb.Torsion("world", "crank", axis="z", spring=TORQUE, free_angle=REST - START)
        },
        supports={"base": jb.Support()} if support else {},
        gravity=[0, -G, 0],
    )


def by_hand(times, foot):
    """Angle of the crank and its rate by d/dt dL/dx' = dL/dx, L = T - V of the crank's angle x and
    of the foot's place in time."""
    masses, inertias = (jnp.array([values[i] for values in BAR.values()]) for i in (0, 2))

    def lagrangian(x, rate, t):
        (centers, turns), (v, w) = jax.jvp(
            lambda x, t: places(x, foot(t)), (x, t), (rate, jnp.ones_like(t))
        )
        T = jnp.sum(masses * jnp.sum(v * v, 1)) / 2 + jnp.sum(inertias * w * w) / 2
        return T - G * jnp.sum(masses * centers[:, 1]) - TORQUE * (turns[0] - REST) ** 2 / 2

    @jax.jit
    def rates(t, y):
        momentum = jax.grad(lagrangian, 1)
        by_x, by_rate, by_t = jax.jacfwd(momentum, (0, 1, 2))(y[0], y[1], t)
        return jnp.stack(
            [y[1], (jax.grad(lagrangian)(y[0], y[1], t) - by_x * y[1] - by_t) / by_rate]
        )

    span = float(times[0]), float(times[-1])
    return solve_ivp(
        rates, span, [START, 0.0], t_eval=np.asarray(times), method="DOP853", rtol=1e-12, atol=1e-13
    ).y


def turned(trajectory, body):
    R = np.asarray(trajectory.poses[body].R)
    return np.unwrap(np.arctan2(R[:, 1, 0], R[:, 0, 0]))


def largest_gap(trajectory):
    def gap(model, motions, t, state):
        coordinates = Coordinates(model)
        frames = coordinates.frames(state.q, state.v, coordinates.supports_moving(motions, t))
        return jnp.max(jnp.abs(gaps(model, coordinates, frames, state.q)))

    return float(jnp.max(trajectory.at_samples(gap)))


@pytest.mark.long
@pytest.mark.parametrize("cut", ["head", "foot"])
def test_a_four_bar_moves_as_its_one_equation_of_motion_and_keeps_its_energy(cut):
    times, rtol = np.linspace(0.0, 10.0, 201), 1e-10
    trajectory = jb.simulate(four_bar(cut), times, rtol=rtol)
    angle, _ = by_hand(times, lambda t: jnp.array(BASE) + 0 * t)
    np.testing.assert_allclose(turned(trajectory, "crank") + START, angle, atol=1e-8)
    rocker = np.array([angles(x, BASE)[1] - angles(START, BASE)[1] for x in angle])
    np.testing.assert_allclose(turned(trajectory, "rocker"), rocker, atol=1e-8)
    energies = trajectory.energies
    exchanged = np.ptp(energies["kinetic"])
    np.testing.assert_allclose(energies["total"], energies["total"][0], atol=100 * rtol * exchanged)
    assert largest_gap(trajectory) < 1e-12 * CRANK
    assert trajectory.closing is not None and float(trajectory.closing.gap) < 1e-12


@pytest.mark.long
@pytest.mark.parametrize("cut", ["head", "foot"])
def test_a_support_that_moves_drives_a_closed_loop(cut):
    """The foot of the rocker shakes: c depends on time, through the tree or through the closure."""
    times = np.linspace(0.0, 2.0, 1001)

    def shake(t):
        return 0.02 * jnp.sin(8.0 * t) ** 2

    motion = {"base": lambda t: jnp.zeros(6).at[0].set(shake(t))}
    trajectory = jb.simulate(four_bar(cut, support=True), times, motion=motion, rtol=1e-10)
    angle, _ = by_hand(times, lambda t: BASE + shake(t))
    np.testing.assert_allclose(turned(trajectory, "crank") + START, angle, atol=1e-8)
    assert largest_gap(trajectory) < 1e-12 * CRANK
    if cut == "head":
        check_newton(trajectory)


def check_newton(trajectory):
    """m a = m g + forces of the closure and of the joint, and work of the base = change
    of energy."""
    mass, com = trajectory.model["rocker"].mass, trajectory.model["rocker"].com
    read = jb.measure(
        trajectory, {"a": jb.Acceleration("rocker", com), "joint": jb.sensors.Reaction("rocker")}
    )
    turn = np.asarray(trajectory.poses["coupler"].R)[:, :2, :2]
    of_closure = np.stack([trajectory.closure_reactions["pin"][row] for row in "xy"], -1)
    assert np.isnan(trajectory.closure_reactions["pin"]["z"]).all()
    expected = mass * (np.asarray(read["a"])[:, :2] + [0, G])
    np.testing.assert_allclose(
        -np.einsum("tij,tj->ti", turn, of_closure) + np.asarray(read["joint"])[:, :2],
        expected,
        atol=1e-9,
    )
    work = CubicSpline(trajectory.times, trajectory.powers["supports"]).antiderivative()(
        trajectory.times
    )
    energy = trajectory.energies["total"]
    # of the spline's integral
    np.testing.assert_allclose(energy - energy[0], work, atol=1e-5 * np.ptp(energy))


@pytest.mark.long
def test_rest_on_a_base_that_moves_slowly_follows_the_equilibria():
    """v = d(equilibrium)/dXi Xi', by differences over the place of the base."""
    model, speed, h = four_bar("foot", support=True), 0.05, 1e-4
    slow = {"base": lambda t: jnp.zeros(6).at[0].set(speed * t)}
    start = jax.tree.map(
        lambda x: x[0], jb.simulate(model, [0.0, 1e-3], motion=slow, initial="rest").state
    )
    at_rest = [
        jb.equilibrium(jb.replace(model, {"base.position": jnp.array([x, 0.0, 0])})).state.q
        for x in (0.0, h, -h)
    ]
    np.testing.assert_allclose(start.q, at_rest[0], atol=1e-9)
    np.testing.assert_allclose(start.v, speed * (at_rest[1] - at_rest[2]) / (2 * h), rtol=1e-5)


@pytest.mark.long
def test_rest_on_a_base_that_is_displaced_and_turns():
    """q and v of the equilibria of a model drawn with the base there, by differences; the closure
    is on the base."""
    model, h = four_bar("foot", support=True), 1e-3
    place = {"base": lambda t: jnp.array([0.01 + 0.05 * t, 0, 0, 0, 0, 0.1 + 0.3 * t])}

    def drawn(t):
        turn = 0.05 + 0.15 * t
        there = {
            "base.position": jnp.array([0.01 + 0.05 * t, 0.0, 0]),
            "base.orientation": jnp.array([jnp.cos(turn), 0, 0, jnp.sin(turn)]),
        }
        return jb.equilibrium(jb.replace(model, there)).state.q

    start = rest_state(model, motions_of(model, place), 0.0)[0]
    at_rest = [drawn(t) for t in (0.0, h, -h, 2 * h, -2 * h)]
    np.testing.assert_allclose(start.q, at_rest[0], atol=1e-9)
    differences = (8 * (at_rest[1] - at_rest[2]) - at_rest[3] + at_rest[4]) / (12 * h)
    np.testing.assert_allclose(start.v, differences, rtol=1e-6)
    assert np.abs(start.v).min() > 1e-3


def windows(n=2):
    """The N-four-bar mechanism of the IFToMM benchmark A02: rods of 1 m and 1 kg, upright ones on
    the ground, level ones on top."""
    bodies, joints, closures = {}, {}, {}
    for i in range(n + 1):
        bodies[f"up {i}"] = jb.Body(
            mass=1.0, inertia=[1 / 12, 1e-4, 1 / 12], com=[0, 0.5, 0], position=[i, 0, 0]
        )
        joints[f"up {i}"] = jb.Hinge("world", axis="z")
    for i in range(n):
        bodies[f"level {i}"] = jb.Body(
            mass=1.0, inertia=[1e-4, 1 / 12, 1 / 12], com=[0.5, 0, 0], position=[i, 1, 0]
        )
        joints[f"level {i}"] = jb.Hinge(f"up {i}", axis="z")
        closures[f"pin {i}"] = jb.closures.Hinge(
            (f"level {i}", [1, 0, 0]), (f"up {i + 1}", [0, 1, 0]), axis="z"
        )
    return jb.Model(bodies=bodies, joints=joints, closures=closures, gravity=[0, -G, 0])


@pytest.mark.long
def test_a_mechanism_passes_its_folded_positions_at_speed():
    """Rank drops where all links lie in line; one freedom, ((N + 1)/3 + N) x'' = -((N + 1)/2 + N) g
    cos x: published curves."""
    model = windows()
    up = jnp.array([-1.0 if name.startswith("up") else 1.0 for name in model.layout.bodies])
    start = jb.State(model.reference.q, up)
    times = np.array([0.0, 0.5, 1.0, 2.0, 10.0])
    trajectory = jb.simulate(model, times, initial=start, rtol=1e-9)
    assert trajectory.ok
    top = jb.measure(
        trajectory,
        {"place": jb.Position("up 0", [0, 1, 0]), "speed": jb.Velocity("up 0", [0, 1, 0])},
    )
    published = [
        [0.695286633164, 0.718732563436],
        [-0.195020301950, -0.980799205662],
        [0.057815795768, 0.998327267863],
    ]
    np.testing.assert_allclose(
        top["place"][1:, :2], [*published, [0.328458111533, 0.944518538181]], atol=1e-6
    )
    np.testing.assert_allclose(
        top["speed"][1:, 0], [1.9602054254, -6.6766780369, 1.0172601366, 1.4230514702], atol=1e-5
    )
    energy = trajectory.energies["total"]
    assert float(energy[0]) == pytest.approx(35.835, abs=1e-12)
    np.testing.assert_allclose(energy, energy[0], atol=1e-6)


def squeezer():
    """Andrews' squeezing mechanism, benchmark A03, drawn where it starts; the crank turns under a
    constant moment."""
    A, B, C = (
        np.array([-0.06934, -0.00227]),
        np.array([-0.03635, 0.03273]),
        np.array([0.014, 0.072]),
    )
    beta, gamma, delta = -0.0617138900142764963589, 0.455279819163070380256, 0.487364979543842550226
    phi, epsilon = 0.222668390165885884674, 1.23054744454982119250
    e, n = (
        (lambda a: np.array([np.cos(a), np.sin(a)])),
        (lambda a: np.array([np.sin(a), -np.cos(a)])),
    )
    F, G_, H = 0.007 * e(beta), A + 0.04 * e(delta), A + 0.04 * n(epsilon)
    E = F - 0.028 * e(beta)
    for other in (B + 0.035 * n(gamma), G_ + 0.02 * n(phi + delta), H + 0.02 * e(-phi + epsilon)):
        np.testing.assert_allclose(other, E, atol=1e-15)
    parts = {  # where it is hinged and on what, center of mass, mass, inertia
        "beta": ("world", np.zeros(2), 0.00092 * e(beta), 0.04325, 2.194e-6),
        "theta": ("beta", F, F - 0.0115 * e(beta), 0.00365, 4.410e-7),
        "gamma": ("world", B, B + np.hypot(0.01874, 0.01043) * e(gamma), 0.02373, 5.255e-6),
        "delta": ("world", A, A + np.hypot(0.02308, 0.00916) * e(delta), 0.0705, 1.169e-5),
        "phi": ("delta", G_, G_ + 0.00579 * n(phi + delta), 0.00706, 5.667e-7),
        "epsilon": ("world", A, A + np.hypot(0.01228, 0.00449) * e(epsilon), 0.05498, 1.912e-5),
        "Omega": ("epsilon", H, H + 0.00579 * e(-phi + epsilon), 0.00706, 5.667e-7),
    }
    end = np.append(E, 0.0)
    D = B + 0.02 * e(gamma) + 0.018 * n(gamma)
    model = jb.Model(
        bodies={
            name: jb.Body(mass=m, inertia=[J, J, J], com=np.append(c, 0))
            for name, (_, _, c, m, J) in parts.items()
        },
        joints={
            name: jb.Hinge(parent, axis="z", at=np.append(at, 0))
            for name, (parent, at, *_) in parts.items()
        },
        closures={
            f"{name} head": jb.closures.Hinge(("theta", end), (name, end), axis="z")
            for name in ("gamma", "phi", "Omega")
        },
        elements={
            "spring": jb.Spring(
                ("gamma", np.append(D, 0)),
                ("world", np.append(C, 0)),
                stiffness=4530.0,
                free_length=0.07785,
            )
        },
    )
    return model, dict(
        beta=beta, theta=0.0, gamma=gamma, delta=delta, phi=phi, epsilon=epsilon, Omega=-phi
    )


@pytest.mark.long
def test_andrews_squeezer_ends_as_published():
    model, start = squeezer()
    q, v = model.layout.q_slices, model.layout.v_slices
    motor = jb.Force("beta", moment=[0, 0, 0.033])
    trajectory = jb.simulate(model, np.linspace(0.0, 0.03, 31), loads={"motor": motor}, rtol=1e-10)
    ends = {
        "beta": (15.81077119629904, 1139.920302151208),
        "theta": (-15.75637105984298, -1424.379294994111),
        "gamma": (0.04082224013073101, 11.03291221937134),
        "phi": (-0.5347301163226948, 19.29337464421385),
        "delta": (0.5244099658805304, 0.5735699284790808),
        "Omega": (0.5347301163226948, -19.29337464421385),
        "epsilon": (1.048080741042263, 0.3231791658026955),
    }
    state = trajectory.state
    for name, (angle, rate) in ends.items():
        assert float(state.q[-1, q[name]][0]) + start[name] == pytest.approx(angle, abs=1e-6), name
        assert float(state.v[-1, v[name]][0]) == pytest.approx(rate, rel=1e-5), name
    total = trajectory.energies["total"] - 0.033 * state.q[:, q["beta"]][:, 0]
    np.testing.assert_allclose(total, total[0], atol=1e-9)
    assert largest_gap(trajectory) < 1e-12 * 0.028


@pytest.mark.long
def test_trajectories_have_derivatives_by_points_and_masses():
    """By the head of the coupler and its mass: forward, reverse and differences; a batch moves as
    its members."""
    model, times = four_bar(), jnp.linspace(0.0, 2.0, 9)
    head = jnp.asarray(model["pin"].a)

    def end(x):
        changed = jb.replace(
            model,
            {
                "pin.a": head + jnp.array([0.1, 0.2, 0.0]) * x[0],
                "coupler.mass": BAR["coupler"][0] + x[1],
            },
        )
        state = jb.simulate(changed, times, rtol=1e-10).state
        return state.q[-1] @ jnp.array([1.0, 2.0, 3.0]) + state.v[4] @ jnp.array([0.3, -0.1, 0.2])

    zero, value = jnp.zeros(2), jax.jit(end)
    forward, reverse = jax.jit(jax.jacfwd(end))(zero), jax.jit(jax.grad(end))(zero)
    np.testing.assert_allclose(forward, reverse, rtol=1e-9)
    h = np.array([1e-4, 1e-3])
    steps = [zero.at[i].set(h[i]) for i in range(2)]
    differences = [
        (8 * (value(s) - value(-s)) - value(2 * s) + value(-2 * s)) / (12 * h[i])
        for i, s in enumerate(steps)
    ]
    np.testing.assert_allclose(forward, differences, rtol=1e-6)
    batch = jnp.stack([zero, *steps])
    np.testing.assert_allclose(jax.jit(jax.vmap(end))(batch), [value(x) for x in batch], rtol=1e-9)


@pytest.mark.long
def test_the_derivative_of_the_projection_is_the_implicit_one():
    """P fulfills c = 0 and M Delta + J' mu = 0: at a closed state its derivative is 1 - M^-1 J' (J
    M^-1 J')^+ J for q, and for v too."""
    model = four_bar()
    loops, zero = ClosedLoops(model, ()), jnp.zeros(())
    state = jb.State(model.reference.q, jnp.zeros(3))
    y, nv = loops.pack(state), 3
    coordinates = loops.coordinates

    def c(q):
        return gaps(model, coordinates, coordinates.at_rest(q), q)

    M, J = np.asarray(matrices(model, state)[0]), np.asarray(jax.jacfwd(c)(state.q))
    along = np.linalg.solve(M, J.T) @ np.linalg.pinv(J @ np.linalg.solve(M, J.T), rcond=1e-10)
    projector = np.eye(nv) - along @ J
    unrolled = jax.jacfwd(lambda y: loops.projected(zero, y))(y)
    np.testing.assert_allclose(unrolled[:nv, :nv], projector, atol=1e-9)
    np.testing.assert_allclose(unrolled[nv:, nv:], projector, atol=1e-9)
    np.testing.assert_allclose(
        jax.jacrev(lambda y: loops.projected(zero, y))(y), unrolled, atol=1e-12
    )


def chain(speed):
    """Two links from the world to a support that moves out of their reach of 1 m
    at t = 0.1 / speed."""
    bodies = {
        name: jb.Body(mass=1.0, inertia=[0.02] * 3, com=[0.25, 0, 0], position=[x, 0, 0])
        for name, x in (("upper", 0.0), ("lower", 0.5))
    }
    model = jb.Model(
        bodies=bodies,
        joints={"upper": jb.Hinge("world", axis="z"), "lower": jb.Hinge("upper", axis="z")},
        supports={"end": jb.Support(position=[0.9, 0, 0])},
        closures={"tip": jb.closures.Ball(("lower", [0.5, 0, 0]), ("end", [0, 0, 0]))},
        gravity=[0, -G, 0],
    )
    up = float(np.arccos(0.9))
    start = jb.State(jnp.array([up, -2 * up]), jnp.zeros(2))
    return model, start, {"end": lambda t: jnp.zeros(6).at[0].set(speed * t)}


def test_without_an_initial_state_a_model_that_is_drawn_open_starts_closed():
    """In its reference, which is closed, so that nobody is told that it was open."""
    model = jb.replace(
        chain(0.0)[0],
        {"lower.orientation": jb.EulerAngles("Z", [-0.5]), "end.position": [0.9, 0.1, 0]},
    )
    assert abs(float(model.reference.q[1]) + 0.5) > 0.05  # drawn open
    trajectory = jb.simulate(model, [0.0, 1e-3])
    np.testing.assert_allclose(trajectory.state.q[0], model.reference.q, atol=1e-9)
    assert trajectory.ok and largest_gap(trajectory) < 1e-12


@pytest.mark.long
def test_where_a_motion_ends_or_cannot_start_is_said_by_name():
    model, start, motion = chain(0.2)
    times = np.linspace(0.0, 0.8, 9)
    with pytest.warns(
        jb.JaxbodyWarning, match=r"SINGULAR_CLOSURE.*t = 0.5 s.*'tip x'.*smallest singular value"
    ):
        trajectory = jb.simulate(model, times, motion=motion, initial=start)
    np.testing.assert_allclose(
        trajectory.state.q[:5, 0], np.arccos(0.9 + 0.2 * times[:5]), atol=1e-9
    )
    assert np.isnan(trajectory.state.q[6:]).all()
    open_ = jb.State(start.q + 0.1, start.v)
    with pytest.warns(
        jb.JaxbodyWarning, match=r"NOT_CLOSED.*nearest closed|initial state is open by"
    ):
        moved = jb.simulate(model, times[:3], motion=motion, initial=open_)
    assert moved.ok and largest_gap(moved) < 1e-12
    far = jb.replace(model, {"end.position": jnp.array([3.0, 0, 0])})
    with pytest.warns(jb.JaxbodyWarning, match="NOT_CLOSED"):
        assert (
            int(jb.simulate(far, times, motion=motion, initial=start).status)
            == jb.Status.NOT_CLOSED
        )
    with pytest.raises(jb.JaxbodyError, match=r"Gauss.*closures: tip.*CLOSED_LOOPS"):
        jb.simulate(
            model,
            times,
            solver=jb.Gauss(),
            stepsize_controller=diffrax.ConstantStepSize(),
            dt0=0.01,
            initial=start,
        )


@pytest.mark.long
@pytest.mark.parametrize(
    "options",
    [
        {"solver": diffrax.Kvaerno5()},
        {"solver": diffrax.Tsit5()},
        {"stepsize_controller": diffrax.ConstantStepSize(), "dt0": 0.02},
    ],
    ids=["implicit", "explicit", "constant steps"],
)
def test_steps_of_every_solver_are_projected(options):
    model, start, motion = chain(0.1)
    times = np.linspace(0.0, 0.8, 9)
    trajectory = jb.simulate(model, times, motion=motion, initial=start, **options)
    np.testing.assert_allclose(trajectory.state.q[:, 0], np.arccos(0.9 + 0.1 * times), atol=1e-12)
    assert largest_gap(trajectory) < 1e-12


def bob_on_a_rod():
    """In a plane, drawn closed."""
    plane = jb.joints.Composite(
        "world", ["move", "move"], directions=[[1, 0, 0], [0, 0, 1]], points=[[0, 0, 0]] * 2
    )
    rod = jb.closures.Rod(("world", [0, 0, 0]), ("bob", [0, 0, 0]), length=1.0)
    bob = jb.Body(1.0, [1, 1, 1], position=[0.6, 0, -0.8])
    return jb.Model(
        bodies={"bob": bob}, joints={"bob": plane}, closures={"rod": rod}, gravity=[0, 0, -G]
    )


@pytest.mark.nan
@pytest.mark.long
@pytest.mark.filterwarnings("ignore::jaxbody.JaxbodyWarning")
@pytest.mark.parametrize("solver, few", [(None, 3), (diffrax.Tsit5(), 12)])
@pytest.mark.parametrize("of", [jax.jacfwd, jax.jacrev])
def test_samples_after_a_failure_have_no_derivatives_and_those_before_keep_theirs(of, solver, few):
    """By gravity and the initial state; the samples before are compared with those of the
    whole run."""
    model, times = bob_on_a_rod(), jnp.linspace(0.0, 2.0, 21)

    adjoint = diffrax.ForwardMode() if solver and of is jax.jacfwd else None

    def states(x, max_steps):
        changed, initial = (
            jb.replace(model, {"gravity": jnp.array([0.0, 0.0, -G]) * x[0]}),
            jb.State(x[1:], jnp.zeros(2)),
        )
        state = jb.simulate(
            changed,
            times,
            initial=initial,
            max_steps=max_steps,
            solver=solver,
            rtol=1e-6,
            adjoint=adjoint,
            progress=False,
        ).state
        return jnp.concatenate([state.q, state.v], 1)

    x = jnp.array([1.0, 0.0, 0.0])
    whole, cut = (np.asarray(jax.jit(of(lambda x, n=n: states(x, n)))(x)) for n in (10000, few))
    values = np.asarray(states(x, few))
    valid = np.isfinite(values).all(1)
    assert 1 < valid.sum() < len(times)
    assert np.isnan(cut[~valid]).all()
    np.testing.assert_allclose(cut[valid], whole[valid], rtol=1e-4, atol=1e-5)
