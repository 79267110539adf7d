"""Couplings of coordinates: rack and pinion, gears, screws and cams in closed form, derivatives by
the ratio, redundant ones, messages."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import brentq

import jaxbody as jb

G = 9.81
# of the rack, of the pinion about its axis, and of the spring at the pinion
MASS, ABOUT, RADIUS, STIFFNESS = 6.0, 0.02, 0.05, 8.0


def part(mass=1.0, about=ABOUT):
    return jb.Body(mass=mass, inertia=[about] * 3)


def rack_and_pinion():
    """A rack that hangs on a pinion with a torsion spring."""
    return jb.Model(
        bodies={"rack": part(MASS), "pinion": part()},
        joints={"rack": jb.Guide("world", axis=[0, 0, -1]), "pinion": jb.Hinge("world", axis="y")},
        closures={"mesh": jb.closures.Coupling("rack.q", "pinion.q", ratio=RADIUS)},
        elements={"spring": jb.Torsion("world", "pinion", axis="y", spring=STIFFNESS, damper=0.1)},
        gravity=[0, 0, -G],
    )


@pytest.mark.long
def test_a_rack_hangs_on_the_spring_of_its_pinion():
    """k y = m g r: with the pinion's turn y the rack sinks by r y; M = J + m r^2."""
    model = rack_and_pinion()
    eq = jb.equilibrium(model)
    turn = MASS * G * RADIUS / STIFFNESS
    assert eq.ok and eq.stable
    np.testing.assert_allclose(eq.state.q, [RADIUS * turn, turn], rtol=1e-12)
    # it holds the rack
    assert float(eq.closure_reactions["mesh"]["move"]) == pytest.approx(MASS * G, rel=1e-12)
    lin = jb.linearize(model, eq)
    assert len(lin.coordinates) == 1
    inertia = ABOUT + MASS * RADIUS**2
    assert float(jb.modes(lin).frequency[0]) == pytest.approx(
        np.sqrt(STIFFNESS / inertia) / (2 * np.pi), rel=1e-12
    )


@pytest.mark.long
def test_equilibrium_and_frequency_have_derivatives_by_the_ratio():
    model = rack_and_pinion()

    def turn_and_frequency(ratio):
        changed = jb.replace(model, {"mesh.ratio": ratio})
        eq = jb.equilibrium(changed)
        return jnp.stack([eq.state.q[1], jb.modes(jb.linearize(changed, eq)).frequency[0]])

    inertia = ABOUT + MASS * RADIUS**2
    exact = [MASS * G / STIFFNESS, -np.sqrt(STIFFNESS) * MASS * RADIUS / inertia**1.5 / (2 * np.pi)]
    for derivative in (jax.jacfwd, jax.jacrev):
        np.testing.assert_allclose(
            jax.jit(derivative(turn_and_frequency))(RADIUS), exact, rtol=1e-10
        )


@pytest.mark.long
def test_gears_turn_by_their_teeth_any_number_of_turns():
    joints = dict.fromkeys(["first", "second", "third"], jb.Hinge("world", axis="z"))
    couplings = {
        "first pair": jb.closures.Coupling("second.q", "first.q", ratio=-23 / 17),
        "second pair": jb.closures.Coupling("third.q", "second.q", ratio=-17 / 31),
        "both pairs": jb.closures.Coupling("third.q", "first.q", ratio=23 / 31),
    }
    model = jb.Model(bodies=dict.fromkeys(joints, part()), joints=joints, closures=couplings)
    turned = 40.0  # rad
    done = jb.suspension.assemble(
        model, start=jb.State(jnp.array([turned, -50.0, 25.0]), jnp.zeros(3)), hold=["first"]
    )
    assert done.ok and done.freedoms == 1 and len(done.redundant) == 1
    np.testing.assert_allclose(
        done.state.q, [turned, -23 / 17 * turned, 23 / 31 * turned], rtol=1e-14
    )
    assert done.redundant[0] in ("first pair turn", "second pair turn", "both pairs turn")
    slipped = jb.closures.Coupling("third.q", "first.q", function=lambda y: 23 / 31 * y + 0.2)
    with pytest.warns(jb.JaxbodyWarning, match=r"NOT_CLOSED.*pair"):
        done = jb.suspension.assemble(
            jb.Model(
                bodies=dict.fromkeys(joints, part()),
                joints=joints,
                closures=couplings | {"both pairs": slipped},
            )
        )
    assert not done.ok


