"""Small motions of models whose elements have memory: rows of massless coordinates, poles,
responses, against closed forms."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import rigs

import jaxbody as jb
from jaxbody.lagrange import rayleigh
from jaxbody.mechanics.closed_loops import state_slopes
from jaxbody.model.element_states import apart, holding
from jaxbody.model.joints.frame_tables import frames_of
from jaxbody.numerics.eigenproblems import first_order

K0, K1, TAU, MASS = 2e4, 6e4, 0.01, 50.0
SOLID = jb.laws.Linear(K0) + jb.laws.Maxwell(stiffness=K1, relaxation_time=TAU)
FREQUENCIES = np.array([1.0, 5, 10, 20, 100])
W = 2 * np.pi * FREQUENCIES
STIFFNESS = np.array(  # REFERENCES2 1.1
    [
        20235.93905557 + 3755.08669623j,
        25389.80974122 + 17156.29725281j,
        36982.59198051 + 27028.63460210j,
        56736.40179565 + 29233.89968594j,
        78517.72861809 + 9313.38576808j,
    ]
)
INPUTS = {"force": jb.PointForce("m", direction="x"), "base": jb.BaseMotion("base", "x")}
OUTPUTS = {
    "x": jb.Position("m", axis="x"),
    "tension": jb.sensors.LoadCell("s"),
    "reaction": jb.sensors.Reaction("base", component=0),
}


def oscillator(spring, mass=MASS):
    element = jb.SpringDamper(("m", [0, 0, 0]), ("base", [0, 0, 0]), free_length=1.0, spring=spring)
    return jb.Model(
        bodies={"m": jb.Body(mass=mass)},
        joints={"m": jb.Guide("world", axis="x")},
        supports={"base": jb.Support(position=[1, 0, 0])},
        elements={"s": element},
    )


@pytest.fixture(scope="module")
def solid():
    model = oscillator(SOLID)
    return jb.linearize(model, jb.equilibrium(model))


class Coupled(jb.laws.Viscoelastic):
    """Two coordinates, in series and coupled to e' by the dissipation."""

    stiffness: jax.Array
    damping: jax.Array
    states = ("middle", "end")
    state_units = ("argument", "argument")

    def energy(self, e, y):
        return (
            0.5 * self.stiffness * ((e - y[0]) ** 2 + (y[0] - y[1]) ** 2 + 0.3 * y[1] ** 2)
            + 0.1 * self.stiffness * (e - y[0]) ** 4
        )

    def dissipation(self, e_dot, y_dot):
        return (
            0.5
            * self.damping
            * (y_dot[0] ** 2 + 0.5 * y_dot[1] ** 2 + 0.4 * e_dot * y_dot[0] + 0.3 * e_dot**2)
        )


LAWS = {
    "maxwell": SOLID,
    "prony": SOLID + jb.laws.Maxwell(stiffness=2e4, relaxation_time=0.1),
    "coupled": jb.laws.Linear(K0) + Coupled(jnp.array(3e4), jnp.array(200.0)),
    "bouc_wen": jb.laws.Linear(K0) + jb.laws.BoucWen(alpha=3e4, beta=100.0, gamma=0.6, delta=0.4),
    "dahl": jb.laws.Linear(K0) + jb.laws.Dahl(stiffness=3e4, level=50.0),
    "lugre": jb.laws.Linear(K0)
    + jb.laws.LuGre(stiffness=3e4, damping=100.0, viscosity=20.0, level=50.0, static_level=70.0),
    "all": SOLID
    + jb.laws.Dahl(stiffness=3e4, level=50.0)
    + Coupled(jnp.array(3e4), jnp.array(200.0)),
}


