"""Inerters: natural frequencies, isolators, conservation, small motions and derivatives against
closed forms and other routes."""

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import rigs
import scipy.integrate

import jaxbody as jb
from jaxbody.mechanics.closed_loops import dynamics_of, state_slopes
from jaxbody.mechanics.dynamics import FreeBodies
from jaxbody.numerics.eigenproblems import first_order

M, K, C, B = 100.0, 1e4, 50.0, 20.0  # the isolator of REFERENCES2 3.5
HERTZ = 2 * np.pi


def isolator(b=B, c=C, between=(("m", [0, 0, 0]), ("base", [0, 0, 0]))):
    return jb.Model(
        bodies={"m": jb.Body(mass=M)},
        joints={"m": jb.Guide("world", axis="z")},
        supports={"base": jb.Support(position=[0, 0, -1])},
        elements={
            "spring": jb.Spring(*between, stiffness=K, damping=c, free_length=1.0),
            "inerter": jb.Inerter(*between, inertance=b),
        },
    )


def at_rest(model):
    return jb.linearize(model, jb.equilibrium(model))


def transmissibility(f, b=B, c=C):
    w = HERTZ * np.asarray(f)
    return (K - b * w**2 + 1j * c * w) / (K - (M + b) * w**2 + 1j * c * w)


def responses(model, f, **outputs):
    found = jb.frequency_response(at_rest(model), f, {"base": jb.BaseMotion("base", "z")}, outputs)
    return dict(zip(outputs, np.asarray(found.values)[:, 0], strict=True))


def test_an_isolator_with_an_inerter():
    lin = at_rest(isolator())
    np.testing.assert_allclose(jb.modes(lin).frequency, [1.452879208], rtol=1e-9)
    np.testing.assert_allclose(lin.M, [[M + B]], rtol=1e-14)
    np.testing.assert_allclose(lin.M_tilde, [[0, 0, B, 0, 0, 0]], atol=1e-12)
    np.testing.assert_allclose(lin.M_bb, np.diag([0, 0, B, 0, 0, 0]), atol=1e-12)
    f = np.array([1.0, 2, 5, 10])
    found = responses(
        isolator(),
        f,
        x=jb.Position("m", axis="z"),
        force=jb.sensors.LoadCell("inerter"),
        base=jb.sensors.Reaction("base", component=2),
    )
    np.testing.assert_allclose(
        np.abs(found["x"]), [1.74807666047, 0.76580144294, 0.09096704238, 0.14884768905], rtol=1e-10
    )
    exact, w = transmissibility(f), HERTZ * f
    np.testing.assert_allclose(found["x"], exact, rtol=1e-12)
    np.testing.assert_allclose(found["force"], -B * w**2 * (exact - 1), rtol=1e-12)
    np.testing.assert_allclose(found["base"], M * w**2 * exact, rtol=1e-10)
    antiresonance = np.sqrt(K / B) / HERTZ
    np.testing.assert_allclose(antiresonance, 3.558812717, rtol=1e-9)
    free = responses(isolator(c=0.0), np.array([antiresonance, 1e4]), x=jb.Position("m", axis="z"))[
        "x"
    ]
    assert abs(free[0]) < 1e-13
    # b/(m + b); what is left is (w_0/w)^2
    np.testing.assert_allclose(abs(free[1]), 1 / 6, rtol=1e-6)


def quarter_car(k, c, b):
    def up(one, other, **spring):
        return jb.Spring((one, [0, 0, 0]), (other, [0, 0, 0]), free_length=0.5, **spring)

    return jb.Model(
        bodies={
            "wheel": jb.Body(mass=35.0, position=[0, 0, 0.5]),
            "car": jb.Body(mass=250.0, position=[0, 0, 1.0]),
        },
        joints={"wheel": jb.Guide("world", axis="z"), "car": jb.Guide("world", axis="z")},
        supports={"road": jb.Support()},
        elements={
            "tyre": up("wheel", "road", stiffness=150e3),
            "strut": up("car", "wheel", stiffness=k, damping=c),
            "inerter": jb.Inerter(("car", [0, 0, 0]), ("wheel", [0, 0, 0]), inertance=b),
        },
    )


CARS = [
    (20000, 1500, 0, 1.090091909, 0.006846942, 432.063113, (1.3358563236, 11.1029175178)),
    (20000, 1500, 20, 1.146764334, 0.006846942, 512.371418, (1.2960171429, 8.9054572040)),
    (60000, 3000, 30, 1.687416713, 0.004841519, 529.718358, (2.0116270573, 9.0821986757)),
]


