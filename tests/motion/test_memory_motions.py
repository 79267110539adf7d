"""Motions of models whose elements have memory, against closed forms and published values."""

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import rigs

import jaxbody as jb

K0, K1, TAU, MASS = 2e4, 6e4, 0.01, 50.0
SOLID = jb.laws.Linear(K0) + jb.laws.Maxwell(stiffness=K1, relaxation_time=TAU)


def oscillator(spring, mass=MASS, damper=None, joint="guide"):
    """A mass on one element; its elongation is minus its coordinate."""
    joints = {"guide": {"m": jb.Guide("world", axis="x")}, "held": {"m": jb.Fixed("world")}}[joint]
    element = jb.SpringDamper(
        ("m", [0, 0, 0]), ("base", [0, 0, 0]), free_length=1.0, spring=spring, damper=damper
    )
    return jb.Model(
        bodies={"m": jb.Body(mass=mass)},
        joints=joints,
        supports={"base": jb.Support(position=[1, 0, 0])},
        elements={"s": element},
    )


@pytest.fixture(scope="module")
def solid():
    return oscillator(SOLID)


def test_states_have_names_units_and_values_at_rest(solid):
    assert solid.layout.states == ("s, branch",) and solid.layout.z_units == ("m",)
    assert solid.reference.z.tolist() == [0.0]
    several = oscillator(
        SOLID
        + jb.laws.Maxwell(stiffness=1.0, relaxation_time=1.0)
        + jb.laws.Dahl(stiffness=1.0, level=1.0)
    )
    assert several.layout.states == ("s, branch 1", "s, branch 2", "s, friction force")
    assert several.layout.z_units == ("m", "m", "N")
    torsion = jb.Torsion(
        "m", "world", axis="x", spring=jb.laws.Maxwell(stiffness=1.0, relaxation_time=1.0)
    )
    model = jb.Model(
        bodies={"m": jb.Body(mass=1.0, inertia=[1, 1, 1])},
        joints={"m": jb.Hinge("world", axis="x")},
        elements={"t": torsion},
    )
    assert model.layout.z_units == ("rad",)
    initial = jb.Experiment(
        [0.0, 1.0], initial=solid.reference, sensors={"x": jb.Position("m", axis="x")}
    )
    assert set(jb.parameter_paths(initial)) >= {"initial.q", "initial.v", "initial.z"}


@pytest.mark.parametrize(
    ("state", "expected"),
    [
        (
            jb.State(np.array([0.01]), np.zeros(1), np.zeros(1)),
            [0.00232846928172, -0.00428358732873, -0.00111835294108],
        ),
        (
            jb.State(np.array([0.01]), np.zeros(1)),
            [0.00591420889827, -0.00069629871714, -0.00234130573447],
        ),  # z at rest
    ],
)
def test_free_motion_of_the_standard_linear_solid(solid, state, expected):
    motion = jb.simulate(solid, [0.0, 0.05, 0.1, 0.2], initial=state, rtol=1e-10)
    np.testing.assert_allclose(motion.state.q[1:, 0], expected, atol=1e-8 * 0.01)
    force = 141.797909602 if state.z.shape[-1] else 85.671746575  # elongations are minus x
    np.testing.assert_allclose(motion.forces["s"][2], force, rtol=1e-8)


def test_relaxation_and_ramp_of_a_held_solid():
    """F = 0.01 (k0 + k1 exp(-t/tau)) after a step; and after a ramp of 0.1 m/s."""
    held = oscillator(SOLID, joint="held")
    times = np.array([0.0, 0.01, 0.05, 0.06, 0.1])
    moved = {"base": lambda t: jnp.array([0.01, 0, 0, 0, 0, 0]) + 0 * t}
    step = jb.simulate(
        held,
        times,
        motion=moved,
        initial=jb.State(np.zeros(0), np.zeros(0), np.zeros(1)),
        rtol=1e-10,
    )
    np.testing.assert_allclose(step.forces["s"], 0.01 * (K0 + K1 * np.exp(-times / TAU)), rtol=1e-8)
    moved = {"base": lambda t: jnp.array([0.1, 0, 0, 0, 0, 0]) * jnp.minimum(t, 0.05)}
    up = jb.simulate(held, times[:3], motion=moved, rtol=1e-10)
    np.testing.assert_allclose(up.forces["s"][1:], [57.927233530, 159.595723180], rtol=1e-8)
    after = jb.simulate(
        held, times[2:], motion=moved, initial=jax.tree.map(lambda x: x[-1], up.state), rtol=1e-10
    )
    np.testing.assert_allclose(after.forces["s"][1:], [121.924041340, 100.401552824], rtol=1e-8)