def heavy(law):
    """A beam on two struts with this law and an anti-roll bar, under gravity, on joints whose q
    are increments."""
    strut = {"free_length": 0.5, "spring": law, "damper": 30.0}
    return rigs.beam_with_tip(
        {
            "left": jb.SpringDamper(("beam", [-0.5, 0, 0]), ("base", [-0.6, 0, -0.5]), **strut),
            "right": jb.SpringDamper(("beam", [0.5, 0, 0]), ("base", [0.4, 0, -0.5]), **strut),
            "twist": jb.Torsion(
                "beam",
                "tip",
                axis="y",
                spring=jb.laws.Linear(300.0)
                + jb.laws.Maxwell(stiffness=200.0, relaxation_time=0.05),
            ),
        }
    )


@pytest.mark.long
@pytest.mark.parametrize("name", LAWS)
def test_linearization_against_the_slopes_of_the_equations_of_motion(name):
    """A of x' = A x, hysteretic states eliminated by their tangent, z = df/de' Delta."""
    model = heavy(LAWS[name])
    eq = jb.equilibrium(model)
    assert int(eq.status) == 0
    lin, layout = jb.linearize(model, eq), model.layout
    nv, inner = layout.nv, layout.massless
    A = np.asarray(state_slopes(model, eq.state))
    slow = np.setdiff1d(np.arange(layout.nz), inner) + 2 * nv
    keep = np.concatenate([np.arange(2 * nv), inner + 2 * nv])
    expected = A[np.ix_(keep, keep)].copy()
    expected[:, :nv] += A[np.ix_(keep, slow)] @ A[slow, nv : 2 * nv]
    found = first_order(lin.M, lin.C, lin.K, nv)[0]
    assert np.abs(found - expected).max() < 1e-10 * np.abs(expected).max()


@pytest.mark.long
def test_the_rows_are_the_second_derivatives_of_V_and_R():
    """Hessians of V in (Delta, y, Xi) and of R in their rates."""
    model = heavy(LAWS["coupled"])
    eq = jb.equilibrium(model)
    lin, layout = jb.linearize(model, eq), model.layout
    nv, ny = layout.nv, len(layout.massless)
    assert lin.coordinates[nv:] == layout.inner and lin.M.shape == (nv + ny, nv + ny)

    def V(x):
        state = jb.State(eq.state.q + x[:nv], eq.state.v, eq.state.z + x[nv : nv + ny])
        return jb.potential_energy(model, state, xi=x[nv + ny :].reshape(-1, 6))

    def R(rate):
        state = jb.State(eq.state.q, rate[:nv], eq.state.z)
        return rayleigh(
            apart(model, state.z, rate[nv : nv + ny]),
            frames_of(model, state, None, rate[nv + ny :].reshape(-1, 6)),
        )

    zero = jnp.zeros(nv + ny + layout.nxi)
    K, C, M = lin.whole
    for found, function in ((K, V), (C, R)):
        expected = jax.hessian(function)(zero)
        assert np.abs(found - expected).max() < 1e-12 * np.abs(expected).max()
    assert not np.asarray(M)[nv : nv + ny].any()


@pytest.mark.long
def test_modes_relaxed_and_instantaneous(solid):
    for stiffness, k in (("relaxed", K0), ("instantaneous", K0 + K1)):
        modes = jb.modes(solid, stiffness=stiffness)
        np.testing.assert_allclose(modes.frequency, [np.sqrt(k / MASS) / 2 / np.pi], rtol=1e-12)
    np.testing.assert_allclose(solid.condensed.C, [[K1 * TAU]], rtol=1e-12)
    np.testing.assert_allclose(jb.vibration.mode_energies(solid).strain["s"], [100.0], rtol=1e-12)
    with pytest.raises(jb.JaxbodyError):
        jb.modes(solid, stiffness="soft")


def test_poles_of_the_standard_linear_solid(solid):
    damped = jb.complex_modes(solid)
    np.testing.assert_allclose(damped.relaxations, [-86.883424586956], rtol=1e-10)
    np.testing.assert_allclose(damped.poles[0, 0], -6.558287706522 + 20.429779039925j, rtol=1e-10)
    assert "relaxation" in str(damped)