@pytest.mark.long
@pytest.mark.parametrize(("k", "c", "b", "acceleration", "deflection", "force", "undamped"), CARS)
def test_quarter_cars_of_smith_and_wang(k, c, b, acceleration, deflection, force, undamped):
    """REFERENCES2 3.5: root mean squares on a road of white velocity, by the modes of the library's
    state space."""
    lin = at_rest(quarter_car(float(k), float(c), float(b)))
    np.testing.assert_allclose(jb.modes(lin).frequency, undamped, rtol=1e-9)
    outputs = {"deflection": jb.Elongation("strut"), "tyre": jb.sensors.LoadCell("tyre")}
    system = lin.state_space({"road": jb.BaseMotion("road", "z", kind="velocity")}, outputs)
    A, b_in, out = np.asarray(system.A), np.asarray(system.B), np.asarray(system.C)
    W = HERTZ**2 * 5e-7 * 25
    # the displacement of the road is a state that no output sees
    stable, vectors = np.linalg.eig(A)
    seen = np.abs(stable) > 1e-6
    G, H = np.linalg.inv(vectors)[seen] @ b_in, out @ vectors[:, seen]
    P = -W / 2 * (G @ G.conj().T) / (stable[seen][:, None] + stable[seen].conj()[None])
    spread = np.sqrt(np.real(np.diag(H @ (2 * P) @ H.conj().T)))
    np.testing.assert_allclose(spread, [deflection, force], rtol=2e-7)
    f = np.array([0.5, 2.0, 9.0])
    s, ms, mu, kt = 2j * np.pi * f, 250.0, 35.0, 150e3
    below = [ms * mu + b * (ms + mu), c * (ms + mu), k * (ms + mu) + kt * (ms + b), kt * c, k * kt]
    road = {"road": jb.BaseMotion("road", "z", kind="velocity")}
    found = jb.frequency_response(lin, f, road, {"a": jb.Acceleration("car", axis="z")}).values[
        0, 0
    ]
    np.testing.assert_allclose(
        found, kt * s * (b * s**2 + c * s + k) / np.polyval(below, s), rtol=1e-10
    )


@pytest.mark.long
def test_two_masses_move_against_each_other():
    """The relative motion has the mass m1 m2/(m1 + m2) + b; the shares of the inerter and of the
    masses in its energy."""
    m1, m2, b, k = 3.0, 5.0, 2.0, 800.0
    places = ("one", [0, 0, 0]), ("two", [0, 0, 0])
    model = jb.Model(
        bodies={"one": jb.Body(mass=m1), "two": jb.Body(mass=m2, position=[1, 0, 0])},
        joints={"one": jb.Guide("world", axis="x"), "two": jb.Guide("world", axis="x")},
        elements={
            "spring": jb.Spring(*places, stiffness=k, free_length=1.0),
            "inerter": jb.Inerter(*places, inertance=b),
            "weak": jb.Spring(
                ("one", [0, 0, 0]), ("world", [-1, 0, 0]), stiffness=1e-9 * k, free_length=1.0
            ),
        },
    )
    lin = at_rest(model)
    reduced = m1 * m2 / (m1 + m2)
    np.testing.assert_allclose(
        jb.modes(lin).frequency[1] * HERTZ, np.sqrt(k / (reduced + b)), rtol=1e-8
    )
    energies = jb.vibration.mode_energies(lin)
    np.testing.assert_allclose(energies.inertia["inerter"][1], 100 * b / (reduced + b), rtol=1e-8)
    np.testing.assert_allclose(
        energies.kinetic_shares.sum((0, 1)) + energies.inertia_shares.sum(0), 100.0, rtol=1e-12
    )
    assert energies.names[1] == "one against two along x 63, 37 %"
    assert "inerter" in str(energies) and energies.to_xarray()["inertia"].shape == (1, 2)


def swinging():
    """Two free bodies on springs and two inerters under gravity, far from rest."""
    return jb.Model(
        bodies={
            "plate": jb.Body(mass=2.0, inertia=[0.2, 0.3, 0.4], com=[0.05, 0, 0.02]),
            "rotor": jb.Body(mass=1.0, inertia=[0.05, 0.06, 0.08], position=[0, 0, -1]),
        },
        elements={
            "up": jb.Spring(
                ("plate", [0.2, 0, 0]), ("world", [0, 0, 1]), stiffness=60.0, free_length=0.5
            ),
            "down": jb.Spring(
                ("plate", [0, 0.1, 0]), ("rotor", [0.1, 0, 0]), stiffness=40.0, free_length=0.7
            ),
            "upper": jb.Inerter(("plate", [-0.2, 0.1, 0]), ("world", [0.3, 0, 1.5]), inertance=1.5),
            "lower": jb.Inerter(("plate", [0, -0.3, 0]), ("rotor", [0, 0.2, 0]), inertance=0.8),
        },
        gravity=[0, 0, -9.81],
    )


def start(model):
    return jb.State(model.reference.q, jnp.array([0.5, 0.3, 0, 3, -2, 4, 0, 1, 0.5, -3, 5, 2.0]))


