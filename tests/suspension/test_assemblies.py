"""Assembly of closed loops: closed forms of linkages, redundant conditions, derivatives,
and messages."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import jaxbody as jb
from jaxbody.core.compilation.compile_options import program
from jaxbody.geometry.frames import Pose
from jaxbody.mechanics.constraints import closed_on
from jaxbody.model.joints.frame_tables import drawn, gaps
from jaxbody.model.joints.kinematics import Coordinates
from jaxbody.suspension.assemblies import drives_of, position, positions

BAR = jb.Body(mass=1.0, inertia=[1, 1, 1])
CRANK, COUPLER, ROCKER, GROUND = 0.04, 0.12, 0.08, 0.1

# crank, coupler and rocker angles [deg], rates [rad/s] and accelerations [rad/s2] of coupler and
# rocker where the crank turns at 25 rad/s and 15 rad/s2: Freudenstein, after Norton, Design of
# Machinery; REFERENCES2 2.1
OPEN = [
    (0, 36.33605751, 62.72038726, -16.66666667, -16.66666667, 348.116635, 934.125673),
    (40, 20.29788279, 57.32488007, -4.12091442, 6.99798524, 296.089193, 470.133530),
    (120, 21.96428431, 96.25042326, 3.48646845, 12.85780849, 89.111244, -65.238176),
    (180, 34.77194403, 121.18862233, 7.14285714, 7.14285714, 81.498743, -179.428045),
    (240, 54.16851181, 128.45465077, 8.05199309, -1.31934695, -57.611420, -223.206447),
]
CROSSED = (40, -60.97796680, -98.00496408, -9.25877230, -20.37767196, 597.622400, 423.578063)


def four_bar(closure=None, crank=CRANK, coupler=COUPLER, rocker=ROCKER):
    """Links along x in the drawing, so that angles are coordinates (that of the coupler relative to
    the crank); hinges about z."""
    joints = {
        "crank": jb.Hinge("world", axis="z", at=[0, 0, 0]),
        "coupler": jb.Hinge("crank", axis="z", at=[crank, 0, 0]),
        "rocker": jb.Hinge("world", axis="z", at=[GROUND, 0, 0]),
    }
    pin = closure or jb.closures.Hinge(
        ("coupler", [crank + coupler, 0, 0]), ("rocker", [GROUND + rocker, 0, 0]), axis="z"
    )
    return jb.Model(bodies=dict.fromkeys(joints, BAR), joints=joints, closures={"pin": pin})


def state(*degrees):
    return jb.State(jnp.deg2rad(jnp.array(degrees)), jnp.zeros(3))


@pytest.fixture(scope="module")
def motion():
    """Rates and accelerations of the coordinates for a rate and an acceleration of the crank, next
    to an assembled state."""
    model = four_bar()
    drives = drives_of(model, {"crank": "crank.q"}, "test")

    @jax.jit
    def rates(q, rate, acceleration):
        at = lambda t: position(model, drives, q[:1] + rate * t + acceleration * t**2 / 2, q)  # noqa: E731
        return jax.jacfwd(at)(0.0), jax.jacfwd(jax.jacfwd(at))(0.0)

    return model, rates


@pytest.mark.parametrize("crank, coupler, rocker, w3, w4, a3, a4", [*OPEN, CROSSED])
def test_a_four_bar_linkage_moves_as_by_freudenstein(
    motion, crank, coupler, rocker, w3, w4, a3, a4
):
    model, rates = motion
    rough = state(crank, coupler - crank + 10.0, rocker - 10.0)
    q = jb.suspension.assemble(model, start=rough, hold=["crank"]).state.q
    found = np.rad2deg([q[0] + q[1], q[2]])
    np.testing.assert_allclose((found - [coupler, rocker] + 180) % 360 - 180, 0, atol=1e-8)
    v, a = rates(q, 25.0, 15.0)
    np.testing.assert_allclose([v[0] + v[1], v[2]], [w3, w4], atol=1e-8)
    np.testing.assert_allclose([a[0] + a[1], a[2]], [a3, a4], atol=1e-6)  # the digits of the table


@pytest.mark.long
def test_conditions_out_of_the_plane_are_redundant_and_do_no_harm():
    done = jb.suspension.assemble(four_bar(), start=state(40.0, -20.0, 57.0))
    assert done.freedoms == 1 and len(done.redundant) == 3 and done.ok
    assert set(done.redundant) == {"pin z", "pin turn 1", "pin turn 2"}
    assert "implied by the others: pin z" in repr(done)


@pytest.mark.parametrize("name", ["Ball", "Rod", "Inline"])
def test_other_closures_of_the_same_linkage_move_alike(name):
    """A ball joint; a rod in place of the coupler; the point of the rocker on a line of the coupler
    and at its end's distance."""
    ends = ("coupler", [CRANK + COUPLER, 0, 0]), ("rocker", [GROUND + ROCKER, 0, 0])
    start = state(40.0, 20.0 - 40.0, 57.0)
    expected = jb.suspension.assemble(four_bar(), start=start, hold=["crank"]).state.q
    if name == "Ball":
        q = jb.suspension.assemble(
            four_bar(jb.closures.Ball(*ends)), start=start, hold=["crank"]
        ).state.q
        np.testing.assert_allclose(q, expected, atol=1e-12)
    elif name == "Rod":
        rod = jb.closures.Rod(("crank", [CRANK, 0, 0]), ends[1], length=COUPLER)
        q = jb.suspension.assemble(four_bar(rod), start=start, hold=["crank"]).state.q
        np.testing.assert_allclose(q[2], expected[2], atol=1e-12)
    else:
        line = jb.closures.Inline(("coupler", [CRANK, 0, 0]), ends[1], axis="x")
        q = jb.suspension.assemble(
            four_bar(line), start=jb.State(expected, jnp.zeros(3)), hold=["crank"]
        ).state.q
        np.testing.assert_allclose(q, expected, atol=1e-12)


