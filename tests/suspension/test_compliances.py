"""Bushings in the place of joints: ideal joints are their limit, and the toe of a wheel under a
side force in closed form."""

import jax.numpy as jnp
import numpy as np
import pytest

import jaxbody as jb
from jaxbody.model.joints.frame_tables import frames_of

G = 9.81
RADIUS, ROD, ANGLE = 0.1, 0.35, 0.9


def slider_crank():
    """A crank with a weight, and a slider on a spring, joined by a rod; a lever hangs on the slider
    and on a pin that closes no loop."""
    pin = [RADIUS * np.cos(ANGLE), RADIUS * np.sin(ANGLE), 0.0]
    x = pin[0] + np.sqrt(ROD**2 - pin[1] ** 2)
    bodies = {
        "crank": jb.Body(mass=6.0, inertia=[0.03] * 3, com=pin),
        "slider": jb.Body(
            mass=1.5,
            inertia=[0.02] * 3,
            com=[0, 0, 0],
            position=[x, 0, 0],
            orientation=jb.EulerAngles("ZYX", [0.4, 0.2, 0.1]),
        ),
        "lever": jb.Body(mass=0.8, inertia=[0.01] * 3, com=[x, -0.1, 0.02]),
    }
    return jb.Model(
        bodies=bodies,
        joints={
            "crank": jb.Hinge("world", axis="z", at=[0, 0, 0]),
            "slider": jb.Guide("world", axis="x"),
            "lever": jb.Hinge("world", axis="z", at=[x + 0.2, 0, 0]),
        },
        closures={
            "rod": jb.closures.Rod(("crank", pin), ("slider", [0, 0, 0]), length=ROD),
            "guide": jb.closures.Rod(("slider", [0, 0, 0]), ("lever", [x, 0.05, 0])),
        },
        elements={
            "return": jb.Spring(
                ("slider", [0, 0, 0]), ("world", [2.0, 0, 0]), stiffness=600.0, free_length=1.9 - x
            )
        },
        gravity=[0, -G, 0],
    )


@pytest.fixture(scope="module")
def limit():
    """Places of the bodies and the lowest frequency of the ideal mechanism, and of elastic ones
    with bushings stiffer by 10, 100, 1000."""
    model, k = slider_crank(), 2e5
    hinge, slide = (
        jb.suspension.Compliance(stiffness=[k, k, k, k, k, 0.0]),
        jb.suspension.Compliance(stiffness=[k, k, 0.0, k, k, k]),
    )
    joints = {
        "crank": hinge,
        "slider": slide,
        "lever": hinge,
        "rod": jb.suspension.Compliance(stiffness=k),
        "guide": jb.suspension.Compliance(stiffness=k),
    }
    elastic = jb.suspension.compliant(model, joints)

    def settled(model, start=None):
        eq = jb.equilibrium(model, start=start)
        poses = frames_of(model, eq.state)[model.layout.first_body :]
        assert eq.ok and eq.stable
        return (
            np.ravel(poses.point(model.bodies.rows.com)),
            float(jb.modes(jb.linearize(model, eq)).frequency[0]),
            poses,
        )

    own = jb.parameter_paths(elastic, "*.stiffness")
    stiffer = [
        {path: s * x for path, x in own.items() if path != "return.stiffness"}
        for s in (10.0, 100.0, 1000.0)
    ]
    ideal = settled(model)
    start = jb.State(jnp.concatenate([ideal[2].p, ideal[2].quaternion], -1).ravel(), jnp.zeros(18))
    return elastic, ideal, [settled(jb.replace(elastic, values), start) for values in stiffer]


@pytest.mark.long
def test_names_are_kept(limit):
    elastic = limit[0]
    assert elastic.element_names == (
        "return",
        "rod",
        "guide",
        "crank joint",
        "slider joint",
        "lever joint",
    )
    assert elastic.closure_names == () and elastic.layout.nv == 18


@pytest.mark.long
@pytest.mark.parametrize("what", [0, 1], ids=["places", "frequency"])
def test_ideal_joints_are_the_limit_of_stiff_bushings(limit, what):
    """The error is inversely proportional to the stiffness."""
    _, ideal, elastic = limit
    errors = [np.abs(np.subtract(each[what], ideal[what])).max() for each in elastic]
    np.testing.assert_allclose(np.diff(np.log10(errors)), -1.0, atol=0.02)
    assert errors[-1] < 1e-3 * np.abs(ideal[what]).max()


