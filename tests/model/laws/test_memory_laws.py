"""Laws with memory by themselves: published loops of hysteresis, relaxation, and what
is refused."""

from itertools import pairwise

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import jaxbody as jb
from jaxbody.model.laws.law_states import Held, Relaxed

BENCHMARK = {"alpha": 5e4, "beta": 1e3, "gamma": 0.8, "delta": -1.1}  # Noel, Schoukens (2016)
# parameters, amplitude, end of the closed loop, energy per cycle (closed forms of REFERENCES2 1.4)
LOOPS = (
    (BENCHMARK, 1e-3, 77.756980989156, 0.049164468767580),
    (
        {"alpha": 1.0, "beta": 1.0, "gamma": 0.5, "delta": 0.5},
        3.0,
        0.9933069995022,
        7.0401132067126,
    ),
    (
        {"alpha": 1.0, "beta": 1.0, "gamma": 0.1, "delta": 0.9},
        3.0,
        0.9829352506081,
        3.8097993453690,
    ),
)


def swept(law, ends, z):
    """The forces at the ends of strokes between these deformations, and the work of each; the
    deformation is the independent variable."""
    rate = jax.jit(lambda z, way: law.rate(jnp.zeros(()), way, jnp.reshape(z, (1,)))[0])
    forces, works = [], []
    for start, end in pairwise(ends):
        way = np.sign(end - start)
        run = solve_ivp(
            lambda s, y, way=way: [float(rate(y[0], way)), way * y[0]],
            (0, abs(end - start)),
            [z, 0.0],
            method="DOP853",
            rtol=1e-11,
            atol=1e-13 * max(1.0, abs(z)),
        )
        z, work = run.y[:, -1]
        forces.append(z)
        works.append(work)
    return np.array(forces), np.array(works)


@pytest.mark.parametrize(("parameters", "Y", "Z", "energy"), LOOPS)
def test_loops_of_bouc_and_wen(parameters, Y, Z, energy):
    law = jb.laws.BoucWen(**parameters)
    forces, works = swept(law, [Y, -Y, Y], Z)
    np.testing.assert_allclose(forces, [-Z, Z], rtol=1e-8)
    np.testing.assert_allclose(works.sum(), energy, rtol=1e-8)


def test_first_half_cycles_of_the_benchmark():
    forces, _ = swept(jb.laws.BoucWen(**BENCHMARK), 1e-3 * np.array([0, 1, -1, 1, -1]), 0.0)
    np.testing.assert_allclose(
        forces, [58.309801262668, -85.8719273455, 74.8763905245, -78.8426534948], rtol=1e-8
    )


def test_exponent_two_has_its_closed_form():
    """Rising from rest with gamma + delta = 1, beta = 1, alpha = 1: z' = 1 - z^2, z = tanh y."""
    forces, _ = swept(
        jb.laws.BoucWen(alpha=1.0, beta=1.0, gamma=0.4, delta=0.6, n=2.0), [0.0, 0.7], 0.0
    )
    np.testing.assert_allclose(forces, np.tanh(0.7), rtol=1e-9)


def test_friction_of_dahl():
    law, X = jb.laws.Dahl(stiffness=1e6, level=100.0), 2e-4
    first, _ = swept(law, [0.0, X], 0.0)
    end = 96.402758007582
    forces, works = swept(law, [X, -X, X], end)
    np.testing.assert_allclose(first, 86.466471676339, rtol=1e-9)
    np.testing.assert_allclose(forces, [-end, end], rtol=1e-9)
    np.testing.assert_allclose(works.sum(), 0.041438896796967, rtol=1e-8)
    np.testing.assert_allclose(swept(law, [0.0, 9.162907318742e-5], 0.0)[0], 60.0, rtol=1e-9)


def test_steady_sliding_of_lugre():
    """F = g(v) + sigma2 v, where z' = 0."""
    law = jb.laws.LuGre(
        stiffness=1e5, damping=300.0, viscosity=0.4, level=1.0, static_level=1.5, velocity=1e-3
    )
    for v in (1e-4, 1e-3, -0.01):
        g = 1.0 + 0.5 * np.exp(-((v / 1e-3) ** 2))
        z = jnp.array([np.sign(v) * g / 1e5])
        assert abs(float(law.rate(jnp.array(0.0), jnp.array(v), z)[0])) < 1e-12 * abs(v)
        np.testing.assert_allclose(
            law.restoring_force(jnp.array(0.0), jnp.array(v), z),
            np.sign(v) * g + 0.4 * v,
            rtol=1e-12,
        )


class Cubic(jb.laws.Viscoelastic):
    """A dashpot behind a cubic spring that itself holds on to the ground, coupled to e' by
    its dissipation."""

    def energy(self, e, y):
        return 0.25 * (e - y[0]) ** 4 + 0.5 * (e - y[0]) ** 2 + y[0] ** 2

    def dissipation(self, e_dot, y_dot):
        return 0.5 * (y_dot[0] ** 2 + 0.6 * e_dot * y_dot[0] + 0.4 * e_dot**2)