def test_guides_welds_and_equations_hold_what_they_say():
    """A box on the world: gaps of a pose that is moved and turned, by hand."""
    box = jb.Body(mass=1.0, inertia=[1, 1, 1])
    ends = ("world", [0, 0, 0]), ("box", [0, 0, 0])
    equation = jb.closures.Equation(lambda A, B: B.p[0] * 2.0 - A.p[0], ("world", "box"))
    kinds = {
        "guide": jb.closures.Guide(*ends, axis="x"),
        "weld": jb.closures.Weld(*ends),
        "rule": equation,
    }
    model = jb.Model(bodies={"box": box}, closures=kinds)
    angle = 0.3
    q = jnp.array([0.5, 0.2, -0.1, np.cos(angle / 2), 0, 0, np.sin(angle / 2)])
    coordinates = Coordinates(model)
    c = gaps(model, coordinates, coordinates.at_rest(q), q)
    sine = [0.0, 0.0, np.sin(angle)]  # times the size of the model, 1 m
    assert np.sort(np.abs(c[:2])).tolist() == pytest.approx([0.1, 0.2])
    np.testing.assert_allclose(c[2:5], sine, atol=1e-12)
    np.testing.assert_allclose(c[5:11], [0.5, 0.2, -0.1, *sine], atol=1e-12)
    np.testing.assert_allclose(c[11], 1.0, atol=1e-12)


def test_angles_of_closures_are_from_the_poses_as_they_are_drawn(rng):
    """Two frames that are drawn turned, each by itself, and are then moved and turned; by SciPy."""
    drawn_A, drawn_B, turned_A, turned_B = (Rotation.random(rng=rng) for _ in range(4))
    p_A, p_B, a, b, n = rng.normal(size=(5, 3))
    n = n / np.linalg.norm(n)
    drawn, there = (
        (A.inv() * B).as_matrix() for A, B in ((drawn_A, drawn_B), (turned_A, turned_B))
    )
    A, B = (
        Pose(jnp.asarray(p), jnp.asarray(R.as_matrix()))
        for p, R in ((p_A, turned_A), (p_B, turned_B))
    )
    R = there @ drawn.T
    d = turned_A.inv().apply(p_B + turned_B.apply(b) - p_A - turned_A.apply(a))
    turn = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]]) / 2
    ends, rest = (("one", a), ("other", b)), Pose(jnp.zeros(3), jnp.asarray(drawn))
    weld, guide, hinge = (
        closure.gap(A, B, rest)
        for closure in (
            jb.closures.Weld(*ends),
            jb.closures.Guide(*ends, axis=n),
            jb.closures.Hinge(*ends, axis=n),
        )
    )
    np.testing.assert_allclose(weld, [*d, *turn], atol=1e-14)
    np.testing.assert_allclose(
        np.linalg.norm(guide[:2]), np.linalg.norm(np.cross(n, d)), rtol=1e-13
    )
    np.testing.assert_allclose(guide[2:], turn, atol=1e-14)
    np.testing.assert_allclose(hinge[:3], d, atol=1e-14)
    np.testing.assert_allclose(
        np.linalg.norm(hinge[3:]), np.linalg.norm(np.cross(n, R @ n)), rtol=1e-13
    )


