"""Motions, rest and load cases of models with hydraulic mounts, against closed forms."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import rigs

import jaxbody as jb

MOUNT = {
    "stiffness": 2e5,
    "damping": 100.0,
    "upper_stiffness": 3e5,
    "lower_stiffness": 4e4,
    "fluid_mass": 60.0,
    "fluid_damping": 1500.0,
}
LINEAR = jb.laws.Hydraulic(**MOUNT)
WHOLE = jb.laws.Hydraulic(**MOUNT, quadratic_damping=4e4, gap=2e-4)


def oscillator(spring, mass=200.0, joint=None, gravity=0.0):
    """A mass on one element; its elongation is minus its coordinate."""
    element = jb.SpringDamper(("m", [0, 0, 0]), ("base", [0, 0, 0]), free_length=1.0, spring=spring)
    return jb.Model(
        bodies={"m": jb.Body(mass=mass)},
        joints={"m": joint or jb.Guide("world", axis="x")},
        supports={"base": jb.Support(position=[1, 0, 0])},
        elements={"s": element},
        gravity=[gravity, 0, 0],
    )


@pytest.mark.long
def test_dynamic_stiffness_in_the_steady_state():
    """kr + cr s + k1 (m s^2 + c s + k2)/(m s^2 + c s + k1 + k2) from the force under an
    imposed motion."""
    held = oscillator(LINEAR, joint=jb.Fixed("world"))

    @jax.jit
    def measured(frequency):
        """First harmonics of force and deformation over a period after 1.5 s, when the start has
        died out by e^-18."""
        t = 1.5 + jnp.arange(64) / 64 / frequency
        moved = {"base": jb.Harmonic(frequency=frequency, translation=[1e-3, 0, 0])}
        run = jb.simulate(held, jnp.concatenate([jnp.zeros(1), t]), motion=moved, rtol=1e-9)
        turn = jnp.exp(-2j * jnp.pi * frequency * t)
        return jnp.mean(run.forces["s"][1:] * turn), jnp.mean(run.elongations["s"][1:] * turn)

    for f in (2.0, 8.0, 12.0, 20.0, 80.0):
        F, e = measured(f)
        s = 2j * np.pi * f
        column = 60.0 * s**2 + 1500.0 * s + 4e4
        assert abs(F / e / (2e5 + 100.0 * s + 3e5 * column / (column + 3e5)) - 1) < 1e-5


@pytest.mark.long
def test_the_balance_of_energies_over_a_random_run():
    """Work of the base = stored + kinetic energy of mass and fluid + lost, with decoupler,
    quadratic loss and a branch."""
    model, rng = (
        oscillator(WHOLE + jb.laws.Maxwell(stiffness=1e4, relaxation_time=0.1)),
        np.random.default_rng(4),
    )
    t = np.linspace(0, 1, 4001)
    parts = zip(rng.normal(size=8) * 1e-3, rng.uniform(1, 12, 8), rng.uniform(0, 6, 8), strict=True)
    road = sum(a * np.sin(2 * np.pi * f * t + p) for a, f, p in parts)
    motion = jb.Sampled(t, translation=np.stack([road - road[0], 0 * t, 0 * t], -1))
    rtol = 1e-8
    run = jb.simulate(model, t, motion={"base": motion}, rtol=rtol)
    assert int(run.status) == 0 and np.abs(run.state.z[:, 0]).max() > 5e-4
    total = np.asarray(run.energies["total"])
    power = np.asarray(run.powers["supports"]) - np.asarray(run.powers["damping"])
    h = t[1] - t[0]
    slopes = np.gradient(power, h, edge_order=2)
    # of fourth order but at kinks
    pieces = (power[1:] + power[:-1]) / 2 * h - (slopes[1:] - slopes[:-1]) * h**2 / 12
    work = np.concatenate([[0], np.cumsum(pieces)])
    assert np.abs(total - total[0] - work).max() < 1e-6 * np.sum(np.abs(power)) * h
    fluid = 0.5 * 60.0 * np.asarray(run.state.z[:, 1]) ** 2
    np.testing.assert_allclose(
        run.energies["kinetic"],
        0.5 * 200.0 * np.asarray(run.state.v[:, 0]) ** 2 + fluid,
        rtol=1e-12,
    )


@pytest.mark.long
def test_free_motion_of_the_fluid():
    """A held mount whose fluid is released: an oscillator of k1 + k2, in closed form."""
    held = oscillator(LINEAR, joint=jb.Fixed("world"))
    run = jb.simulate(
        held,
        np.linspace(0, 0.3, 7),
        initial=jb.State(np.zeros(0), np.zeros(0), np.array([1e-3, 0.0])),
        rtol=1e-10,
    )
    w0, decay = np.sqrt(3.4e5 / 60), 1500 / 120
    w = np.sqrt(w0**2 - decay**2)
    y = (
        1e-3
        * np.exp(-decay * run.times)
        * (np.cos(w * run.times) + decay / w * np.sin(w * run.times))
    )
    np.testing.assert_allclose(run.state.z[:, 0], y, atol=1e-8 * 1e-3)
    np.testing.assert_allclose(run.forces["s"], -3e5 * y, atol=1e-8 * 300)


@pytest.mark.long
def test_rest_and_load_cases():
    """Under a weight beyond the gap, F = kr e + k1 k2 (e - gap)/(k1 + k2); rest stays at rest."""
    model = oscillator(WHOLE, gravity=-9.81)
    eq = jb.equilibrium(model)
    series, weight = 3e5 * 4e4 / 3.4e5, 200 * 9.81
    e = (weight + series * 2e-4) / (2e5 + series)
    np.testing.assert_allclose(eq.state.q, [-e], rtol=1e-10)
    np.testing.assert_allclose(eq.state.z, [3e5 * (e - 2e-4) / 3.4e5, 0.0], rtol=1e-10)
    assert eq.stable and int(eq.status) == 0
    run = jb.simulate(model, [0.0, 0.2, 0.5], initial=eq.state)
    assert np.abs(run.state.q - eq.state.q).max() < 1e-9
    cases = jb.load_cases(
        model, {"more": jb.LoadCase(loads={"push": jb.Force("m", force=[-1000.0, 0, 0])})}
    )
    np.testing.assert_allclose(
        cases.state.q[0], -(weight + 1000 + series * 2e-4) / (2e5 + series), rtol=1e-9
    )


def travel(model, values):
    names = ("upper_stiffness", "fluid_mass", "fluid_damping", "quadratic_damping")
    model = jb.replace(
        model, {f"s.spring.{name}": x for name, x in zip(names, values, strict=True)}
    )
    moved = {"base": jb.Harmonic(frequency=9.0, translation=[2e-3, 0, 0])}
    run = jb.simulate(model, np.linspace(0, 0.2, 5), motion=moved, rtol=1e-11)
    return jnp.sum(run.state.q**2) * 1e4 + 1e2 * jnp.sum(run.state.z**2)


@pytest.mark.long
def test_derivatives_of_a_motion_and_a_batch():
    model = oscillator(jb.replace(oscillator(WHOLE), {"s.spring.gap": 0.0})["s"].spring)
    x = jnp.array([3e5, 60.0, 1500.0, 4e4])
    of = jax.jit(lambda x: travel(model, x))
    rigs.check_derivatives(of, x)
    batch = jnp.stack([x, 1.2 * x])
    np.testing.assert_allclose(jax.vmap(of)(batch), [of(row) for row in batch], rtol=1e-9)


def test_a_mount_with_a_fluid_has_paths_words_and_a_file(tmp_path):
    mount = jb.Mount(
        ("engine", [0.1, 0, 0]),
        ("frame", [0.1, 0, 0]),
        x=1e5,
        y=1e5,
        z=WHOLE,
        rx=50.0,
        ry=50.0,
        rz=50.0,
    )
    body = jb.Body(mass=200.0, inertia=[3, 4, 5])
    model = jb.Model(
        bodies={"engine": body},
        supports={"frame": jb.Support()},
        elements={"engine mount A": mount},
    )
    assert model.layout.states == ("engine mount A, fluid", "engine mount A, rate of fluid")
    assert "engine mount A.z.fluid_mass" in jb.parameter_paths(model)
    jb.write_model(model, tmp_path / "engine.toml")
    again = jb.read_model(tmp_path / "engine.toml")
    for one, other in zip(jax.tree.leaves(model), jax.tree.leaves(again), strict=True):
        np.testing.assert_array_equal(one, other)
    with pytest.raises(jb.JaxbodyError, match="NEGATIVE"):
        jb.replace(model, {"engine mount A.z.gap": -1e-3})
    with pytest.raises(jb.JaxbodyError, match="BAD_SHAPE"):
        jb.simulate(
            model, [0.0, 1.0], initial=jb.State(model.reference.q, model.reference.v, np.zeros(1))
        )
