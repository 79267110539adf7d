"""Reactions of joints in the responses of closed loops: those of the same bodies on a tree of
joints, and those that a motion has."""

import numpy as np
import pytest
import rigs

import jaxbody as jb

FREQUENCIES = np.array([0.3, 1.1, 4.0])


def swing(tip):
    """An arm that hangs aslant from a base, and a tip on a hinge of the arm, by a joint or by
    a closure."""
    parts = {
        "arm": jb.Body(mass=2.0, inertia=[0.3, 0.2, 0.4], com=[0.1, -0.4, 0.05]),
        "tip": jb.Body(
            mass=1.5, inertia=[0.05, 0.06, 0.07], com=[0.02, -0.3, 0], position=[0, -0.8, 0]
        ),
    }
    pin = ("arm", [0, -0.8, 0]), ("tip", [0, 0, 0])
    return jb.Model(
        bodies=parts,
        supports={"base": jb.Support([0.1, 0.2, 0.3])},
        joints={"arm": jb.Hinge("base", axis="z", at=[-0.1, -0.2, -0.3])}
        | ({"tip": jb.Hinge("arm", axis="z")} if tip == "joint" else {}),
        closures={} if tip == "joint" else {"pin": jb.closures.Hinge(*pin, axis="z")},
        elements={
            "coil": jb.Torsion("base", "arm", axis="z", spring=20.0, damper=0.3, free_angle=0.4),
            "knee": jb.Torsion("arm", "tip", axis="z", spring=5.0, damper=0.2, free_angle=-0.7),
        },
        gravity=[0, -9.81, 0],
    )


INPUTS = {
    "push": jb.PointForce("tip", [0, -0.5, 0.1], [1.0, 2.0, 0.5]),
    "shake": jb.BaseMotion("base", "x"),
    "rock": jb.BaseMotion("base", "rz"),
    "acceleration": jb.BaseMotion("base", "y", kind="acceleration"),
}
OUTPUTS = {
    "hinge": jb.sensors.Reaction("arm"),
    "edge": jb.sensors.Reaction("base", [0.3, 0.1, 0.2]),
    "plate": jb.sensors.ForcePlate("base"),
    "moment": jb.sensors.Reaction("arm", [0, -0.2, 0.1], component=3, gain=2.0, lag=0.01),
}


def response(tip):
    model = swing(tip)
    return jb.frequency_response(
        jb.linearize(model, jb.equilibrium(model)), FREQUENCIES, INPUTS, OUTPUTS
    )


@pytest.mark.long
def test_they_are_those_of_a_tree():
    """1e-9: equilibria have residuals of 1e-9 of the weights."""
    tree, loop = response("joint"), response("closure")
    assert tree.outputs == loop.outputs and len(tree.outputs) == 19
    scale = np.max(np.abs(tree.values), axis=(1, 2))
    assert np.all(
        np.max(np.abs(loop.values - tree.values), axis=(1, 2)) <= 1e-9 * np.maximum(scale, 1.0)
    )


@pytest.mark.long
def test_of_a_slider_crank_they_are_the_changes_of_a_motions_reactions():
    """Central differences of the readings at the start of a motion: their error is 1e-4^2 of
    third derivatives."""
    crank, coupler = 0.2, 0.3
    spring = jb.Torsion("world", "crank", axis="z", spring=60.0, damper=0.5)
    model = rigs.slider_crank({"spring": spring}, "base", crank, coupler)
    rest = jb.equilibrium(model)
    lin = jb.linearize(model, rest)
    outputs = {
        "foot": jb.sensors.Reaction("crank"),
        "pin": jb.sensors.Reaction("coupler"),
        "base": jb.sensors.ForcePlate("base"),
    }
    system = lin.state_space({"push": jb.PointForce("coupler", direction="y")}, outputs)

    def reading(displacement, speed):
        N = lin.dependent.N[:, 0]
        start = jb.State(rest.state.q + displacement * N, speed * N)
        read = jb.measure(jb.simulate(model, [0.0, 1e-3], initial=start), outputs)
        return np.concatenate([read[name][0] for name in outputs])

    h = 1e-4
    found = [
        (reading(h * a, h * b) - reading(-h * a, -h * b)) / (2 * h) for a, b in ((1, 0), (0, 1))
    ]
    np.testing.assert_allclose(
        system.C, np.transpose(found), rtol=1e-6, atol=1e-6 * np.max(np.abs(system.C))
    )
