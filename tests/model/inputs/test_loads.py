"""Loads: motion under them against SciPy, equilibrium under them against root finding, and the ends
of load paths."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import simpson, solve_ivp
from scipy.optimize import brentq, fsolve
from scipy.spatial.transform import Rotation

import jaxbody as jb
from jaxbody import Status, laws, plots
from jaxbody.core.arrays import device_array
from jaxbody.mechanics.hessians import configuration_at
from jaxbody.mechanics.load_paths import AppliedLoads, alike, generalized_force
from jaxbody.model.inputs.signals import Samples, Sine
from jaxbody.model.joints.kinematics import Coordinates
from jaxbody.suspension.presets import presets

G = 9.81
MASS, INERTIA, COM = 3.0, np.diag([0.2, 0.3, 0.4]), np.array([0.05, -0.02, 0.03])
TIMES = np.linspace(0, 1, 11)


def flying(loads, times=TIMES):
    """Position of the center of mass and orientation of every body, which only loads act on: {name:
    function of a body's name -> loads}."""
    body = jb.Body(mass=MASS, inertia=INERTIA, com=COM)
    model = jb.Model(bodies=dict.fromkeys(loads, body))
    with pytest.warns(jb.JaxbodyWarning, match="UNATTACHED"):
        run = jb.simulate(
            model,
            times,
            loads={
                f"{name} {i}": load for name, group in loads.items() for i, load in enumerate(group)
            },
            rtol=1e-11,
        )
    return {
        name: (np.asarray(pose.p + pose.R @ COM), np.asarray(pose.R))
        for name, pose in run.poses.items()
    }, run


def newton_euler(wrench, times=TIMES):
    """The same by SciPy: m x'' = F, I w' = M_C - w x I w in body axes."""

    def rate(t, y):
        v, quaternion, w = y[3:6], y[6:10], y[10:]
        R = Rotation.from_quat(quaternion).as_matrix()
        F, M_C = wrench(t, R)
        M_B = R.T @ M_C
        a, b, c, d = quaternion
        p, q, r = w
        spin = 0.5 * np.array(
            [
                d * p + b * r - c * q,
                d * q + c * p - a * r,
                d * r + a * q - b * p,
                -a * p - b * q - c * r,
            ]
        )
        return np.concatenate(
            [v, F / MASS, spin, np.linalg.solve(INERTIA, M_B - np.cross(w, INERTIA @ w))]
        )

    start = np.concatenate([COM, np.zeros(3), [0, 0, 0, 1], np.zeros(3)])
    y = solve_ivp(
        rate, (0, times[-1]), start, method="DOP853", rtol=1e-12, atol=1e-13, t_eval=times
    ).y
    return y[:3].T, Rotation.from_quat(y[6:10].T).as_matrix()


P, F, M = np.array([0.3, 0.1, -0.2]), np.array([1.0, -2.0, 0.7]), np.array([0.1, 0.3, -0.2])
AXIS = np.array([0.0, 0.6, 0.8])


def unbalance(t, u=0.02, f=2.0, r=1.0, p=0.4):
    """Minus the mass times the acceleration of a point on a circle, by differences of its path."""
    n1 = np.array([1.0, 0, 0])
    n2 = np.cross(AXIS, n1)

    def place(t):
        phi = 2 * np.pi * (f * t + r * t**2 / 2) + p
        return np.cos(phi) * n1 + np.sin(phi) * n2

    rate, change = 2 * np.pi * (f + r * t), 2 * np.pi * r
    phi = 2 * np.pi * (f * t + r * t**2 / 2) + p
    along = -np.sin(phi) * n1 + np.cos(phi) * n2
    return -u * (-(rate**2) * place(t) + change * along)


def engine(t, f=3.0):
    return (
        -(0.4 + 0.5 * np.cos(2 * 2 * np.pi * f * t + 0.3) + 0.2 * np.cos(4 * 2 * np.pi * f * t))
        * AXIS
    )


LOADS = {
    # a force at the reference point counts as well
    "force of world": (
        lambda on: [jb.Force((on, P), force=F, moment=M), jb.Force(on, force=F)],
        lambda t, R: (2 * F, M + np.cross(R @ (P - COM), F) + np.cross(R @ -COM, F)),
    ),
    "force of body": (
        lambda on: [jb.Force((on, P), force=F, moment=M, axes="body")],
        lambda t, R: (R @ F, R @ (M + np.cross(P - COM, F))),
    ),
    "timed force": (
        lambda on: [jb.Force((on, P), force=Sine(amplitude=F, frequency=1.5, phase=0.2))],
        lambda t, R: (f := F * np.cos(3 * np.pi * t + 0.2), np.cross(R @ (P - COM), f)),
    ),
    "function": (
        lambda on: [jb.Force(on, moment=lambda t: M * t**2)],
        lambda t, R: (np.zeros(3), M * t**2),
    ),
    "unbalance": (
        lambda on: [
            jb.inputs.Unbalance(
                (on, P), axis=AXIS, unbalance=0.02, frequency=2.0, run_up=1.0, phase=0.4
            )
        ],
        lambda t, R: (f := R @ unbalance(t), np.cross(R @ (P - COM), f)),
    ),
    "engine torque": (
        lambda on: [
            jb.inputs.EngineTorque(
                on,
                axis=AXIS,
                frequency=3.0,
                mean=0.4,
                orders=[2, 4],
                amplitudes=[0.5, 0.2],
                phases=[0.3, 0.0],
            )
        ],
        lambda t, R: (np.zeros(3), R @ engine(t)),
    ),
}


@pytest.fixture(scope="module")
def flown():
    return flying(
        {name: loads(name) for name, (loads, _) in LOADS.items()}, np.linspace(0, 1, 1001)
    )


@pytest.mark.parametrize("name", LOADS)
def test_a_body_under_a_load_moves_as_by_newton_and_euler(flown, name):
    x, R = (part[::100] for part in flown[0][name])
    x_exact, R_exact = newton_euler(LOADS[name][1])
    assert abs(x - x_exact).max() <= 1e-9 * abs(x_exact).max()
    assert abs(R - R_exact).max() <= 1e-9


def test_the_work_of_the_loads_is_the_kinetic_energy(flown):
    energy, power = (
        np.asarray(x) for x in (flown[1].energies["kinetic"], flown[1].powers["loads"])
    )
    assert abs(simpson(power, x=flown[1].times) - energy[-1]) <= 1e-8 * energy[-1]


@pytest.mark.long
@pytest.mark.parametrize("kind", ["hold", "linear", "cubic"])
def test_samples_are_what_their_kind_says(kind):
    t = np.array([0.0, 0.1, 0.25, 0.4, 0.6])
    y = np.array([[1.0, 0.0], [2.0, 1.0], [-1.0, 4.0], [0.5, 2.0], [3.0, -1.0]])
    signal = Samples(t, y, kind=kind)
    between = np.linspace(0, 0.6, 61)
    result = jax.vmap(signal)(between)
    if kind == "cubic":
        np.testing.assert_allclose(jax.vmap(signal)(t), y, atol=1e-14)
        smooth = Samples(t, t**3 - t, kind=kind)  # a cubic is itself
        np.testing.assert_allclose(jax.vmap(smooth)(between), between**3 - between, atol=1e-14)
    elif kind == "linear":
        np.testing.assert_allclose(
            result, np.stack([np.interp(between, t, column) for column in y.T], 1), atol=1e-14
        )
    else:
        held = y[np.clip(np.searchsorted(t, between + 1e-12, side="right") - 1, 0, 4)]
        np.testing.assert_allclose(result, held, atol=1e-14)


def test_asking_outside_of_a_recorded_force_is_refused():
    load = jb.Force("body", force=Samples([0.0, 0.5], [[0.0, 0, 0], [1.0, 0, 0]], kind="linear"))
    model = jb.Model(bodies={"body": jb.Body(mass=1.0, inertia=[1, 1, 1])})
    with pytest.raises(jb.JaxbodyError, match=r"loads\['push'\].*0.5.*requested 0 to 1 s.*T_RANGE"):
        jb.simulate(model, [0.0, 1.0], loads={"push": load})


def test_bad_loads_are_refused():
    model = jb.Model(bodies={"body": jb.Body(mass=1.0, inertia=[1, 1, 1])})
    for make, words in (
        (
            lambda: jb.simulate(model, [0, 1], loads={"f": jb.Force("engine", force=[1, 0, 0])}),
            ("UNKNOWN_BODY", "engine", "body"),
        ),
        (lambda: jb.simulate(model, [0, 1], loads={"f": 3.0}), ("WRONG_KIND", "float", "jb.Force")),
        (lambda: jb.load_cases(TABLE, {}), ("NO_CASE", "jb.LoadCase")),
        (lambda: jb.Force("body", force=[1, 0]), ("BAD_SHAPE", "Force.force")),
        (lambda: jb.Force("body", force=lambda t: t), ("BAD_SHAPE", "Force.force", "()")),
        (lambda: jb.Force("body", axes="wheel"), ("BAD_AXES", "wheel", "world or body")),
        (
            lambda: jb.inputs.Unbalance("body", axis=[0, 0, 0], unbalance=1, frequency=1),
            ("ZERO_AXIS", "Unbalance.axis"),
        ),
        (
            lambda: jb.inputs.EngineTorque(
                "body", axis=[1, 0, 0], frequency=1, orders=[2, 4], amplitudes=[1]
            ),
            ("BAD_SHAPE", "EngineTorque.amplitudes"),
        ),
        (lambda: Samples([0, 1], [1.0, 2.0], kind="quintic"), ("BAD_KIND", "quintic", "cubic")),
        (
            lambda: Samples([0, 1], [1.0, 2.0, 3.0], kind="hold"),
            ("BAD_SHAPE", "Samples.values", "(3,)"),
        ),
        (lambda: jb.load_cases(model, {}), ("UNATTACHED",)),
    ):
        with pytest.raises(jb.JaxbodyError) as refused:
            make()
        for word in words:
            assert word in str(refused.value), word


# Equilibrium under loads

TABLE = jb.presets.stewart_table(gravity=G)
ENGINE = jb.presets.engine_on_mounts(gravity=G)
POINTS, STIFFNESS = presets.MOUNTS, presets.MOUNT_STIFFNESS
CASES = {
    "3 g bump": jb.LoadCase(acceleration=[0, 0, 3]),
    "braking": jb.LoadCase(acceleration=[-1, 0, 0]),
    "cornering": jb.LoadCase(acceleration=[0, 0.9, 0]),
    "torque": jb.LoadCase(loads={"drive": jb.Force("engine", moment=[0, 400.0, 0], axes="body")}),
    "pull": jb.LoadCase(
        acceleration=[0, 0, 1],
        loads={"chain": jb.Force(("engine", [0.2, 0.1, 0.3]), force=[900.0, 0, -300.0])},
    ),
}


def bushing_forces(x, phi):
    """Force and moment about O of the mounts on an engine displaced by x and turned by exp(phi), by
    the logarithm of SciPy: minus the gradient of 1/2 sum k u'u, u the translational part of
    log(X_A^-1 X_B), A on the engine."""

    def V(z):
        R = Rotation.from_rotvec(z[3:]).as_matrix()
        total = 0.0
        for p, k in zip(POINTS, STIFFNESS, strict=True):
            t = R.T @ (p - (z[:3] + R @ p))
            theta = -z[3:]
            n = np.linalg.norm(theta)
            W = np.array(
                [[0, -theta[2], theta[1]], [theta[2], 0, -theta[0]], [-theta[1], theta[0], 0]]
            )
            c = (1 - n / 2 / np.tan(n / 2)) / n**2 if n > 1e-3 else 1 / 12 + n**2 / 720
            u = (np.eye(3) - W / 2 + c * W @ W) @ t
            total += 0.5 * np.sum(k * u**2)
        return total

    z, h = np.concatenate([x, phi]), 1e-5
    slopes = [(V(z + h * e) - V(z - h * e)) / (2 * h) for e in np.eye(6)]
    return np.array(slopes)


def test_alike_loads_are_traced_as_one_and_act_as_all_of_them():
    """Q = (sum F, sum R p x F) by NumPy, for forces in the axes of the world and of the body;
    twenty take as many operations as four."""
    rng = np.random.default_rng(3)
    points, forces, weights = (
        rng.normal(size=(20, 3)),
        rng.normal(size=(20, 3)),
        rng.normal(size=20),
    )
    quaternion = np.array([0.8, 0.0, 0.6, 0.0])
    R = Rotation.from_quat(quaternion, scalar_first=True).as_matrix()
    q = jnp.asarray([0.1, -0.2, 0.3, *quaternion])

    def force(count):
        loads = [
            jb.Force(("engine", points[i]), force=forces[i], axes=("world", "body")[i % 2])
            for i in range(count)
        ]
        groups, members = alike([jax.tree.map(device_array, load) for load in loads])
        assert members == [list(range(0, count, 2)), list(range(1, count, 2))]
        parts = tuple(jnp.asarray(weights[group]) for group in members)
        applied = AppliedLoads(groups, parts, jnp.zeros(3))
        return lambda q: generalized_force(
            configuration_at(Coordinates(ENGINE), q, base=False), applied
        )

    pulls = weights[:, None] * np.where(np.arange(20)[:, None] % 2, forces @ R.T, forces)
    expected = np.concatenate([pulls.sum(0), np.cross(points @ R.T, pulls).sum(0)])
    np.testing.assert_allclose(jax.jit(force(20))(q), expected, rtol=1e-13)
    operations = [len(jax.make_jaxpr(force(count))(q).eqns) for count in (4, 20)]
    assert operations[0] == operations[1]


@pytest.fixture(scope="module")
def cases():
    return jb.load_cases(ENGINE, CASES)


@pytest.mark.long
def test_load_cases_are_in_equilibrium_by_an_energy_written_here(cases):
    """dV/dz - Q = 0 in rotation vectors, V by SciPy and differences, which leave a residual of 1e-6
    of the load."""
    assert cases.ok.all() and bool(cases.unloaded.ok)
    m = 139.5
    for i, (name, case) in enumerate(CASES.items()):
        q = np.asarray(cases.state.q[i])
        phi = Rotation.from_quat(q[3:], scalar_first=True).as_rotvec()
        n = np.linalg.norm(phi)
        W = np.array([[0, -phi[2], phi[1]], [phi[2], 0, -phi[0]], [-phi[1], phi[0], 0]])
        J = np.eye(3) + (1 - np.cos(n)) / n**2 * W + (n - np.sin(n)) / n**3 * W @ W  # w = J phi'
        R = Rotation.from_rotvec(phi).as_matrix()
        force, moment = (
            np.array([0, 0, -m * G]) - m * 9.80665 * np.asarray(case.acceleration),
            np.zeros(3),
        )
        if name == "torque":
            moment = R @ [0, 400.0, 0]
        if name == "pull":
            force, moment = (
                force + np.array([900.0, 0, -300.0]),
                np.cross(R @ [0.2, 0.1, 0.3], [900.0, 0, -300.0]),
            )
        left = bushing_forces(q[:3], phi) - np.concatenate([force, J.T @ moment])
        assert abs(left).max() <= 1e-6 * np.linalg.norm(force), name


@pytest.mark.nan
def test_load_cases_give_displacements_strokes_and_forces(cases):
    """Against small motions K^-1 F, to the second order of a rotation; strokes and forces against
    poses and Hooke's law."""
    lin = jb.linearize(ENGINE, cases.unloaded)
    x = np.linalg.solve(lin.K, np.concatenate([[139.5 * 9.80665, 0, 0], np.zeros(3)]))
    result = np.concatenate([cases.displacements["engine"][1], cases.rotations["engine"][1]])
    assert abs(result - x).max() <= 0.05 * abs(x).max()
    for i in range(1, 4):
        forces, strokes = (
            np.asarray(cases.forces[f"mount {i}"]),
            np.asarray(cases.strokes[f"mount {i}"]),
        )
        rest = np.asarray(cases.unloaded.elongations[f"mount {i}"])
        np.testing.assert_allclose(
            forces[:, :3], STIFFNESS[i - 1] * (strokes + rest)[:, :3], rtol=1e-12
        )
    total = sum(np.asarray(cases.forces[f"mount {i}"])[0, 2] for i in (1, 2, 3))
    # but for the turn of the mounts' axes
    assert abs(abs(total) - 139.5 * (G + 3 * 9.80665)) <= 0.02 * abs(total)
    text = str(cases)
    for word in (
        "3 g bump",
        "engine",
        "mount 2",
        "stroke [m]",
        "rotation [rad]",
        "force [N]",
        "ok",
    ):
        assert word in text
    assert cases.to_xarray()["displacement"].shape == (5, 1, 3)


@pytest.mark.long
def test_one_case_is_the_equilibrium_under_its_loads():
    loads = {"drive": jb.Force("table", moment=[0, 40.0, 0], axes="body")}
    eq = jb.equilibrium(TABLE, loads=loads)
    one = jb.load_cases(TABLE, {"torque": jb.LoadCase(loads=loads)})
    np.testing.assert_allclose(eq.state.q, one.state.q[0], atol=1e-13)
    assert eq.ok and float(eq.load_factor) == 1.0 and abs(eq.residual).max() <= 1e-8
    lin = jb.linearize(TABLE, eq)
    assert abs(lin.K_loads - lin.K_loads.T).max() > 1.0  # a following moment has no potential
    with pytest.warns(jb.JaxbodyWarning, match="NOT_SYMMETRIC"):
        assert np.isnan(jb.modes(lin).frequency).all()


ARM, PULL = jnp.array([0.2, 0.1, 0.3]), jnp.array([90.0, 0, -30.0])


@pytest.mark.long
def test_the_stiffness_under_a_dead_force_is_the_second_derivative_of_its_potential():
    """-F . P, with which the equilibrium is one of least energy."""
    eq = jb.equilibrium(TABLE, loads={"pull": jb.Force(("table", ARM), force=PULL)})
    lin = jb.linearize(TABLE, eq)

    @jax.jit
    def V(delta):
        q = jb.joints.retract(TABLE, eq.state.q, delta)
        w, v = q[3], q[4:]
        P = q[:3] + ARM + 2 * jnp.cross(v, jnp.cross(v, ARM) + w * ARM)
        return jb.potential_energy(TABLE, jb.State(q, jnp.zeros(6))) - PULL @ P

    np.testing.assert_allclose(jax.grad(V)(jnp.zeros(6)), 0, atol=1e-8)
    np.testing.assert_allclose(
        lin.K, jax.hessian(V)(jnp.zeros(6)), rtol=0, atol=1e-11 * abs(lin.K).max()
    )


@pytest.mark.long
def test_derivatives_of_load_cases():
    """Forward and reverse against differences, by a stiffness, a force and an acceleration."""

    def top(u):
        model = jb.replace(TABLE, {"leg 1.stiffness": 1e4 * (1 + u[0])})
        case = jb.LoadCase(
            acceleration=jnp.array([0, 0, 1.0]) * (1 + u[2]),
            loads={"chain": jb.Force(("table", ARM), force=PULL * (1 + u[1]))},
        )
        return jb.load_cases(model, {"pull": case}).displacements["table"][0]

    u, h = jnp.zeros(3), 1e-6
    forward, reverse, here = jax.jit(jax.jacfwd(top))(u), jax.jit(jax.jacrev(top))(u), jax.jit(top)
    np.testing.assert_allclose(forward, reverse, atol=1e-12)
    differences = np.stack([(here(u + h * e) - here(u - h * e)) / (2 * h) for e in jnp.eye(3)], 1)
    np.testing.assert_allclose(forward, differences, atol=1e-7 * abs(differences).max())


# Where there is none


def hanging(law, mass=1.0, free_length=1.0, joints=None):
    return jb.Model(
        bodies={"mass": jb.Body(mass=mass, inertia=[1, 1, 1])},
        joints={"mass": jb.Guide("world", axis=[0, 0, 1])} if joints is None else joints,
        elements={
            "spring": jb.SpringDamper(
                ("mass", [0, 0, 0]), ("world", [0, 0, 1]), free_length=free_length, spring=law
            )
        },
        gravity=[0, 0, -G],
    )


SOFT = laws.Digressive(slow=1000.0, fast=0.0, knee=0.05)  # bears less than 50 N


@pytest.mark.long
def test_a_softening_spring_has_a_largest_load():
    eq = jb.equilibrium(hanging(SOFT), loads={"pull": jb.Force("mass", force=[0, 0, -30.0])})
    assert (
        abs(
            eq.state.q[0]
            + brentq(
                lambda x: 1000 * x / np.sqrt(1 + (x / 0.05) ** 2) - (G + 30), 0, 10, xtol=1e-15
            )
        )
        <= 1e-12
    )


@pytest.mark.long
def test_no_equilibrium_states_the_carried_load():
    with pytest.warns(jb.JaxbodyWarning, match=r"load factor 0\.6.* \[NO_EQUILIBRIUM\]"):
        eq = jb.equilibrium(hanging(SOFT), loads={"pull": jb.Force("mass", force=[0, 0, -60.0])})
    assert int(eq.status) == Status.NO_EQUILIBRIUM and not bool(eq.stable)
    assert 0.98 * (50 - G) / 60 < float(eq.load_factor) < (50 - G) / 60
    for joints in (None, {}):  # a guide's coordinate, a free body's seven
        with pytest.warns(
            jb.JaxbodyWarning, match=r"50\.\d* % of the weights is carried \[NO_EQUILIBRIUM\]"
        ):
            jb.equilibrium(hanging(SOFT, mass=10.0, joints=joints))


def truss():
    """Two springs that meet at a flat angle: pressed down, it snaps through (von Mises)."""
    return jb.Model(
        bodies={"tip": jb.Body(mass=1.0, inertia=[1, 1, 1])},
        joints={"tip": jb.Guide("world", axis=[0, 0, 1])},
        elements={
            side: jb.Spring(
                ("tip", [0, 0, 0]),
                ("world", [x, 0, -0.3]),
                stiffness=1000.0,
                free_length=float(np.hypot(1, 0.3)),
            )
            for side, x in (("left", -1.0), ("right", 1.0))
        },
    )


@pytest.mark.long
def test_a_limit_point_is_found_where_the_force_is_largest():
    h = np.linspace(0, 0.3, 100_001)
    largest = (2000 * (np.hypot(1, 0.3) - np.hypot(1, h)) * h / np.hypot(1, h)).max()
    press = {"press": jb.Force("tip", force=[0, 0, -2 * largest])}
    with pytest.warns(jb.JaxbodyWarning, match=r"load factor 0\.(5|499).* \[LIMIT_POINT\]"):
        eq = jb.equilibrium(truss(), loads=press)
    assert abs(float(eq.load_factor) - 0.5) <= 1e-3
    smallest = np.asarray(eq.path.smallest)
    assert np.nanmin(smallest) < 0.05 < np.nanmax(smallest) == 1.0
    line = plots.plot_load_path(eq).lines[0]
    assert line.get_xdata()[0] == 0 and abs(np.nanmax(line.get_xdata()) - 0.5) <= 1e-3
    with pytest.raises(jb.JaxbodyError, match="NO_PATH"):
        plots.plot_load_path(jb.equilibrium(truss()))


@pytest.mark.long
def test_two_stable_equilibria_and_the_one_between_are_found():
    result = jb.find_equilibria(truss(), starts=16)
    assert result.stable.tolist() == [True, True, False] and result.negative.tolist() == [0, 0, 1]
    np.testing.assert_allclose(
        sorted(float(eq.state.q[0]) for eq in result.solutions), [-0.6, -0.3, 0], atol=1e-9
    )
    flat = 1000 * (np.hypot(1, 0.3) - 1) ** 2
    np.testing.assert_allclose(result.energies, [0, 0, flat], atol=1e-12)
    assert "unstable (1)" in str(result) and len(result) == 3


# Preload


def test_preload_is_the_least_change_that_balances():
    """Against NumPy: residual r + A dl = 0, dl = -A^+ r; A of unit vectors along the springs."""
    model = jb.presets.stewart_table(gravity=G)
    pose = jb.State(
        jb.joints.retract(
            model, model.reference.q, jnp.array([0.02, -0.01, 0.01, 0.01, 0.02, -0.03])
        ),
        jnp.zeros(6),
    )
    result = jb.preload(model, pose)
    assert int(result.status) == 0
    q = np.asarray(pose.q)
    R = Rotation.from_quat(q[3:], scalar_first=True).as_matrix()
    A, r = np.zeros((6, 6)), np.array([0, 0, 50 * G, 0, 0, 0])
    for i, name in enumerate(model.element_names):
        spring = model[name]
        arm = R @ np.asarray(spring.a)
        d = np.asarray(spring.b) - q[:3] - arm
        u = d / np.linalg.norm(d)
        J = np.concatenate([u, np.cross(arm, u)])  # what a tension of 1 N does
        A[:, i] = 1e4 * J
        r -= 1e4 * (np.linalg.norm(d) - float(spring.free_length)) * J
    np.testing.assert_allclose(result.change, -np.linalg.pinv(A) @ r, atol=1e-10)
    eq = jb.equilibrium(result.model, start=pose)
    np.testing.assert_allclose(eq.state.q, pose.q, atol=1e-9)


def test_preload_takes_the_least_of_many_and_leaves_the_others():
    """One mass on three parallel springs of which two are free: the stiffer one changes
    more, dl ~ k."""
    springs = {
        name: jb.Spring(("m", [0, 0, 0]), ("world", [0, 0, 1]), stiffness=k, free_length=1.0)
        for name, k in (("a", 100.0), ("b", 200.0), ("c", 400.0))
    }
    model = jb.Model(
        bodies={"m": jb.Body(mass=2.0, inertia=[1, 1, 1])},
        joints={"m": jb.Guide("world", axis=[0, 0, 1])},
        elements=springs,
        gravity=[0, 0, -G],
    )
    result = jb.preload(model, free=["a.free_length", "b.free_length"])
    np.testing.assert_allclose(
        result.change, -2 * G * np.array([100, 200]) / (100**2 + 200**2), rtol=1e-12
    )
    assert float(result.model["c"].free_length) == 1.0


def raised(tyre):
    """A quarter car whose tyre has another free length: the spring's that keeps the body where it
    is, and the height of the wheel."""
    model = jb.replace(jb.presets.quarter_car(), {"tyre.free_length": tyre})
    result = jb.preload(model, free="suspension.free_length", moving="wheel*")
    return result.moved["wheel move along its guide"], result


@pytest.mark.long
def test_preload_moves_the_height_of_a_wheel_too():
    """The tyre carries both weights, the spring the body's, wherever the wheel then is."""
    height, result = raised(0.36)
    wheel = 0.36 - 450 * 9.81 / 193e3
    np.testing.assert_allclose(
        [height, result.free_lengths["suspension.free_length"]],
        [wheel - 0.3, 0.7 - wheel + 375 * 9.81 / 35e3],
        rtol=1e-12,
    )
    assert result.ok and "wheel move along its guide" in str(result)
    eq = jb.equilibrium(result.model, start=result.state)
    np.testing.assert_allclose(eq.state.q, [0, wheel - 0.3], atol=1e-12)
    np.testing.assert_allclose(result.state.q, eq.state.q, atol=1e-12)

    def moves(tyre):
        result = raised(tyre)[1]
        return result.moves[0] + 10 * result.values[0]

    slopes = jax.jit(lambda tyre: (jax.jacfwd(moves)(tyre), jax.grad(moves)(tyre)))(0.36)
    # the wheel rises with its tyre, the spring is that much shorter
    np.testing.assert_allclose(slopes, 1 - 10, rtol=1e-12)


def test_preload_of_heights_alone_is_the_equilibrium():
    model = jb.replace(jb.presets.quarter_car(), {"tyre.free_length": 0.36})
    result = jb.preload(model, free=(), moving="*")
    np.testing.assert_allclose(result.state.q, jb.equilibrium(model).state.q, atol=1e-12)
    with pytest.raises(jb.JaxbodyError, match=r"preload.moving: 'weel\*' is unknown.*UNKNOWN_NAME"):
        jb.preload(model, moving="weel*")


@pytest.mark.long
def test_preload_states_what_is_impossible():
    model = hanging(laws.Linear(200.0))
    tilted = jb.replace(model, {"gravity": [0, 0, -G]})
    beam = jb.Model(
        bodies={"beam": jb.Body(mass=2.0, inertia=[1, 1, 1])},
        elements={
            "s": jb.Spring(
                ("beam", [0.5, 0, 0]), ("world", [0.5, 0, 1]), stiffness=200.0, free_length=0.9
            )
        },
        gravity=[0, 0, -G],
    )
    with pytest.warns(
        jb.JaxbodyWarning,
        match=(
            r"none of these free lengths balances .*N m on beam turn about y; free a length .*or "
            r"let it move: moving=\['beam move along z', 'beam turn about y'\].*\[UNBALANCED\]"
        ),
    ):
        assert int(jb.preload(beam).status) == Status.UNBALANCED
    with pytest.warns(
        jb.JaxbodyWarning, match=r"spring.free_length = -0\.\d+ m \[NEGATIVE_LENGTH\]"
    ):
        jb.preload(jb.replace(tilted, {"mass.mass": 25.0}))
    with pytest.raises(jb.JaxbodyError, match="NOT_A_LENGTH"):
        jb.preload(model, free="spring.spring.coefficient")


@pytest.mark.long
def test_equilibrium_of_a_nonlinear_rig_under_a_load_is_scipys():
    """Two guides with stops and gas, pulled: a root of NumPy's equations."""
    gas = laws.AirSpring.carrying(3 * G, area=1e-3, height=0.3)
    model = jb.Model(
        bodies={
            name: jb.Body(mass=m, inertia=[1, 1, 1], position=[0, 0, z])
            for name, m, z in (("low", 2.0, 1.0), ("high", 1.0, 2.0))
        },
        joints={name: jb.Guide("world", axis=[0, 0, 1]) for name in ("low", "high")},
        elements={
            "gas": jb.SpringDamper(
                ("low", [0, 0, 0]), ("world", [0, 0, 0]), free_length=1.0, spring=gas
            ),
            "stop": jb.SpringDamper(
                ("high", [0, 0, 0]),
                ("low", [0, 0, 0]),
                free_length=1.0,
                spring=laws.Linear(90.0) + laws.BumpStop(gap=0.1, stiffness=900.0, engagement=0.05),
            ),
        },
        gravity=[0, 0, -G],
    )
    eq = jb.equilibrium(model, loads={"press": jb.Force("high", force=[0, 0, -25.0])})
    assert eq.ok

    def equations(z):
        d = -(z[1] - z[0]) - 0.1
        upper = 90 * (z[1] - z[0]) - 900 * (0 if d < 0 else d**2 / 0.1 if d < 0.05 else d - 0.025)
        lower = 1e-3 * (101325 - (101325 + 3 * G / 1e-3) * (1 + z[0] / 0.3) ** -1.4)
        return [-2 * G - lower + upper, -G - upper - 25.0]

    exact = fsolve(equations, [-0.05, -0.2], xtol=1e-13)
    np.testing.assert_allclose(eq.state.q, exact, atol=1e-11)
