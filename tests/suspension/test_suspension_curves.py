"""Curves of suspensions beside published tables, closed forms and differences."""

import os
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

import jaxbody as jb
from jaxbody.model.joints.frame_tables import frames_of
from jaxbody.suspension.suspensions import DOUBLE_WISHBONE, FIVE_LINK, MACPHERSON, SOLID_AXLE

TRAVEL = np.linspace(-0.1, 0.1, 11)

# dz [mm], camber [deg], toe [deg], wheel x [m], wheel y [m], dcamber/dz [deg/m], dtoe/dz [deg/m],
# dy/dz: closed form (circle, sphere) and Newton agree to 1e-15 m; REFERENCES2 2.4
DOUBLE = """
-100 -2.122915025 -2.595473746 -0.025411403 0.937942793  6.260927 39.185060  0.244785658
 -80 -2.017774942 -1.871030802 -0.023847970 0.942314524  4.313407 33.362483  0.192833045
 -60 -1.948340783 -1.257407062 -0.022540003 0.945671517  2.672912 28.076665  0.143196622
 -40 -1.909401415 -0.745310024 -0.021470528 0.948053702  1.251795 23.190035  0.095261009
 -20 -1.897225078 -0.327848409 -0.020626913 0.949489956 -0.012212 18.597693  0.048527755
   0 -1.909152433  0           -0.020000000 0.950000000 -1.165259 14.216158  0.002574212
  20 -1.943335044  0.241739078 -0.019583526 0.949595620 -2.243023  9.976097 -0.042974212
  40 -1.998564556  0.399584770 -0.019373744 0.948281418 -3.274322  5.817352 -0.088464228
  60 -2.074161366  0.474610548 -0.019369187 0.946055208 -4.283550  1.685304 -0.134230641
  80 -2.169904556  0.466828442 -0.019570548 0.942908108 -5.292433 -2.472011 -0.180610269
 100 -2.285992431  0.375216775 -0.019980650 0.938824368 -6.321371 -6.706400 -0.227955367
"""

# dz [mm], dl/dz, wheel force [N], wheel rate [N/m], with the spring of 30 kN/m that is compressed
# by 4000 N; REFERENCES2 2.4
SPRING = """
-100 -0.522397604 1253.93860  8610.090
 -60 -0.530416801 1608.14369  9120.670
 -20 -0.540342727 1985.28127  9758.174
   0 -0.546021078 2184.08431 10128.077
  20 -0.552184839 2390.64962 10534.783
  60 -0.566014591 2830.15953 11468.713
 100 -0.581949159 3310.54228 12582.324
"""

# dz [mm], camber, toe, caster, kingpin [deg], wheel x, wheel y [m], dcamber/dz, dtoe/dz [deg/m];
# REFERENCES2 2.5
STRUT = """
-100  0.986005241 -1.014849514 2.986261675 14.256180861 -0.021543552 0.945214855 -33.254973 19.102207
 -80  0.337512030 -0.672000298 3.094215519 14.887853572 -0.020871624 0.947722281 -31.591082 15.228436
 -60 -0.277422934 -0.403965108 3.201674730 15.489659465 -0.020388528 0.949441677 -29.894910 11.616930
 -40 -0.857896975 -0.205709915 3.308691060 16.060522294 -0.020086694 0.950387838 -28.140579  8.247597
 -20 -1.402476028 -0.072542617 3.415287125 16.598900862 -0.019959271 0.950571563 -26.300651  5.106237
   0 -1.909152433  0           3.521453377 17.102728969 -0.020000000 0.950000000 -24.345005  2.184122
  20 -2.375278574  0.016260536 3.627143506 17.569332491 -0.020203097 0.948676886 -22.239527 -0.522064
  40 -2.797471613 -0.019428573 3.732267942 17.995317755 -0.020563135 0.946602721 -19.944510 -3.009941
  60 -3.171481919 -0.102624968 3.836684947 18.376422712 -0.021074921 0.943774869 -17.412592 -5.270746
  80 -3.492014197 -0.228637818 3.940188574 18.707318586 -0.021733351 0.940187593 -14.586045 -7.288150
 100 -3.752485015 -0.392359407 4.042492438 18.981344099 -0.022533242 0.935832033 -11.393061 -9.036418
"""  # noqa: E501


