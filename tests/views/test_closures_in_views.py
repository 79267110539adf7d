"""Closures in views and drawings: what is drawn is where the poses of the model are, in
every frame."""

import numpy as np
import pytest

import jaxbody as jb
from jaxbody.model.models import drawn_reference
from jaxbody.views.scenes.poses import CYCLE, still
from jaxbody.views.scenes.scenes import animation_of

BAR = jb.Body(mass=0.5, inertia=[1e-3, 2e-3, 2e-3])
G, L = 9.81, 0.1


@pytest.fixture(scope="module")
def curves():
    return jb.suspension.double_wishbone().curves(np.linspace(-0.06, 0.06, 5))


@pytest.fixture(scope="module")
def corner(curves):
    return jb.view(curves)


def linkage(**closures):
    """A parallelogram of a crank and a rocker, hung from the world, with these closures between the
    ends of both and a bar."""
    joints = {
        "crank": jb.Hinge("world", axis="z"),
        "rocker": jb.Hinge("world", axis="z", at=[2 * L, 0, 0]),
        "bar": jb.Hinge("crank", axis="z", at=[0, -L, 0]),
    }
    body = jb.Body(mass=0.5, inertia=[1e-3, 1e-3, 1e-3], com=[0, -L / 2, 0])
    spring = jb.Spring(
        ("crank", [0, -L, 0]), ("world", [-2 * L, -L, 0]), stiffness=50.0, free_length=2 * L
    )
    return jb.Model(
        bodies=dict.fromkeys(joints, body),
        joints=joints,
        elements={"spring": spring},
        closures=closures,
        gravity=[0, -G, 0],
    )


PIN = jb.closures.Hinge(("bar", [2 * L, -L, 0]), ("rocker", [2 * L, -L, 0]), axis="z")


def place(pose, point):
    """World positions (n, 3) of a point of a frame, from the poses that a result states."""
    return np.asarray(pose.p) + np.asarray(pose.R) @ np.asarray(point)


def length_as_drawn(part):
    """The distance of the ends of a rod, from the vertices of its mesh in world axes."""
    placed = np.stack([part.at(i).vertices for i in range(len(part.p))])
    low = part.mesh.vertices[:, 2] < 0.5
    return np.linalg.norm(placed[:, low].mean(1) - placed[:, ~low].mean(1), axis=-1)


@pytest.mark.long
def test_a_suspension_moves_over_its_travel(curves, corner):
    """The wheel has the travel of each row, the rod its length, and balls are where both
    bodies are."""
    animation, model = corner.animation, curves.model
    assert len(animation.seconds) == 5 and animation.clock[0] == "travel -60.0 mm, steering 0.0 mm"
    wheel = animation.part("wheels", "upright")
    center = np.stack([curves[f"wheel {x}"] for x in "xyz"], -1)
    np.testing.assert_allclose(wheel.p, center, atol=1e-9)
    camber = -np.arctan2(wheel.R[:, 2, 2], wheel.R[:, 1, 2])
    np.testing.assert_allclose(camber, curves["camber"], atol=1e-9)
    rod = model["tie rod"]
    # all bodies have the axes of the car
    drawn = np.linalg.norm(np.asarray(rod.b) - np.asarray(rod.a))
    np.testing.assert_allclose(
        length_as_drawn(animation.part("closures", "tie rod", "rod")), drawn, atol=1e-6
    )
    np.testing.assert_allclose(
        animation.part("closures", "tie rod", "a").p, np.tile(np.asarray(rod.a), (5, 1)), atol=1e-9
    )
    upright = animation.part("bodies", "upright", "solid")
    on_upright = upright.p + upright.R @ np.asarray(model["upper ball"].b)
    np.testing.assert_allclose(animation.part("closures", "upper ball").p, on_upright, atol=1e-6)
    on_upright = upright.p + upright.R @ np.asarray(rod.b)
    np.testing.assert_allclose(animation.part("closures", "tie rod", "b").p, on_upright, atol=1e-6)
    assert np.ptp(upright.p[:, 2]) > 0.05


@pytest.mark.long
def test_rows_beyond_reach_are_left_out(curves):
    with pytest.warns(jb.JaxbodyWarning):
        partly = jb.suspension.double_wishbone().curves([0.0, 0.02, 1.0])
    assert len(jb.view(partly).animation.seconds) == 2
    with pytest.warns(jb.JaxbodyWarning):
        nowhere = jb.suspension.double_wishbone().curves([1.0])
    with pytest.raises(jb.JaxbodyError, match=r"has no configuration.*NONFINITE"):
        jb.view(nowhere)


