"""Curves whose free motions are in equilibrium: closed forms, equilibria under the wheel force,
ideal joints as a limit."""

import jax
import numpy as np
import pytest
from scipy.optimize import brentq

import jaxbody as jb
from jaxbody.model.joints.frame_tables import frames_of

# stiffnesses along y and of an inclined spring; its free length; its height at rest
SIDE, SPRING, LENGTH, OVER = 4e4, 3e4, 0.5, 0.6
TRAVEL = np.array([-0.05, 0.0, 0.04])


def carriage(side=SIDE, spring=SPRING):
    """A wheel that does not turn, held along x and y by a bushing, with an inclined spring
    above it."""
    return jb.Model(
        bodies={"upright": jb.Body(mass=10.0, inertia=[1, 1, 1])},
        joints={"upright": jb.Translation("world")},
        elements={
            "side": jb.Bushing(
                ("upright", [0, 0, 0]),
                ("world", [0, 0, 0]),
                stiffness=np.diag([1e5, side, 0, 0, 0, 0]),
            ),
            "strut": jb.Spring(
                ("upright", [0, 0, 0]),
                ("world", [0, 0.2, OVER]),
                stiffness=spring,
                free_length=LENGTH,
            ),
        },
    )


WHEEL = jb.suspension.Wheel("upright", center=[0, 0, 0], axis="y", radius=0.3)


def curves(model, push=0.0):
    loads = {"push": jb.Force("upright", force=[0, push, 0])}
    return jb.suspension.suspension_curves(
        model,
        drive={"travel": WHEEL},
        over={"travel": TRAVEL},
        wheel=WHEEL,
        equilibrium=True,
        loads=loads,
    )


def y_of(z, push, side=SIDE, spring=SPRING):
    """Where the force along y is zero."""

    def force(y):
        length = np.hypot(0.2 - y, OVER - z)
        return push - side * y + spring * (length - LENGTH) * (0.2 - y) / length

    return brentq(force, -0.2, 0.19, xtol=1e-15)


@pytest.mark.long
@pytest.mark.parametrize("push", [0.0, 500.0])
def test_a_wheel_goes_aside_until_both_springs_balance(push):
    """1e-11: brentq and the search end at 1e-12 of the size."""
    found = curves(carriage(), push)
    expected = [y_of(z, push) for z in TRAVEL]
    assert found.ok.all()
    np.testing.assert_allclose(found["wheel y"], expected, atol=1e-11)
    length = np.hypot(0.2 - np.array(expected), OVER - TRAVEL)
    # the least force that holds the height: dV/dz at fixed y
    lift = -SPRING * (length - LENGTH) * (OVER - TRAVEL) / length
    np.testing.assert_allclose(
        found["wheel force"] - push * found.slopes["travel"]["wheel y"], lift, rtol=1e-9
    )


@pytest.mark.long
def test_derivatives_by_stiffnesses_and_loads():
    """Differences of a closed form; the wheel rate is a derivative of the third order of
    the energy."""

    def rate(x):
        side = np.diag([1e5, 0, 0, 0, 0, 0]) + np.diag([0, 1.0, 0, 0, 0, 0]) * x[0]
        found = curves(
            jb.replace(carriage(), {"side.stiffness": side, "strut.stiffness": x[1]}), x[2]
        )
        return found["wheel y"], found["wheel rate"]

    x = np.array([SIDE, SPRING, 500.0])
    y, by_rate = jax.jacfwd(rate)(x)
    for i, h in enumerate(1e-4 * x):
        up, down = (rate(x + s * h * np.eye(3)[i]) for s in (1, -1))
        np.testing.assert_allclose(by_rate[:, i], (up[1] - down[1]) / (2 * h), rtol=1e-6)
        exact = [
            (
                y_of(z, *(x + h * np.eye(3)[i])[[2, 0, 1]])
                - y_of(z, *(x - h * np.eye(3)[i])[[2, 0, 1]])
            )
            / (2 * h)
            for z in TRAVEL
        ]
        np.testing.assert_allclose(y[:, i], exact, rtol=1e-6)


