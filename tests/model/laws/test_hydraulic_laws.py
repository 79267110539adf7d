"""Hydraulic mounts by themselves: published stiffness, hydraulic parameters, decoupler, loss that
grows with amplitude, what is refused."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import jaxbody as jb
from jaxbody.model.laws.law_states import Held, Relaxed

PUBLISHED = {
    "stiffness": 512950.0,
    "damping": 198.0,
    "upper_stiffness": 436950.0,
    "fluid_mass": 62.8,
    "fluid_damping": 2666.0,
}
TABLE = {  # frequency: modulus, angle (REFERENCES2 1.3)
    5.0: (478823.4998, 13.840957),
    8.0: (481442.0037, 35.292396),
    10.0: (641526.9444, 53.216419),
    12.0: (1042292.2845, 53.241490),
    15.0: (1399469.5686, 27.016588),
    30.0: (1050573.7784, 3.544686),
    11.00159062: (818769.9968, 56.325412197),
    14.94341808: (1399555.1792, 27.451088),
}
MOUNT = {
    "stiffness": 2e5,
    "damping": 100.0,
    "upper_stiffness": 3e5,
    "lower_stiffness": 4e4,
    "fluid_mass": 60.0,
    "fluid_damping": 1500.0,
    "quadratic_damping": 4e4,
    "gap": 2e-4,
}


def formula(
    f,
    *,
    stiffness,
    upper_stiffness,
    fluid_mass,
    fluid_damping,
    lower_stiffness=0.0,
    damping=0.0,
    **_,
):
    s = 2j * np.pi * np.asarray(f)
    column = fluid_mass * s**2 + fluid_damping * s + lower_stiffness
    return stiffness + damping * s + upper_stiffness * column / (column + upper_stiffness)


def test_published_dynamic_stiffness():
    found = jb.vibration.dynamic_stiffness(jb.laws.Hydraulic(**PUBLISHED), list(TABLE))
    modulus, angle = np.array(list(TABLE.values())).T
    # the table has ten digits of the modulus
    np.testing.assert_allclose(found.magnitude, modulus, rtol=1e-9)
    np.testing.assert_allclose(np.rad2deg(found.loss_angle), angle, atol=1e-6)


def test_two_chambers():
    f, law = [0.5, 8.0, 14.0, 40.0], {**MOUNT, "gap": 0.0}
    np.testing.assert_allclose(
        jb.vibration.dynamic_stiffness(jb.laws.Hydraulic(**law), f).stiffness,
        formula(f, **law),
        rtol=1e-12,
    )


def test_hydraulic_parameters():
    """Against the equations of the pressures and of the flow: p1 C1 = A e - V, p2 C2 = V, I Q' + R
    Q + R2 |Q| Q = p1 - p2."""
    A, inertance, C1, C2, R, R2 = 5e-3, 2e6, 3e-11, 2e-9, 3e7, 4e11
    law = jb.laws.Hydraulic.from_fluid(
        stiffness=2e5,
        damping=50.0,
        pumping_area=A,
        inertance=inertance,
        upper_compliance=C1,
        lower_compliance=C2,
        resistance=R,
        quadratic_resistance=R2,
    )
    e, e_dot, y, u = 1e-3, 0.02, 4e-4, 0.03
    V, Q = A * y, A * u
    p1, p2 = (A * e - V) / C1, V / C2
    flow = (p1 - p2 - R * Q - R2 * abs(Q) * Q) / inertance
    z = jnp.array([y, u])
    np.testing.assert_allclose(
        law.rate(jnp.array(e), jnp.array(e_dot), z), [u, flow / A], rtol=1e-12
    )
    np.testing.assert_allclose(
        law.restoring_force(jnp.array(e), jnp.array(e_dot), z),
        2e5 * e + 50 * e_dot + A * p1,
        rtol=1e-12,
    )
    free = jb.laws.Hydraulic.from_fluid(
        stiffness=2e5, pumping_area=A, inertance=1e6, upper_compliance=C1, free_volume=1e-6
    )
    assert float(free.lower_stiffness) == 0 and abs(float(free.gap) - 2e-4) < 1e-18


@pytest.mark.parametrize("e", [0.0, 1e-4, -1e-4, 1.5e-3, -1.5e-3])
def test_rest_with_a_decoupler(e):
    """dV/dy = 0 in closed form, and its derivatives; inside of the gap the fluid has no part."""
    law, e = jb.laws.Hydraulic(**MOUNT), jnp.array(e)
    y = law.relaxed(e)
    assert abs(float(jax.grad(law.energy, 1)(e, y)[0])) < 1e-12 * 4e4
    at_rest = Relaxed(law, jnp.zeros(2))
    np.testing.assert_allclose(
        at_rest.force(e), jax.grad(at_rest.potential)(e), rtol=1e-12, atol=1e-12
    )
    series = 3e5 * 4e4 / 3.4e5
    np.testing.assert_allclose(
        at_rest.slope(e), 2e5 + (series if abs(e) > 2e-4 else 0.0), rtol=1e-12
    )
    np.testing.assert_allclose(at_rest.state(e), [y[0], 0.0])


def test_work_is_stored_or_lost():
    """F e' = d(V + T)/dt + cr e'^2 + c y'^2 + q |y'|^3."""
    held, x_dot = Held(jb.laws.Hydraulic(**MOUNT), jnp.array([3e-4, -0.04])), jnp.array(0.07)
    lost = 100 * 0.07**2 + 1500 * 0.04**2 + 4e4 * 0.04**3
    np.testing.assert_allclose(held.lost_power(jnp.array(1e-3), x_dot), lost, rtol=1e-12)
    np.testing.assert_allclose(held.kinetic(), 0.5 * 60 * 0.04**2, rtol=1e-14)
    np.testing.assert_allclose(
        held.dissipation(jnp.array(1e-3), x_dot),
        100 * 0.07**2 / 2 + 1500 * 0.04**2 / 2 + 4e4 * 0.04**3 / 3,
    )


@pytest.mark.long
@pytest.mark.parametrize(
    ("f", "X", "gap"), [(9.0, 1e-3, 0.0), (9.0, 1e-3, 2e-4), (14.0, 5e-5, 2e-4)]
)
def test_first_harmonic_at_an_amplitude(f, X, gap):
    """Against scipy's steady state; within the gap only the rubber acts."""
    law, w = {**MOUNT, "gap": gap}, 2 * np.pi * f
    k1, k2, m, c, q = (
        law[name]
        for name in (
            "upper_stiffness",
            "lower_stiffness",
            "fluid_mass",
            "fluid_damping",
            "quadratic_damping",
        )
    )

    def upper(e, y):
        return k1 * ((e - y) - np.clip(e - y, -gap, gap))

    def rates(t, z):
        force = upper(X * np.cos(w * t), z[0])
        F = law["stiffness"] * X * np.cos(w * t) - law["damping"] * X * w * np.sin(w * t) + force
        return [
            z[1],
            (force - k2 * z[0] - c * z[1] - q * abs(z[1]) * z[1]) / m,
            F * np.cos(w * t),
            -F * np.sin(w * t),
        ]

    T, z = 1 / f, np.zeros(4)
    start = solve_ivp(
        rates, (0, 40 * T), z, method="DOP853", rtol=1e-11, atol=1e-14, max_step=T / 50
    ).y[:2, -1]
    re, im = solve_ivp(
        rates, (0, T), [*start, 0, 0], method="DOP853", rtol=1e-11, atol=1e-14, max_step=T / 50
    ).y[2:, -1]
    found = jb.vibration.dynamic_stiffness(jb.laws.Hydraulic(**law), [f], amplitude=X)
    assert int(found.status) == 0
    np.testing.assert_allclose(found.stiffness[0], 2 * f / X * (re + 1j * im), rtol=1e-8)
    if gap > X:
        np.testing.assert_allclose(
            found.stiffness[0], law["stiffness"] + 1j * w * law["damping"], rtol=1e-9
        )