def table(text):
    return np.array([[float(x) for x in line.split()] for line in text.strip().splitlines()]).T


@pytest.fixture(scope="module")
def double():
    return jb.suspension.double_wishbone().curves(TRAVEL)


def degrees(curves, name):
    return np.rad2deg(curves[name])


def rate(curves, name):
    return np.asarray(curves.slopes["travel"][name])


def test_a_double_wishbone_over_travel_is_that_of_the_closed_form(double):
    dz, camber, toe, x, y, camber_rate, toe_rate, y_rate = table(DOUBLE)
    np.testing.assert_allclose(double.over["travel"], 1e-3 * dz, atol=1e-15)
    # 1e-9: the digits of the table
    np.testing.assert_allclose(degrees(double, "camber"), camber, atol=1e-9)
    np.testing.assert_allclose(degrees(double, "toe"), toe, atol=1e-9)
    np.testing.assert_allclose(double["wheel x"], x, atol=1e-9)
    np.testing.assert_allclose(double["wheel y"], y, atol=1e-9)
    np.testing.assert_allclose(np.rad2deg(rate(double, "camber")), camber_rate, atol=1e-6)
    np.testing.assert_allclose(np.rad2deg(rate(double, "toe")), toe_rate, atol=1e-6)
    np.testing.assert_allclose(rate(double, "wheel y"), y_rate, atol=1e-9)


def test_motion_ratio_wheel_force_and_wheel_rate(double):
    dz, ratio, force, wheel_rate = table(SPRING)
    rows = np.searchsorted(TRAVEL, 1e-3 * dz - 1e-9)
    np.testing.assert_allclose(double["motion ratio of spring"][rows], ratio, atol=1e-9)
    along = np.subtract(DOUBLE_WISHBONE["spring upper"], DOUBLE_WISHBONE["spring lower"])
    shortened = CubicSpline(TRAVEL, double["motion ratio of spring"]).antiderivative()
    expected = np.linalg.norm(along) + shortened(TRAVEL) - shortened(0.0)
    np.testing.assert_allclose(double["length of spring"], expected, atol=1e-8)
    np.testing.assert_allclose(double["wheel force"][rows], force, rtol=1e-8)
    np.testing.assert_allclose(double["wheel rate"][rows], wheel_rate, rtol=1e-7)


@pytest.mark.long
def test_a_wheel_under_load_moves_by_the_wheel_rate():
    """Equilibria under a vertical force at the wheel center, with the rack held: the forces of the
    table lead to its travel, and the change of travel by force is one over the wheel rate."""
    model, center = (
        jb.suspension.double_wishbone().model,
        jb.suspension.double_wishbone().wheel.center,
    )
    bodies, joints = (
        {name: part(name) for name in model.layout.bodies}
        for part in (model.__getitem__, model.joint)
    )
    closures = {name: model[name] for name in model.closure_names}
    held = jb.Model(
        bodies=bodies,
        joints=joints | {"rack": jb.Fixed("world")},
        closures=closures,
        elements={"spring": model["spring"]},
    )
    start = jb.equilibrium(held, start=held.reference, loads=lift(center, 2184.08431)).state

    def travel(force):
        state = jb.equilibrium(held, start=start, loads=lift(center, force)).state
        return float(
            frames_of(held, state)[held.layout.frame("upright")].point(center)[2] - center[2]
        )

    dz, _, force, wheel_rate = table(SPRING)
    for i in (3, 5):  # at rest in the design position, and 60 mm up
        up, down = (travel(force[i] + change) for change in (2.0, -2.0))
        assert (up + down) / 2 == pytest.approx(1e-3 * dz[i], abs=1e-7)  # the square of the change
        assert 4.0 / (up - down) == pytest.approx(wheel_rate[i], rel=1e-5)


