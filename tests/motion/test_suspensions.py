"""Simulated suspensions: a mass for every law against SciPy; their energy; tyres that leave
the ground."""

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from data import columns
from scipy.integrate import simpson, solve_ivp
from scipy.interpolate import PchipInterpolator

import jaxbody as jb
from jaxbody import laws

G, M = 9.81, 2.0
BASE = {"amplitude": 0.03, "frequency": 1.7}
X, F = (
    np.array([-0.4, -0.2, -0.1, -0.02, 0.0, 0.05, 0.1, 0.4]),
    np.array([-90.0, -60.0, -40.0, -8.0, 0.0, 10.0, 30.0, 200.0]),
)
V, D = (
    np.array([-2.0, -0.5, -0.1, 0.0, 0.1, 0.5, 2.0]),
    np.array([-6.0, -3.0, -1.5, 0.0, 2.0, 5.0, 12.0]),
)


def stop(d, k, w):
    return k * np.where(d <= 0, 0, np.where(d < w, d**2 / (2 * w), d - w / 2))


def gas(x, load=M * G, area=2e-3, height=0.4):
    return area * (101325 - (101325 + load / area) * (1 + x / height) ** -1.4)


def touching(e, v, k=2000.0, c=30.0, w=0.01):
    push, c_e = stop(-e, k, w), c * np.clip(-e / w, 0, 1)
    return -push - np.maximum(-c_e * v, -push)


# For each mass its element to the base, one meter long, and its tension over (elongation, rate)
# in NumPy
SPRING = {"free_length": 1.0}
RIG = {
    "linear": (dict(spring=300.0, damper=2.0), lambda x, v: 300 * x + 2 * v),
    "hardening": (
        dict(
            spring=laws.Polynomial([200.0, 100.0, 9000.0]), damper=laws.Polynomial([1.0, 0.0, 0.5])
        ),
        lambda x, v: 200 * x + 100 * x**2 + 9000 * x**3 + v + 0.5 * v**3,
    ),
    "table": (
        dict(spring=laws.Tabulated(X, F), damper=laws.Tabulated(V, D)),
        lambda x, v: PchipInterpolator(X, F)(x) + PchipInterpolator(V, D)(v),
    ),
    "bilinear": (
        dict(spring=300.0, damper=laws.TwoSided(bump=2.0, rebound=6.0)),
        lambda x, v: 300 * x + np.where(v < 0, 2 * v, 6 * v),
    ),
    "digressive": (
        dict(spring=300.0, damper=laws.Digressive(slow=9.0, fast=1.0, knee=0.1)),
        lambda x, v: 300 * x + v + 8 * v / np.sqrt(1 + (v / 0.1) ** 2),
    ),
    "bump stop": (
        dict(
            spring=laws.Linear(200.0) + laws.BumpStop(gap=0.1, stiffness=5000.0, engagement=0.02),
            damper=1.0,
        ),
        lambda x, v: 200 * x - stop(-x - 0.1, 5000, 0.02) + v,
    ),
    "friction": (
        dict(spring=300.0, damper=laws.Friction(level=1.5, velocity=0.02)),
        lambda x, v: 300 * x + 1.5 * v / np.hypot(v, 0.02),
    ),
    "gas": (
        dict(spring=laws.AirSpring.carrying(M * G, area=2e-3, height=0.4), damper=3.0),
        lambda x, v: gas(x) + 3 * v,
    ),
    "user's own": (
        dict(spring=lambda x: 40 * jnp.sinh(x / 0.1), damper=lambda v: 3 * jnp.tanh(v)),
        lambda x, v: 40 * np.sinh(x / 0.1) + 3 * np.tanh(v),
    ),
}
UP = {"axis": [0, 0, 1]}