@pytest.mark.long
def test_derivatives_of_the_stiffness_at_an_amplitude():
    names = (
        "stiffness",
        "damping",
        "upper_stiffness",
        "fluid_mass",
        "fluid_damping",
        "quadratic_damping",
    )
    x = jnp.array([MOUNT[name] for name in names])

    @jax.jit
    def curve(x):
        law = jb.laws.Hydraulic(**dict(zip(names, x, strict=True)), lower_stiffness=4e4)
        K = jb.vibration.dynamic_stiffness(law, [8.0, 11.0], amplitude=1e-3)
        return jnp.sum(K.magnitude) + 1e5 * jnp.sum(K.loss_angle)

    forward, reverse = jax.jacfwd(curve)(x), jax.grad(curve)(x)
    np.testing.assert_allclose(reverse, forward, rtol=1e-9)
    for i, h in enumerate(1e-3 * x):  # differences of fourth order
        near, far = (
            float(curve(x.at[i].add(k * h)) - curve(x.at[i].add(-k * h))) / float(2 * k * h)
            for k in (1, 2)
        )
        np.testing.assert_allclose(forward[i], (4 * near - far) / 3, rtol=1e-6, err_msg=names[i])


class Absorber(jb.laws.Inertial):
    """Two masses on springs that the deformation carries: only V, R and T are stated."""

    stiffness: jax.Array
    states = ("near", "far", "rate of near", "rate of far")
    state_units = ("argument", "argument", "argument/s", "argument/s")

    def energy(self, e, y):
        return (
            0.5 * self.stiffness * ((e - y[0]) ** 2 + (y[0] - y[1]) ** 2 + y[1] ** 2)
            + 0.25 * self.stiffness * (e - y[0]) ** 4
        )

    def dissipation(self, e_dot, y_dot):
        return 0.5 * (
            3.0 * y_dot[0] ** 2 + 0.4 * y_dot[1] ** 2 + 0.6 * e_dot * y_dot[0] + 0.9 * e_dot**2
        )

    def kinetic_energy(self, y_dot):
        return y_dot[0] ** 2 + 0.5 * y_dot[1] ** 2 + 0.3 * y_dot[0] * y_dot[1]