@pytest.mark.long
def test_what_has_no_minimum_of_energy_is_unstable_and_loads_need_an_equilibrium():
    pushed = carriage(side=100.0, spring=SPRING)
    # a compressed spring above buckles aside
    pushed = jb.replace(pushed, {"strut.b": [0, 0, OVER], "strut.free_length": 0.8})
    with pytest.warns(jb.JaxbodyWarning, match="UNSTABLE"):
        found = curves(pushed)
    assert np.isnan(found["wheel y"]).all()
    with pytest.raises(
        jb.JaxbodyError, match=r"suspension_curves.loads.*equilibrium=True.*BAD_OPTION"
    ):
        jb.suspension.suspension_curves(
            carriage(),
            drive={"travel": WHEEL, "x": "upright.q.0", "y": "upright.q.1"},
            over={"travel": TRAVEL, "x": 0.0, "y": 0.0},
            wheel=WHEEL,
            loads={"push": jb.Force("upright", force=[0, 1, 0])},
        )
    bare = jb.Model(
        bodies={"upright": jb.Body(mass=10.0, inertia=[1, 1, 1])},
        joints={"upright": jb.Translation("world")},
    )
    with pytest.raises(
        jb.JaxbodyError, match=r"equilibrium: has no elements to rest on.*BAD_OPTION"
    ):
        curves(bare)
    with pytest.raises(jb.JaxbodyError, match=r"freedoms remain.*equilibrium=True.*UNDRIVEN"):
        jb.suspension.suspension_curves(
            carriage(), drive={"travel": WHEEL}, over={"travel": TRAVEL}, wheel=WHEEL
        )


@pytest.fixture(scope="module")
def elastic():
    """A double wishbone with bushings at its arms and an elastic tie rod."""
    corner = jb.suspension.double_wishbone()
    bushing = jb.suspension.Compliance(stiffness=[5e6, 5e6, 5e6, 5e4, 5e4, 20.0], damping=10.0)
    joints = {
        "lower arm": bushing,
        "upper arm": bushing,
        "tie rod": jb.suspension.Compliance(stiffness=5e6),
    }
    return corner, jb.suspension.compliant(corner.model, joints)


def of_corner(corner, model, travel=TRAVEL, **more):
    over = {"travel": travel, "steering": 0.0}
    return jb.suspension.suspension_curves(
        model, drive=corner.drive, over=over, wheel=corner.wheel, equilibrium=True, **more
    )


@pytest.mark.long
def test_an_elastic_corner_is_where_the_force_that_lifts_it_puts_it(elastic):
    """An equilibrium under the wheel force of a row has its travel and its angles: two searches
    with nothing in common."""
    corner, model = elastic
    found = of_corner(corner, model)
    held = jb.Model(
        bodies={name: model[name] for name in model.layout.bodies},
        joints={name: model.joint(name) for name in model.layout.bodies}
        | {"rack": jb.Fixed("world")},
        closures={name: model[name] for name in model.closure_names},
        elements={name: model[name] for name in model.element_names},
    )

    def lift(force):
        return {"road": jb.Force(("upright", corner.wheel.center), force=[0, 0, force])}

    start = jb.equilibrium(held, loads=lift(2100.0)).state
    for i, travel in enumerate(TRAVEL):
        at = jb.equilibrium(held, start=start, loads=lift(found["wheel force"][i]))
        pose = frames_of(held, at.state)[held.layout.frame("upright")].pose()
        center, axis = (
            np.asarray(pose.point(corner.wheel.center)),
            np.asarray(pose.R @ corner.wheel.axis),
        )
        # 1e-9 of the force over the wheel rate
        assert center[2] - float(corner.wheel.center[2]) == pytest.approx(travel, abs=1e-8)
        assert abs(np.arctan2(axis[0], axis[1])) == pytest.approx(
            abs(float(found["toe"][i])), abs=1e-8
        )


@pytest.mark.long
def test_ideal_joints_are_the_limit_of_stiff_bushings(elastic):
    corner, model = elastic
    ideal, paths = corner.curves(TRAVEL), jb.parameter_paths(model, "*.stiffness")
    errors = []
    for factor in (10.0, 100.0, 1000.0):
        stiffer = {
            path: np.asarray(k) * factor for path, k in paths.items() if path != "spring.stiffness"
        }
        stiffer |= {
            path: k - np.diag([0, 0, 0, 0, 0, 20.0 * factor])
            for path, k in stiffer.items()
            if np.ndim(k) == 2
        }  # hinges stay free
        errors.append(
            np.max(np.abs(of_corner(corner, jb.replace(model, stiffer))["toe"] - ideal["toe"]))
        )
    np.testing.assert_allclose(np.divide(errors[:-1], errors[1:]), 10.0, rtol=0.05)