@pytest.mark.long
def test_a_motion_moves_pins_and_rods():
    rod = jb.closures.Rod(("crank", [0, -L, 0]), ("rocker", [2 * L, -L, 0]))
    joints = {
        "crank": jb.Hinge("world", axis="z"),
        "rocker": jb.Hinge("world", axis="z", at=[2 * L, 0, 0]),
    }
    both = jb.Model(
        bodies=dict.fromkeys(joints, BAR), joints=joints, closures={"rod": rod}, gravity=[0, -G, 0]
    )
    for model, name, path in (
        (linkage(pin=PIN), "pin", ("closures", "pin")),
        (both, "rod", ("closures", "rod", "b")),
    ):
        v = np.zeros(model.layout.nv)
        v[:] = 2.0
        if name == "pin":
            v[2] = -2.0  # the bar moves without turning
        run = jb.simulate(model, np.linspace(0.0, 0.2, 6), initial=jb.State(model.reference.q, v))
        animation, closure = jb.view(run, speed=0.1).animation, model[name]
        shown = [int(np.argmin(np.abs(np.asarray(run.times) - t))) for t in animation.seconds * 0.1]
        ends = [
            place(run.poses[frame], point)[shown]
            for frame, point in zip(closure.between, closure.points, strict=True)
        ]
        assert np.ptp(ends[0][:, 0]) > 0.3 * L
        np.testing.assert_allclose(
            animation.part(*path).p, ends[0 if name == "pin" else 1], atol=1e-6
        )
        if name == "rod":
            np.testing.assert_allclose(
                length_as_drawn(animation.part("closures", "rod", "rod")), 2 * L, atol=1e-6
            )
        else:
            np.testing.assert_allclose(
                animation.part(*path).R[:, :, 2], np.tile([0.0, 0, 1], (len(shown), 1)), atol=1e-9
            )
            np.testing.assert_allclose(ends[0], ends[1], atol=1e-6)


@pytest.mark.long
def test_modes_stay_closed_at_the_amplitude_that_is_drawn():
    model = linkage(pin=PIN)
    eq = jb.equilibrium(model)
    modes = jb.modes(jb.linearize(model, eq))
    animation = jb.view(modes, at=eq).animation
    assert len(animation.seconds) == CYCLE
    pose = {name: animation.part("bodies", name, "solid") for name in ("bar", "rocker")}
    bar, rocker = (part.p + part.R @ np.array([2 * L, -L, 0]) for part in pose.values())
    assert np.ptp(bar[:, 0]) > 0.02
    np.testing.assert_allclose(bar, rocker, atol=1e-6)
    np.testing.assert_allclose(animation.part("closures", "pin").p, bar, atol=1e-6)


@pytest.mark.long
def test_every_closure_is_drawn_where_it_is():
    ends = ("world", [0.1, 0.2, 0]), ("box", [0.3, 0.1, -0.1])
    kinds = {
        "ball": jb.closures.Ball(*ends),
        "hinge": jb.closures.Hinge(*ends, axis="y"),
        "guide": jb.closures.Guide(*ends, axis=[1, 1, 0]),
        "inline": jb.closures.Inline(*ends, axis="x"),
        "weld": jb.closures.Weld(*ends),
        "rod": jb.closures.Rod(*ends),
    }
    rule = {"rule": jb.closures.Equation(lambda A, B: B.p[0] - A.p[0], ("world", "box"))}
    model = jb.Model(bodies={"box": BAR}, closures=kinds | rule)
    drawn = drawn_reference(model)  # these closures contradict each other
    animation = animation_of(still(model, drawn))
    # a rule has no place
    assert {part.path[1] for part in animation.parts if part.path[0] == "closures"} == set(kinds)
    a, b = (np.array(point) for _, point in ends)
    for path, at in (
        (("ball",), a),
        (("hinge",), a),
        (("weld",), a),
        (("inline", "b"), b),
        (("guide", "b"), b),
        (("rod", "a"), a),
    ):
        np.testing.assert_allclose(animation.part("closures", *path).p[0], at, atol=1e-12)
    for path, axis in (
        (("hinge",), [0, 1, 0]),
        (("guide", "rail"), [0.5**0.5, 0.5**0.5, 0]),
        (("inline", "rail"), [1, 0, 0]),
    ):
        np.testing.assert_allclose(animation.part("closures", *path).R[0, :, 2], axis, atol=1e-12)
    rail = animation.part("closures", "inline", "rail").at(0).vertices
    assert rail[:, 0].min() < a[0] < b[0] < rail[:, 0].max()