@pytest.mark.long
def test_an_overdamped_mode_keeps_its_two_poles():
    """Three real poles: the two of the damper and the fast one of a branch whose coordinate
    hardly follows."""
    model = jb.replace(
        oscillator(
            jb.laws.Linear(50.0) + jb.laws.Maxwell(stiffness=5.0, relaxation_time=1e-4), 1.0
        ),
        {},
    )
    element = jb.SpringDamper(
        ("m", [0, 0, 0]),
        ("base", [0, 0, 0]),
        free_length=1.0,
        spring=model["s"].spring,
        damper=40.0,
    )
    model = jb.Model(
        bodies={"m": jb.Body(mass=1.0)},
        joints={"m": jb.Guide("world", axis="x")},
        supports={"base": jb.Support(position=[1, 0, 0])},
        elements={"s": element},
    )
    damped = jb.complex_modes(jb.linearize(model, model.reference))
    roots = np.sort(np.roots([1e-4, 1 + 40e-4, 40 + 55e-4, 50.0]).real)[::-1]
    np.testing.assert_allclose(np.asarray(damped.poles[0]).real, roots[:2], rtol=1e-9)
    np.testing.assert_allclose(damped.relaxations, roots[2:], rtol=1e-9)


@pytest.mark.long
@pytest.mark.parametrize("method", ["direct", "modal"])
def test_responses_of_the_standard_linear_solid(solid, method):
    response = jb.frequency_response(solid, FREQUENCIES, INPUTS, OUTPUTS, method=method)
    K, D = STIFFNESS, STIFFNESS - MASS * W**2
    expected = {
        ("x", "force"): 1 / D,
        ("x", "base"): K / D,
        ("tension", "force"): -K / D,
        ("tension", "base"): K - K * K / D,
        ("reaction", "force"): K / D,
        ("reaction", "base"): K * K / D - K,
    }
    for pair, value in expected.items():
        # the table has ten digits
        np.testing.assert_allclose(response[pair], value, rtol=1e-9, err_msg=str(pair))
    with pytest.raises(jb.JaxbodyError) as caught:
        jb.frequency_response(solid, FREQUENCIES, INPUTS, OUTPUTS, loss_factor=0.1)
    assert caught.value.code == "MEMORY"


def test_state_space_has_the_same_response(solid):
    s = solid.state_space(INPUTS, {name: OUTPUTS[name] for name in ("x", "tension")})
    assert s.states == ("m move along its guide", "rate of m move along its guide", "s, branch")
    response = jb.frequency_response(
        solid, FREQUENCIES, INPUTS, {name: OUTPUTS[name] for name in ("x", "tension")}
    )
    for i, w in enumerate(W):
        H = s.C @ np.linalg.solve(1j * w * np.eye(len(s.A)) - s.A, s.B) + s.D
        np.testing.assert_allclose(H, response.values[..., i], rtol=1e-10, atol=1e-12)


COUPLED = [
    ("displacement", "coupled"),
    pytest.param("velocity", "coupled", marks=pytest.mark.long),
    ("acceleration", "prony"),
]


@pytest.mark.long
@pytest.mark.parametrize(("kind", "name"), COUPLED)
def test_state_space_of_coupled_dissipation(kind, name):
    """C between y and the base, and inputs given as rates."""
    model = heavy(LAWS[name])
    lin = jb.linearize(model, jb.equilibrium(model))
    inputs, outputs = (
        {"base": jb.BaseMotion("base", "z", kind=kind)},
        {"z": jb.Position("tip", axis="z")},
    )
    s, response = (
        lin.state_space(inputs, outputs),
        jb.frequency_response(lin, FREQUENCIES, inputs, outputs),
    )
    for i, w in enumerate(W):
        H = s.C @ np.linalg.solve(1j * w * np.eye(len(s.A)) - s.A, s.B) + s.D
        np.testing.assert_allclose(H, response.values[..., i], rtol=1e-8)


