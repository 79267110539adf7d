"""Small motions of models with hydraulic mounts: rows of fluid with mass, poles, modes, energies,
responses, against closed forms."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import rigs

import jaxbody as jb
from jaxbody.lagrange import kinetic, potential, rayleigh
from jaxbody.mechanics.closed_loops import state_slopes
from jaxbody.model.element_states import apart
from jaxbody.model.joints.frame_tables import frames_of
from jaxbody.numerics.eigenproblems import first_order

KR, CR, KM, M_F, CM = 512950.0, 198.0, 436950.0, 62.8, 2666.0  # REFERENCES2 1.3
MASS = 100.0
PUBLISHED = jb.laws.Hydraulic(
    stiffness=KR, damping=CR, upper_stiffness=KM, fluid_mass=M_F, fluid_damping=CM
)
POLES = np.array(
    [
        -11.105241022859 + 45.802584170398j,
        -14.710350417599 + 52.112753957758j,
        -16.479222310973 + 52.810376305340j,
        -21.696330448460 + 61.591244223242j,
        -28.576522483330 + 70.554746963060j,
        -83.697118772965 + 98.990189949578j,
        -15.647672342453 + 171.540270679492j,
    ]
)
TWO = jb.laws.Hydraulic(
    stiffness=2e4,
    damping=30.0,
    upper_stiffness=3e4,
    lower_stiffness=5e3,
    fluid_mass=8.0,
    fluid_damping=200.0,
    quadratic_damping=500.0,
    gap=1e-4,
)
BRANCH = jb.laws.Maxwell(stiffness=1e4, relaxation_time=0.02)
LAWS = {
    "fluid": TWO,
    "fluid_and_branches": BRANCH
    + TWO
    + jb.laws.Dahl(stiffness=3e3, level=50.0)
    + jb.laws.Maxwell(stiffness=5e3, relaxation_time=0.2),
}
FREQUENCIES = np.array([1.0, 5, 10, 13, 20, 60])
W = 2 * np.pi * FREQUENCIES
INPUTS = {"force": jb.PointForce("m", direction="x"), "base": jb.BaseMotion("base", "x")}
OUTPUTS = {
    "x": jb.Position("m", axis="x"),
    "tension": jb.sensors.LoadCell("s"),
    "reaction": jb.sensors.Reaction("base", component=0),
}


def powertrain():
    preset = jb.presets.engine_on_mounts()
    elements = {}
    for name in preset.element_names:
        bushing = preset[name]
        k, c = np.array(bushing.stiffness[:3]), np.array(bushing.damping[:3])
        first = name == "mount 1"
        c[2] = 0.0 if first else c[2]
        ends = ("engine", bushing.a), ("frame", bushing.b)
        elements[name] = jb.Mount(*ends, x=k[0], y=k[1], z=PUBLISHED if first else k[2], damping=c)
    body = preset["engine"]
    return jb.Model(
        bodies={"engine": jb.Body(mass=body.mass, inertia=body.inertia)},
        supports={"frame": jb.Support()},
        elements=elements,
    )


def oscillator(law, mass=MASS):
    element = jb.SpringDamper(("m", [0, 0, 0]), ("base", [0, 0, 0]), free_length=1.0, spring=law)
    return jb.Model(
        bodies={"m": jb.Body(mass=mass)},
        joints={"m": jb.Guide("world", axis="x")},
        supports={"base": jb.Support(position=[1, 0, 0])},
        elements={"s": element},
    )


def heavy(law):
    """A beam on two struts with this law and a torsion spring with a branch, under gravity, on
    joints whose q are increments."""
    strut = {"free_length": 0.5, "spring": law, "damper": 30.0}
    twist = jb.Torsion(
        "beam",
        "tip",
        axis="y",
        spring=jb.laws.Linear(300.0) + jb.laws.Maxwell(stiffness=200.0, relaxation_time=0.05),
    )
    return rigs.beam_with_tip(
        {
            "twist": twist,
            "left": jb.SpringDamper(("beam", [-0.5, 0, 0]), ("base", [-0.6, 0, -0.5]), **strut),
            "right": jb.SpringDamper(("beam", [0.5, 0, 0]), ("base", [0.4, 0, -0.5]), **strut),
        }
    )


@pytest.fixture(scope="module")
def published():
    model = oscillator(PUBLISHED)
    return jb.linearize(model, jb.equilibrium(model))


def stiffness(w):
    column = CM * 1j * w - M_F * w**2
    return KR + CR * 1j * w + KM * column / (column + KM)


@pytest.mark.long
def test_poles_of_a_powertrain():
    model = powertrain()
    assert model.layout.states == (
        "mount 1, fluid",
        "mount 1, rate of fluid",
    ) and model.layout.z_units == ("m", "m/s")
    eq = jb.equilibrium(model)
    assert eq.stable and int(eq.status) == 0
    lin = jb.linearize(model, eq)
    assert lin.coordinates[6:] == ("mount 1, fluid",) and lin.M.shape == (7, 7)
    damped = jb.complex_modes(lin)
    np.testing.assert_allclose(damped.poles[:, 0], POLES, rtol=1e-9)
    assert damped.relaxations.shape == (0,) and damped.names[2].startswith("mount 1, fluid")
    energies = jb.vibration.mode_energies(lin)
    np.testing.assert_allclose(
        sum(x.sum(0) for x in energies.kinetic.values()) + energies.inertia["mount 1, fluid"],
        100,
        rtol=1e-10,
    )
    np.testing.assert_allclose(sum(energies.strain.values()), 100, rtol=1e-9)
    np.testing.assert_allclose(sum(energies.dissipation.values()), 100, rtol=1e-10)
    assert energies.names == jb.modes(lin).names
    assert jb.modes(lin).to_xarray()["shape"].shape == (7, 7)


@pytest.mark.long
@pytest.mark.parametrize("name", LAWS)
def test_linearization_against_the_slopes_of_the_equations_of_motion(name):
    """A of x' = A x, in the order Delta, fluid, their rates, branches; hysteretic states eliminated
    by their tangent."""
    model = heavy(LAWS[name])
    eq = jb.equilibrium(model)
    assert int(eq.status) == 0
    lin, layout = jb.linearize(model, eq), model.layout
    nv, fluid, rates, branches = layout.nv, layout.inertial, layout.inner_rates, layout.massless
    A = np.asarray(state_slopes(model, eq.state))
    slow = np.setdiff1d(np.arange(layout.nz), [*fluid, *rates, *branches]) + 2 * nv
    keep = np.concatenate(
        [np.arange(nv), 2 * nv + fluid, nv + np.arange(nv), 2 * nv + rates, 2 * nv + branches]
    )
    expected = A[np.ix_(keep, keep)].copy()
    expected[:, :nv] += A[np.ix_(keep, slow)] @ A[slow, nv : 2 * nv]
    found = first_order(lin.M, lin.C, lin.K, lin.nv)[0]
    assert lin.nv == nv + 2 and lin.massless == len(branches)
    assert np.abs(found - expected).max() < 1e-10 * np.abs(expected).max()


@pytest.mark.long
def test_the_rows_are_the_second_derivatives_of_T_V_and_R():
    """Hessians of V in (Delta, y, Xi), of T and R in their rates, with the fluid in motion, where
    its quadratic loss has a slope."""
    model = heavy(LAWS["fluid_and_branches"])
    eq, layout = jb.equilibrium(model), model.layout
    z = eq.state.z.at[layout.inner_rates].set(jnp.array([0.02, -0.05]))
    lin = jb.linearize(model, jb.State(eq.state.q, eq.state.v, z))
    nv, ny, places = layout.nv, len(layout.inner_places), layout.inner_places
    assert lin.coordinates[nv:] == layout.inner

    def V(x):
        frames = frames_of(
            model, jb.State(eq.state.q + x[:nv], eq.state.v, z), x[nv + ny :].reshape(-1, 6)
        )
        held = apart(model, z.at[places].add(x[nv : nv + ny]))
        return potential(held, frames)

    def at_rates(rate, function):
        moving = z.at[layout.inner_rates].add(rate[nv : nv + 2])
        frames = frames_of(
            model, jb.State(eq.state.q, rate[:nv], z), None, rate[nv + ny :].reshape(-1, 6)
        )
        return function(
            apart(model, moving, jnp.zeros_like(z).at[places].set(rate[nv : nv + ny])), frames
        )

    zero = jnp.zeros(nv + ny + layout.nxi)
    K, C, M = lin.whole
    slopes = ((K, V), (C, lambda x: at_rates(x, rayleigh)), (M, lambda x: at_rates(x, kinetic)))
    for found, function in slopes:
        expected = jax.jit(jax.hessian(function))(zero)
        assert np.abs(found - expected).max() < 1e-10 * np.abs(expected).max()


@pytest.mark.long
@pytest.mark.parametrize("method", ["direct", "modal"])
def test_responses_of_a_mass_on_a_hydraulic_mount(published, method):
    response = jb.frequency_response(published, FREQUENCIES, INPUTS, OUTPUTS, method=method)
    K = stiffness(W)
    D = K - MASS * W**2
    expected = {
        ("x", "force"): 1 / D,
        ("x", "base"): K / D,
        ("tension", "force"): -K / D,
        ("tension", "base"): K - K * K / D,
        ("reaction", "force"): K / D,
        ("reaction", "base"): K * K / D - K,
    }
    for pair, value in expected.items():
        np.testing.assert_allclose(response[pair], value, rtol=1e-10, err_msg=str(pair))
    with pytest.raises(jb.JaxbodyError, match="MEMORY"):
        jb.frequency_response(published, FREQUENCIES, INPUTS, OUTPUTS, loss_factor=0.1)


@pytest.mark.long
@pytest.mark.parametrize("kind", ["displacement", "velocity", "acceleration"])
def test_state_space_has_the_same_response(published, kind):
    inputs, outputs = {"base": jb.BaseMotion("base", "x", kind=kind)}, {"x": OUTPUTS["x"]}
    s = published.state_space(inputs, outputs)
    assert s.states[:4] == (
        "m move along its guide",
        "s, fluid",
        "rate of m move along its guide",
        "rate of s, fluid",
    )
    response = jb.frequency_response(published, FREQUENCIES, inputs, outputs)
    for i, w in enumerate(W):
        H = s.C @ np.linalg.solve(1j * w * np.eye(len(s.A)) - s.A, s.B) + s.D
        np.testing.assert_allclose(H, response.values[..., i], rtol=1e-10)


@pytest.mark.long
def test_branches_beside_a_fluid():
    """Poles against the eigenvalues of the equations of motion; responses by elimination and by
    modes; the two limits of stiffness."""
    model = heavy(LAWS["fluid_and_branches"])
    lin = jb.linearize(model, jb.equilibrium(model))
    damped = jb.complex_modes(lin)
    assert damped.frequency.shape == (5,) and damped.relaxations.shape == (5,)
    found = np.concatenate([np.asarray(damped.poles).ravel(), damped.relaxations])
    exact = np.linalg.eigvals(np.asarray(first_order(lin.M, lin.C, lin.K, lin.nv)[0]))
    assert max(np.abs(exact - s).min() for s in found) < 1e-9 * np.abs(exact).max()
    inputs, outputs = (
        {"base": jb.BaseMotion("base", "z")},
        {"z": jb.Position("tip", axis="z"), "left": jb.sensors.LoadCell("left")},
    )
    direct, modal = (
        jb.frequency_response(lin, FREQUENCIES, inputs, outputs, method=method)
        for method in ("direct", "modal")
    )
    np.testing.assert_allclose(direct.values, modal.values, rtol=1e-8)
    relaxed, instantaneous = (
        jb.modes(lin, stiffness=stiffness) for stiffness in ("relaxed", "instantaneous")
    )
    assert (
        np.asarray(relaxed.frequency) < np.asarray(instantaneous.frequency)
    ).all() and relaxed.shapes.shape == (5, 5)
    for stiffness in ("relaxed", "instantaneous"):
        energies = jb.vibration.mode_energies(lin, stiffness=stiffness)
        np.testing.assert_allclose(
            sum(energies.strain.values()) + sum(energies.other_strain.values()), 100, rtol=1e-9
        )
        x = jb.modes(lin, stiffness=stiffness).shapes
        C = (lin.condensed if stiffness == "relaxed" else lin.instantaneous).C
        loss = np.asarray(jnp.sum(x * (C @ x), 0))
        assert (loss > 0).all() and np.allclose(sum(energies.dissipation.values()), 100)


@pytest.mark.long
def test_a_gap_without_a_lower_chamber_leaves_the_fluid_free():
    """Within the gap nothing holds the fluid: a mode of zero frequency, which is named."""
    free = jb.laws.Hydraulic(
        stiffness=KR, damping=CR, upper_stiffness=KM, fluid_mass=M_F, fluid_damping=CM, gap=1e-3
    )
    model = oscillator(free)
    eq = jb.equilibrium(model)
    assert int(eq.status) == 0
    with pytest.warns(jb.JaxbodyWarning, match="SINGULAR_K"):
        modes = jb.modes(jb.linearize(model, eq))
    np.testing.assert_allclose(modes.frequency, [0, np.sqrt(KR / MASS) / 2 / np.pi], rtol=1e-9)
    assert modes.names[0] == "s, fluid 100 %"
    held = oscillator(jb.replace(model, {"s.spring.lower_stiffness": 1e3})["s"].spring)
    modes = jb.modes(jb.linearize(held, held.reference))
    np.testing.assert_allclose(modes.frequency[0], np.sqrt(1e3 / M_F) / 2 / np.pi, rtol=1e-12)


@pytest.mark.long
def test_two_alike_mounts_have_a_mode_of_the_fluid_alone():
    """The fluids of two mounts side by side move against each other and leave the mass at rest."""
    ends = ("m", [0, 0, 0]), ("base", [0, 0, 0])
    model = jb.Model(
        bodies={"m": jb.Body(mass=MASS)},
        joints={"m": jb.Guide("world", axis="x")},
        supports={"base": jb.Support(position=[1, 0, 0])},
        elements={
            name: jb.SpringDamper(*ends, free_length=1.0, spring=PUBLISHED)
            for name in ("one", "other")
        },
    )
    damped = jb.complex_modes(jb.linearize(model, model.reference))
    exact = np.roots([M_F, CM, KM])
    i = int(np.argmin(np.abs(np.asarray(damped.poles[:, 0]) - exact[exact.imag > 0][0])))
    np.testing.assert_allclose(damped.poles[i, 0], exact[exact.imag > 0][0], rtol=1e-10)
    assert (
        np.isfinite(damped.shapes).all()
        and abs(damped.shapes[0, i]) < 1e-9
        and "fluid" in damped.names[i]
    )


@pytest.mark.long
def test_derivatives_of_poles_in_both_modes():
    model = oscillator(LAWS["fluid_and_branches"])
    paths = [
        f"s.spring.terms.1.{name}"
        for name in (
            "stiffness",
            "upper_stiffness",
            "lower_stiffness",
            "fluid_mass",
            "fluid_damping",
        )
    ]
    x = jnp.array([2e4, 3e4, 5e3, 8.0, 200.0])
    displaced = jb.State(jnp.array([5e-3]), jnp.zeros(1))  # beyond the gap

    @jax.jit
    def of(x):
        damped = jb.complex_modes(
            jb.linearize(jb.replace(model, dict(zip(paths, x, strict=True))), displaced)
        )
        return jnp.sum(damped.decay_rate + damped.frequency) + 1e-2 * damped.relaxations[0]

    forward, reverse = jax.jacfwd(of)(x), jax.grad(of)(x)
    np.testing.assert_allclose(reverse, forward, rtol=1e-9)
    differences = [
        (of(x.at[i].add(h)) - of(x.at[i].add(-h))) / (2 * h) for i, h in enumerate(1e-4 * x)
    ]
    np.testing.assert_allclose(forward, differences, rtol=1e-6)
    batch = jax.vmap(of)(jnp.stack([x, 1.1 * x]))
    np.testing.assert_allclose(batch, [of(x), of(1.1 * x)], rtol=1e-10)


@pytest.mark.long
def test_measured_modes_see_the_fluid():
    """The shape of the mode of the fluid at a sensor, with branches that follow."""
    model = oscillator(BRANCH + PUBLISHED)
    lin = jb.linearize(model, model.reference)
    modes = jb.modes(lin)
    test = jb.MeasuredModes(
        frequency=modes.frequency,
        shapes=np.asarray(modes.shapes)[:1].T,
        sensors={"x": OUTPUTS["x"]},
    )
    assert jb.fit(model, {"test": test}, free=["s.spring.terms.1.upper_stiffness"]).status == 0


@pytest.mark.long
def test_maxima_by_a_spectrum_have_the_fluid_and_branches_that_follow():
    """In slow motions a branch k, tau beside the mount is the damper k tau."""
    branch = jb.laws.Maxwell(stiffness=2e4, relaxation_time=0.01)
    ends = ("m", [0, 0, 0]), ("base", [0, 0, 0])
    followed = oscillator(PUBLISHED + branch)
    damped = jb.Model(
        bodies={"m": jb.Body(mass=MASS)},
        joints={"m": jb.Guide("world", axis="x")},
        supports={"base": jb.Support(position=[1, 0, 0])},
        elements={"s": jb.SpringDamper(*ends, free_length=1.0, spring=PUBLISHED, damper=200.0)},
    )
    outputs, shock = (
        {"a": jb.Acceleration("m", axis="x"), "tension": jb.sensors.LoadCell("s")},
        {"base": {"x": jb.shock.Eurocode8(2.5, ground="B")}},
    )
    one, other = (
        jb.shock.spectrum_response(jb.linearize(model, model.reference), shock, outputs)
        for model in (followed, damped)
    )
    assert one.damping_ratio.shape == (2,)
    np.testing.assert_allclose(one["a"], other["a"], rtol=1e-9)
    np.testing.assert_allclose(one["tension"], other["tension"], rtol=1e-9)