def lift(center, force):
    return {"road": jb.Force(("upright", center), force=[0, 0, force])}


@pytest.mark.long
def test_a_macpherson_strut_over_travel():
    curves = jb.suspension.macpherson().curves(TRAVEL)
    _, *angles, x, y, camber_rate, toe_rate = table(STRUT)
    for name, expected in zip(("camber", "toe", "caster", "kingpin"), angles, strict=True):
        np.testing.assert_allclose(degrees(curves, name), expected, atol=1e-9)
    np.testing.assert_allclose(curves["wheel x"], x, atol=1e-9)
    np.testing.assert_allclose(curves["wheel y"], y, atol=1e-9)
    np.testing.assert_allclose(np.rad2deg(rate(curves, "camber")), camber_rate, atol=1e-6)
    np.testing.assert_allclose(np.rad2deg(rate(curves, "toe")), toe_rate, atol=1e-6)


@pytest.mark.long
@pytest.mark.skipif("JAXBODY_DATA" not in os.environ, reason="needs the data of JAXBODY_DATA")
def test_rack_and_travel_together_in_41_positions():
    """Numbers of the public project that the hard points are from, computed again by a
    closed form."""
    file = Path(os.environ["JAXBODY_DATA"]) / "double_wishbone_41.csv"
    names = (
        next(line for line in file.read_text().splitlines() if "rack_m" in line)
        .lstrip("# ")
        .split(",")
    )
    rows = dict(zip(names, np.loadtxt(file, delimiter=",").T, strict=True))
    curves = jb.suspension.double_wishbone().curves(rows["dz_m"], rows["rack_m"])
    for name in ("camber", "toe", "caster", "kingpin"):
        np.testing.assert_allclose(degrees(curves, name), rows[f"{name}_deg"], atol=1e-8)
    for name in "xyz":
        np.testing.assert_allclose(curves[f"wheel {name}"], rows[f"wheel_{name}_m"], atol=1e-9)
    for name in ("camber", "toe"):
        np.testing.assert_allclose(
            np.rad2deg(rate(curves, name)), rows[f"d{name}_dz_deg_per_m"], rtol=1e-6, atol=1e-6
        )
        slopes = np.rad2deg(curves.slopes["steering"][name])
        np.testing.assert_allclose(slopes, rows[f"d{name}_drack_deg_per_m"], rtol=1e-6)


def test_a_right_wheel_has_the_curves_of_the_left_one(double):
    mirrored = {name: np.array(point) * [1, -1, 1] for name, point in DOUBLE_WISHBONE.items()}
    right = jb.suspension.double_wishbone(mirrored).curves(TRAVEL)
    for name in (
        "camber",
        "toe",
        "caster",
        "kingpin",
        "trail",
        "scrub radius",
        "roll center height",
        "wheel rate",
    ):
        np.testing.assert_allclose(right[name], double[name], atol=1e-9, rtol=1e-9)
    np.testing.assert_allclose(right["wheel y"], -double["wheel y"], atol=1e-12)


def test_trail_and_scrub_radius_are_measured_on_the_ground(double):
    """In the design position toe is zero, so that the heading is x: by hand from the
    hard points."""
    lower, upper, inner, center = (
        np.array(DOUBLE_WISHBONE[n])
        for n in ("lower outer", "upper outer", "axle inner", "wheel center")
    )
    a = (center - inner) / np.linalg.norm(center - inner)
    down = a * a[2] - [0, 0, 1]
    C = center + 0.3 * down / np.linalg.norm(down)
    K = lower + (upper - lower) * (C[2] - lower[2]) / (upper - lower)[2]
    np.testing.assert_allclose(double["trail"][5], (K - C)[0], atol=1e-12)
    np.testing.assert_allclose(double["scrub radius"][5], (C - K)[1], atol=1e-12)


