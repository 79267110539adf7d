"""Fronts against closed forms: a quarter car between comfort and travel, three circles, and
objectives without a conflict."""

import warnings

import jax.numpy as jnp
import numpy as np
import pytest

import jaxbody as jb

MS, MU, KT = 375.0, 75.0, 193000.0
W = 2 * np.pi**2 * 0.1**2 * 256e-6 * 20.0  # intensity of a class C road at 20 m/s
BAND = jb.vibration.Band(1e-4, 1e5, points=801)
ROAD = jb.vibration.RoadRoughness.iso("C").at_speed(20.0)
ASKED = {"comfort": jb.Acceleration("body", axis="z"), "travel": jb.Elongation("suspension")}


@pytest.fixture(scope="module")
def car():
    return jb.presets.quarter_car(damping=1500.0)


def ride(model):
    result = jb.random_response(
        jb.linearize(model, model.reference),
        BAND,
        {"road": jb.BaseMotion("road", "z")},
        ASKED,
        {"road": ROAD},
    )
    return {name: result[name] for name in ASKED}


@pytest.mark.long
def test_comfort_against_travel_is_the_closed_form(car):
    """On the softest spring all along; travel fixes the damper, c = W M/(2 travel^2), and that the
    acceleration; its end is c = ks sqrt(M/kt). Slopes are those of the curve."""
    bounds = {"suspension.stiffness": (15e3, 60e3), "suspension.damping": (300.0, 4000.0)}
    front = jb.pareto(
        car, ride, minimize=["comfort", "travel"], free=list(bounds), bounds=bounds, points=9
    )
    assert front.ok.all() and len(front.status) == 9
    travel, M, ks = front.objectives["travel"], MS + MU, 15e3

    def least(travel):
        c = W * M / (2 * travel**2)
        return np.sqrt(W / 2 * (M * ks**2 / (c * MS**2) + KT * c / MS**2))

    np.testing.assert_allclose(front.objectives["comfort"], least(travel), rtol=1e-3)
    np.testing.assert_allclose(
        front.values["suspension.damping"][-1], ks * np.sqrt(M / KT), rtol=1e-3
    )
    np.testing.assert_allclose(front.values["suspension.damping"][0], 4000.0, rtol=1e-6)
    h = 1e-4 * travel[1:-1]
    np.testing.assert_allclose(
        front.slopes[1:-1, 0],
        (least(travel[1:-1] + h) - least(travel[1:-1] - h)) / (2 * h),
        rtol=5e-3,
    )
    x, y = ((v - v.min()) / np.ptp(v) for v in (travel, front.objectives["comfort"]))
    apart = np.hypot(np.diff(x), np.diff(y))
    assert apart.max() < 2.5 * np.median(apart) and (np.diff(travel) > 0).all()  # spread along it
    assert "Front of comfort and travel" in str(front) and front.to_xarray()["travel"].shape == (9,)


def distances(model):
    """From three corners of a triangle, squared, in the plane of two logarithms."""
    x, y = (
        jnp.log(model["suspension"].stiffness / 35000.0),
        jnp.log(model["suspension"].damping / 1500.0),
    )
    return {
        "one": x**2 + y**2,
        "two": (x - 1) ** 2 + y**2,
        "three": x**2 + (y - 1) ** 2,
        "same": 2 * (x**2 + y**2),
    }


PLANE = dict(
    free=["suspension.stiffness", "suspension.damping"],
    bounds={"suspension.stiffness": (1e4, 2e5), "suspension.damping": (300.0, 9e3)},
)


def test_points_of_a_front_lie_about_equally_far_apart(car):
    """sqrt(f1) + sqrt(f2) = 1, as steep as can be at either end: along the tangent steps are equal
    to a factor of three; without its slope the first alone is half the front."""
    front = jb.pareto(car, distances, minimize=["one", "two"], points=12, **PLANE)
    one, two = front.objectives["one"], front.objectives["two"]
    np.testing.assert_allclose(np.sqrt(np.abs(one)) + np.sqrt(np.abs(two)), 1, rtol=1e-3)
    apart = np.hypot(np.diff(one), np.diff(two))
    assert len(one) == 12 and (apart > 0.05).all() and (apart < 0.25).all(), apart


@pytest.mark.long
def test_three_objectives_have_the_triangle_between_their_corners(car):
    front = jb.pareto(car, distances, minimize=["one", "two", "three"], points=25, **PLANE)
    x, y = (
        np.log(front.values["suspension.stiffness"] / 35000.0),
        np.log(front.values["suspension.damping"] / 1500.0),
    )
    assert (x > -1e-4).all() and (y > -1e-4).all() and (x + y < 1 + 1e-4).all()
    assert len(x) >= 12 and np.ptp(x) > 0.99 and np.ptp(y) > 0.99
    assert front.to_xarray()["slope over three"].shape == x.shape


@pytest.mark.long
def test_a_front_is_the_same_by_two_processes(car):
    """Its ends are searched from 18 initial designs, each of which is a chunk."""
    pytest.importorskip("loky", reason="needs jaxbody[cluster]")
    options = dict(minimize=["one", "two"], points=4, starts=18, **PLANE)
    with warnings.catch_warnings():
        # of four points one does not converge, in either way
        warnings.simplefilter("ignore", jb.JaxbodyWarning)
        one, two = (jb.pareto(car, distances, workers=workers, **options) for workers in (None, 2))
    assert (one.status == two.status).all() and len(two.status) == 4
    for name, objective in one.objectives.items():
        np.testing.assert_array_equal(objective, two.objectives[name])


def test_objectives_that_agree_have_one_design(car):
    front = jb.pareto(car, distances, minimize=["one", "same"], **PLANE)
    assert len(front.status) == 1 and abs(front.objectives["one"][0]) < 1e-8


@pytest.mark.parametrize(
    "options", [dict(minimize=["one"]), dict(minimize=["one", "two"], points=2)]
)
def test_bad_input_is_reported(car, options):
    with pytest.raises(
        jb.JaxbodyError, match=r"two or three different names|a whole number >= 3"
    ) as caught:
        jb.pareto(car, distances, **options, **PLANE)
    assert caught.value.code == "BAD_FRONT"