@pytest.mark.long
@pytest.mark.parametrize(
    ("N", "crossing", "height"),
    [(3, 1.264911064067, 5 / 3), (1, 1.154700538379, 3.0), (10, 1.354006400773, 1.2)],
)
def test_the_optimum_of_an_elastically_supported_damper(N, crossing, height):
    """Ruzicka's isolator: with the best damping the crossing of all curves is the maximum
    (REFERENCES2 1.2)."""
    zeta = N * np.sqrt(2 * (N + 2)) / (4 * (N + 1))
    k0, c = 1.0, 2 * zeta
    model = oscillator(
        jb.laws.Linear(k0) + jb.laws.Maxwell(stiffness=N * k0, relaxation_time=c / (N * k0)),
        mass=1.0,
    )
    lin = jb.linearize(model, model.reference)
    grid = np.linspace(0.2, 4, 401) / (2 * np.pi)
    response = jb.frequency_response(
        lin, np.append(grid, crossing / (2 * np.pi)), {"base": INPUTS["base"]}, {"x": OUTPUTS["x"]}
    )
    T = np.abs(response["x", "base"])
    np.testing.assert_allclose(T[-1], height, rtol=1e-9)
    assert T[:-1].max() <= height + 1e-9


def test_random_response_against_a_sum(solid):
    """The rms under white noise of the base's displacement from 1 to 40 Hz: the integral
    of |K/D|^2."""
    band = jb.vibration.Band(1.0, 40.0)
    found = jb.random_response(
        solid,
        band,
        {"base": INPUTS["base"]},
        {"x": OUTPUTS["x"]},
        {"base": jb.vibration.PowerLaw(1e-6, unit="m2/Hz")},
    )
    f = np.linspace(1, 40, 20001)
    w = 2 * np.pi * f
    K = K0 + K1 * 1j * w * TAU / (1 + 1j * w * TAU)
    exact = np.sqrt(np.trapezoid(1e-6 * np.abs(K / (K - MASS * w**2)) ** 2, f))
    np.testing.assert_allclose(found["x"], exact, rtol=1e-4)  # of the band's own grid


def test_small_motion_of_the_benchmark_of_hysteresis():
    law = jb.laws.Linear(5e4) + jb.laws.BoucWen(alpha=5e4, beta=1e3, gamma=0.8, delta=-1.1)
    element = jb.SpringDamper(
        ("m", [0, 0, 0]), ("world", [1, 0, 0]), free_length=1.0, spring=law, damper=10.0
    )
    model = jb.Model(
        bodies={"m": jb.Body(mass=2.0)},
        joints={"m": jb.Guide("world", axis="x")},
        elements={"s": element},
    )
    modes = jb.modes(jb.linearize(model, jb.equilibrium(model)))
    np.testing.assert_allclose(modes.frequency, [35.588127170859], rtol=1e-12)
    np.testing.assert_allclose(modes.damping_ratio, [0.011180339887], rtol=1e-10)
    with pytest.raises(jb.JaxbodyError) as caught:
        jb.excitation(model, model.reference, {})
    assert caught.value.code == "MEMORY"


def first_pole(model):
    damped = jb.complex_modes(jb.linearize(model, jb.equilibrium(model)))
    return damped.decay_rate[0] + damped.frequency[0] + 1e-2 * damped.relaxations[0]