@pytest.mark.long
def test_an_assembled_state_has_derivatives_by_lengths():
    """The rocker's angle by the length of the crank: the law of cosines, differentiated by
    differences of the closed form."""

    def rocker(crank):
        return jb.suspension.assemble(
            four_bar(crank=crank), start=state(90.0, 0.0 - 90.0, 80.0), hold=["crank"]
        ).state.q[2]

    def closed_form(crank):
        diagonal = np.hypot(GROUND, crank)
        return (
            np.pi
            - np.arctan2(crank, GROUND)
            - np.arccos((diagonal**2 + ROCKER**2 - COUPLER**2) / (2 * diagonal * ROCKER))
        )

    rocker = jax.jit(rocker)
    assert float(rocker(CRANK)) == pytest.approx(closed_form(CRANK), abs=1e-12)
    h = 1e-5
    difference = (closed_form(CRANK + h) - closed_form(CRANK - h)) / (2 * h)
    second = (closed_form(CRANK + 1e-4) - 2 * closed_form(CRANK) + closed_form(CRANK - 1e-4)) / 1e-8
    reverse, forward_of_reverse = jax.jit(lambda x: jax.jvp(jax.grad(rocker), (x,), (1.0,)))(CRANK)
    assert float(reverse) == pytest.approx(difference, rel=1e-8)
    assert float(jax.jit(jax.jacfwd(rocker))(CRANK)) == pytest.approx(difference, rel=1e-8)
    assert float(forward_of_reverse) == pytest.approx(second, rel=1e-5)


def test_the_reference_of_a_model_is_assembled_and_follows_lengths():
    """A point between two rods a and b whose ends are d apart: x = (a^2 - b^2 + d^2)/(2 d),
    z = -sqrt(a^2 - x^2); drawn 1 cm too low. Memory is relaxed there: a branch is as long as
    the spring."""
    d, drawn = 1.2, np.array([0.5, -0.81])
    plane = jb.joints.Composite(
        "world", ["move", "move"], directions=[[1, 0, 0], [0, 0, 1]], points=[[0, 0, 0]] * 2
    )
    rods = {
        name: jb.closures.Rod(("world", [x, 0, 0]), ("bar", [0, 0, 0]), length=1.0)
        for name, x in (("left", 0.0), ("right", d))
    }
    spring = jb.SpringDamper(
        ("world", [0, 0, -2.0]),
        ("bar", [0, 0, 0]),
        free_length=1.0,
        spring=jb.laws.Maxwell(stiffness=1.0, relaxation_time=1.0),
    )
    bar = jb.Body(mass=1.0, inertia=[1, 1, 1], position=[drawn[0], 0, drawn[1]])
    model = jb.Model(
        bodies={"bar": bar}, joints={"bar": plane}, closures=rods, elements={"s": spring}
    )

    def place(lengths):
        reference = jb.replace(
            model, {"left.length": lengths[0], "right.length": lengths[1]}
        ).reference
        return jnp.append(reference.q + drawn, reference.z)

    lengths = jnp.array([1.05, 0.95])
    a, b = (float(length) for length in lengths)
    x = (a**2 - b**2 + d**2) / (2 * d)
    z = -np.sqrt(a**2 - x**2)
    length = np.hypot(x, z + 2.0)
    of_x = np.array([a, -b]) / d
    of_z = (np.array([a, 0.0]) - x * of_x) / z
    expected = [of_x, of_z, (x * of_x + (z + 2.0) * of_z) / length]
    np.testing.assert_allclose(place(lengths), [x, z, length - 1.0], atol=1e-12)
    for of in (jax.jacfwd, jax.jacrev):
        np.testing.assert_allclose(of(jax.jit(place))(lengths), expected, atol=1e-12)