def rig(names=(*RIG, "rope", "contact")):
    """Masses on guides, and one on a tyre."""
    bodies, joints, elements = {}, {}, {}
    for name in (name for name in names if name in RIG):
        elements[f"{name} strut"] = jb.SpringDamper(
            (name, [0, 0, 0]), ("base", [0, 0, -1]), **SPRING, **RIG[name][0]
        )
    elements["rope strut"] = jb.SpringDamper(
        ("rope", [0, 0, 0]),
        ("base", [0, 0, 1]),
        spring=laws.TensionOnly(400.0),
        damper=0.5,
        **SPRING,
    )
    elements["tyre strut"] = jb.Tyre(
        "tyre", ("base", [0, 0, -1]), stiffness=2000.0, damping=30.0, radius=1.0, engagement=0.01
    )
    elements["contact strut"] = jb.Contact(
        ("contact", [0, 0, 0]),
        ("base", [0, 0, -1]),
        stiffness=2000.0,
        damping=30.0,
        distance=1.0,
        engagement=0.01,
    )
    elements = {
        name: element
        for name, element in elements.items()
        if name.removesuffix(" strut") in (*names, "tyre")
    }
    for name in (*names, "tyre"):
        bodies[name] = jb.Body(mass=M, inertia=[1, 1, 1])
        joints[name] = jb.Guide("world", **UP)
    return jb.Model(
        bodies=bodies,
        supports={"base": jb.Support()},
        joints=joints,
        elements=elements,
        gravity=[0, 0, -G],
    )


FORCES = {name: tension for name, (_, tension) in RIG.items()} | {
    "rope": lambda x, v: -(400 * np.maximum(x, 0) + 0.5 * v),
    "tyre": touching,
    "contact": touching,
}


def program(name, times, start):
    """The mass `name` by SciPy: M z'' = -M g - tension; of the rope, which hangs from above, the
    other way round."""
    a, w = BASE["amplitude"], 2 * np.pi * BASE["frequency"]
    side = -1.0 if name == "rope" else 1.0

    def rate(t, y):
        x, v = side * (y[0] - a * np.cos(w * t)), side * (y[1] + a * w * np.sin(w * t))
        return [y[1], -G - FORCES[name](x, v) / M]

    return solve_ivp(
        rate,
        (0, times[-1]),
        start,
        method="DOP853",
        rtol=1e-12,
        atol=1e-13,
        t_eval=times,
        max_step=0.01,
    ).y


MOTION = {"base": jb.Harmonic(frequency=BASE["frequency"], translation=[0, 0, BASE["amplitude"]])}
TIMES = np.linspace(0, 1.5, 30001)  # so dense for the integrals of powers, which have corners


@pytest.fixture(scope="module")
def model():
    return rig()


@pytest.fixture(scope="module")
def start(model):
    z = jnp.linspace(-0.05, 0.05, len(model.layout.bodies)) + BASE["amplitude"]
    return jb.State(z, jnp.linspace(-0.2, 0.3, len(z)))


@pytest.fixture(scope="module")
def moved(model, start):
    trajectory = jb.simulate(model, TIMES, motion=MOTION, initial=start, rtol=jnp.array(1e-11))
    assert trajectory.ok
    return trajectory


@pytest.mark.long
@pytest.mark.parametrize("name", FORCES)
def test_a_mass_on_every_law_moves_as_by_scipy(model, moved, start, name):
    """1e-8 of the largest value, in displacement and velocity."""
    i = model.layout.bodies.index(name)
    z, v = program(name, TIMES[::300], [float(start.q[i]), float(start.v[i])])
    assert abs(z - moved.state.q[::300, i]).max() <= 1e-8 * abs(z).max()
    assert abs(v - moved.state.v[::300, i]).max() <= 1e-8 * abs(v).max()


@pytest.mark.long
def test_the_rig_reaches_every_regime_of_its_laws(model, moved):
    """Stops are reached, the rope goes slack, tyre and contact leave the ground."""
    e = moved.elongations
    assert e["bump stop strut"].min() < -0.1 < e["bump stop strut"].max()
    assert e["rope strut"].min() < 0 < e["rope strut"].max()
    for name in ("tyre", "contact"):
        assert e[f"{name} strut"].min() < -0.01 and e[f"{name} strut"].max() > 0
        assert (
            moved.forces[f"{name} strut"].max() <= 0
            and moved.forces[f"{name} strut"].min() < -M * G
        )