@pytest.mark.long
def test_the_benchmark_of_hysteresis_in_forced_motion():
    law = jb.laws.Linear(5e4) + jb.laws.BoucWen(alpha=5e4, beta=1e3, gamma=0.8, delta=-1.1)
    model = oscillator(law, mass=2.0, damper=10.0)
    push = jb.Force("m", force=lambda t: jnp.array([40.0, 0, 0]) * jnp.sin(2 * jnp.pi * 25 * t))
    motion = jb.simulate(model, [0.0, 0.01, 0.05, 0.2], loads={"push": push}, rtol=1e-9)
    np.testing.assert_allclose(
        motion.state.q[1:, 0],
        [3.480191415e-04, 6.817882485e-04, -6.7256902540e-05],
        atol=1e-6 * 7e-4,
    )
    np.testing.assert_allclose(
        motion.state.v[1:, 0], [0.0745629446, -0.0268495763, 0.0886636964], atol=1e-6 * 0.1
    )
    np.testing.assert_allclose(
        -motion.state.z[1:, 0], [18.341793044, 50.765972240, 2.130618619], atol=1e-6 * 60
    )


@pytest.mark.long
@pytest.mark.parametrize("frequency", [1.0, 5.0, 10.0, 20.0, 100.0])
def test_dynamic_stiffness_in_the_steady_state(frequency):
    """k0 + k1 i w tau/(1 + i w tau) from the force under an imposed motion."""
    held = oscillator(SOLID, joint="held")
    t = np.linspace(0.5, 0.5 + 1 / frequency, 65)[:-1]
    run = jb.simulate(
        held,
        np.concatenate([[0.0], t]),
        motion={"base": jb.Harmonic(frequency=frequency, translation=[1e-3, 0, 0])},
        rtol=1e-9,
    )
    w = 2 * np.pi * frequency
    F = (
        2
        * np.mean(np.asarray(run.forces["s"])[1:] * np.exp(-1j * w * t))
        / (2 * np.mean(1e-3 * np.cos(w * t) * np.exp(-1j * w * t)))
    )
    K = K0 + K1 * 1j * w * TAU / (1 + 1j * w * TAU)
    assert abs(F / K - 1) < 1e-5


@pytest.mark.long
def test_energy_lost_in_a_cycle():
    """pi Im K X^2 at 10 Hz and 1 mm, from the power that the branch dissipates."""
    held, f = oscillator(SOLID, joint="held"), 10.0
    t = np.linspace(0.5, 0.6, 65)
    run = jb.simulate(
        held,
        np.concatenate([[0.0], t]),
        motion={"base": jb.Harmonic(frequency=f, translation=[1e-3, 0, 0])},
        rtol=1e-10,
    )
    lost = np.mean(np.asarray(run.powers["damping"])[1:-1]) / f
    np.testing.assert_allclose(lost, 0.08491295990, rtol=1e-8)


@pytest.mark.long
def test_the_balance_of_energies_over_a_random_run():
    """Work of base and gravity = stored + lost, over a run with branches, hysteresis and
    a damper."""
    law = (
        SOLID
        + jb.laws.BoucWen(alpha=4e4, beta=300.0, gamma=0.7, delta=0.3)
        + jb.laws.Maxwell(stiffness=1e4, relaxation_time=0.1)
    )
    model, rng = oscillator(law, damper=30.0), np.random.default_rng(4)
    t = np.linspace(0, 1, 4001)
    road = sum(
        a * np.sin(2 * np.pi * f * t + p)
        for a, f, p in zip(
            rng.normal(size=8) * 2e-3, rng.uniform(1, 12, 8), rng.uniform(0, 6, 8), strict=True
        )
    )
    motion = jb.Sampled(t, translation=np.stack([road - road[0], 0 * t, 0 * t], -1))
    run = jb.simulate(model, t, motion={"base": motion}, rtol=1e-8)
    balance = np.asarray(run.energies["total"]) - np.asarray(run.energies["total"])[0]
    power = np.asarray(run.powers["supports"]) - np.asarray(run.powers["damping"])
    work = np.concatenate([[0], np.cumsum((power[1:] + power[:-1]) / 2 * np.diff(t))])
    largest = np.max(np.abs(np.cumsum(np.abs(power)) * (t[1] - t[0])))
    # of the trapezoidal rule, 1e-3 of a period squared
    assert np.abs(balance - work).max() < 1e-5 * largest


@pytest.mark.long
@pytest.mark.parametrize(("limit", "order"), [("damper", 1), ("spring", 1)])
def test_limits_of_a_branch(limit, order):
    """tau -> 0 at constant c: a damper c; tau -> infinity at constant k: a spring k. The difference
    falls with tau, or with 1/tau."""
    t = np.linspace(0, 0.2, 5)
    start = jb.State(np.array([0.01]), np.zeros(1), np.zeros(1) if limit == "spring" else None)
    if limit == "damper":
        exact = oscillator(jb.laws.Linear(K0), damper=400.0)
        branches = [
            jb.laws.Maxwell(stiffness=400.0 / tau, relaxation_time=tau) for tau in (1e-3, 5e-4)
        ]
    else:
        exact = oscillator(jb.laws.Linear(K0 + K1))
        branches = [jb.laws.Maxwell(stiffness=K1, relaxation_time=tau) for tau in (10.0, 20.0)]
    x = np.asarray(
        jb.simulate(exact, t, initial=jb.State(np.array([0.01]), np.zeros(1))).state.q[:, 0]
    )
    errors = [
        np.abs(
            np.asarray(
                jb.simulate(oscillator(jb.laws.Linear(K0) + branch), t, initial=start).state.q[:, 0]
            )
            - x
        ).max()
        for branch in branches
    ]
    assert errors[0] < 0.1 * 0.01 and abs(np.log2(errors[0] / errors[1]) - order) < 0.1


