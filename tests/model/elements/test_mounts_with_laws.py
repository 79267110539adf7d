"""Mounts: as a Bushing with constant stiffness, and with a law in each direction."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxbody as jb
from jaxbody.mechanics.closed_loops import state_slopes
from jaxbody.numerics.eigenproblems import first_order

STIFFNESS, DAMPING = (
    np.array([2e4, 3e4, 5e4, 400.0, 500.0, 600.0]),
    np.array([20.0, 30, 50, 4, 5, 6]),
)
PLACES = ("engine", [0.2, 0.1, -0.1]), ("base", [0.2, 0.1, -0.1])
TURNED = jb.EulerAngles("XYZ", [0.3, -0.2, 0.5])


def engine(mount, joint=None):
    body = jb.Body(mass=40.0, inertia=[1.0, 2.0, 1.5], com=[0.05, 0, 0.02])
    joints = {} if joint is None else {"engine": joint}
    model = jb.Model(
        bodies={"engine": body},
        joints=joints,
        supports={"base": jb.Support()},
        elements={"mount": mount},
        gravity=[0, 0, -9.81],
    )
    return model


def test_constant_laws_make_a_bushing():
    names = ("x", "y", "z", "rx", "ry", "rz")
    mount = jb.Mount(
        *PLACES, **dict(zip(names, STIFFNESS, strict=True)), damping=DAMPING, orientation=TURNED
    )
    bushing = jb.Bushing(
        *PLACES, stiffness=np.diag(STIFFNESS), damping=np.diag(DAMPING), orientation=TURNED
    )
    one, other = engine(mount), engine(bushing)
    eq, expected = jb.equilibrium(one), jb.equilibrium(other)
    np.testing.assert_allclose(eq.state.q, expected.state.q, atol=1e-12)
    lin, exact = jb.linearize(one, eq), jb.linearize(other, expected)
    for name in ("K", "C", "M", "K_tilde", "C_tilde", "K_bb"):
        a, b = np.asarray(getattr(lin, name)), np.asarray(getattr(exact, name))
        assert np.abs(a - b).max() < 1e-12 * np.abs(b).max(), name


@pytest.mark.long
def test_small_motions_of_a_mount_with_laws_of_every_kind():
    """Against the slopes of the equations of motion, for a body on joints whose q
    are increments."""
    rubber = jb.laws.Linear(2e4) + jb.laws.Maxwell(stiffness=1e4, relaxation_time=0.02)
    rubber = rubber + jb.laws.Maxwell(stiffness=4e3, relaxation_time=0.3)
    mount = jb.Mount(
        *PLACES,
        x=rubber,
        y=3e4,
        z=rubber + jb.laws.BumpStop(gap=0.001, stiffness=2e4, engagement=0.01),
        rx=500.0,
        ry=jb.laws.Linear(300.0) + jb.laws.Maxwell(stiffness=90.0, relaxation_time=0.05),
        rz=200.0,
        damping=[5.0, 6.0, 7.0],
    )
    model = engine(mount, jb.joints.HeavePitch("world"))
    assert model.layout.states == (
        "mount, x branch 1",
        "mount, x branch 2",
        "mount, z branch 1",
        "mount, z branch 2",
        "mount, ry branch",
    )
    assert model.layout.z_units == ("m",) * 4 + ("rad",)
    eq = jb.equilibrium(model)
    lin = jb.linearize(model, eq)
    A, found = state_slopes(model, eq.state), first_order(lin.M, lin.C, lin.K, model.layout.nv)[0]
    assert np.abs(found - A).max() < 1e-10 * np.abs(A).max()
    run = jb.simulate(model, [0.0, 0.3], initial=eq.state)
    assert np.abs(run.state.q - eq.state.q).max() < 1e-9


FREQUENCIES = np.array([1.0, 5.0, 10.0, 20.0, 100.0])
SOLID = jb.laws.Linear(2e4) + jb.laws.Maxwell(stiffness=6e4, relaxation_time=0.01)
EXACT = 2e4 + 6e4 * 2j * np.pi * FREQUENCIES * 0.01 / (1 + 2j * np.pi * FREQUENCIES * 0.01)


@pytest.mark.parametrize("amplitude", [None, 1e-3])
def test_dynamic_stiffness_of_the_standard_linear_solid(amplitude):
    element = jb.Mount(("a", [0, 0, 0]), ("b", [0, 0, 0]), z=SOLID)
    found = jb.vibration.dynamic_stiffness(
        element, FREQUENCIES, amplitude=amplitude, preload=-100.0, direction="z"
    )
    np.testing.assert_allclose(found.stiffness, EXACT, rtol=1e-10 if amplitude is None else 1e-8)
    np.testing.assert_allclose(found.deformation, -100.0 / 2e4, rtol=1e-12)
    np.testing.assert_allclose(
        np.rad2deg(found.loss_angle),
        [10.51252859, 34.04751826, 36.16110839, 27.26016153, 6.76453635],
        rtol=1e-8,
    )


def test_at_0_hz_the_dynamic_stiffness_is_static():
    found = jb.vibration.dynamic_stiffness(SOLID, [0.0, 1.0])
    np.testing.assert_allclose(found.stiffness, [2e4, EXACT[0]], rtol=1e-10)


def test_the_loop_of_bouc_and_wen_in_its_dynamic_stiffness():
    """The energy of a cycle is pi Im K X^2, in closed form 2 [(alpha l1 - Z)/p + (alpha
    l2 - Z)/q]; its derivatives against differences, in both modes. The force has kinks within a
    cycle, at z = 0."""

    def energy(x, X=1e-3):
        law = jb.laws.BoucWen(alpha=x[0], beta=1e3, gamma=0.8, delta=x[1])
        return (
            np.pi * X**2 * jb.vibration.dynamic_stiffness(law, [1.0], amplitude=X).stiffness.imag[0]
        )

    x = jnp.array([5e4, -1.1])
    for X, exact in ((2e-4, 4.2389324969e-4), (1e-3, 0.049164468767580), (2e-3, 0.366679080472407)):
        np.testing.assert_allclose(energy(x, X), exact, rtol=2e-8)
    forward, reverse = jax.jacfwd(energy)(x), jax.grad(energy)(x)
    np.testing.assert_allclose(reverse, forward, rtol=1e-9)
    steps = 2e-3 * x
    differences = [
        (energy(x.at[i].add(h)) - energy(x.at[i].add(-h))) / (2 * h) for i, h in enumerate(steps)
    ]
    # of steps within which a kink moves
    np.testing.assert_allclose(forward, differences, rtol=3e-4)


def test_bad_input_is_refused():
    for call, code in (
        (lambda: jb.vibration.dynamic_stiffness(SOLID, [-1.0]), "BAD_FREQUENCY"),
        (lambda: jb.vibration.dynamic_stiffness(SOLID, [0.0], amplitude=1e-3), "BAD_FREQUENCY"),
        (lambda: jb.vibration.dynamic_stiffness(SOLID, [1.0], amplitude=-1.0), "NOT_POSITIVE"),
        (lambda: jb.vibration.dynamic_stiffness(jb.Mount(*PLACES, z=1.0), [1.0]), "BAD_DIRECTION"),
        (lambda: jb.vibration.dynamic_stiffness("mount", [1.0]), "WRONG_KIND"),
        (lambda: jb.Mount(*PLACES, damping=[-1.0, 0, 0]), "NEGATIVE"),
        (lambda: jb.fitting.MeasuredStiffness("mount", [1.0]), "NO_DATA"),
    ):
        with pytest.raises(jb.JaxbodyError) as caught:
            call()
        assert caught.value.code == code