@pytest.mark.long
@pytest.mark.parametrize("rtol", [1e-6, 1e-8])
def test_energy_is_the_work_of_the_base_less_dissipation(model, start, rtol):
    """Within 10 rtol of the largest energy; the integrals by Simpson's rule, whose own error
    is below."""
    trajectory = jb.simulate(model, TIMES, motion=MOTION, initial=start, rtol=jnp.array(rtol))
    energy, powers = trajectory.energies["total"], trajectory.powers
    change = energy - energy[0]
    done = np.array(
        [
            simpson((powers["supports"] - powers["damping"])[: n + 1], x=TIMES[: n + 1])
            for n in range(2000, 30001, 4000)
        ]
    )
    assert (np.asarray(powers["damping"]) >= 0).all()
    assert abs(change[2000::4000] - done).max() <= 10 * rtol * abs(change).max()


LIKE_ADAMS = {
    "linear": (100.0, 5.0),
    "polynomial": (laws.Polynomial([100.0, 0.0]), laws.Polynomial([5.0])),
    "table": (
        laws.Tabulated([-3, -1, 0.5, 1, 4], [-300, -100, 50, 100, 400]),
        laws.Tabulated([-9, -1, 0.5, 1, 9], [-45, -5, 2.5, 5, 45]),
    ),
    "two-sided": (laws.TwoSided(bump=100.0, rebound=100.0), laws.TwoSided(bump=5.0, rebound=5.0)),
    "digressive": (
        laws.Linear(60.0) + laws.Linear(40.0),
        laws.Digressive(slow=5.0, fast=5.0, knee=0.1),
    ),
    "function": (lambda x: 100 * x, lambda v: 5 * v),
}


@pytest.mark.long
def test_every_law_that_can_express_it_moves_as_in_adams():
    """The file has seven digits, six decimals: the limit is half of the last one."""
    time, *place = columns("adams_tsda", "TranSpring_Case02_ADAMS_Pos.txt", header=3)
    model = jb.Model(
        bodies={
            name: jb.Body(mass=1.0, inertia=[0.04, 0.1, 0.1], position=[0, 2, 0])
            for name in LIKE_ADAMS
        },
        elements={
            f"{name} strut": jb.SpringDamper(
                (name, [0, 0, 0]),
                ("world", [0, 0, 0]),
                spring=spring,
                damper=damper,
                free_length=2.0,
            )
            for name, (spring, damper) in LIKE_ADAMS.items()
        },
        gravity=[0, 0, -9.80665],
    )
    trajectory = jb.simulate(model, time, rtol=jnp.array(1e-11))
    assert trajectory.ok
    for pose in trajectory.poses.values():
        assert abs(pose.p - np.array(place).T).max() < 0.5001e-6


# Leaving a table


def on_a_table(start):
    strut = jb.SpringDamper(
        ("body", [0, 0, 0]), ("world", [0, 0, -1]), spring=laws.Tabulated(X, F), free_length=1.0
    )
    model = jb.Model(
        bodies={"body": jb.Body(mass=M, inertia=[1, 1, 1])},
        joints={"body": jb.Guide("world", **UP)},
        elements={"strut": strut},
    )
    return model, jb.State(jnp.array([start]), jnp.array([0.0]))


@pytest.mark.long
def test_a_motion_that_leaves_a_table_reports_which_and_when():
    model, initial = on_a_table(0.6)
    times = np.linspace(0, 0.3, 31)
    with pytest.warns(
        jb.JaxbodyWarning, match=r"'strut' first at t = 0 s.*end slope \[TABLE_RANGE\]"
    ):
        trajectory = jb.simulate(model, times, initial=initial)
    beyond = np.asarray(trajectory.elongations["strut"]) > 0.4
    assert not trajectory.ok and beyond.any() and not beyond.all()
    assert np.isfinite(trajectory.state.q).all()
    assert jb.simulate(model, times, initial=on_a_table(0.2)[1]).ok


