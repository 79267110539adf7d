"""Roads against quadrature of their profiles: the height under a wheel, its rate, and its
derivatives in all parameters."""

import itertools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import quad

import jaxbody as jb

RNG = np.random.default_rng(8608)
DISTANCES = np.cumsum(RNG.uniform(0.05, 0.8, size=12)) - 1.0
HEIGHTS = 0.1 * RNG.normal(size=12)
STATIONS = RNG.uniform(-3.0, 6.0, size=40)
STEP = [2.0, np.nextafter(2.0, 3.0)], [0.0, 0.15]
LONG = 1000.0


@eqx.filter_jit
def felt_and_slope(road, stations):
    return jax.vmap(jax.value_and_grad(road.felt))(stations)


def felt(distances, heights, stations, footprint):
    return felt_and_slope(
        jb.inputs.Road(distances, heights, speed=1.0, footprint=footprint), jnp.asarray(stations)
    )


def by_quadrature(distances, heights, s, L):
    """The definition, cut at the points of the profile, where it has kinks; in lengths from s, to
    lose no digits to s itself."""
    cuts = np.concatenate([[-L / 2], [d for d in distances - s if abs(d) < L / 2], [L / 2]])
    return (
        sum(
            quad(lambda u: np.interp(u, distances - s, heights), *ends, epsrel=1e-14)[0]
            for ends in itertools.pairwise(cuts)
        )
        / L
    )


@pytest.mark.parametrize("footprint", [0.0, 0.01, 0.3, 2.0, 20.0], ids=lambda L: f"L = {L:g} m")
def test_a_wheel_feels_the_average_over_its_footprint(footprint):
    """20 m is longer than the whole profile, 0.01 m within one piece of it at most stations. The
    slope is (z(front) - z(rear))/L."""
    z, slope = felt(DISTANCES, HEIGHTS, STATIONS, footprint)
    if footprint == 0:
        exact = np.interp(STATIONS, DISTANCES, HEIGHTS)
        i = np.searchsorted(DISTANCES, STATIONS)
        rises = np.concatenate([[0], np.diff(HEIGHTS) / np.diff(DISTANCES), [0]])[i]
    else:
        exact = np.array([by_quadrature(DISTANCES, HEIGHTS, s, footprint) for s in STATIONS])
        rises = (
            np.subtract(
                *(
                    np.interp(STATIONS + side, DISTANCES, HEIGHTS)
                    for side in (footprint / 2, -footprint / 2)
                )
            )
            / footprint
        )
    assert np.abs(z - exact).max() <= 2e-15
    # the division by L
    assert np.abs(slope - rises).max() <= 1e-15 * max(10.0, 1 / (footprint or 1))


@pytest.mark.parametrize("footprint", [0.0, 1e-3, 0.3, 5.0], ids=lambda L: f"L = {L:g} m")
def test_level_and_straight_roads_are_felt_as_they_are(footprint):
    """One linear piece or many, an average of a straight line is the line, to the rounding
    of heights."""
    z, slope = felt(DISTANCES, np.full(12, 0.7), STATIONS, footprint)
    # of points 1e-16 / 1e-3 m apart
    assert np.abs(z - 0.7).max() <= 1e-15 and np.abs(slope).max() <= 1e-12
    distances = np.linspace(-10.0, 10.0, 83)
    z, slope = felt(distances, 0.3 * distances + 1.0, STATIONS, footprint)
    assert np.abs(z - 0.3 * STATIONS - 1.0).max() <= 2e-15 and np.abs(slope - 0.3).max() <= 1e-12


def test_a_step_is_felt_as_a_ramp_of_the_length_of_the_footprint():
    """The step is as short as numbers allow, so that from far away both its ends are at
    one distance."""
    stations, L = np.append(np.linspace(1.5, 2.5, 101), [-1e3, 1e3]), 0.4
    z, slope = felt(*STEP, stations, L)
    assert np.abs(z - 0.15 * np.clip((stations - 2.0) / L + 0.5, 0, 1)).max() <= 1e-15
    assert np.isfinite(slope).all()


@pytest.fixture(scope="module")
def kilometre():
    """Hills of 20 m with roughness. Points are multiples of 1/32 m, so that their lengths from
    stations that are multiples of 1/1024 m are exact, and so is the quadrature."""
    distances = np.arange(0, LONG + 1 / 64, 1 / 32)
    return distances, 30 + 20 * np.sin(distances / 70) + 0.01 * RNG.normal(size=len(distances))


def near(kilometre, s, reach=1.0):
    """The points within this distance of a station."""
    distances, heights = kilometre
    some = slice(*np.searchsorted(distances, (s - reach, s + reach)))
    return distances[some], heights[some]