@pytest.mark.long
def test_the_screw_axis_of_steering_is_the_line_through_the_ball_joints():
    """With the lower arm held, steering turns the upright about both ball joints."""
    corner = jb.suspension.double_wishbone()
    at_rest = dict(over={"arm": 0.0, "rack": 0.0})
    wheel = jb.suspension.Wheel(
        "upright", center=corner.wheel.center, axis=corner.wheel.axis, radius=0.3
    )
    drive = {"arm": "lower arm.q", "rack": "rack.q"}
    screw = jb.suspension.suspension_curves(corner.model, drive=drive, wheel=wheel, **at_rest)
    line = jb.suspension.suspension_curves(corner.model, drive=drive, wheel=corner.wheel, **at_rest)
    for name in ("caster", "kingpin", "trail", "scrub radius"):
        np.testing.assert_allclose(screw[name], line[name], atol=1e-12)


def test_the_roll_center_is_where_the_front_view_instant_center_says():
    """Arms that lie in planes x = const: the instant center is where their lines meet, and the roll
    center on its line to the contact."""
    points = {
        **{f"lower inner {end}": (x, 0.4, 0.2) for end, x in (("front", 0.2), ("rear", -0.2))},
        **{f"upper inner {end}": (x, 0.4, 0.45) for end, x in (("front", 0.2), ("rear", -0.2))},
        "lower outer": (0, 0.7, 0.18),
        "upper outer": (0, 0.68, 0.5),
        "tie rod inner": (0.1, 0.4, 0.2),
        "tie rod outer": (0.1, 0.7, 0.18),
        "axle inner": (0, 0.7, 0.3),
        "wheel center": (0, 0.75, 0.3),
    }
    curves = jb.suspension.double_wishbone(points).curves(TRAVEL)
    # lines z = 0.2 - (y - 0.4) 0.02/0.3 and z = 0.45 + (y - 0.4) 0.05/0.28 meet at y, z
    y = 0.4 - 0.25 / (0.02 / 0.3 + 0.05 / 0.28)
    z = 0.2 - (y - 0.4) * 0.02 / 0.3
    height = 0.75 * z / (0.75 - y)  # of the line from the contact (0.75, 0) to there, at y = 0
    assert float(curves["roll center height"][5]) == pytest.approx(height, rel=1e-9)
    assert abs(curves["side view angle of the contact"][5]) < 1e-12


LINKS = [
    name.removesuffix(" inner")
    for name in FIVE_LINK
    if name.endswith(" inner") and name != "axle inner"
]


def upright(travel, rack):
    """Displacement and turn of the upright of the five links: five distances and the height of the
    wheel, by SciPy."""
    P = {name: np.array(point) for name, point in FIVE_LINK.items()}
    inner = np.array([P[f"{name} inner"] + [0, rack * (name == "tie rod"), 0] for name in LINKS])
    outer, lengths = (
        np.array([P[f"{name} outer"] for name in LINKS]),
        [np.linalg.norm(P[f"{name} outer"] - P[f"{name} inner"]) for name in LINKS],
    )

    def gaps(x):
        R = Rotation.from_rotvec(x[3:])
        ends = x[:3] + R.apply(outer)
        return [
            *(np.linalg.norm(ends - inner, axis=1) - lengths),
            (x[:3] + R.apply(P["wheel center"]))[2] - P["wheel center"][2] - travel,
        ]

    x = least_squares(gaps, np.zeros(6), jac="3-point", xtol=1e-15, ftol=1e-15, gtol=1e-15).x
    assert np.abs(gaps(x)).max() < 1e-14
    return x[:3], Rotation.from_rotvec(x[3:])


