"""Compliance of a wheel: toe and camber per force, against a closed form and against equilibria
under small loads."""

import jax
import numpy as np
import pytest

import jaxbody as jb
from jaxbody.model.joints.kinematics import Coordinates

K_ROD = 4e6


@pytest.fixture(scope="module")
def ideal():
    return jb.suspension.double_wishbone()


@pytest.fixture(scope="module")
def elastic(ideal):
    """The corner with an elastic tie rod, whose rack and height of the wheel are held."""
    model, center = ideal.model, np.asarray(ideal.wheel.center)
    held = jb.closures.Equation(
        lambda A, B: B.point(jax.numpy.asarray(center))[2] - center[2], ("world", "upright")
    )
    still = jb.Model(
        bodies={name: model[name] for name in model.layout.bodies},
        joints={name: model.joint(name) for name in model.layout.bodies}
        | {"rack": jb.Fixed("world")},
        closures={name: model[name] for name in model.closure_names} | {"height": held},
    )
    return jb.suspension.compliant(still, {"tie rod": jb.suspension.Compliance(stiffness=K_ROD)})


@pytest.fixture(scope="module")
def compliance(ideal, elastic):
    return jb.vibration.wheel_compliance(
        jb.linearize(elastic, jb.equilibrium(elastic)), ideal.wheel
    )


@pytest.mark.long
def test_an_elastic_tie_rod_gives_toe_by_a_side_force(ideal, compliance):
    """dtoe/dF = T Y/(k u_y^2), where T and Y are the changes of toe and of the contact's y by
    the rack, whose motion changes the distance of the rod's ends by u_y; likewise for other
    loads and readings."""
    slopes = ideal.curves(0.0, 0.0).slopes["steering"]
    rod = ideal.model["tie rod"]
    u = np.asarray(rod.b - rod.a)
    soft = K_ROD * (u[1] / np.linalg.norm(u)) ** 2
    for load, moved in (
        ("force y", "contact y"),
        ("force x", "contact x"),
        ("force x at the center", "wheel x"),
    ):
        for reading in ("toe", "camber", "wheel y"):
            expected = float(slopes[reading][0] * _of_point(ideal, slopes, moved)) / soft
            # of differences
            assert float(compliance[reading, load]) == pytest.approx(expected, rel=1e-6, abs=1e-15)
    assert abs(float(compliance["wheel z", "force y"])) < 1e-18  # it is held
    assert "deg" in str(compliance) and "1 kN force y" in str(compliance)
    with pytest.raises(jb.JaxbodyError, match=r"'to' is unknown.*Did you mean 'toe'"):
        compliance["to", "force y"]


def _of_point(ideal, slopes, moved):
    """The motion of the point of the upright that is at the contact, or at the center, by
    the rack."""
    if moved.startswith("wheel"):
        return slopes[moved][0]
    at = "xyz".index(moved[-1])
    return _contact_by_rack(ideal)[at]


def _contact_by_rack(ideal):
    """By differences of the poses of the upright."""
    step = 1e-4
    curves = ideal.curves(0.0, [-step, 0.0, step])
    frames = [
        Coordinates(ideal.model).at_rest(q)[ideal.model.layout.frame("upright")].pose()
        for q in np.asarray(curves.q)
    ]
    at = np.array([curves[f"contact {x}"][1] for x in "xyz"])
    contact = np.asarray(frames[1].R).T @ (at - np.asarray(frames[1].p))
    return (np.asarray(frames[2].point(contact)) - np.asarray(frames[0].point(contact))) / (
        2 * step
    )