@pytest.mark.long
def test_an_equilibrium_beyond_a_table_reports_which():
    model, _ = on_a_table(0.0)
    with pytest.warns(
        jb.JaxbodyWarning, match=r"beyond the points of its table; 'strut' \[TABLE_RANGE\]"
    ):
        eq = jb.equilibrium(jb.replace(model, {"gravity": [0, 0, -60.0]}))
    slope = PchipInterpolator(X, F).derivative()(-0.4)
    assert abs(eq.state.q[0] - (-0.4 - (60 * M - 90) / slope)) <= 1e-12
    assert jb.equilibrium(jb.replace(model, {"gravity": [0, 0, -20.0]})).ok


# Derivatives at singular configurations


@pytest.mark.long
def test_struts_of_zero_length_and_free_length_have_the_stiffness_of_their_law():
    """K = F'(0) I at d = 0, and its derivative by the law's number is I."""

    def K(k1):
        strut = jb.SpringDamper(
            ("body", [0, 0, 0]),
            ("world", [0, 0, 0]),
            spring=laws.Polynomial(jnp.stack([k1, 7.0, 3.0])),
        )
        model = jb.Model(
            bodies={"body": jb.Body(mass=M, inertia=[1, 1, 1])},
            joints={"body": jb.Translation("world")},
            elements={"strut": strut},
        )
        definition = jax.hessian(lambda q: jb.potential_energy(model, jb.State(q, 0 * q)))(
            model.reference.q
        )
        return jb.linearize(model, model.reference).K, definition

    (result, definition), (slope, _) = jax.jvp(K, (jnp.array(50.0),), (jnp.array(1.0),))
    np.testing.assert_allclose(result, 50 * np.eye(3), atol=1e-13)
    np.testing.assert_allclose(definition, 50 * np.eye(3), atol=1e-13)
    np.testing.assert_allclose(slope, np.eye(3), atol=1e-15)


@pytest.mark.parametrize("pull", [False, True])
def test_a_strut_that_has_a_direction_is_refused_at_zero_length(pull):
    law = (
        dict(spring=laws.AirSpring(pressure=2e5, area=0.01, height=1.0))
        if pull
        else dict(spring=10.0, damper=1.0)
    )
    with pytest.raises(jb.JaxbodyError, match="ZERO_LENGTH"):
        jb.Model(
            bodies={"body": jb.Body(mass=M, inertia=[1, 1, 1])},
            elements={"strut": jb.SpringDamper(("body", [0, 0, 0]), ("world", [0, 0, 0]), **law)},
        )


@pytest.mark.long
def test_gradients_of_a_motion_by_numbers_of_its_laws():
    """Forward mode against central differences, through a stop and lift-off; the error is that of
    the steps over the difference."""
    model = rig(("bump stop", "table", "friction"))
    start = jb.State(jnp.array([-0.02, 0.0, 0.02, 0.0]), jnp.zeros(4))
    paths = [
        "bump stop strut.spring.terms.1.gap",
        "tyre strut.stiffness",
        "table strut.spring.forces",
        "friction strut.damper.velocity",
    ]
    values = jb.parameter_paths(model)
    assert set(paths) <= set(values)

    @jax.jit
    def end(u):
        changed = jb.replace(
            model, {path: values[path] * (1 + x) for path, x in zip(paths, u, strict=True)}
        )
        run = jb.simulate(
            changed,
            jnp.linspace(0, 0.5, 3),
            motion=MOTION,
            initial=start,
            rtol=1e-11,
            adjoint=diffrax.ForwardMode(),
        )
        return run.state.q[-1]

    u = jnp.zeros(len(paths))
    J = jax.jit(jax.jacfwd(end))(u)
    assert np.isfinite(J).all() and (abs(J).max(0) > 1e-4).all()
    h = 1e-4
    for i in range(len(paths)):
        step = h * jnp.eye(len(paths))[i]
        difference = (end(u + step) - end(u - step)) / (2 * h)
        assert abs(difference - J[:, i]).max() <= 1e-5 * abs(J[:, i]).max()