@pytest.mark.long
def test_free_motion_with_large_rotations_keeps_its_energy():
    model, rtol = swinging(), 1e-9
    run = jb.simulate(model, jnp.linspace(0, 2, 21), initial=start(model), rtol=rtol)
    energies = run.energies
    np.testing.assert_allclose(
        energies["total"], energies["total"][0], atol=100 * rtol * float(energies["kinetic"].max())
    )
    turned = jnp.arccos(jnp.clip(jnp.abs(run.state.q[:, 3]), 0, 1))
    assert float(2 * turned.max()) > 2.0
    steps = jnp.linspace(0, 1, 401)
    gauss = jb.simulate(
        model,
        steps,
        initial=start(model),
        solver=jb.Gauss(3),
        stepsize_controller=diffrax.ConstantStepSize(),
        dt0=1 / 400,
    )
    np.testing.assert_allclose(gauss.state.q[200], run.state.q[5], atol=1e-7)
    np.testing.assert_allclose(gauss.state.v[-1], run.state.v[10], atol=1e-6)


@pytest.mark.long
def test_what_supports_supply_is_stored_or_lost():
    """Power of the supports = rate of the energies + damping, in the mean over a motion; the load
    cell reads b times the acceleration."""
    rtol = 1e-10
    motion = {
        "base": jb.Harmonic(frequency=2.0, translation=[0, 0, 0.02], translation_phase=[0, 0, 0.4])
    }
    times = jnp.linspace(0, 1, 2001)
    run = jb.simulate(isolator(), times, motion=motion, rtol=rtol)
    powers, total = run.powers, run.energies["total"]
    work = scipy.integrate.simpson(
        np.asarray(powers["supports"] - powers["damping"]), dx=float(times[1])
    )
    np.testing.assert_allclose(work, total[-1] - total[0], atol=1e-9 * float(np.abs(total).max()))
    sensors = {
        "cell": jb.sensors.LoadCell("inerter"),
        "a": jb.Acceleration("m", axis="z"),
        "base": jb.sensors.Reaction("base", component=2),
    }
    read = jb.measure(run, sensors)
    base = jax.vmap(jax.grad(jax.grad(lambda t: run.motions[0](t)[2])))(times)
    np.testing.assert_allclose(
        read["cell"], B * (read["a"] - base), atol=1e-9 * B * float(jnp.abs(base).max())
    )
    np.testing.assert_allclose(run.forces["inerter"], read["cell"], rtol=1e-12)
    np.testing.assert_allclose(
        read["base"], -M * read["a"], atol=1e-9 * M * float(jnp.abs(read["a"]).max())
    )


def beam():
    """On joints whose q are increments, tilted, under gravity."""
    return rigs.beam_with_tip(
        {
            "left": jb.Spring(
                ("beam", [-0.5, 0, 0]),
                ("base", [-0.6, 0, -0.5]),
                stiffness=2e4,
                free_length=0.5,
                damping=30.0,
            ),
            "right": jb.Spring(
                ("beam", [0.5, 0, 0]),
                ("base", [0.4, 0, -0.5]),
                stiffness=2e4,
                free_length=0.5,
                damping=30.0,
            ),
            "tip spring": jb.Torsion("tip", "beam", axis="y", spring=300.0, damper=1.0),
            "slant": jb.Inerter(("tip", [0.2, 0, 0]), ("base", [0.3, 0, -0.7]), inertance=12.0),
            "inner": jb.Inerter(("tip", [0.3, 0, 0.1]), ("beam", [0, 0, 0.3]), inertance=4.0),
        }
    )


@pytest.mark.long
def test_small_motions_are_the_slopes_of_the_equations_of_motion():
    model = beam()
    eq = jb.equilibrium(model)
    lin = jb.linearize(model, eq)
    A = state_slopes(model, eq.state)
    found = first_order(lin.M, lin.C, lin.K, model.layout.nv)[0]
    assert np.abs(found - A).max() < 1e-10 * np.abs(A).max()
    without = jb.Model(
        bodies={name: model[name] for name in model.layout.bodies},
        supports={"base": model["base"]},
        joints={name: model.joint(name) for name in model.layout.bodies},
        elements={name: model[name] for name in ("left", "right", "tip spring")},
        gravity=model.gravity,
    )
    # no force at rest
    np.testing.assert_allclose(eq.state.q, jb.equilibrium(without).state.q, atol=1e-12)
    np.testing.assert_allclose([eq.forces["slant"], eq.forces["inner"]], 0.0, atol=1e-12)