def test_a_start_off_the_closures_has_derivatives_by_the_point_that_sets_the_size():
    """Least movement weighs turns by the size of the model: a slider-crank whose crank is its
    longest part."""

    @program
    def moved(crank):
        tip, slider = jnp.array([1.0, 0, 0]) * crank, jb.Guide("world", axis=[1, 0, 0])
        model = jb.Model(
            bodies={
                "crank": BAR,
                "slider": jb.Body(mass=1.0, inertia=[1, 1, 1], position=[0.5, 0, 0]),
            },
            joints={"crank": jb.Hinge("world", axis="z"), "slider": slider},
            closures={"rod": jb.closures.Rod(("crank", tip), ("slider", [0, 0, 0.05]), length=0.4)},
        )
        coordinates = Coordinates(model)
        return closed_on(
            coordinates, drawn(coordinates), coordinates.supports.at_rest(), jnp.array([0.6, -0.05])
        )

    h = 1e-4
    slope, differences = jax.jacfwd(moved)(0.2), (moved(0.2 + h) - moved(0.2 - h)) / (2 * h)
    assert np.abs(moved(0.2) - np.array([0.6, -0.05])).min() > 1e-3  # both move
    np.testing.assert_allclose(slope, differences, rtol=1e-6)
    np.testing.assert_allclose(jax.jacrev(moved)(0.2), slope, rtol=1e-9)


@pytest.mark.long
def test_a_turn_of_the_crank_one_position_after_the_other():
    model = four_bar()
    q = jb.suspension.assemble(model, start=state(0.0, 36.0, 62.0), hold=["crank"]).state.q
    drives = drives_of(model, {"crank": "crank.q"}, "test")
    turns = jnp.linspace(0.0, 2 * np.pi, 37)[:, None]
    each, status = jax.jit(positions)(model, drives, turns, q)
    assert (np.asarray(status) == 0).all()
    for crank, coupler, rocker, *_ in OPEN:
        i = round(crank / 10)
        np.testing.assert_allclose(
            np.rad2deg([each[i, 0] + each[i, 1], each[i, 2]]), [coupler, rocker], atol=1e-8
        )
    # the coupler's is relative to the crank
    np.testing.assert_allclose(each[-1] - each[0], [2 * np.pi, -2 * np.pi, 0.0], atol=1e-9)


@pytest.mark.long
def test_what_cannot_be_assembled_is_named():
    with pytest.warns(jb.JaxbodyWarning, match=r"NOT_CLOSED.*'pin x' stays 0.3.* m apart"):
        done = jb.suspension.assemble(four_bar(coupler=0.5, rocker=0.08))
    assert done.report().startswith("NOT_CLOSED")


