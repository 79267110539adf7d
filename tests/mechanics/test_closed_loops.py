"""Equilibria of models with closures: virtual work in closed form, reactions, stability,
derivatives, and failures by name."""

import warnings

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import brentq

import jaxbody as jb
from jaxbody.model.joints.frame_tables import frames_of

G = 9.81
# of the parallelogram: its cranks are drawn hanging, with pins OFFSET to the right of their hinges
CRANK, GROUND, OFFSET = 0.5, 0.3, 0.1
MASSES = {"left": 1.0, "right": 2.0, "coupler": 3.0}
PARTS = {
    "left": [0.0, -CRANK / 2, 0],
    "right": [GROUND, -CRANK / 2, 0],
    "coupler": [GROUND / 2, -CRANK, 0],
}
# stiffness, place and free length of the spring that pulls the coupler to the right
PULL, ANCHOR, FREE = 100.0, 1.0, 0.8
CUTS = ["right pin", "left pin", "right hinge", "left hinge"]


def parallelogram(cut="right pin", *, spring=True, gravity=(0, -G, 0), base="world", supports=None):
    """Two cranks of equal length that carry a coupler, as hinges in space; one of the four is
    a closure."""
    ends = {
        "left hinge": (base, "left", [0, 0, 0]),
        "left pin": ("left", "coupler", [0, -CRANK, 0]),
        "right hinge": (base, "right", [GROUND, 0, 0]),
        "right pin": ("coupler", "right", [GROUND, -CRANK, 0]),
    }
    first, second, at = ends.pop(cut)
    carried, joints = {base}, {}
    while len(joints) < 3:
        for one, other, point in ends.values():
            for parent, body in ((one, other), (other, one)):
                if parent in carried and body not in carried:
                    joints[body], carried = jb.Hinge(parent, axis="z", at=point), carried | {body}
    bodies = {
        name: jb.Body(mass=MASSES[name], inertia=[0.02, 0.03, 0.04], com=com)
        for name, com in PARTS.items()
    }
    pull = jb.Spring(
        ("coupler", [0, -CRANK, 0]), (base, [ANCHOR, -CRANK, 0]), stiffness=PULL, free_length=FREE
    )
    return jb.Model(
        bodies=bodies,
        joints=joints,
        closures={"cut": jb.closures.Hinge((first, at), (second, at), axis="z")},
        elements={"pull": pull} if spring else {},
        supports=supports,
        gravity=gravity,
    )


def pulled_angle(pull=PULL, anchor=ANCHOR):
    """The angle of the cranks by virtual work: sum of m g h'(angle) = tension . displacement'."""
    weight = G * (MASSES["left"] / 2 + MASSES["right"] / 2 + MASSES["coupler"])

    def slope(angle):
        d = np.array([anchor - CRANK * np.sin(angle), -CRANK + CRANK * np.cos(angle)])
        length = np.hypot(*d)
        return (
            CRANK * weight * np.sin(angle)
            - pull * (length - FREE) * CRANK * (d @ [np.cos(angle), np.sin(angle)]) / length
        )

    return brentq(slope, 0.0, 1.0, xtol=1e-15, rtol=1e-15)


def turn_of(model, state, body):
    """The angle of a body about z."""
    R = frames_of(model, state).R[model.layout.frame(body)]
    return float(np.arctan2(R[1, 0], R[0, 0]))


@pytest.mark.long
@pytest.mark.parametrize("cut", CUTS)
def test_a_parallelogram_cut_at_any_joint_is_at_rest_where_virtual_work_is_zero(cut):
    """Four hinges in space: three of the five conditions of each closure are implied, and these
    have no unique reaction."""
    model = parallelogram(cut)
    eq = jb.equilibrium(model)
    angle = pulled_angle()
    assert eq.ok and eq.stable
    np.testing.assert_allclose(
        [turn_of(model, eq.state, name) for name in PARTS], [angle, angle, 0.0], atol=1e-12
    )
    np.testing.assert_allclose(eq.residual, 0, atol=1e-12)
    assert set(eq.redundant) == {"cut z", "cut turn 1", "cut turn 2"}
    reaction = eq.closure_reactions["cut"]
    assert all(np.isnan(reaction[row]) for row in ("z", "turn 1", "turn 2"))
    assert "not unique: cut z" in repr(eq)
    # the crank at the right carries its share by its own moments; half of the coupler hangs on it
    if cut == "right pin":
        c, s = np.cos(angle), np.sin(angle)
        across = -MASSES["right"] * G * s / 2  # moments about its hinge
        assert float(reaction["x"]) * c + float(reaction["y"]) * s == pytest.approx(
            across, abs=1e-12
        )