@pytest.mark.long
def test_stiff_branches_by_an_implicit_solver():
    model = oscillator(
        jb.laws.Linear(K0) + jb.laws.Maxwell(stiffness=400 / 1e-6, relaxation_time=1e-6)
    )
    t = np.linspace(0, 0.2, 5)
    stiff = jb.simulate(
        model,
        t,
        initial=jb.State(np.array([0.01]), np.zeros(1)),
        solver=diffrax.Kvaerno5(),
        rtol=1e-8,
    )
    exact = jb.simulate(
        oscillator(jb.laws.Linear(K0), damper=400.0),
        t,
        initial=jb.State(np.array([0.01]), np.zeros(1)),
    )
    assert int(stiff.status) == 0 and np.abs(stiff.state.q - exact.state.q).max() < 1e-6


@pytest.fixture(scope="module")
def both():
    """A free body on two springs with branches and hysteresis."""
    law = SOLID + jb.laws.BoucWen(alpha=2e4, beta=200.0, gamma=0.6, delta=0.4, n=1.5)
    points = {"left": [-0.3, 0.1, 0], "right": [0.3, -0.1, 0]}
    elements = {
        name: jb.SpringDamper(
            ("box", p), ("base", [p[0], p[1], -0.5]), free_length=0.5, spring=law, damper=50.0
        )
        for name, p in points.items()
    }
    elements["guide"] = jb.Bushing(
        ("box", [0, 0, 0]), ("base", [0, 0, 0]), stiffness=np.diag([3e4, 3e4, 1.0, 900, 900, 900])
    )
    box = jb.Body(mass=MASS, inertia=[2, 2, 3], com=[0.02, 0, 0.01])
    return jb.Model(
        bodies={"box": box},
        supports={"base": jb.Support()},
        elements=elements,
        gravity=[0, 0, -9.81],
    )


SHAKEN = {"base": jb.Harmonic(frequency=6.0, translation=[1e-3, 0, 4e-3])}


def travel(model, values):
    """Differences see the steps change with a parameter, derivatives hold them: they agree to the
    error of the motion. So do both modes, from the first kink of hysteresis on: forward mode takes
    the steps anew, and where the error of a step is near rounding, rounding makes them a little
    longer or shorter. With the lengths of one given to the other they agree to all digits."""
    model = jb.replace(
        model,
        dict(
            zip(
                ("left.spring.terms.1.*", "right.spring.terms.2.alpha"),
                (values[:2], values[2]),
                strict=True,
            )
        ),
    )
    run = jb.simulate(model, np.linspace(0, 0.2, 5), motion=SHAKEN, rtol=1e-13)
    return jnp.sum(run.state.q[:, :3] ** 2) * 1e4 + 1e-4 * jnp.sum(run.state.z**2)


@pytest.mark.long
def test_derivatives_of_a_motion(both):
    x = jnp.array([K1, TAU, 2e4])
    of = jax.jit(lambda x: travel(both, x))
    rigs.check_derivatives(of, x, modes=1e-6)


@pytest.mark.long
def test_a_batch_is_a_loop(both):
    values = jnp.array([[K1, TAU, 2e4], [0.8 * K1, 2 * TAU, 3e4]])
    np.testing.assert_allclose(
        jax.vmap(lambda x: travel(both, x))(values), [travel(both, x) for x in values], rtol=1e-9
    )


@pytest.mark.long
def test_rest_stays_at_rest(both):
    eq = jb.equilibrium(both)
    assert eq.stable and int(eq.status) == 0
    run = jb.simulate(both, [0.0, 0.2, 0.5], initial=eq.state)
    assert np.abs(run.state.q - eq.state.q).max() < 1e-9
    moved = {"base": lambda t: jnp.array([0, 0, 0.1, 0, 0, 0]) + 0 * t}
    displaced = jb.simulate(both, [0.0, 0.2], motion=moved, initial="rest")
    assert (
        np.abs(displaced.state.v).max() < 1e-9
        and np.abs(displaced.state.z[:, 0] - eq.state.z[0]).max() < 1e-9
    )


@pytest.mark.long
def test_a_z_of_another_length_and_gauss_are_refused(solid):
    with pytest.raises(jb.JaxbodyError) as caught:
        jb.simulate(solid, [0.0, 1.0], initial=jb.State(np.zeros(1), np.zeros(1), np.zeros(3)))
    assert caught.value.code == "BAD_SHAPE" and "s 1" in str(caught.value)
    constant = diffrax.ConstantStepSize()
    with pytest.raises(jb.JaxbodyError) as caught:
        jb.simulate(solid, [0.0, 1.0], solver=jb.Gauss(), stepsize_controller=constant, dt0=0.01)
    assert caught.value.code == "MEMORY"