def test_a_patch_far_along_a_road_is_felt_to_all_digits(kilometre):
    """1 km and a patch of 0.1 m: antiderivatives that reach 3e4 m2 and differ by 3 would leave
    1e-12 of it."""
    stations = LONG - 1 - RNG.integers(1, 200000, size=60) / 1024
    exact = np.array([by_quadrature(*near(kilometre, s), s, 0.1) for s in stations])
    assert np.abs(felt(*kilometre, stations, 0.1)[0] / exact - 1).max() <= 1e-14


def test_a_footprint_may_grow_to_twice_its_length_and_is_never_cut_short(kilometre):
    """Only nearby pieces are evaluated: 16 of 32000 for a patch of 0.2 m and for twice that."""
    road = jb.inputs.Road(*kilometre, speed=1.0, footprint=0.2)
    assert road.window == 16
    for footprint, right in ((0.4, True), (0.6, False), (5.0, False)):
        grown = eqx.tree_at(lambda r: r.footprint, road, jnp.array(footprint))
        z = felt_and_slope(grown, jnp.array([LONG / 2]))[0][0]
        exact = by_quadrature(*near(kilometre, LONG / 2, 5.0), LONG / 2, footprint)
        assert abs(z / exact - 1) <= 1e-14 if right else np.isnan(z)


def test_a_patch_of_a_tenth_of_a_metre_on_a_piece_of_a_kilometre_too():
    z, _ = felt([0.0, LONG, LONG + 1.0], [0.0, 10.0, 0.0], [LONG, LONG - 1.0], 0.1)
    assert np.abs(z - np.array([10.0 - 0.1 / 8 * (0.01 + 10.0), 9.99])).max() <= 1e-14


def test_a_wheel_rises_with_speed_times_the_slope_of_the_road():
    """Xi = (0, 0, z_f, 0, 0, 0) at position + speed t, and its rate."""
    road = jb.inputs.Road(DISTANCES, HEIGHTS, speed=3.0, position=0.4, footprint=0.3)
    xi, xi_dot = jax.jvp(road, (0.2,), (1.0,))
    z, slope = felt(DISTANCES, HEIGHTS, [1.0], 0.3)
    assert np.abs(xi - np.array([0, 0, z[0], 0, 0, 0])).max() <= 1e-15
    assert np.abs(xi_dot - np.array([0, 0, 3 * slope[0], 0, 0, 0])).max() <= 1e-14
    assert road.covers() == (-np.inf, np.inf)


@pytest.mark.long
@pytest.mark.parametrize("footprint", [0.0, 0.05, 0.5])
@pytest.mark.parametrize("t", [0.0, 0.7, 1.9])
def test_a_road_can_be_differentiated_in_its_numbers(footprint, t):
    """Forward = reverse = central differences, in heights, distances, speed, position and
    footprint, alone at speed zero and together."""
    road = jb.inputs.Road(DISTANCES, HEIGHTS, speed=2.0, position=-0.3, footprint=footprint)
    direction = jax.tree.map(lambda x: jnp.asarray(RNG.normal(size=x.shape)), road)
    if footprint == 0:  # differences would need a negative one
        direction = eqx.tree_at(lambda r: r.footprint, direction, jnp.array(0.0))
    grad = gradient(road, t)
    assert all(np.isfinite(x).all() for x in jax.tree.leaves(grad))
    reverse = sum(
        jnp.sum(a * b)
        for a, b in zip(jax.tree.leaves(grad), jax.tree.leaves(direction), strict=True)
    )
    h = 1e-6
    low, here, high = (
        jax.tree.map(lambda x, d, k=k: x + k * h * d, road, direction) for k in (-1, 0, 1)
    )
    # d/dL is a difference over L
    assert abs(jax.jvp(lambda r: r(t)[2], (here,), (direction,))[1] - reverse) <= 1e-13
    # rounding 1e-16 / 1e-6, curvature 1e-12
    assert abs((high(t)[2] - low(t)[2]) / (2 * h) - reverse) <= 1e-9


gradient = jax.jit(jax.grad(lambda road, t: road(t)[2]))
curvature = jax.jit(lambda road, s: jax.hessian(road.felt)(s))


def test_no_footprint_has_finite_derivatives_at_the_points_too():
    """At a kink, at the ends, standing or not: a derivative of one side, never NaN; second
    derivatives as well."""
    for station in (DISTANCES[0], DISTANCES[5], DISTANCES[-1]):
        road = jb.inputs.Road(DISTANCES, HEIGHTS, speed=0.0, position=station)
        assert all(
            np.isfinite(x).all()
            for x in jax.tree.leaves((gradient(road, 0.0), curvature(road, station)))
        )


def test_a_rear_wheel_feels_the_front_wheels_road_a_wheelbase_later():
    speed, wheelbase = 12.5, 2.5
    wheels = {"front": 1.5, "rear": 1.5 - wheelbase}
    front, rear = (
        jb.inputs.Road(DISTANCES, HEIGHTS, speed=speed, position=at, footprint=0.2)
        for at in wheels.values()
    )
    later = jb.signals.Delayed(front, wheelbase / speed)
    times = jnp.linspace(-0.5, 1.0, 200)
    feel = jax.jit(lambda motion: jax.vmap(motion)(times))
    assert np.abs(feel(rear)).max() > 0.05
    # stations within rounding, slopes of order 1
    assert np.abs(feel(rear) - feel(later)).max() <= 1e-14


