"""Hard points as parameters: one name moves a point in all bodies, closures, elements and the wheel
that have it."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxbody as jb
from jaxbody.fitting.parameters.spaces import space_of

TRAVEL = np.array([-0.04, 0.0, 0.06])
READY = {
    "double wishbone": jb.suspension.double_wishbone,
    "macpherson": jb.suspension.macpherson,
    "five links": jb.suspension.five_link,
    "solid axle": jb.suspension.solid_axle,
}
SHIFT = np.array([0.004, -0.003, 0.006])


@pytest.mark.long
@pytest.mark.parametrize("name", READY)
def test_a_moved_suspension_is_the_one_built_from_the_moved_points(name):
    """In every number of the model and the wheel, for each point by itself. (Which speeds count as
    independent stays as it was drawn.)"""
    drawn = READY[name]()
    for point, place in drawn.hard_points.items():
        moved, anew = (of({point: np.asarray(place) + SHIFT}) for of in (drawn.moved, READY[name]))
        changed = 0
        for a, b, before in zip(*map(jax.tree.leaves, (moved, anew, drawn)), strict=True):
            np.testing.assert_allclose(a, b, rtol=1e-12, atol=1e-12)
            changed += not np.array_equal(b, before)
        assert changed > 1  # the list of hard points is one


@pytest.mark.long
def test_what_is_no_point_stays():
    """A stiffness that was changed, and the compression of the spring in the design position."""
    corner = jb.suspension.double_wishbone(force=2500.0, radius=0.32)
    corner = jb.suspension.Corner(
        jb.replace(corner.model, {"upright.mass": 33.0}),
        corner.wheel,
        hard_points=corner.hard_points,
        build=corner.build,
    )
    moved = corner.moved({"spring upper": [0.01, 0.54, 0.63]})
    spring, length = (
        moved.model["spring"],
        np.linalg.norm(np.array([0.01, 0.54, 0.63]) - [0.0, 0.7, 0.21]),
    )
    assert float(spring.stiffness * (spring.free_length - length)) == pytest.approx(
        2500.0, rel=1e-12
    )
    assert float(moved.model["upright"].mass) == 33.0 and float(moved.wheel.radius) == 0.32


FREE = ["lower outer", "tie rod inner", "upper inner front", "wheel center"]


@pytest.mark.long
def test_curves_of_a_space_and_their_derivatives_are_those_of_corners_built_anew():
    space = space_of(jb.suspension.double_wishbone(), [*FREE, "upright.mass"], "test")
    assert space.labels[:3] == ["lower outer[0]", "lower outer[1]", "lower outer[2]"]
    assert space.units(space.parameters[0]) == ["m"] * 3
    u = 0.003 * np.random.default_rng(1).normal(size=space.size)
    u[-1] = 0.2
    values = space.values(jnp.asarray(u))

    def toe(corner):
        return corner.curves(TRAVEL)["toe"]

    def with_slopes(function):
        return jax.jit(lambda x: (function(x), jax.jacfwd(function)(x)))

    places = {name: values[name] for name in FREE}
    of_space = with_slopes(lambda u: toe(space.designed(u)[0]))
    (found, slopes), (expected, by_places) = (
        of_space(jnp.asarray(u)),
        with_slopes(lambda x: toe(jb.suspension.double_wishbone(x)))(places),
    )
    np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-12)
    assert float(space.place(jnp.asarray(u))[0]["upright"].mass) == pytest.approx(
        20.0 * np.exp(0.2), rel=1e-12
    )
    of_u = jax.jacfwd(space.values)(jnp.asarray(u))
    np.testing.assert_allclose(
        slopes,
        sum(np.asarray(by_places[n]) @ np.asarray(of_u[n]) for n in FREE),
        rtol=1e-10,
        atol=1e-12,
    )
    np.testing.assert_allclose(slopes[:, -1], 0.0, atol=1e-12)  # curves do not depend on masses
    i, h = 1, 1e-5
    ahead, behind = (of_space(jnp.asarray(u).at[i].add(step))[0] for step in (h, -h))
    np.testing.assert_allclose(slopes[:, i], (ahead - behind) / (2 * h), rtol=1e-6, atol=1e-8)


@pytest.mark.long
def test_tune_moves_a_point_within_its_bounds():
    """The height of the inner end of the tie rod at which toe has no slope over travel, from
    Newton's steps by hand."""
    corner = jb.suspension.double_wishbone()

    def slope(corner):
        return corner.curves(0.0).slopes["travel"]["toe"][0]

    def goal(corner):
        return {"objective": slope(corner) ** 2, "slope": slope(corner)}

    bounds = {"tie rod inner": ([0.05, 0.2, 0.24], [0.05001, 0.20001, 0.28])}
    design = jb.tune(corner, goal, free=["tie rod inner"], bounds=bounds)
    z = float(design.values["tie rod inner"][2])
    assert (
        isinstance(design.suspension, jb.suspension.Corner) and design.suspension.model is not None
    )
    np.testing.assert_allclose(
        design.suspension.hard_points["tie rod inner"], design.values["tie rod inner"], atol=1e-15
    )
    np.testing.assert_allclose(
        design.model["tie rod"].a, design.values["tie rod inner"], atol=1e-15
    )
    assert 0.24 < z < 0.28 and abs(float(design.after["slope"])) < 1e-6


def test_measured_wheels_of_an_axle_move_with_their_own_hard_points():
    axle = jb.suspension.solid_axle()
    rig = jb.fitting.MeasuredCurves(
        axle.right,
        drive={"left": axle.left, "right": axle.right},
        over={"left": [0.0], "right": 0.0},
        measured={"toe": [0.0]},
    )
    moved = rig.on(axle, axle.moved({"right wheel center": [0.0, -0.76, 0.32]}))
    np.testing.assert_allclose(moved.wheel.center, [0.0, -0.76, 0.32], atol=1e-15)
    np.testing.assert_allclose(moved.driven["right"].center, [0.0, -0.76, 0.32], atol=1e-15)
    np.testing.assert_array_equal(moved.driven["left"].center, axle.left.center)


def test_bad_input():
    corner = jb.suspension.double_wishbone()
    with pytest.raises(jb.JaxbodyError, match=r"lower outr.*UNKNOWN_PATH"):
        space_of(corner, ["lower outr"], "test")
    with pytest.raises(
        jb.JaxbodyError, match=r"lower outr.*Did you mean 'lower outer'.*UNKNOWN_NAME"
    ):
        corner.moved({"lower outr": [0, 0, 0]})
    with pytest.raises(jb.JaxbodyError, match="WRONG_SIDE"):
        corner.moved({"lower outer": [0, -0.9, 0.2]})
    with pytest.raises(jb.JaxbodyError, match=r"lower outer.*START_OUTSIDE"):
        space_of(corner, ["lower outer"], "test", bounds={"lower outer": (-0.1, 0.1)})
