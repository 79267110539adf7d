"""Laws with memory on a closed loop, against its equations written here: a parallelogram with a
rubber hinge and a hydraulic strut."""

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import rigs
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

import jaxbody as jb

# of crank and rocker, of coupler and ground; angle of the drawing
G, LENGTH, SPAN, START = 9.81, 0.3, 0.5, 1.0
# of the coupler; of crank and rocker each, about their pins; free angle of the hinge
MASS, INERTIA, FREE = 4.0, 0.05, 0.8
HINGE = {"stiffness": 60.0, "branch": 40.0, "relaxation_time": 0.05}
FLUID = {
    "stiffness": 3e3,
    "damping": 8.0,
    "upper_stiffness": 4e3,
    "lower_stiffness": 600.0,
    "fluid_mass": 3.0,
    "fluid_damping": 40.0,
}
# loss of the fluid, foot and free length of the strut
QUADRATIC, GROUND, STRUT = 30.0, np.array([0.45, -0.1]), 0.4
# of the strut, the pin of crank and coupler
HEAD = LENGTH * np.array([np.cos(START), np.sin(START)])


def parallelogram(hinge=HINGE, fluid=FLUID):
    """Crank and rocker stay parallel. Drawn at START; bodies have the axes of the world."""
    head, foot = np.append(HEAD, 0.0), np.array([SPAN, 0.0, 0.0])
    bodies = {
        "crank": jb.Body(mass=1.0, inertia=[INERTIA] * 3),
        "coupler": jb.Body(mass=MASS, inertia=[0.1] * 3, com=head + foot / 2),
        "rocker": jb.Body(mass=1.0, inertia=[INERTIA] * 3, com=foot),
    }
    rubber = jb.laws.Linear(hinge["stiffness"]) + jb.laws.Maxwell(
        stiffness=hinge["branch"], relaxation_time=hinge["relaxation_time"]
    )
    strut = jb.laws.Hydraulic(**fluid, quadratic_damping=QUADRATIC)
    return jb.Model(
        bodies=bodies,
        joints={
            "crank": jb.Hinge("world", axis="z", at=[0, 0, 0]),
            "coupler": jb.Hinge("crank", axis="z", at=head),
            "rocker": jb.Hinge("world", axis="z", at=foot),
        },
        closures={
            "pin": jb.closures.Hinge(("coupler", head + foot), ("rocker", head + foot), axis="z")
        },
        elements={
            "rubber": jb.Torsion(
                "world", "crank", axis="z", spring=rubber, free_angle=FREE - START
            ),
            "strut": jb.SpringDamper(
                ("coupler", head),
                ("world", np.append(GROUND, 0.0)),
                free_length=STRUT,
                spring=strut,
            ),
        },
        gravity=[0, -G, 0],
    )


def strut_at(x):
    """Elongation of the strut."""
    d = LENGTH * jnp.stack([jnp.cos(x), jnp.sin(x)]) - GROUND
    return jnp.sqrt(jnp.sum(d * d)) - STRUT


def rates(_, state):
    """Of the crank's angle and its rate, the branch, the fluid and its rate."""
    x, v, y, u, u_dot = state
    e, e_dot = jax.jvp(strut_at, (x,), (v,))
    slope = jax.grad(strut_at)(x)
    F = FLUID["stiffness"] * e + FLUID["damping"] * e_dot + FLUID["upper_stiffness"] * (e - u)
    M = HINGE["stiffness"] * (x - FREE) + HINGE["branch"] * (x - FREE - y)
    acceleration = -(F * slope + M + MASS * G * LENGTH * jnp.cos(x)) / (
        2 * INERTIA + MASS * LENGTH**2
    )
    held = FLUID["upper_stiffness"] * (e - u) - FLUID["lower_stiffness"] * u
    flow = (held - (FLUID["fluid_damping"] + QUADRATIC * jnp.abs(u_dot)) * u_dot) / FLUID[
        "fluid_mass"
    ]
    return jnp.stack([v, acceleration, (x - FREE - y) / HINGE["relaxation_time"], u_dot, flow])


def at_rest(x):
    """States of a crank that rests at this angle."""
    share = FLUID["upper_stiffness"] / (FLUID["upper_stiffness"] + FLUID["lower_stiffness"])
    return np.array([x, 0.0, x - FREE, share * float(strut_at(x)), 0.0])