def test_an_arm_that_hangs_on_a_rod_pulls_it_with_half_its_weight():
    arm = jb.Body(mass=3.0, inertia=[0.01, 0.1, 0.1], com=[0.5, 0, 0])
    rod = jb.closures.Rod(("world", [1.0, 0.7, 0]), ("arm", [1.0, 0, 0]))
    model = jb.Model(
        bodies={"arm": arm},
        joints={"arm": jb.Hinge("world", axis="z", at=[0, 0, 0])},
        closures={"rod": rod},
        gravity=[0, -G, 0],
    )
    eq = jb.equilibrium(model)
    assert eq.ok and eq.redundant == ()
    assert float(eq.closure_reactions["rod"]["length"]) == pytest.approx(1.5 * G, rel=1e-12)


# scissor lift: length and angle of its arms, stiffness of the spring, mass on top
ARM, ANGLE, LIFT, LOAD = 1.2, 0.6, 20000.0, 80.0


def scissor_lift(angle=0.5, *, all_pins=False):
    """Two arms crossed at their middle; the spring between their feet balances the platform
    at ANGLE."""
    free = ARM * np.cos(ANGLE) - LOAD * G * np.cos(ANGLE) / (LIFT * np.sin(ANGLE))
    c, s = ARM * np.cos(angle), ARM * np.sin(angle)
    light = jb.Body(mass=1e-9, inertia=[1e-9, 1e-9, 1e-9], com=[c / 2, s / 2, 0])
    joints = {
        "rising": jb.Hinge("world", axis="z", at=[0, 0, 0]),
        "falling": jb.Hinge("rising", axis="z", at=[c / 2, s / 2, 0]),
        "platform": jb.Guide("world", axis="y"),
    }
    closures = {
        "foot": jb.closures.Inline(("world", [0, 0, 0]), ("falling", [c, 0, 0]), axis="x"),
        "head": jb.closures.Inline(("platform", [0, s, 0]), ("falling", [0, s, 0]), axis="x"),
    }
    if all_pins:
        closures["pin"] = jb.closures.Ball(("platform", [0, s, 0]), ("falling", [0, s, 0]))
        closures["slot"] = jb.closures.Inline(
            ("platform", [0, s, 0]), ("rising", [c, s, 0]), axis="x"
        )
    spring = jb.Spring(
        ("falling", [c, 0, 0]), ("world", [0, 0, 0]), stiffness=LIFT, free_length=free
    )
    bodies = {
        "rising": light,
        "falling": light,
        "platform": jb.Body(mass=LOAD, inertia=[1, 1, 1], com=[c / 2, s, 0]),
    }
    return jb.Model(
        bodies=bodies,
        joints=joints,
        closures=closures,
        elements={"spring": spring},
        gravity=[0, -G, 0],
    )


@pytest.mark.long
@pytest.mark.parametrize("all_pins", [False, True])
def test_a_scissor_lift_is_balanced_by_virtual_work(all_pins):
    """m g L cos a = k (L cos a - l) L sin a, with light arms; pins that repeat what others hold
    change nothing."""
    eq = jb.equilibrium(scissor_lift(all_pins=all_pins))
    assert eq.ok and eq.stable
    np.testing.assert_allclose(eq.state.q[0] + 0.5, ANGLE, atol=1e-11)  # arms of 1e-9 kg
    np.testing.assert_allclose(eq.state.q[2], ARM * (np.sin(ANGLE) - np.sin(0.5)), atol=1e-11)
    heads = [
        value for row, value in eq.closure_reactions["head"].items() if row.startswith("across")
    ]
    if all_pins:
        assert np.isnan(heads).all() and len(eq.redundant) > 2
    else:
        assert (
            np.nanmax(np.abs(heads)) == pytest.approx(LOAD * G, rel=1e-10)
            and len(eq.redundant) == 2
        )


RADIUS, ROD = 0.1, 0.35