@pytest.mark.long
def test_an_elastic_tie_rod_gives_toe_by_a_side_force():
    """With the wheel's height and the rack held: dtoe/dF = T Y/(k u_y^2), where T and Y are the
    changes of toe and of the contact's y by the rack, whose motion changes the distance of the
    rod's ends by u_y."""
    corner, k = jb.suspension.double_wishbone(), 4e6
    model, wheel = corner.model, corner.wheel
    names = model.layout.bodies
    center, height = np.asarray(wheel.center), float(wheel.center[2])
    held = jb.closures.Equation(
        lambda A, B: B.point(jnp.asarray(center))[2] - height, ("world", "upright")
    )
    still = jb.Model(
        bodies={name: model[name] for name in names},
        joints={name: model.joint(name) for name in names} | {"rack": jb.Fixed("world")},
        closures={name: model[name] for name in model.closure_names} | {"height": held},
    )
    elastic = jb.suspension.compliant(still, {"tie rod": jb.suspension.Compliance(stiffness=k)})
    curves = corner.curves(0.0, 0.0)
    contact = np.array([curves[f"contact {x}"][0] for x in "xyz"])

    def toe(force):
        state = jb.equilibrium(
            elastic, loads={"side": jb.Force(("upright", contact), force=[0, force, 0])}
        ).state
        pose = frames_of(elastic, state)[elastic.layout.frame("upright")]
        return float(wheel.alignment(pose, jnp.array(1.0))["toe"])

    force = 50.0
    u = np.asarray(model["tie rod"].b - model["tie rod"].a)
    u = u / np.linalg.norm(u)
    slopes = curves.slopes["steering"]
    expected = float(slopes["toe"][0] * slopes["contact y"][0]) / (k * u[1] ** 2)
    assert (toe(force) - toe(-force)) / (2 * force) == pytest.approx(expected, rel=1e-6)


@pytest.mark.long
def test_bushings_turn_with_the_axis_of_their_joint_and_take_derivatives():
    """K of a hinge's bushing in axes of the parent: radial, axial and tilting parts about n,
    whatever the body's own axes."""
    n = np.array([0.36, 0.48, 0.8])
    body = jb.Body(
        mass=1.0,
        inertia=[1, 1, 1],
        position=[0.3, 0.2, 0.1],
        orientation=jb.EulerAngles("XYZ", [0.5, -0.4, 1.1]),
    )
    model = jb.Model(bodies={"arm": body}, joints={"arm": jb.Hinge("world", axis=n)})
    elastic = jb.suspension.compliant(
        model,
        {"arm": jb.suspension.Compliance(stiffness=[5.0, 5.0, 2.0, 3.0, 3.0, 1.0], damping=4.0)},
    )
    lin = jb.linearize(elastic, elastic.reference)
    along = np.outer(n, n)
    exact = np.block(
        [
            [5 * np.eye(3) - 3 * along, np.zeros((3, 3))],
            [np.zeros((3, 3)), 3 * np.eye(3) - 2 * along],
        ]
    )
    np.testing.assert_allclose(lin.K, exact, atol=1e-13)
    np.testing.assert_allclose(lin.C, np.diag([4.0, 4, 4, 0, 0, 0]), atol=1e-13)


@pytest.mark.long
def test_bad_input():
    corner = jb.suspension.macpherson()
    with pytest.raises(jb.JaxbodyError, match=r"compliant\['strut'\]: is a Inline.*WRONG_KIND"):
        jb.suspension.compliant(corner.model, {"strut": jb.suspension.Compliance(stiffness=1e6)})
    with pytest.raises(jb.JaxbodyError, match=r"lower ar'.*UNKNOWN_NAME"):
        jb.suspension.compliant(corner.model, {"lower ar": jb.suspension.Compliance(stiffness=1e6)})
    with pytest.raises(jb.JaxbodyError, match="NEGATIVE_STIFFNESS"):
        jb.suspension.compliant(
            corner.model, {"lower arm": jb.suspension.Compliance(stiffness=[1e6, -1e6, 1e6])}
        )