def test_general_coordinates_without_mass():
    """F, y' and y at rest of a law that states V and R only, by hand."""
    law, e, e_dot, y = Cubic(), jnp.array(0.8), jnp.array(0.5), jnp.array([0.1])
    V_y = -((0.7) ** 3) - 0.7 + 2 * 0.1
    rate = -(V_y + 0.3 * 0.5)
    np.testing.assert_allclose(law.rate(e, e_dot, y), [rate], rtol=1e-14)
    np.testing.assert_allclose(
        law.restoring_force(e, e_dot, y), 0.7**3 + 0.7 + 0.3 * rate + 0.4 * 0.5, rtol=1e-14
    )
    at_rest = float(law.relaxed(e)[0])
    assert abs(-((0.8 - at_rest) ** 3) - (0.8 - at_rest) + 2 * at_rest) < 1e-14
    d = 3 * (0.8 - at_rest) ** 2 + 1  # V_ey = -d, V_yy = d + 2
    np.testing.assert_allclose(law.sensitivity(e), [d / (d + 2)], rtol=1e-13)
    step = 1e-4
    slopes = [float(law.sensitivity(e + h)[0]) for h in (step, -step)]
    np.testing.assert_allclose(
        jax.grad(lambda e: law.sensitivity(e)[0])(e),
        (slopes[0] - slopes[1]) / (2 * step),
        rtol=1e-6,
    )
    np.testing.assert_allclose(
        Relaxed(law, y).force(e), jax.grad(Relaxed(law, y).potential)(e), rtol=1e-12
    )


def test_work_is_stored_or_lost():
    """F e' = dV/dt + lost power, which is c y'^2 of a branch and not negative of hysteresis
    with gamma >= |delta|."""
    maxwell, x, x_dot = (
        jb.laws.Maxwell(stiffness=300.0, relaxation_time=0.2),
        jnp.array(0.3),
        jnp.array(-0.7),
    )
    held = Held(maxwell, jnp.array([0.1]))
    np.testing.assert_allclose(
        held.lost_power(x, x_dot), 300.0 * 0.2 * (0.2 / 0.2) ** 2, rtol=1e-13
    )
    np.testing.assert_allclose(
        2 * held.dissipation(x, x_dot), held.lost_power(x, x_dot), rtol=1e-13
    )
    laws = [
        jb.laws.BoucWen(alpha=2.0, beta=1.0, gamma=0.6, delta=0.5),
        jb.laws.Dahl(stiffness=2.0, level=1.0),
    ]
    laws.append(
        jb.laws.LuGre(stiffness=2.0, damping=0.1, viscosity=0.3, level=1.0, static_level=1.4)
    )
    for law in laws:
        for z in (-0.4, 0.0, 0.3):
            for rate in (-0.5, 0.0, 0.8):
                held = Held(law, jnp.array([z]))
                lost = float(held.lost_power(jnp.zeros(()), jnp.array(rate)))
                assert lost >= -1e-14, (type(law).__name__, z, rate)


@pytest.mark.parametrize(
    ("make", "code"),
    [
        (lambda: jb.laws.Maxwell(stiffness=0.0, relaxation_time=1.0), "NOT_POSITIVE"),
        (lambda: jb.laws.Maxwell(stiffness=1.0, relaxation_time=-1.0), "NOT_POSITIVE"),
        (lambda: jb.laws.BoucWen(alpha=1.0, beta=-1.0, gamma=0.5, delta=0.5), "NEGATIVE"),
        (lambda: jb.laws.Dahl(stiffness=1.0, level=0.0), "NOT_POSITIVE"),
        (
            lambda: jb.laws.TwoSided(
                bump=jb.laws.Maxwell(stiffness=1.0, relaxation_time=1.0), rebound=1.0
            ),
            "MEMORY",
        ),
        (
            lambda: jb.SpringDamper(
                ("a", [0, 0, 0]),
                ("b", [0, 0, 0]),
                damper=jb.laws.Maxwell(stiffness=1.0, relaxation_time=1.0),
            ),
            "MEMORY",
        ),
        (
            lambda: jb.Torsion("a", "b", axis="x", damper=jb.laws.Dahl(stiffness=1.0, level=1.0)),
            "MEMORY",
        ),
        (
            lambda: jb.laws.Maxwell(stiffness=1.0, relaxation_time=1.0).force(jnp.array(0.1)),
            "MEMORY",
        ),
    ],
)
def test_bad_input_is_refused(make, code):
    with pytest.raises(jb.JaxbodyError) as caught:
        make()
    assert caught.value.code == code


class Actuator(jb.laws.Hysteretic):
    """A state that relaxes, which a hysteretic law must not."""

    def rate(self, e, e_dot, z):
        return e_dot - 3.0 * z

    def restoring_force(self, e, e_dot, z):
        return z[0]


@pytest.mark.long
def test_a_hysteretic_state_that_moves_at_rest_is_refused():
    with pytest.raises(jb.JaxbodyError) as caught:
        jb.Model(
            bodies={"m": jb.Body(mass=1.0)},
            joints={"m": jb.Guide("world", axis="x")},
            elements={
                "s": jb.SpringDamper(("m", [0, 0, 0]), ("world", [1, 0, 0]), spring=Actuator())
            },
        )
    assert caught.value.code == "RELAXES"