@pytest.mark.long
def test_derivatives_of_poles_in_both_modes():
    model, paths = (
        heavy(LAWS["prony"]),
        [
            "left.spring.terms.1.stiffness",
            "right.spring.terms.2.relaxation_time",
            "twist.spring.terms.1.stiffness",
        ],
    )
    x = jnp.array([K1, 0.1, 200.0])

    def of(x):
        return first_pole(jb.replace(model, dict(zip(paths, x, strict=True))))

    forward, reverse = jax.jacfwd(of)(x), jax.grad(of)(x)
    np.testing.assert_allclose(reverse, forward, rtol=1e-9)
    steps = 1e-4 * x
    differences = [
        (of(x.at[i].add(s)) - of(x.at[i].add(-s))) / (2 * s) for i, s in enumerate(steps)
    ]
    np.testing.assert_allclose(forward, differences, rtol=1e-6)
    batch = jax.vmap(of)(jnp.stack([x, 1.1 * x]))
    np.testing.assert_allclose(batch, [of(x), of(1.1 * x)], rtol=1e-10)


def test_what_does_not_take_states_yet_says_so(solid):
    model = solid.model
    for call in (
        lambda: jb.vibration.backbone_curves(solid),
        lambda: jb.vibration.linearize_spin(model, model.reference),
    ):
        with pytest.raises(jb.JaxbodyError) as caught:
            call()
        assert caught.value.code == "MEMORY"
    assert holding(model, model.reference.z).layout == model.layout


@pytest.mark.parametrize("free", [False, True])
def test_a_body_that_hysteresis_alone_holds_is_not_free_to_move(free):
    """Its tangent alpha resists; f = sqrt(alpha/m)/(2 pi). A body beside it that nothing holds is
    named alone."""
    law = jb.laws.BoucWen(alpha=5e4, beta=1e3, gamma=0.8, delta=-1.1)
    elements = {
        "grip": jb.SpringDamper(
            ("held", [0, 0, 0]), ("world", [0, 0, -1.0]), spring=law, free_length=1.0
        )
    }
    elements["loose"] = jb.Spring(
        ("other", [0, 0, 0]),
        ("world", [2.0, 0, -1.0]),
        stiffness=0.0 if free else 1e4,
        free_length=1.0,
    )
    model = jb.Model(
        bodies={"held": jb.Body(2.0), "other": jb.Body(1.0, position=[2.0, 0, 0])},
        joints={name: jb.Guide("world", axis="z") for name in ("held", "other")},
        elements=elements,
    )
    if free:
        with pytest.warns(
            jb.JaxbodyWarning, match=r"SINGULAR_K.*; 'other' free to move along its guide \["
        ) as said:
            jb.equilibrium(model)
        assert "'held'" not in str(said[0].message)
        return
    eq = jb.equilibrium(model)
    assert eq.ok and eq.stable
    np.testing.assert_allclose(
        jb.modes(jb.linearize(model, eq)).frequency[1], np.sqrt(5e4 / 2.0) / (2 * np.pi), rtol=1e-12
    )


def test_hysteretic_states_stay_in_derivatives_by_parameters():
    """The tension in K of a state does not follow a change of the free length by its z, as a
    displacement takes it along."""
    law = jb.laws.Linear(400.0) + jb.laws.BoucWen(alpha=900.0, beta=20.0, gamma=0.8, delta=-0.3)
    model = jb.Model(
        bodies={"ball": jb.Body(2.0, [1, 1, 1])},
        joints={"ball": jb.Translation("world")},
        elements={
            "s": jb.SpringDamper(
                ("ball", [0, 0, 0]), ("world", [0, 0, 1]), spring=law, free_length=0.8
            )
        },
    )
    state = jb.State(model.reference.q, model.reference.v, jnp.array([3.0]))

    @jb.jit
    def K(length):
        return jb.linearize(jb.replace(model, {"s.free_length": length}), state).K

    slope, h = jax.jacfwd(K)(jnp.array(0.8)), 1e-6
    np.testing.assert_allclose(
        slope, (K(0.8 + h) - K(0.8 - h)) / (2 * h), atol=1e-6 * float(jnp.abs(slope).max())
    )
    # d(F/L)/d l0, by the elastic part alone
    np.testing.assert_allclose(slope[0, 0], -400.0 / 1.0, rtol=1e-12)