@pytest.mark.long
def test_five_links_over_travel_and_steering_are_where_five_distances_say():
    corner = jb.suspension.five_link()
    travel, rack = (
        np.array([-0.08, -0.03, 0.0, 0.05, 0.08]),
        np.array([0.0, 0.02, 0.0, -0.03, 0.01]),
    )
    curves = corner.curves(travel, rack)
    center, inner = np.array(FIVE_LINK["wheel center"]), np.array(FIVE_LINK["axle inner"])
    for i, (z, y) in enumerate(zip(travel, rack, strict=True)):
        p, R = upright(z, y)
        a, place = R.apply(center - inner), p + R.apply(center)
        expected = [-np.arctan2(a[2], a[1]), np.arctan2(a[0], a[1]), *place]
        np.testing.assert_allclose(
            [curves[n][i] for n in ("camber", "toe", "wheel x", "wheel y", "wheel z")],
            expected,
            atol=1e-11,
        )
    # the steering axis is the screw axis of a small turn by the rack: w x v/|w|^2 is a point of it,
    # w its direction
    h = 1e-4
    (p1, R1), (p0, R0) = upright(0.0, h), upright(0.0, -h)
    # of the upright, and of its point at the origin
    w, v = (R1 * R0.inv()).as_rotvec() / (2 * h), (p1 - p0) / (2 * h)
    w, v = w * np.sign(w[2]), v * np.sign(w[2])
    contact = np.array([curves[f"contact {axis}"][2] for axis in "xyz"])
    line = np.cross(w, v) / (w @ w)
    K = line + w * (contact[2] - line[2]) / w[2]
    expected = np.arctan2(-w[0], w[2]), np.arctan2(-w[1], w[2]), (K - contact)[0], (contact - K)[1]
    for name, value in zip(("caster", "kingpin", "trail", "scrub radius"), expected, strict=True):
        assert float(curves[name][2]) == pytest.approx(value, abs=1e-7)  # of the differences


def loss(point):
    curves = jb.suspension.double_wishbone({"upper outer": point}).curves(
        np.array([-0.05, 0.05]), np.array([0.0, 0.01])
    )
    return (
        jnp.sum(curves["toe"] ** 2)
        + jnp.sum(curves["camber"])
        + 1e-5 * jnp.sum(curves["wheel rate"])
    )


@pytest.mark.long
def test_curves_have_derivatives_by_hard_points():
    """wheel rates hold two derivatives by travel, so that this is the third."""
    point, h = jnp.array(DOUBLE_WISHBONE["upper outer"]), 1e-5
    forward = jax.jit(jax.jacfwd(loss))(point)
    np.testing.assert_allclose(jax.jit(jax.grad(loss))(point), forward, rtol=1e-9)
    value = jax.jit(loss)
    difference = [
        (value(point.at[i].add(h)) - value(point.at[i].add(-h))) / (2 * h) for i in range(3)
    ]
    np.testing.assert_allclose(forward, difference, rtol=1e-6)


@pytest.mark.long
def test_beyond_reach_the_last_good_value_is_kept_by_name():
    with pytest.warns(jb.JaxbodyWarning, match=r"NOT_CLOSED.*within reach: travel = 0.* m"):
        curves = jb.suspension.double_wishbone().curves(np.linspace(0.0, 1.0, 11))
    ok = np.asarray(curves.ok)
    assert (
        ok[:3].all()
        and not ok[-1]
        and np.isnan(curves["camber"][-1])
        and np.isfinite(curves["camber"][ok]).all()
    )