def slider_crank(angle):
    """A crank with a weight and a slider, drawn at an angle, joined by a rod without mass."""
    pin = [RADIUS * np.cos(angle), RADIUS * np.sin(angle), 0]
    x = pin[0] + np.sqrt(ROD**2 - pin[1] ** 2)
    bodies = {
        "crank": jb.Body(mass=6.0, inertia=[0.01, 0.01, 0.01], com=pin),
        "slider": jb.Body(mass=1.5, inertia=[0.01, 0.01, 0.01], com=[x, 0, 0]),
    }
    return jb.Model(
        bodies=bodies,
        joints={
            "crank": jb.Hinge("world", axis="z", at=[0, 0, 0]),
            "slider": jb.Guide("world", axis="x"),
        },
        closures={"rod": jb.closures.Rod(("crank", pin), ("slider", [x, 0, 0]), length=ROD)},
        elements={
            "return": jb.Spring(
                ("slider", [x, 0, 0]), ("world", [2.0, 0, 0]), stiffness=600.0, free_length=2.0 - x
            )
        },
        gravity=[0, -G, 0],
    )


@pytest.mark.long
def test_a_slider_crank_holds_a_load():
    """F x'(angle) = m g r cos(angle) + k (x - x_0) x'(angle), and the rod carries what the slider
    does not balance."""
    model, angle, drawn = slider_crank(-1.2), -0.9, -1.2
    place = lambda a: RADIUS * np.cos(a) + np.sqrt(ROD**2 - (RADIUS * np.sin(a)) ** 2)  # noqa: E731
    root = np.sqrt(ROD**2 - (RADIUS * np.sin(angle)) ** 2)
    slope = -RADIUS * np.sin(angle) - RADIUS**2 * np.sin(angle) * np.cos(angle) / root
    spring = 600.0 * (place(angle) - place(drawn))
    load = 6.0 * G * RADIUS * np.cos(angle) / slope + spring
    eq = jb.equilibrium(model, loads={"load": jb.Force("slider", force=[load, 0, 0])})
    assert eq.ok and eq.stable and float(eq.load_factor) == 1.0
    np.testing.assert_allclose(eq.state.q, [angle - drawn, place(angle) - place(drawn)], atol=1e-12)
    assert float(eq.closure_reactions["rod"]["length"]) == pytest.approx(
        (load - spring) * ROD / root, rel=1e-11
    )