@pytest.mark.long
def test_general_coordinates_with_mass():
    """F and y'' of a law that states V, R and T only, by hand."""
    law, z = Absorber(jnp.array(50.0)), np.array([0.1, -0.2, 0.5, 0.3])
    e, e_dot = 0.4, -0.7
    V_y = 50 * np.array([-(e - z[0]) + (z[0] - z[1]) - (e - z[0]) ** 3, -(z[0] - z[1]) + z[1]])
    R_y = np.array([3.0 * z[2] + 0.3 * e_dot, 0.4 * z[3]])
    rate = np.linalg.solve([[2.0, 0.3], [0.3, 1.0]], -V_y - R_y)
    np.testing.assert_allclose(
        law.rate(jnp.array(e), jnp.array(e_dot), jnp.asarray(z)), [*z[2:], *rate], rtol=1e-13
    )
    F = 50 * ((e - z[0]) + (e - z[0]) ** 3) + 0.3 * z[2] + 0.9 * e_dot
    np.testing.assert_allclose(
        law.restoring_force(jnp.array(e), jnp.array(e_dot), jnp.asarray(z)), F, rtol=1e-13
    )
    y = law.relaxed(jnp.array(e))
    assert np.abs(jax.grad(law.energy, 1)(jnp.array(e), y)).max() < 1e-12


@pytest.mark.parametrize(
    ("change", "code"),
    [
        ({"fluid_mass": 0.0}, "NOT_POSITIVE"),
        ({"fluid_mass": -1.0}, "NOT_POSITIVE"),
        ({"upper_stiffness": 0.0}, "NOT_POSITIVE"),
        ({"lower_stiffness": -1.0}, "NEGATIVE"),
        ({"gap": -1e-4}, "NEGATIVE"),
        ({"quadratic_damping": -1.0}, "NEGATIVE"),
        ({"stiffness": [1.0, 2.0]}, "BAD_SHAPE"),
    ],
)
def test_bad_input_is_refused(change, code):
    with pytest.raises(jb.JaxbodyError) as caught:
        jb.laws.Hydraulic(**{**MOUNT, **change})
    assert caught.value.code == code and next(iter(change)) in str(caught.value)


def test_bad_hydraulic_parameters_are_all_named():
    with pytest.raises(jb.JaxbodyError) as caught:
        jb.laws.Hydraulic.from_fluid(
            stiffness=2e5, pumping_area=0.0, inertance=-1.0, upper_compliance=1e-11, resistance=-3.0
        )
    assert [problem.code for problem in caught.value.problems] == [
        "NOT_POSITIVE",
        "NOT_POSITIVE",
        "NEGATIVE",
    ]
    with pytest.raises(jb.JaxbodyError, match="MEMORY"):
        jb.SpringDamper(("a", [0, 0, 0]), ("b", [0, 0, 0]), damper=jb.laws.Hydraulic(**MOUNT))
