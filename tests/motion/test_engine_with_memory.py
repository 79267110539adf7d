"""An engine on three rubber mounts of three branches in each of six directions, and on a hydraulic
one: 54 + 2 states."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxbody as jb

pytestmark = pytest.mark.long
DIRECTIONS, TURNING = ("x", "y", "z", "rx", "ry", "rz"), (300.0, 250.0, 400.0)
# stiffness relative to the spring, relaxation time
BRANCHES = ((0.3, 0.1), (0.4, 0.02), (0.5, 0.004))
FLUID = {
    "stiffness": 1e5,
    "damping": 100.0,
    "upper_stiffness": 2e5,
    "lower_stiffness": 1e4,
    "fluid_mass": 30.0,
    "fluid_damping": 600.0,
}
SHAKEN = {"frame": jb.Harmonic(frequency=9.0, translation=[5e-4, 2e-4, 1e-3])}


def engine(memory=True):
    preset, elements = jb.presets.engine_on_mounts(), {}
    for i, name in enumerate(preset.element_names):
        bushing, laws = preset[name], {}
        for direction, k in zip(DIRECTIONS, [*bushing.stiffness[:3], *TURNING], strict=True):
            branches = [
                jb.laws.Maxwell(stiffness=g * k, relaxation_time=tau * (1 + 0.1 * i))
                for g, tau in BRANCHES
                if memory
            ]
            laws[direction] = jb.laws.Sum(jb.laws.Linear(k), *branches)
        elements[name] = jb.Mount(
            ("engine", bushing.a),
            ("frame", bushing.b),
            **laws,
            damping=[20.0, 20, 20, 0.1, 0.1, 0.1],
        )
    series = (
        FLUID["upper_stiffness"]
        * FLUID["lower_stiffness"]
        / (FLUID["upper_stiffness"] + FLUID["lower_stiffness"])
    )
    z = jb.laws.Hydraulic(**FLUID) if memory else jb.laws.Linear(FLUID["stiffness"] + series)
    at = [0.1, 0.0, -0.3]
    elements["hydraulic"] = jb.Mount(
        ("engine", at), ("frame", at), x=5e4, y=5e4, z=z, damping=[50.0, 50, 0]
    )
    return jb.Model(
        bodies={"engine": preset["engine"]},
        supports={"frame": jb.Support()},
        elements=elements,
        gravity=[0, 0, -9.81],
    )


@pytest.fixture(scope="module")
def model():
    return engine()


@pytest.fixture(scope="module")
def rest(model):
    return jb.equilibrium(model)


@pytest.fixture(scope="module")
def lin(model, rest):
    return jb.linearize(model, rest)


def test_rest_is_that_without_memory(model, rest):
    assert model.layout.nz == 56 and rest.ok and rest.stable
    without = jb.equilibrium(engine(memory=False))
    np.testing.assert_allclose(rest.state.q, without.state.q, rtol=1e-9, atol=1e-13)
    cases = jb.load_cases(
        model, {"pull": jb.LoadCase(loads={"pull": jb.Force("engine", force=[300.0, 0, 200.0])})}
    )
    plain = jb.load_cases(
        engine(memory=False),
        {"pull": jb.LoadCase(loads={"pull": jb.Force("engine", force=[300.0, 0, 200.0])})},
    )
    np.testing.assert_allclose(cases.state.q, plain.state.q, rtol=1e-8, atol=1e-12)


def test_small_motions(model, rest, lin):
    """Slow matrices are those without memory; poles are those of the state space; energies sum up
    to all."""
    without = jb.linearize(engine(memory=False), jb.State(rest.state.q, rest.state.v))
    assert lin.massless == 54 and lin.M.shape == (61, 61)
    y = np.arange(6, 61)
    slow = np.asarray(lin.K)[:6, :6] - np.asarray(lin.K)[:6, y] @ np.linalg.solve(
        np.asarray(lin.K)[np.ix_(y, y)], np.asarray(lin.K)[y, :6]
    )
    assert np.abs(slow - without.K).max() < 1e-9 * np.abs(without.K).max()
    damped = jb.complex_modes(lin)
    assert (
        damped.frequency.shape == (7,)
        and damped.relaxations.shape == (54,)
        and (np.asarray(damped.relaxations) < 0).all()
    )
    s = lin.state_space(
        {"base": jb.BaseMotion("frame", "z")}, {"z": jb.Position("engine", axis="z")}
    )
    exact = np.linalg.eigvals(np.asarray(s.A))
    found = np.concatenate([np.asarray(damped.poles).ravel(), damped.relaxations])
    assert max(np.abs(exact - pole).min() for pole in found) < 1e-8 * np.abs(exact).max()
    for stiffness in ("relaxed", "instantaneous"):
        energies = jb.vibration.mode_energies(lin, stiffness=stiffness)
        np.testing.assert_allclose(
            sum(energies.strain.values()) + sum(energies.other_strain.values()), 100, rtol=1e-8
        )


def test_responses(lin):
    """Of the base to the engine, against the state space; the variance of a random response against
    the sum of its spectrum."""
    inputs, outputs = {"base": jb.BaseMotion("frame", "z")}, {"z": jb.Position("engine", axis="z")}
    f = np.array([2.0, 7.0, 12.0, 40.0])
    response, s = jb.frequency_response(lin, f, inputs, outputs), lin.state_space(inputs, outputs)
    by_states = [
        (s.C @ np.linalg.solve(2j * np.pi * x * np.eye(len(s.A)) - s.A, s.B) + s.D)[0, 0] for x in f
    ]
    np.testing.assert_allclose(response["z", "base"], by_states, rtol=1e-9)
    ride = jb.random_response(
        lin,
        jb.vibration.Band(1.0, 50.0),
        inputs,
        outputs,
        {"base": jb.vibration.PSD([1.0, 50.0], [1e-8, 1e-8], unit="m2/Hz")},
    )
    fine = np.linspace(1.0, 50.0, 4001)
    square = (
        np.abs(np.asarray(jb.frequency_response(lin, fine, inputs, outputs)["z", "base"])) ** 2
        * 1e-8
    )
    np.testing.assert_allclose(ride["z"], np.sqrt(np.trapezoid(square, fine)), rtol=1e-4)


def lowest(model):
    return jb.modes(jb.linearize(model, model.reference)).frequency[0]


def test_designs(model):
    path = "mount 2.y.terms.0.coefficient"
    k = float(jb.parameter_paths(model)[path])
    swept = jb.sweep(model, lambda model: {"lowest": lowest(model)}, {path: [k, 1.1 * k]})
    np.testing.assert_allclose(
        swept["lowest"], [lowest(model), lowest(jb.replace(model, {path: 1.1 * k}))], rtol=1e-10
    )
    wanted = float(swept["lowest"][1])
    tuned = jb.tune(model, lambda model: (lowest(model) - wanted) ** 2, free=path)
    assert abs(float(lowest(tuned.model)) - wanted) < 1e-4
    spread = jb.tolerances(model, lowest, {path: 0.02 * k}, samples=200)
    slope = (wanted - float(swept["lowest"][0])) / (0.1 * k)
    # a difference of 10 %
    np.testing.assert_allclose(spread.deviation[0], 0.02 * k * slope, rtol=0.1)


def test_reverse_mode_over_a_minute_within_100_mb(model, rest):
    times = jnp.linspace(0, 60.0, 601)

    def travel(k):
        run = jb.simulate(
            jb.replace(model, {"mount 1.z.terms.1.stiffness": k}),
            times,
            motion=SHAKEN,
            initial=rest.state,
        )
        return jnp.sum(run.state.q[:, 2] ** 2) * 1e6

    k = jnp.array(float(jb.parameter_paths(model)["mount 1.z.terms.1.stiffness"]))
    program = jax.jit(jax.grad(travel)).lower(k).compile()
    memory = program.memory_analysis()
    assert memory.temp_size_in_bytes + memory.output_size_in_bytes < 100e6
    step = 1e-4 * k
    np.testing.assert_allclose(
        program(k), (travel(k + step) - travel(k - step)) / (2 * step), rtol=1e-4
    )