def test_bad_input():
    with pytest.raises(jb.JaxbodyError, match=r"closures.*is a Hinge"):
        jb.Model(bodies={"a": BAR}, closures={"pin": jb.Hinge("world", axis="z")})
    with pytest.raises(jb.JaxbodyError, match=r"closures\['pin'\].*UNKNOWN_BODY"):
        jb.Model(
            bodies={"a": BAR},
            closures={"pin": jb.closures.Ball(("b", [0, 0, 0]), ("a", [0, 0, 0]))},
        )
    with pytest.raises(jb.JaxbodyError, match="NOT_POSITIVE"):
        jb.closures.Rod(("a", [0, 0, 0]), ("world", [0, 0, 0]), length=0.0)
    with pytest.raises(jb.JaxbodyError, match="ZERO_AXIS"):
        jb.closures.Inline(("a", [0, 0, 0]), ("world", [0, 0, 0]), axis=[0, 0, 0])
    ends = ("b", [0, 0, 0]), ("world", [0, 0.1, 0])
    joints = {"a": jb.Fixed("world"), "b": jb.Fixed("a"), "c": jb.Hinge("b", axis="z")}
    with pytest.raises(
        jb.JaxbodyError,
        match=r"closures\['pin'\]: joins 'b' and 'world', which are joined rigidly already.*RIGID",
    ):
        jb.Model(
            bodies=dict.fromkeys("abc", BAR),
            joints=joints,
            closures={"pin": jb.closures.Ball(*ends)},
        )
    table = {"table": jb.Support(position=[0, 0.1, 0])}
    with pytest.raises(
        jb.JaxbodyError,
        match=r"joins 'b' and 'table', neither of which moves but by imposed motion.*RIGID",
    ):
        jb.Model(
            bodies=dict.fromkeys("ab", BAR),
            supports=table,
            joints={k: joints[k] for k in "ab"},
            closures={"pin": jb.closures.Weld(ends[0], ("table", [0, 0, 0]))},
        )
    point = jb.closures.Rod(("a", [0, 0, 0]), ("world", [0, 0, 0]))
    with pytest.raises(
        jb.JaxbodyError,
        match=(
            r"closures\['point'\]: has length 0 m in the reference pose.*To give it "
            r"one, move.*ZERO_LENGTH"
        ),
    ):
        jb.Model(bodies={"a": BAR}, closures={"point": point})
    with pytest.raises(jb.JaxbodyError, match=r"has no closures.*NO_CLOSURE"):
        jb.suspension.assemble(jb.Model(bodies={"a": BAR}))
    with pytest.raises(jb.JaxbodyError, match=r"assemble.hold.*UNKNOWN_NAME"):
        jb.suspension.assemble(four_bar(), hold=["cranc"])


@pytest.mark.nan
def test_a_condition_without_slopes_is_refused():
    apart = jb.closures.Equation(lambda A, B: jnp.linalg.norm(A.p - B.p), ("a", "world"))
    with pytest.raises(
        jb.JaxbodyError, match=r"closures\['apart'\]: has slopes that are not finite.*NON_FINITE"
    ):
        jb.Model(bodies={"a": BAR}, closures={"apart": apart})


def two_arms(length=0.35):
    """Arms that turn about z and about y, joined by a rod; drawn open, with one freedom
    when assembled."""
    place = np.array([0.25, 0.05, 0.1])
    joints = {"input": jb.Hinge("world", axis="z"), "output": jb.Hinge("world", axis="y", at=place)}
    rod = jb.closures.Rod(("input", [0.1, 0, 0]), ("output", [0.2, 0, 0]), length=length)
    return jb.Model(
        bodies={"input": BAR, "output": jb.Body(1.0, [1, 1, 1], position=place)},
        joints=joints,
        closures={"rod": rod},
    )


def differences(function, x, h=1e-5):
    """Central, of fourth order."""
    steps = h * np.eye(len(x))
    return np.stack(
        [
            (8 * (function(x + s) - function(x - s)) - function(x + 2 * s) + function(x - 2 * s))
            / (12 * h)
            for s in steps
        ],
        -1,
    )


@pytest.mark.long
@pytest.mark.parametrize("hold", [(), ("input",)])
def test_an_assembled_state_has_derivatives_by_its_start(hold):
    """By a coordinate that is held, and by those of the least movement, which is far here; by a
    length too."""
    model = two_arms()

    def assembled(x):
        changed = jb.replace(model, {"rod.length": x[2]})
        return jb.suspension.assemble(
            changed, start=jb.State(x[:2], jnp.zeros(2)), hold=hold
        ).state.q

    x = jnp.array([np.deg2rad(30.0), 0.1, 0.35])
    expected = differences(assembled, x)
    assert np.abs(assembled(x) - x[:2]).max() > 0.05
    if hold:  # F(a, b) = |d|^2 - l^2 = 0 gives db/da
        np.testing.assert_allclose(expected[1, 0], 0.56819365, rtol=1e-7)
    for of in (jax.jacfwd, jax.jacrev):
        np.testing.assert_allclose(of(assembled)(x), expected, rtol=1e-8, atol=1e-8)
        np.testing.assert_allclose(jax.jit(of(assembled))(x), expected, rtol=1e-8, atol=1e-8)


