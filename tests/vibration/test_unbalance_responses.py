"""The frequency response to a rotating unbalance, against closed forms of a mass on a guide and
against the rotating force itself."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxbody as jb

M, K, C, U = 4.0, 9000.0, 25.0, 3e-3
F = np.array([2.0, 7.5, 20.0])
W = 2 * np.pi * F


def guided(axis, stiffness=K):
    """A mass on a guide along `axis`, held by a spring and a damper."""
    mass = jb.Body(mass=M, inertia=[1, 1, 1])
    end = [0.5 * x for x in axis]
    spring = jb.Spring("mass", ("world", end), stiffness=stiffness, damping=C, free_length=0.5)
    joints = {"mass": jb.Guide("world", axis=axis)}
    return jb.Model(bodies={"mass": mass}, joints=joints, elements={"s": spring})


def response(model, load, along):
    lin = jb.linearize(model, jb.equilibrium(model))
    outputs = {"mass": jb.Position("mass", axis=along)}
    inputs = {"u": load, "f": jb.PointForce("mass", direction=along)}
    return jb.frequency_response(lin, F, inputs, outputs)


@pytest.mark.parametrize(
    ("along", "n"),
    [([1, 0, 0], 1.0), ([0, 0, 1], 1j), ([0, 1, 0], 0.0)],
)
def test_a_mass_on_a_guide(along, n):
    """For a shaft along y, n1 = x and n2 = -z, so that the force u w^2 (n1 - i n2) has the
    components u w^2 (1, 0, i)."""
    load = jb.inputs.Unbalance("mass", axis="y", unbalance=U, frequency=50.0, phase=0.7)
    found = response(guided(along), load, along)
    compliance = 1 / (K + 1j * W * C - W**2 * M)
    expected = U * W**2 * np.exp(0.7j) * n * compliance
    np.testing.assert_allclose(found["mass", "u"], expected, rtol=1e-10, atol=1e-18)
    np.testing.assert_allclose(found["mass", "f"], compliance, rtol=1e-10)
    assert found.unit("mass", "u") == "m" and found.unit("mass", "f") == "m per N"


def test_it_has_derivatives():
    """By the unbalance it is linear; by the stiffness as of a compliance, in both modes."""

    def size(k, u):
        load = jb.inputs.Unbalance("mass", axis="y", unbalance=u, frequency=50.0)
        found = response(guided([1, 0, 0], k), load, [1, 0, 0])
        return jnp.sum(jnp.abs(found["mass", "u"]) ** 2)

    D = K + 1j * W * C - W**2 * M
    force = U * W**2
    by_k = np.sum(-2 * force**2 * D.real / np.abs(D) ** 4)
    by_u = 2 * np.sum(np.abs(force / D) ** 2) / U
    for slope in (jax.jacfwd(size, (0, 1)), jax.jacrev(size, (0, 1))):
        np.testing.assert_allclose(slope(K, U), [by_k, by_u], rtol=1e-9)


def test_the_shaft_turns_with_its_body():
    """A body turned by a right angle about x: its y axis is z of the world."""
    turned = jb.Body(mass=M, inertia=[1, 1, 1], orientation=jb.EulerAngles("X", [np.pi / 2]))
    mount = jb.Bushing("mass", "world", stiffness=K * np.eye(6), damping=C * np.eye(6))
    model = jb.Model(bodies={"mass": turned}, elements={"s": mount})
    load = jb.inputs.Unbalance("mass", axis="y", unbalance=U, frequency=50.0)
    lin = jb.linearize(model, jb.equilibrium(model))
    outputs = {"mass": jb.Position("mass")}
    found = jb.frequency_response(lin, F, {"u": load}, outputs).values[:, 0]
    size = U * W**2 / (K + 1j * W * C - W**2 * M)
    # n1 = x, n2 = z x x = y of the world
    np.testing.assert_allclose(found, [size, -1j * size, 0 * size], rtol=1e-9, atol=1e-15)


def test_a_body_that_is_not_there():
    model = guided([1, 0, 0])
    load = jb.inputs.Unbalance("motor", axis="y", unbalance=U, frequency=50.0)
    with pytest.raises(jb.JaxbodyError, match=r"inputs\['u'\].*UNKNOWN_NAME"):
        response(model, load, [1, 0, 0])