@pytest.mark.parametrize("height, negative", [(-0.8, 0), (0.8, 2)])
def test_a_bob_on_a_rod_is_stable_below_its_pivot_alone(height, negative):
    """In its straight coordinates neither weight nor rod have a stiffness: all of it, m g/L both
    ways, is of the curved path."""
    model = jb.Model(
        bodies={"bob": jb.Body(2.0, [1, 1, 1], position=[0, 0, height])},
        joints={"bob": jb.Translation("world")},
        closures={"rod": jb.closures.Rod(("world", [0, 0, 0]), ("bob", [0, 0, 0]))},
        gravity=[0, 0, -G],
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of the upper one
        rest = jb.equilibrium(model)
    assert jb.Status(int(rest.status)).name == ("UNSTABLE" if negative else "OK")
    assert int(rest.negative) == negative and bool(rest.stable) == (not negative)
    np.testing.assert_allclose(
        float(rest.closure_reactions["rod"]["length"]), -np.sign(height) * 2.0 * G, rtol=1e-10
    )


def test_a_closure_that_holds_a_body_upright_bears_the_moment_of_its_weight():
    """A body beside a vertical guide, on a spring along it, exerts the moment r x W on the guide,
    whatever the size of the model."""
    mass, r = 3.0, np.array([0.4, -0.7, 0.2])
    model = jb.Model(
        bodies={"lift": jb.Body(mass, [1, 1, 1], com=r)},
        closures={"rail": jb.closures.Guide(("world", [0, 0, 0]), ("lift", [0, 0, 0]), axis="z")},
        elements={
            "cable": jb.Spring(
                ("lift", [0, 0, 0]), ("world", [0, 0, 5]), stiffness=2e3, free_length=4.9
            )
        },
        gravity=[0, 0, -G],
    )
    reaction = jb.equilibrium(model).closure_reactions["rail"]
    moment = np.cross(r, [0, 0, -mass * G])
    np.testing.assert_allclose(
        [reaction[f"turn {axis}"] for axis in "xyz"], moment, rtol=1e-10, atol=1e-8
    )
    np.testing.assert_allclose([reaction["across 1"], reaction["across 2"]], 0, atol=1e-8)


@pytest.mark.long
def test_supports_carry_what_closures_hand_to_them():
    model = parallelogram("right hinge", base="base", supports={"base": jb.Support()}, spring=False)
    eq = jb.equilibrium(model)
    force, moment = eq.reactions["base"]
    np.testing.assert_allclose(force, [0, -G * sum(MASSES.values()), 0], atol=1e-12)
    about = sum(m * PARTS[name][0] for name, m in MASSES.items())
    np.testing.assert_allclose(moment, [0, 0, -G * about], atol=1e-12)


@pytest.mark.long
def test_load_cases_tilt_the_linkage_as_gravity_tilts():
    model = parallelogram(spring=False)
    cases = jb.load_cases(
        model,
        {
            "corner": jb.LoadCase(acceleration=[0.4, 0, 0]),
            "bump": jb.LoadCase(acceleration=[0, 2.0, 0]),
        },
    )
    assert np.asarray(cases.ok).all()
    side = 0.4 * 9.80665
    np.testing.assert_allclose(
        cases.state.q[0], np.array([-1, -1, 1]) * np.arctan2(side, G), atol=1e-12
    )
    np.testing.assert_allclose(cases.state.q[1], 0, atol=1e-12)


@pytest.mark.long
def test_stability_is_counted_on_the_closures():
    """The parallelogram turned upside down is at rest, with one direction down."""
    model = parallelogram(spring=False)
    with pytest.warns(jb.JaxbodyWarning, match="UNSTABLE.*1 negative"):
        eq = jb.equilibrium(model, start=jb.State(jnp.array([np.pi, np.pi, -np.pi]), jnp.zeros(3)))
    assert int(eq.negative) == 1 and not eq.stable


@pytest.mark.long
def test_equilibria_have_derivatives_by_stiffness_and_by_points():
    model = parallelogram()

    def angle(x):
        changed = jb.replace(
            model,
            {
                "pull.stiffness": x[0],
                "pull.b": jnp.array([x[1], -CRANK, 0]),
                "cut.b": jnp.array([x[2], -CRANK, 0]),
            },
        )
        eq = jb.equilibrium(changed)
        return jnp.stack([eq.state.q[0], eq.state.q[1], eq.closure_reactions["cut"]["y"]])

    x = jnp.array([PULL, ANCHOR, GROUND])
    forward, reverse = jax.jit(jax.jacfwd(angle))(x), jax.jit(jax.jacrev(angle))(x)
    np.testing.assert_allclose(forward, reverse, rtol=1e-9, atol=1e-9 * np.abs(forward).max())
    value = jax.jit(angle)
    for i, h in enumerate([1e-3, 1e-5, 1e-5]):
        step = jnp.zeros(3).at[i].set(h)
        difference = (value(x + step) - value(x - step)) / (2 * h)
        np.testing.assert_allclose(
            forward[:, i], difference, rtol=1e-6, atol=1e-6 * np.abs(forward[:, i]).max()
        )
    exact = (pulled_angle(PULL + 1e-2) - pulled_angle(PULL - 1e-2)) / 2e-2
    assert float(forward[0, 0]) == pytest.approx(exact, rel=1e-8)
    bends = jax.jit(jax.jacfwd(lambda k: jax.jacrev(angle)(x.at[0].set(k))[0, 0]))(PULL)
    second = (pulled_angle(PULL + 1) - 2 * pulled_angle(PULL) + pulled_angle(PULL - 1)) / 1
    assert float(bends) == pytest.approx(second, rel=1e-4)


@pytest.mark.long
def test_failures_are_named():
    with pytest.warns(jb.JaxbodyWarning, match="SINGULAR_K.*free to move together"):
        assert not jb.equilibrium(parallelogram(spring=False, gravity=(0, 0, 0))).ok
    with pytest.warns(
        jb.JaxbodyWarning, match=r"NOT_CLOSED.*'cut . stays|NOT_CLOSED.*'cut .' stays"
    ):
        open_ = jb.replace(parallelogram(), {"cut.b": jnp.array([3.0, -CRANK, 0])})
        assert jb.equilibrium(open_).report().startswith("NOT_CLOSED")
    flat = parallelogram(spring=False, gravity=(G, 0, 0))
    start = jb.State(jnp.array([np.pi / 2, np.pi / 2, -np.pi / 2]), jnp.zeros(3))
    with pytest.warns(jb.JaxbodyWarning, match="SINGULAR_CLOSURE.*smallest singular value"):
        assert not jb.equilibrium(flat, start=start).ok
