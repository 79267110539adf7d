"""Spins about which closures hold: those of the same bodies on a tree of joints."""

import jax.numpy as jnp
import numpy as np
import pytest

import jaxbody as jb

SPEED = 70.0


def rotor(held="joint"):
    """An unsymmetric carriage on springs and dampers, and a disk that spins on a hinge of it, by a
    joint or by a closure."""
    legs = {
        f"leg {i}{axis}": jb.Spring(
            ("carriage", np.add(corner, [0, 0, -0.1])),
            ("world", np.add(corner, [0, 0, -0.1]) + 0.5 * np.eye(3)[axis]),
            stiffness=2e4 + 3e3 * i + 1e3 * axis,
            free_length=0.5,
            damping=20.0,
        )
        for i, corner in enumerate([(0.3, 0.2, 0), (-0.3, 0.2, 0), (0, -0.25, 0)])
        for axis in range(3)
    }
    bodies = {
        "carriage": jb.Body(mass=4.0, inertia=[0.1, 0.14, 0.2], com=[0.02, -0.01, 0.03]),
        "disk": jb.Body(
            mass=3.0, inertia=[0.05, 0.05, 0.09], com=[0, 0, 0.1], position=[0, 0, 0.2]
        ),
    }
    pin = ("carriage", [0, 0, 0.2]), ("disk", [0, 0, 0])
    joints = {"disk": jb.Hinge("carriage", axis="z")} if held == "joint" else {}
    closures = {} if held == "joint" else {"bearing": jb.closures.Hinge(*pin, axis="z")}
    return jb.Model(bodies=bodies, joints=joints, closures=closures, elements=legs)


def spinning(model, speed=SPEED):
    """Only the disk turns: about the last axis of its own coordinates."""
    return jb.State(model.reference.q, jnp.zeros(model.layout.nv).at[-1].set(speed))


@pytest.mark.long
def test_a_disk_on_a_closure_whirls_as_on_a_joint():
    tree, loop = rotor("joint"), rotor("closure")
    lin, same = (jb.vibration.linearize_spin(model, spinning(model)) for model in (tree, loop))
    assert lin.ok and same.ok and same.M.shape == (7, 7)
    np.testing.assert_allclose(same.G, -same.G.T, atol=1e-9 * np.abs(same.G).max())
    expected, found = jb.complex_modes(lin), jb.complex_modes(same)
    np.testing.assert_allclose(
        found.frequency, expected.frequency, atol=1e-8 * float(expected.frequency[-1])
    )
    np.testing.assert_allclose(
        found.decay_rate, expected.decay_rate, atol=1e-8 * float(np.abs(expected.decay_rate).max())
    )
    assert found.shapes.shape[0] == 12  # of all coordinates
    still = jb.complex_modes(jb.vibration.linearize_spin(tree, spinning(tree, 0.0)))
    # Hz: the spin matters
    assert np.max(np.abs(np.asarray(still.frequency) - expected.frequency)) > 0.1


@pytest.mark.long
def test_without_a_spin_they_are_small_motions_about_rest():
    loop = rotor("closure")
    still, plain = (
        jb.vibration.linearize_spin(loop, spinning(loop, 0.0)),
        jb.linearize(loop, loop.reference),
    )
    assert still.coordinates == plain.coordinates
    for mine, theirs in (
        (still.M, plain.M),
        (still.C, plain.C),
        (still.K, plain.K),
        (still.G, 0 * plain.C),
    ):
        np.testing.assert_allclose(mine, theirs, atol=1e-9 * max(1.0, float(np.abs(theirs).max())))


@pytest.mark.long
def test_speeds_that_do_not_fit_the_closures_are_reported():
    loop = rotor("closure")
    state = spinning(loop)
    with pytest.warns(jb.JaxbodyWarning, match="NOT_CLOSED"):
        # the disk tilts in its bearing
        lin = jb.vibration.linearize_spin(loop, jb.State(state.q, state.v.at[-2].set(5.0)))
    with pytest.warns(jb.JaxbodyWarning, match="NOT_CLOSED"):
        jb.complex_modes(lin)