@pytest.fixture(scope="module")
def model():
    return parallelogram()


@pytest.fixture(scope="module")
def rest(model):
    return jb.equilibrium(model)


@pytest.fixture(scope="module")
def angle():
    """Of the crank at rest, by hand."""
    return brentq(lambda x: float(rates(0.0, jnp.asarray(at_rest(x)))[1]), 0.3, 1.4, xtol=1e-14)


def in_order(model, z):
    """Branch, fluid, rate of fluid."""
    names = ("rubber, branch", "strut, fluid", "strut, rate of fluid")
    return np.asarray(z)[..., [model.layout.states.index(name) for name in names]]


@pytest.mark.long
def test_rest(model, rest, angle):
    assert int(rest.status) == 0 and rest.stable
    turn = np.asarray(rest.state.q)[model.layout.coordinates.index("crank turn about its hinge")]
    np.testing.assert_allclose(START + turn, angle, rtol=1e-10)
    np.testing.assert_allclose(
        in_order(model, rest.state.z), at_rest(angle)[2:], rtol=1e-9, atol=1e-14
    )


@pytest.mark.long
def test_small_motions(model, rest, angle):
    """Poles are the eigenvalues of the slopes of the equations by hand; slow modes those of the
    condensed matrices."""
    lin = jb.linearize(model, rest)
    damped = jb.complex_modes(lin)
    A = np.asarray(jax.jacfwd(lambda y: rates(0.0, y))(jnp.asarray(at_rest(angle))))
    found = np.concatenate([np.asarray(damped.poles).ravel(), damped.relaxations])
    exact = np.linalg.eigvals(A)
    assert damped.frequency.shape == (2,) and damped.relaxations.shape == (1,)
    np.testing.assert_allclose(
        sorted(found, key=lambda s: (s.imag, s.real)),
        sorted(exact, key=lambda s: (s.imag, s.real)),
        rtol=1e-9,
    )
    K = -A[[1, 4]][:, [0, 3]]  # of accelerations, the branch held
    K[0, 0] -= A[1, 2]  # the branch follows
    w = np.sort(np.sqrt(np.linalg.eigvals(K)))
    np.testing.assert_allclose(
        2 * np.pi * jb.modes(lin, stiffness="relaxed").frequency, w, rtol=1e-9
    )
    K[0, 0] += A[1, 2]
    w = np.sort(np.sqrt(np.linalg.eigvals(K)))
    np.testing.assert_allclose(
        2 * np.pi * jb.modes(lin, stiffness="instantaneous").frequency, w, rtol=1e-9
    )


@pytest.mark.long
def test_a_motion_is_that_by_hand(model):
    """Released as drawn, branch and fluid relaxed there."""
    times = np.linspace(0, 0.8, 17)
    run = jb.simulate(model, times, rtol=1e-9)
    exact = solve_ivp(
        jax.jit(rates),
        (0.0, 0.8),
        at_rest(START),
        t_eval=times,
        method="DOP853",
        rtol=1e-12,
        atol=1e-13,
    ).y.T
    turn = np.asarray(run.state.q)[:, model.layout.coordinates.index("crank turn about its hinge")]
    np.testing.assert_allclose(START + turn, exact[:, 0], atol=1e-8)
    states = in_order(model, run.state.z)
    size = np.abs(exact[:, 2:]).max(0)
    np.testing.assert_allclose(states / size, exact[:, 2:] / size, atol=1e-7)
    np.testing.assert_allclose(run.state.q[:, 1] + turn, 0, atol=1e-8)  # the coupler does not turn


@pytest.mark.long
def test_derivatives_of_a_motion(model):
    """In constant steps: controlled ones depend on round-off, which forward and reverse mode do
    not share."""
    steps = dict(stepsize_controller=diffrax.ConstantStepSize(), dt0=0.002, max_steps=128)
    paths = (
        "rubber.spring.terms.1.relaxation_time",
        "strut.spring.upper_stiffness",
        "strut.spring.fluid_mass",
    )

    def travel(x):
        run = jb.simulate(
            jb.replace(model, dict(zip(paths, x, strict=True))), np.linspace(0, 0.2, 5), **steps
        )
        return jnp.sum(run.state.q[:, 0] ** 2) + 1e2 * jnp.sum(run.state.z**2)

    rigs.check_derivatives(jax.jit(travel), jnp.array([0.05, 4e3, 3.0]))
