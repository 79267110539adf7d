"""Closed forms of forces without a potential: flutter and divergence of a section, Ziegler's
pendulum, whirl, a levitated mass. Numbers: REFERENCES3.md, section 9."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import brentq

import jaxbody as jb
from jaxbody.geometry.frames import Frame
from jaxbody.model.forces.force_elements import ForceInputs

# Flutter of a section: 20 h'' + 2 a'' + 8000 h = -Q a, 2 h'' + 2.5 a'' + 3000 a = Q e a


def section(Q, mass=20.0, torsion=3000.0, damper=0.0):
    """A section that plunges by h, downwards, and turns by a, nose up; its static moment behind the
    axis is 2 kg m, its inertia about the axis 2.5 kg m2."""
    return jb.Model(
        bodies={
            "axis": jb.Body(mass=mass - 10.0, inertia=[1, 1, 1]),
            "wing": jb.Body(mass=10.0, com=[-0.2, 0, 0], inertia=[1, 2.5 - 10.0 * 0.04, 2]),
        },
        joints={
            "axis": jb.Guide("world", axis=[0, 0, 1]),
            "wing": jb.Hinge("axis", axis=[0, -1, 0]),
        },
        elements={
            "plunge": jb.SpringDamper(
                ("axis", [0, 0, 0]), ("world", [0, 0, -1]), spring=8000.0, free_length=1.0,
                damper=damper,
            ),
            "pitch": jb.Torsion("wing", "axis", spring=torsion, axis=[0, -1, 0]),
            "air": jb.forces.SectionAirloads(
                ("wing", [0.1, 0, 0]), chord="x", flow=[-1, 0, 0], lift="z", pressure=Q, area=1.0,
                slope=1.0,
            ),
        },
    )  # fmt: skip


FLUTTER, DIVERGENCE = 4762.33108242224, 30000.0


def poles_at(model):
    lin = jb.linearize(model, model.reference)
    return jb.complex_modes(lin)


@pytest.mark.parametrize(
    ("Q", "hertz"),
    [(0.0, (3.12451513087, 5.85577439261)), (3000.0, (3.42125786368, 5.07343866518))],
)
def test_frequencies_of_the_section(Q, hertz):
    np.testing.assert_allclose(poles_at(section(Q)).frequency, hertz, rtol=1e-11)


def test_equilibrium_tells_flutter_from_divergence():
    stable, flutter, divergence = (
        jb.jit(jb.equilibrium)(section(Q))
        for Q in (0.999 * FLUTTER, 1.001 * FLUTTER, 1.001 * DIVERGENCE)
    )
    assert stable.stable and not flutter.stable and not divergence.stable
    assert flutter.growing.tolist() == [2, 0] and "flutter" in flutter.report()
    assert divergence.growing[1] == 1 and "divergence" in divergence.report()
    with pytest.warns(jb.JaxbodyWarning, match="flutter in mode"):
        poles_at(section(1.001 * FLUTTER))


def root_of(function, guess, width):
    """The root of a function between guess - width and guess + width."""
    compiled = jb.jit(function)
    return brentq(
        lambda x: float(compiled(x)), guess - width, guess + width, xtol=1e-12, rtol=1e-14
    )


def discriminant(Q, mass=20.0, torsion=3000.0):
    """Twice the difference of the two w^2, squared: zero where the frequencies meet."""
    lin = jb.linearize(model := section(Q, mass, torsion), model.reference)
    A = jnp.linalg.solve(lin.M, lin.K)
    return jnp.trace(A) ** 2 - 4 * jnp.linalg.det(A)


def test_flutter_is_where_the_frequencies_meet():
    found = root_of(discriminant, 4760.0, 50.0)
    np.testing.assert_allclose(found, FLUTTER, rtol=1e-9)
    lin = jb.linearize(model := section(FLUTTER), model.reference)
    w = jnp.sqrt(jnp.trace(jnp.linalg.solve(lin.M, lin.K)) / 2)
    np.testing.assert_allclose(w, 25.7392180192505, rtol=1e-9)
    slope = jax.grad(discriminant, (0, 1, 2))(FLUTTER, 20.0, 3000.0)
    np.testing.assert_allclose(-slope[1] / slope[0], 310.656768569, rtol=1e-6)
    np.testing.assert_allclose(-slope[2] / slope[0], 2.83787217122, rtol=1e-6)


@pytest.mark.nan  # infinite derivatives where poles coincide
def test_damped_flutter_is_where_a_real_part_is_zero():
    """With a damper of the plunge, against the Routh determinant of the polynomial of fourth order,
    and its derivative by the root."""
    c, e = 30.0, 0.1

    def routh(Q):
        # det [20 s2 + c s + 8000, 2 s2 + Q; 2 s2, 2.5 s2 + 3000 - Q e]
        a4, a3 = 20 * 2.5 - 4, 2.5 * c
        a2, a1, a0 = (
            20 * (3000 - Q * e) + 8000 * 2.5 - 2 * Q,
            c * (3000 - Q * e),
            8000 * (3000 - Q * e),
        )
        return a1 * (a2 * a3 - a1 * a4) - a0 * a3**2

    expected = float(root_of(routh, 4000.0, 3000.0))

    def growth(Q, torsion=3000.0):
        return jnp.min(poles_at(section(Q, torsion=torsion, damper=c)).decay_rate)

    found = root_of(growth, expected, 30.0)
    np.testing.assert_allclose(found, expected, rtol=1e-9)
    by_Q, by_torsion = jax.grad(growth, (0, 1))(found, 3000.0)
    h = 1.0
    sides = [float(root_of(lambda Q, k=k: growth(Q, 3000.0 + k), expected, 30.0)) for k in (-h, h)]
    np.testing.assert_allclose(-by_torsion / by_Q, (sides[1] - sides[0]) / (2 * h), rtol=1e-5)


def test_divergence_is_where_the_stiffness_is_zero():
    def stiffness(Q):
        return jnp.linalg.det(jb.linearize(model := section(Q), model.reference).K)

    np.testing.assert_allclose(root_of(stiffness, DIVERGENCE, 3000.0), DIVERGENCE, rtol=1e-12)


def test_track_modes_follows_the_section_into_flutter():
    still = section(0.0)

    def at(Q):
        model = jb.replace(still, {"air.pressure": Q})
        return jb.linearize(model, model.reference)

    branches = jb.vibration.track_modes(at, np.linspace(0.0, 4700.0, 30))
    hertz = np.asarray(branches.frequency)
    np.testing.assert_allclose(hertz[0], (3.12451513087, 5.85577439261), rtol=1e-10)
    assert hertz[-1, 1] - hertz[-1, 0] < 0.5 and (np.diff(hertz[:, 0]) > 0).all()


# Ziegler's double pendulum: masses 2 m at l and m at 2 l, a follower force along the second link


def ziegler(P, damping=0.0, m=1.5, length=0.8, k=40.0):
    rod = {"inertia": [1e-30, 1e-30, 1e-30]}
    links = {
        "first": jb.Body(mass=2 * m, com=[length, 0, 0], **rod),
        "second": jb.Body(mass=m, com=[length, 0, 0], position=[length, 0, 0], **rod),
    }
    return jb.Model(
        bodies=links,
        joints={
            "first": jb.Hinge("world", axis=[0, 0, 1]),
            "second": jb.Hinge("first", axis=[0, 0, 1]),
        },
        elements={
            "one": jb.Torsion("first", "world", spring=k, damper=damping, axis=[0, 0, 1]),
            "two": jb.Torsion("second", "first", spring=k, damper=damping, axis=[0, 0, 1]),
            "push": jb.Force(("second", [length, 0, 0]), force=[-P, 0, 0], axes="body"),
        },
    )


def test_zieglers_pendulum_flutters():
    m, length, k, c = 1.5, 0.8, 40.0, 0.7
    undamped = (3.5 - np.sqrt(2)) * k / length
    damped = 41 / 28 * k / length + c**2 / (2 * m * length**3)

    def meeting(P):
        lin = jb.linearize(model := ziegler(P), model.reference)
        A = jnp.linalg.solve(lin.M, lin.K)
        return jnp.trace(A) ** 2 - 4 * jnp.linalg.det(A)

    np.testing.assert_allclose(root_of(meeting, undamped, 20.0), undamped, rtol=1e-6)

    def growth(P):
        return jnp.min(poles_at(ziegler(P, c)).decay_rate)

    np.testing.assert_allclose(root_of(growth, damped, 10.0), damped, rtol=1e-6)
    eq = jb.equilibrium
    assert jb.jit(eq)(ziegler(0.999 * damped, c)).stable
    assert jb.jit(eq)(ziegler(1.001 * damped, c)).growing.tolist() == [2, 0]


# Whirl


def shaft(m=4.0, k=900.0, c=6.0, **whirl):
    springs = {"stiffness": np.diag([k, k, k, 1, 1, 1]), "damping": np.diag([c, c, c, 0, 0, 0])}
    return jb.Model(
        bodies={"rotor": jb.Body(mass=m, inertia=[1, 1, 1])},
        joints={"rotor": jb.Translation("world")},
        elements={
            "shaft": jb.Bushing(("rotor", [0, 0, 0]), ("world", [0, 0, 0]), **springs),
            "seal": jb.forces.WhirlForce("rotor", "world", axis="z", **whirl),
        },
    )


def test_cross_coupled_stiffness_whirls_the_shaft():
    m, k, c = 4.0, 900.0, 6.0
    limit = c * np.sqrt(k / m)

    def growth(q):
        return jnp.min(poles_at(shaft(cross_stiffness=q)).decay_rate)

    np.testing.assert_allclose(root_of(growth, limit, 5.0), limit, rtol=1e-12)
    unstable = jb.jit(jb.equilibrium)(shaft(cross_stiffness=1.01 * limit))
    assert unstable.growing.tolist() == [2, 0]
    modes = jb.jit(lambda q: poles_at(shaft(cross_stiffness=q)))(limit)
    np.testing.assert_allclose(
        np.asarray(modes.frequency)[np.argmin(modes.decay_rate)],
        np.sqrt(k / m) / (2 * np.pi),
        rtol=1e-12,
    )


def test_internal_damping_whirls_the_shaft():
    k, m, ce, ci = 900.0, 4.0, 6.0, 2.5
    limit = np.sqrt(k / m) * (1 + ce / ci)

    def growth(W):
        return jnp.min(poles_at(shaft(damping=ci, cross_stiffness=ci * W)).decay_rate)

    np.testing.assert_allclose(root_of(growth, limit, 5.0), limit, rtol=1e-12)


def test_a_positive_cross_stiffness_drives_whirl_in_the_sense_of_the_axis():
    run = jb.simulate(
        shaft(cross_stiffness=200.0), jnp.linspace(0, 6, 601),
        initial=jb.State([1e-3, 0, 0], [0, 0, 0]),
    )  # fmt: skip
    x, y = np.asarray(run.state.q)[-200:, :2].T
    assert (x[:-1] * np.diff(y) - y[:-1] * np.diff(x) > 0).all()


# A levitated mass: m x'' = ki i + ks x, L i' + R i = -P x - D x' - kv x'


NUMBERS = {
    "current_stiffness": 40.0,
    "displacement_stiffness": 2e4,
    "inductance": 0.02,
    "resistance": 3.0,
    "proportional": 4000.0,
    "derivative": 30.0,
    "back_emf": 1.3,
}


def levitated(m=5.0, gravity=0.0, **changed):
    return jb.Model(
        bodies={"rotor": jb.Body(mass=m, inertia=[1, 1, 1])},
        joints={"rotor": jb.Guide("stator", axis=[0, 0, 1])},
        supports={"stator": jb.Support()},
        elements={
            "magnet": jb.forces.MagneticBearing(
                "rotor", "stator", axis="z", **{**NUMBERS, **changed}
            )
        },
        gravity=[0, 0, -gravity],
    )


def polynomial(m=5.0, **changed):
    n = {**NUMBERS, **changed}
    ki, ks, L, R = (n[x] for x in list(NUMBERS)[:4])
    P, D = n["proportional"], n["derivative"] + n["back_emf"]
    return [m * L, m * R, ki * D - ks * L, ki * P - ks * R]


@pytest.mark.parametrize("changed", [{}, {"derivative": 150.0, "inductance": 0.05}])
def test_poles_of_the_levitated_mass(changed):
    expected = np.sort_complex(np.roots(polynomial(**changed)))
    modes = poles_at(levitated(**changed))
    found = np.concatenate([np.ravel(modes.poles), np.ravel(modes.relaxations)])
    np.testing.assert_allclose(np.sort_complex(found), expected, rtol=1e-10)


def test_the_levitated_mass_rests_by_its_current():
    """0 = -m g + ki i + ks x, R i = -P x; the state is found though no energy has a minimum."""
    m, g, n = 5.0, 9.81, NUMBERS
    x = (
        m
        * g
        / (
            n["displacement_stiffness"]
            - n["current_stiffness"] * n["proportional"] / n["resistance"]
        )
    )
    eq = jb.equilibrium(levitated(gravity=g))
    assert eq.stable
    np.testing.assert_allclose(eq.state.q[0], x, rtol=1e-12)
    np.testing.assert_allclose(eq.state.z[0], -n["proportional"] * x / n["resistance"], rtol=1e-12)
    slope = jax.grad(lambda m: jb.equilibrium(levitated(m, g)).state.q[0])(m)
    np.testing.assert_allclose(slope, x / m, rtol=1e-12)
    np.testing.assert_allclose(eq.reactions["stator"][0], [0, 0, -m * g], atol=1e-9)


def test_a_soft_controller_lets_it_fall():
    with pytest.warns(jb.JaxbodyWarning, match="divergence"):
        eq = jb.equilibrium(levitated(proportional=1000.0, gravity=9.81))
    assert eq.growing.tolist() == [0, 1]


def test_shaken_stator():
    """x'' of the rotor relative to the stator, shaken by u: the closed form of the transfer."""
    f = np.array([0.5, 3.0, 11.0])
    s, n = 2j * np.pi * f, NUMBERS
    lin = jb.linearize(model := levitated(), jb.equilibrium(model))
    H = jb.frequency_response(
        lin,
        f,
        {"u": jb.BaseMotion("stator", "z")},
        {"gap": jb.Position("rotor", axis="z", relative_to="stator")},
    ).values[0, 0]
    m, (a3, a2, a1, a0) = 5.0, polynomial()
    expected = (
        -m * s**2 * (n["inductance"] * s + n["resistance"]) / (a3 * s**3 + a2 * s**2 + a1 * s + a0)
    )
    np.testing.assert_allclose(H, expected, rtol=1e-12)


def test_a_bearing_turns_its_stator_too():
    """Forces and moments about one point sum to zero, wherever rotor and stator are."""
    seal = jb.forces.WhirlForce(
        ("rotor", [0.3, 0.1, 0]), ("stator", [0, 0.2, 0.1]), axis=[0.3, 0, 1], stiffness=50.0,
        damping=3.0, cross_stiffness=20.0, cross_damping=1.0,
    )  # fmt: skip
    rng = np.random.default_rng(4)
    frames = []
    for _ in range(2):
        R = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        frames.append(
            Frame(*(jnp.asarray(x) for x in (rng.normal(size=3), R, *rng.normal(size=(2, 3)))))
        )
    wrenches = seal.forces(ForceInputs(tuple(frames), {}, jnp.zeros(0), jnp.zeros(())))
    force = sum(F for F, _ in wrenches)
    moment = sum(M + jnp.cross(A.p, F) for (F, M), A in zip(wrenches, frames, strict=True))
    assert float(jnp.abs(wrenches[0][0]).max()) > 1
    np.testing.assert_allclose(np.concatenate([force, moment]), np.zeros(6), atol=1e-13 * 200)


def test_a_motion_from_rest_begins_in_the_equilibrium_and_stays_there():
    """x and i are those of the closed form above, held for half a second."""
    m, g, n = 5.0, 9.81, NUMBERS
    stiffness = n["current_stiffness"] * n["proportional"] / n["resistance"]
    x = -m * g / (stiffness - n["displacement_stiffness"])
    run = jb.simulate(levitated(gravity=g), jnp.linspace(0.0, 0.5, 6), initial="rest")
    np.testing.assert_allclose(run.state.q[:, 0], x, rtol=1e-9)
    np.testing.assert_allclose(
        run.state.z[:, 0], -n["proportional"] * x / n["resistance"], rtol=1e-9
    )