@pytest.mark.long
def test_the_reference_of_a_free_body_follows_where_it_is_drawn():
    ball = jb.closures.Ball(("world", [0, 0, 0]), ("bar", [0, 0.1, 0.4]))
    model = jb.Model(
        bodies={"bar": jb.Body(1.0, [1, 1, 1], position=[0.1, 0.2, -0.5])}, closures={"ball": ball}
    )
    place, at = (
        jnp.array([0.1, 0.2, -0.5]),
        lambda p: jb.replace(model, {"bar.position": p}).reference.q,
    )
    for of in (jax.jacfwd, jax.jacrev):
        np.testing.assert_allclose(
            jax.jit(of(at))(place), differences(at, place), rtol=1e-8, atol=1e-8
        )
    open_, lengths = two_arms(), lambda x: jb.replace(two_arms(), {"rod.length": x[0]}).reference.q
    assert np.abs(open_.reference.q).max() > 0.2  # rad, far from the drawing
    np.testing.assert_allclose(
        jax.jacfwd(lengths)(jnp.array([0.35])), differences(lengths, jnp.array([0.35])), rtol=1e-7
    )


@pytest.mark.nan
@pytest.mark.long
def test_what_cannot_be_assembled_is_nan_while_traced_and_stays_where_it_ended_otherwise():
    model, start = two_arms(), jb.State(jnp.array([0.5, 0.4]), jnp.zeros(2))

    def assembly(x):
        return jb.suspension.assemble(
            jb.replace(model, {"rod.length": x[0]}),
            start=dataclasses.replace(start, q=x[1:]),
            hold=["input"],
        )

    def reference(x):
        return jb.replace(model, {"rod.length": x[0]}).reference.q

    x = jnp.array([5.0, 0.5, 0.4])
    with pytest.warns(jb.JaxbodyWarning, match="NOT_CLOSED.*'rod length' stays"):
        assert np.isfinite(assembly(x).state.q).all()
    with pytest.warns(jb.JaxbodyWarning, match="assemble.*NOT_CLOSED"):
        assert np.isfinite(reference(x)).all()
    traced = jax.jit(assembly)(x)
    assert np.isnan(traced.state.q).all()
    assert "'rod length' stays" in traced.report()
    with pytest.warns(jb.JaxbodyWarning, match="NOT_CLOSED"):
        for of in (jax.jacfwd, jax.jacrev):
            assert np.isnan(of(lambda x: assembly(x).state.q)(x)).all()
            assert np.isnan(jax.jit(of(lambda x: assembly(x).state.q))(x)).all()
    for of in (lambda f: f, jax.jacfwd, jax.jacrev):
        assert np.isnan(jax.jit(of(reference))(x[:1])).all()


def test_loops_are_refused_in_float32():
    """Their gaps would have to be closed to more digits than there are."""
    with jax.enable_x64(False):
        model, corner = four_bar(), jb.suspension.double_wishbone()
        calls = (
            lambda: jb.suspension.assemble(model),
            lambda: jb.simulate(model, [0.0, 0.1]),
            lambda: jb.equilibrium(model),
            lambda: jb.linearize(model, jb.State(np.zeros(3, np.float32), np.zeros(3, np.float32))),
            lambda: corner.curves(0.0),
        )
        for call in calls:
            with pytest.raises(
                jb.JaxbodyError,
                match=(
                    r"cannot close loops in float32.*jax_enable_x64.*building the "
                    r"model\. \[FLOAT32\]"
                ),
            ):
                call()


def test_a_pin_of_a_planar_linkage_needs_no_conditions_out_of_its_plane():
    """Inline along the axis of the hinges has two conditions, none of which follows from the
    others, and the same position."""
    pin = jb.closures.Inline(
        ("coupler", [CRANK + COUPLER, 0, 0]), ("rocker", [GROUND + ROCKER, 0, 0]), axis="z"
    )
    start = state(40, -20, 50)
    two, five = (
        jb.suspension.assemble(model, start=start, hold=["crank"])
        for model in (four_bar(pin), four_bar())
    )
    np.testing.assert_allclose(two.state.q, five.state.q, atol=1e-9)
    assert "implied" not in str(
        two
    ) and "implied by the others: pin z, pin turn 1, pin turn 2" in str(five)