def test_a_kerb_is_a_ramp_between_two_levels():
    kerb = jb.inputs.Road.kerb(0.12, at=4.0, ramp=0.05, speed=2.0, position=1.0)
    heights = [float(kerb(t)[2]) for t in (0.0, 1.5, 1.5125, 1.525, 9.0)]
    assert np.abs(np.subtract(heights, [0, 0, 0.06, 0.12, 0.12])).max() <= 1e-14


@pytest.mark.long
def test_a_road_is_built_in_a_trace_as_outside():
    def height(h, ramp):
        return jb.inputs.Road([0.0, 1.0, 1.0 + ramp], [0.0, h, 0.0], speed=1.0, footprint=2 * ramp)(
            jnp.array(0.9)
        )[2]

    assert abs(jax.jit(height)(0.3, 0.2) - height(0.3, 0.2)) <= 1e-15
    # linear in the heights
    assert abs(jax.grad(height)(0.3, 0.2) * 0.3 - height(0.3, 0.2)) <= 1e-15


BAD = {
    "unsorted": (
        lambda: jb.inputs.Road([0, 2, 1], [0, 0, 0], speed=1.0),
        "NOT_INCREASING",
        "Road.distances",
        2,
    ),
    "repeated": (
        lambda: jb.inputs.Road([0, 1, 1], [0, 0, 0], speed=1.0),
        "NOT_INCREASING",
        "Road.distances",
        2,
    ),
    "no ramp": (
        lambda: jb.inputs.Road.kerb(0.1, at=1.0, ramp=0.0, speed=1.0),
        "NOT_INCREASING",
        "Road.distances",
        1,
    ),
    "bad ramp": (
        lambda: jb.inputs.Road.kerb(0.1, at=1.0, ramp=None, speed=1.0),
        "NOT_A_NUMBER",
        "Road.kerb ramp",
        None,
    ),
    "one point": (lambda: jb.inputs.Road([0], [0], speed=1.0), "BAD_SHAPE", "Road.distances", (1,)),
    "one number": (
        lambda: jb.inputs.Road(0.0, [0, 0], speed=1.0),
        "BAD_SHAPE",
        "Road.distances",
        (),
    ),
    "table": (
        lambda: jb.inputs.Road([0, 1], np.zeros((2, 2)), speed=1.0),
        "BAD_SHAPE",
        "Road.heights",
        (2, 2),
    ),
    "one height more": (
        lambda: jb.inputs.Road([0, 1], [0, 0, 0], speed=1.0),
        "BAD_SHAPE",
        "Road.heights",
        (3,),
    ),
    "NaN height": (
        lambda: jb.inputs.Road([0, 1], [0, np.nan], speed=1.0),
        "NON_FINITE",
        "Road.heights",
        [0, np.nan],
    ),
    "text": (
        lambda: jb.inputs.Road(["0", "1"], [0, 0], speed=1.0),
        "NOT_A_NUMBER",
        "Road.distances",
        None,
    ),
    "infinite speed": (
        lambda: jb.inputs.Road([0, 1], [0, 0], speed=np.inf),
        "NON_FINITE",
        "Road.speed",
        np.inf,
    ),
    "two positions": (
        lambda: jb.inputs.Road([0, 1], [0, 0], speed=1, position=[1, 2]),
        "BAD_SHAPE",
        "Road.position",
        (2,),
    ),
    "negative footprint": (
        lambda: jb.inputs.Road([0, 1], [0, 0], speed=1, footprint=-0.1),
        "BAD_FOOTPRINT",
        "Road.footprint",
        -0.1,
    ),
}


@pytest.mark.parametrize("case", BAD)
def test_a_bad_road_is_reported_by_name(case):
    build, code, where, value = BAD[case]
    with pytest.raises(jb.JaxbodyError) as caught:
        build()
    error = caught.value
    assert (error.code, error.where) == (code, where)
    assert error.hint and (error.limit or code == "NOT_A_NUMBER")
    if value is not None:
        np.testing.assert_equal(np.asarray(error.value), np.asarray(value))


@pytest.mark.long
def test_all_that_is_wrong_with_a_road_is_reported_at_once():
    with pytest.raises(jb.JaxbodyError) as caught:
        jb.inputs.Road([0, 1, 1], [0, 0], speed="fast", footprint=-1.0)
    assert [problem.code for problem in caught.value.problems] == [
        "BAD_SHAPE",
        "NOT_A_NUMBER",
        "NOT_INCREASING",
        "BAD_FOOTPRINT",
    ]