@pytest.mark.long
def test_bad_input():
    corner = jb.suspension.double_wishbone()
    call = lambda drive, over: jb.suspension.suspension_curves(  # noqa: E731
        corner.model, drive=drive, over=over, wheel=corner.wheel
    )
    travel = jb.Position("upright", corner.wheel.center, axis="z")
    with pytest.raises(jb.JaxbodyError, match=r"leaves the wheel free to move.*UNDRIVEN"):
        call({"travel": travel}, {"travel": 0.0})
    with pytest.raises(jb.JaxbodyError, match=r"drive\['still'\].*does not move.*UNDRIVEN"):
        call(
            {"travel": travel, "still": jb.Position("lower arm", [0.25, 0.4, 0.2], axis="z")},
            {"travel": 0.0, "still": 0.0},
        )
    with pytest.raises(jb.JaxbodyError, match=r"rak.q.*Did you mean 'rack.q'"):
        call({"travel": travel, "rack": "rak.q"}, {"travel": 0.0, "rack": 0.0})
    with pytest.raises(jb.JaxbodyError, match=r"no values of 'rack'.*BAD_SHAPE"):
        call({"travel": travel, "rack": "rack.q"}, {"travel": [0.0, 0.1]})
    with pytest.raises(jb.JaxbodyError, match="reads 3 numbers"):
        call(
            {"travel": jb.Position("upright", corner.wheel.center), "rack": "rack.q"},
            {"travel": 0.0, "rack": 0.0},
        )
    with pytest.raises(jb.JaxbodyError, match=r"uper outer.*Did you mean 'upper outer'"):
        jb.suspension.double_wishbone({"uper outer": (0, 0, 0)})
    with pytest.raises(
        jb.JaxbodyError,
        match=r"'upper outer' at y = -0.7 m.*y > 0 on the left, as the wheel center.*WRONG_SIDE",
    ):
        jb.suspension.double_wishbone({"upper outer": (0, -0.7, 0.5)})
    with pytest.raises(
        jb.JaxbodyError, match=r"'lower outer' at y = 0.9 m.*Give all points of a right wheel"
    ):
        jb.suspension.double_wishbone({"wheel center": (0, -0.9, 0.3)})


READY = {
    "double_wishbone": (jb.suspension.double_wishbone, DOUBLE_WISHBONE),
    "macpherson": (jb.suspension.macpherson, MACPHERSON),
    "five_link": (jb.suspension.five_link, FIVE_LINK),
    "solid_axle": (jb.suspension.solid_axle, SOLID_AXLE),
    "car": (
        lambda points: jb.suspension.car_on_double_wishbones(rear_points=points),
        DOUBLE_WISHBONE,
    ),
}


@pytest.mark.parametrize("name", READY)
@pytest.mark.parametrize(
    ("axes", "code", "words"),
    [
        (
            [1, 1, -1],
            "WRONG_SIDE",
            r"'upper' points at z = -0\.\d+ m.*Is z down there\? Turn the axes",
        ),
        ([1, -1, -1], "WRONG_SIDE", "Is z down there"),  # SAE J670
        ([-1, -1, 1], "WRONG_SIDE", r"'front' points at x = -0\.\d+ m.*Is x rearward there\?"),
        (
            [1e3, 1e3, 1e3],
            "UNIT",
            r"spans \d+(\.\d)? m \(allowed: 20 m\)\. Give all points in meters, not mm",
        ),
    ],
)
def test_hard_points_in_other_axes_or_units_are_refused(name, axes, code, words):
    """With the names that the points have: a front point before a rear one, an upper one above a
    lower one."""
    draw, points = READY[name]
    with pytest.raises(jb.JaxbodyError, match=words) as refused:
        draw({point: np.multiply(place, axes) for point, place in points.items()})
    assert refused.value.code == code
    with pytest.raises(jb.JaxbodyError, match="UNIT"):  # some of them
        draw({point: np.multiply(place, 1e3) for point, place in list(points.items())[:3]})


@pytest.mark.filterwarnings("ignore:.*FAR_FROM_DRAWN")  # a corner without a wheel load
def test_the_plausibility_of_a_suspension_is_that_of_its_model():
    corner = jb.suspension.double_wishbone()
    assert jb.fitting.plausibility(corner).numbers == jb.fitting.plausibility(corner.model).numbers