@pytest.mark.long
def test_a_backbone_bends_by_the_inertia_of_an_inerter_across_the_motion():
    """L = m (1 + eps x^2) x'^2/2 - k x^2/2 has the frequency w (1 - eps a^2/4): eps = b/(m h^2), h
    the length of the inerter at rest."""
    h = 0.5
    model = isolator(between=(("m", [0, 0, 0]), ("base", [0, 0, 0])), c=0.0)
    model = jb.Model(
        bodies={"m": model["m"]},
        joints={"m": model.joint("m")},
        supports={"base": model["base"]},
        elements={
            "spring": model["spring"],
            "inerter": jb.Inerter(("m", [0, 0, 0]), ("world", [h, 0, 0]), inertance=B),
        },
    )
    curves = jb.vibration.backbone_curves(at_rest(model))
    np.testing.assert_allclose(curves.curvature, [-B / (4 * M * h**2)], rtol=1e-10)


@pytest.mark.long
def test_an_inerter_along_the_axis_of_a_rotor():
    """It adds to the mass along the axis and leaves the spin steady."""
    places = ("disk", [0, 0, 0]), ("world", [0, 0, -1])
    model = jb.Model(
        bodies={"disk": jb.Body(mass=2.0, inertia=[0.1, 0.1, 0.2])},
        elements={
            "spring": jb.Spring(*places, stiffness=500.0, free_length=1.0),
            "inerter": jb.Inerter(*places, inertance=3.0),
        },
    )
    lin = jb.vibration.linearize_spin(
        model, jb.State(model.reference.q, jnp.array([0, 0, 0, 0, 0, 30.0]))
    )
    assert int(lin.status) == 0
    np.testing.assert_allclose(lin.M, np.diag([2, 2, 5, 0.1, 0.1, 0.2]), atol=1e-12)
    np.testing.assert_allclose(lin.G[3, 4], 6.0, rtol=1e-10)


def at_the_end(x):
    model = jb.replace(
        swinging(), {"upper.inertance": x[0], "lower.inertance": x[1], "upper.a": x[2:5]}
    )
    return jb.simulate(model, jnp.linspace(0, 0.3, 4), initial=start(model), rtol=1e-11).state.v[-1]


@pytest.mark.long
def test_derivatives_of_motions_and_frequencies():
    x = jnp.array([1.5, 0.8, -0.2, 0.1, 0.0])
    weights = jnp.linspace(1, 2, 12)

    def motion(x):
        return jnp.sum(weights * at_the_end(x))

    def frequency(x):
        model = jb.replace(
            beam(), {"slant.inertance": x[0], "inner.inertance": x[1], "inner.a": x[2:5]}
        )
        return jb.modes(jb.linearize(model, jb.equilibrium(model))).frequency[1]

    for function in (motion, frequency):
        reverse, forward = jax.grad(function)(x), jax.jacfwd(function)(x)
        np.testing.assert_allclose(
            forward, reverse, rtol=1e-9, atol=1e-9 * float(jnp.abs(reverse).max())
        )
        h = 1e-4
        around = np.array(
            [[float(function(x + s * h * e)) for s in (-2, -1, 1, 2)] for e in jnp.eye(5)]
        )
        steps = around @ np.array([1, -8, 8, -1]) / (12 * h)
        np.testing.assert_allclose(
            reverse, steps, rtol=1e-6, atol=1e-6 * float(jnp.abs(reverse).max())
        )


@pytest.mark.long
def test_a_batch_is_a_loop():
    model = beam()
    inertances = jnp.array([0.0, 3.0, 12.0])

    def frequencies(b):
        changed = jb.replace(model, {"slant.inertance": b})
        return jb.modes(jb.linearize(changed, jb.equilibrium(changed))).frequency

    np.testing.assert_allclose(
        jax.vmap(frequencies)(inertances),
        jnp.stack([frequencies(b) for b in inertances]),
        rtol=1e-10,
    )


def test_without_inerters_free_bodies_keep_their_constant_mass():
    model = swinging()
    plain = jb.Model(
        bodies={name: model[name] for name in model.layout.bodies},
        elements={name: model[name] for name in ("up", "down")},
        gravity=model.gravity,
    )
    assert isinstance(dynamics_of(plain, ()), FreeBodies) and not isinstance(
        dynamics_of(model, ()), FreeBodies
    )


@pytest.mark.parametrize(
    ("make", "code"),
    [
        (lambda: jb.Inerter(("a", [0, 0, 0]), ("b", [0, 0, 0]), inertance=-1.0), "NEGATIVE"),
        (lambda: jb.Inerter(("a", [0, 0, 0]), ("a", [0, 0, 1]), inertance=1.0), "SELF_SPRING"),
        (lambda: isolator(between=(("m", [0, 0, 0]), ("base", [0, 0, 1]))), "ZERO_LENGTH"),
        (lambda: jb.vibration.dynamic_stiffness(isolator()["inerter"], [1.0]), "WRONG_KIND"),
    ],
)
def test_bad_inerters(make, code):
    with pytest.raises(jb.JaxbodyError, match=code):
        make()