@pytest.mark.long
def test_a_nut_on_a_screw_has_the_frequency_of_both_motions():
    pitch, mass, about, k = 0.02, 0.4, 3e-5, 900.0
    r = pitch / (2 * np.pi)
    model = jb.Model(
        bodies={"nut": jb.Body(mass=mass, inertia=[1.0, 1.0, about])},
        joints={"nut": jb.joints.Cylindrical("world", axis="z")},
        closures={"thread": jb.closures.Coupling("nut.q.0", "nut.q.1", ratio=r)},
        elements={
            "spring": jb.Spring(
                ("nut", [0, 0, 0]), ("world", [0, 0, 1]), stiffness=k, free_length=1.0
            )
        },
    )
    frequency = jb.modes(jb.linearize(model, jb.equilibrium(model))).frequency
    np.testing.assert_allclose(
        frequency, [np.sqrt(k / (mass + about / r**2)) / (2 * np.pi)], rtol=1e-10
    )


LIFT, SPRING, REST = 0.03, 2.0, 0.6
ANGLES = np.linspace(0.0, np.pi, 400)
CAMS = {
    "function": lambda y: LIFT * (1 - jnp.cos(y)),
    "table": jb.laws.Tabulated(ANGLES, LIFT * (1 - np.cos(ANGLES))),
}


@pytest.mark.long
@pytest.mark.parametrize("kind", CAMS)
def test_a_cam_turns_until_its_spring_balances_the_follower(kind):
    """x = h (1 - cos y), k (y - y0) = m g h sin y; of a table to the error of its interpolation."""
    model = jb.Model(
        bodies={"follower": part(MASS), "cam": part()},
        joints={"follower": jb.Guide("world", axis=[0, 0, -1]), "cam": jb.Hinge("world", axis="y")},
        closures={"contact": jb.closures.Coupling("follower.q", "cam.q", function=CAMS[kind])},
        elements={"spring": jb.Torsion("world", "cam", axis="y", spring=SPRING, free_angle=REST)},
        gravity=[0, 0, -G],
    )
    eq = jb.equilibrium(model, start=jb.State(jnp.array([0.0, 1.0]), jnp.zeros(2)))
    turn = brentq(lambda y: SPRING * (y - REST) - MASS * G * LIFT * np.sin(y), 0.6, 3.0, xtol=1e-14)
    np.testing.assert_allclose(
        eq.state.q, [LIFT * (1 - np.cos(turn)), turn], atol=1e-11 if kind == "function" else 1e-4
    )


@pytest.mark.long
def test_a_corner_is_steered_by_its_pinion():
    corner = jb.suspension.double_wishbone()
    model = corner.model
    names, r = (*model.layout.bodies, "pinion"), 0.007
    bodies = {name: model[name] for name in model.layout.bodies} | {"pinion": part()}
    joints = {name: model.joint(name) for name in model.layout.bodies} | {
        "pinion": jb.Hinge("world", axis="x")
    }
    closures = {name: model[name] for name in model.closure_names} | {
        "mesh": jb.closures.Coupling("rack.q", "pinion.q", ratio=r)
    }
    steered = jb.Model(
        bodies={n: bodies[n] for n in names},
        joints=joints,
        closures=closures,
        elements={"spring": model["spring"]},
    )
    turns = np.array([-2.0, 0.0, 4.0])
    by_pinion = jb.suspension.Corner(steered, corner.wheel, "pinion.q").curves(0.02, turns)
    by_rack = corner.curves(0.02, r * turns)
    for name in ("toe", "camber", "trail", "wheel rate"):
        np.testing.assert_allclose(by_pinion[name], by_rack[name], atol=1e-11, rtol=1e-9)
    np.testing.assert_allclose(
        by_pinion.slopes["steering"]["toe"], r * by_rack.slopes["steering"]["toe"], rtol=1e-9
    )


def test_bad_input():
    with pytest.raises(jb.JaxbodyError, match=r"needs a ratio or a function.*WRONG_KIND"):
        jb.closures.Coupling("rack.q", "pinion.q")
    joints = {"rack": jb.Guide("world", axis="z"), "pinion": jb.Ball("world")}
    coupling = jb.closures.Coupling("rack.q", "pinion.q", ratio=1.0)
    with pytest.raises(
        jb.JaxbodyError,
        match=r"closures\['mesh'\].*pinion.q.*a coordinate of a joint.*UNKNOWN_NAME",
    ):
        jb.Model(bodies=dict.fromkeys(joints, part()), joints=joints, closures={"mesh": coupling})
