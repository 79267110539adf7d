"""The space of free parameters, the same for fits and designs: values, bounds of ties, priors,
units, starts; problems all at once."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxbody as jb
from jaxbody.fitting.parameters.spaces import around, drawn, space_of
from jaxbody.fitting.parameters.transforms import Fraction, Ordered, Positive, Shifted

FREE = [
    "left.stiffness = right.stiffness * 2",
    "left.a = right.a * [1, -1, 1]",
    "body.mass",
    "body.orientation",
]


@pytest.fixture(scope="module")
def model():
    springs = {
        name: jb.Spring(
            ("body", [0.5, y, 0]),
            ("world", [0.5, y, -1]),
            stiffness=k,
            free_length=1.0,
            damping=0.0,
        )
        for name, y, k in (("left", 0.3, 20.0), ("right", -0.3, 10.0))
    }
    return jb.Model(bodies={"body": jb.Body(mass=2.0, inertia=[1, 1, 1])}, elements=springs)


def test_a_design_space_is_a_fits_parameters_without_runs(model):
    """x0 exp(u) for stiffness and mass, x0 + max |x0| u for points; the other side as tied."""
    u = jnp.linspace(-0.3, 0.4, 8)
    for space in (space_of(model, FREE, "fit"), space_of(model, FREE, "tune", between=True)):
        moved, runs = eqx.filter_jit(space.place)(u)
        assert space.size == 8 and runs == {}
        np.testing.assert_allclose(moved["left"].stiffness, 20 * np.exp(u[0]), rtol=1e-14)
        np.testing.assert_allclose(moved["right"].stiffness, 10 * np.exp(u[0]), rtol=1e-14)
        np.testing.assert_allclose(
            moved["left"].a, [0.5 + 0.5 * u[1], 0.3 + 0.5 * u[2], 0.5 * u[3]], rtol=1e-14
        )
        np.testing.assert_allclose(
            moved["right"].a, moved["left"].a * np.array([1, -1, 1]), rtol=1e-14
        )
        np.testing.assert_allclose(moved["body"].mass, 2 * np.exp(u[4]), rtol=1e-14)
        assert (
            space.labels[:2] == ["left.stiffness", "left.a[0]"]
            and space.names[0] == "left.stiffness = right.stiffness * 2"
        )
        assert [space.units(parameter)[0] for parameter in space.parameters] == [
            "N/m",
            "m",
            "kg",
            "",
        ]
        assert [np.isinf(end).all() for end in space.bounds] == [True, True]


@pytest.mark.nan
def test_bounds_and_priors_of_any_leaf_are_those_of_the_first(model):
    """5 <= k_right <= 15 is 10 <= k_left <= 30; for the mirrored coordinate sides change; of two
    bounds the narrower one counts."""
    bounds = {
        "right.*ss": (5.0, 15.0),
        "left.stiffness": (8.0, 25.0),
        "right.a": ([0.0, -0.4, -1.0], [1.0, -0.1, 2.0]),
    }
    space = space_of(model, FREE, "fit", bounds=bounds, priors={"right.stiffness": (11.0, 0.5)})
    low, high = (space.values(end) for end in space.bounds)
    np.testing.assert_allclose(
        [low["left.stiffness"], high["left.stiffness"]], [10.0, 25.0], rtol=1e-14
    )
    np.testing.assert_allclose(
        [low["left.a"], high["left.a"]], [[0.0, 0.1, -1.0], [1.0, 0.4, 2.0]], atol=1e-15
    )
    np.testing.assert_allclose(space.parameters[0].prior, [22.0, 1.0], rtol=1e-15)
    springs = space_of(model, FREE[0], "tune", bounds={"*.stiffness": (5.0, 25.0)})
    for points in (
        around(space, 16, 0.5, 0),
        drawn(springs, *springs.bounds, 16, jax.random.key(0), "tune.bounds"),
    ):
        k = 20 * np.exp(points[:, 0])
        assert (k >= 10 * (1 - 1e-14)).all() and (k <= 25 * (1 + 1e-14)).all() and np.ptp(k) > 5


def test_a_design_reaches_a_bound_of_zero_and_a_fit_comes_near(model):
    ends = {"body.mass": (0.0, 8.0)}
    fitted, tuned = (
        space_of(model, "body.mass", where, bounds=ends, between=where == "tune")
        for where in ("fit", "tune")
    )
    assert fitted.bounds[0][0] == -np.inf and tuned.values(tuned.bounds[0])["body.mass"] == 0
    # u is scaled by half the range
    np.testing.assert_allclose(np.diff(tuned.bounds, axis=0), 2.0, rtol=1e-15)
    for space in (fitted, tuned):
        np.testing.assert_allclose(space.values(space.bounds[1])["body.mass"], 8.0, rtol=1e-14)
    damped = space_of(
        model, "left.damping", "tune", bounds={"left.damping": (0.0, 4.0)}, between=True
    )  # from zero, no logarithm
    assert damped.values(damped.bounds[1])["left.damping"] == 4.0


def test_a_start_at_a_bound_may_be_outside_by_rounding_only(model):
    space_of(model, "body.mass", "fit", bounds={"body.mass": (2.0 * (1 + 1e-12), 3.0)})
    with pytest.raises(jb.JaxbodyError, match="START_OUTSIDE"):
        space_of(model, "body.mass", "fit", bounds={"body.mass": (2.0 * (1 + 1e-6), 3.0)})


def test_all_problems_of_parameters_are_reported_at_once(model):
    bounds = {
        "body.orientation": (0.0, 1.0),
        "left.stiffness": (20.0, 30.0),
        "right.stiffness": (5.0, 10.0),
        "body.m": (1.0, 2.0),
    }
    with pytest.raises(jb.JaxbodyError) as caught:
        space_of(
            model, [*FREE, "left.damping"], "fit", bounds=bounds, priors={"body.mass": (2.0, 0.0)}
        )
    assert [(problem.code, problem.where) for problem in caught.value.problems] == [
        ("UNKNOWN_PATH", "fit.bounds"),
        ("BAD_BOUNDS", "fit.bounds['right.stiffness']"),  # nothing but 20 is left for the left one
        ("BAD_PRIOR", "fit.priors['body.mass']"),
        ("BAD_BOUNDS", "fit.bounds['body.orientation']"),
        ("START_ON_BOUND", "left.damping"),
    ]


def test_directions_in_rows_stay_of_length_one_and_tilt_each_by_itself():
    """Two small tilts turn a direction by their length, normal to it, and no other; the formula
    is (n + t)/|n + t|."""
    rows = np.array([[1.0, 2.0, 2.0], [0.0, -3.0, 4.0]])
    joint = jb.joints.Composite("world", ["turn", "move"], directions=rows, points=np.zeros((2, 3)))
    body = jb.Model(bodies={"body": jb.Body(mass=2.0, inertia=[1, 1, 1])}, joints={"body": joint})
    space = space_of(body, ["body.directions"], "fit")
    n = rows / np.linalg.norm(rows, axis=1, keepdims=True)
    assert space.labels == [f"body.directions[{row}, tilt {i}]" for row in (0, 1) for i in (1, 2)]
    moved = np.asarray(space.place(jnp.array([0.3, -0.2, 0.0, 0.0]))[0].joint("body").directions)
    np.testing.assert_allclose(np.linalg.norm(moved, axis=1), 1, rtol=1e-15)
    np.testing.assert_allclose(
        np.arccos(moved[0] @ n[0]), np.arctan(np.hypot(0.3, 0.2)), rtol=1e-12
    )
    np.testing.assert_allclose(moved[1], n[1], rtol=1e-15)


@pytest.mark.parametrize("kind", [Positive, Fraction, Shifted, Ordered])
def test_slopes_of_numbers_are_the_derivatives_of_their_values(kind):
    """By differences, away from the start; of a row in order, the first number and the steps."""
    start = jnp.array([0.2, 0.3, 0.7])
    form = kind(start, *([jnp.array(1.3)] if kind in (Shifted, Ordered) else []))
    u, h = np.array([0.4, -0.7, 1.1]), 1e-6

    def numbers(u):
        x = np.asarray(form.value(jnp.asarray(u)))
        return np.r_[x[:1], np.diff(x)] if kind is Ordered else x

    x, slopes = form.numbers(u)
    np.testing.assert_allclose(x, numbers(u), rtol=1e-14)
    np.testing.assert_allclose(
        slopes,
        np.diag([(numbers(u + h * e) - numbers(u - h * e)) / (2 * h) for e in np.eye(3)]),
        rtol=1e-8,
    )
