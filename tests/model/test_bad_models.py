"""Messages for invalid models: the object, the value, the limit and the remedy, all problems in
one error."""

import re
import warnings

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import jaxbody as jb
from jaxbody.core.compilation.compile_options import program

NAN, INF = float("nan"), 1e999
TURN = Rotation.from_rotvec([0.3, -0.5, 0.8]).as_matrix()
BODY = jb.Body(mass=1.0, inertia=[1, 1, 1], position=[0, 0, 1])
SUPPORT = jb.Support()
SPRING = jb.Spring(("engine", [0, 0, 0]), ("base", [0, 0, 0]), stiffness=1.0)


def body(**changed):
    return jb.Body(**{"mass": 1.0, "inertia": [1.0, 1.0, 1.0]} | changed)


def spring(a="engine", b="base", **changed):
    return jb.Spring((a, [0, 0, 0]), (b, [0, 0, 0]), **{"stiffness": 1.0} | changed)


def composite(steps, **more):
    return jb.joints.Composite(
        "base",
        steps,
        **{"directions": [[0, 0, 1]] * len(steps), "points": [[0, 0, 0]] * len(steps)} | more,
    )


def bushing(**changed):
    return jb.Bushing(
        ("engine", [0, 0, 0]), ("base", [0, 0, 0]), **{"stiffness": [1.0, 1.0, 1.0]} | changed
    )


def model(**changed):
    return jb.Model(**{"bodies": {"engine": BODY}, "supports": {"base": SUPPORT}} | changed)


def changed(array, *index, to):
    array = np.array(array, dtype=type(to))
    array[index] = to
    return array


SKEWED = changed(np.eye(6), 0, 1, to=0.5)
INDEFINITE = np.diag([1.0, 1, 1, 1, 1, -2])

# number in the table of bad inputs: what is done, code, where, value (None where it is not one
# number or word), words of the message
BAD = {
    "1 unknown body": (
        lambda: model(elements={"m3": spring("enigne")}),
        "UNKNOWN_BODY",
        "elements['m3']",
        "enigne",
        "'engine' base",
    ),
    "1 unknown parent": (
        lambda: model(joints={"engine": jb.Fixed("bse")}),
        "UNKNOWN_BODY",
        "joints['engine']",
        "bse",
        "'base'",
    ),
    "1 joint of no body": (
        lambda: model(joints={"gear": jb.Fixed("base")}),
        "UNKNOWN_BODY",
        "joints['gear']",
        "gear",
        "engine",
    ),
    "2 body and support": (
        lambda: model(supports={"engine": SUPPORT}),
        "DUPLICATE_NAME",
        "supports['engine']",
        "engine",
        "bodies",
    ),
    "2 body and element": (
        lambda: model(elements={"engine": SPRING}),
        "DUPLICATE_NAME",
        "elements['engine']",
        "engine",
        "bodies",
    ),
    **{
        f"3 name {name!r:.8}": (
            lambda name=name: model(supports={name: SUPPORT}),
            "BAD_NAME",
            f"supports[{name!r}]",
            name,
            "200",
        )
        for name in ("", "x" * 201, "a\n", "a\x00", "world", "a.b", "a*", "a?", "a[", "a]", 3)
    },
    "4 mass": (lambda: body(mass=-3), "BAD_MASS", "Body.mass", -3.0, "-3 kg > 0"),
    "4 no mass": (lambda: body(mass=0), "BAD_MASS", "Body.mass", 0.0, "0 kg > 0"),
    "5 NaN mass": (lambda: body(mass=NAN), "NON_FINITE", "Body.mass", NAN, "nan finite"),
    "5 infinite mass": (lambda: body(mass=INF), "NON_FINITE", "Body.mass", INF, "inf finite"),
    "5 text": (lambda: body(mass="nan"), "NOT_A_NUMBER", "Body.mass", "nan", "'nan' number"),
    "5 center of mass": (lambda: body(com=[0, INF, 0]), "NON_FINITE", "Body.com", None, "inf"),
    "5 inertia": (lambda: body(inertia=[1, NAN, 1]), "NON_FINITE", "Body.inertia", None, "nan"),
    "5 position": (
        lambda: jb.Support(position=[NAN, 0, 0]),
        "NON_FINITE",
        "Support.position",
        None,
        "nan",
    ),
    "5 orientation": (
        lambda: body(orientation=[NAN, 0, 0, 0]),
        "NON_FINITE",
        "Body.orientation",
        None,
        "nan",
    ),
    "5 stiffness": (lambda: spring(stiffness=NAN), "NON_FINITE", "Spring.stiffness", NAN, "nan"),
    "5 matrix": (
        lambda: bushing(stiffness=changed(np.eye(6), 2, 3, to=NAN)),
        "NON_FINITE",
        "Bushing.stiffness",
        None,
        "nan 2 3",
    ),
    "5 point": (
        lambda: jb.Spring(("engine", [NAN, 0, 0]), ("base", [0, 0, 0]), stiffness=1),
        "NON_FINITE",
        "Spring, first end (engine)",
        None,
        "nan",
    ),
    "5 gravity": (lambda: model(gravity=[0, 0, NAN]), "NON_FINITE", "gravity", None, "nan"),
    "5 axis": (lambda: jb.Hinge("base", axis=[0, NAN, 1]), "NON_FINITE", "Hinge.axis", None, "nan"),
    "7 two moments": (
        lambda: body(inertia=[1, 1]),
        "BAD_SHAPE",
        "Body.inertia",
        (2,),
        "(2,) (3,) (6,) Ixy matrix",
    ),
    "7 one moment": (
        lambda: body(inertia=1.0),
        "BAD_SHAPE",
        "Body.inertia",
        (),
        "() (3,) (6,) Ixy matrix",
    ),
    "7 small matrix": (
        lambda: body(inertia=np.eye(2)),
        "BAD_SHAPE",
        "Body.inertia",
        (2, 2),
        "(2, 2) (3, 3)",
    ),
    "8 asymmetric": (
        lambda: body(inertia=changed(np.eye(3), 0, 1, to=2e-8)),
        "NOT_SYMMETRIC",
        "Body.inertia",
        None,
        "2e-08 3e-09 I'",
    ),
    "9 indefinite": (
        lambda: body(inertia=TURN @ np.diag([3, 3, -1]) @ TURN.T),
        "NOT_POSITIVE",
        "Body.inertia",
        None,
        "-1, 3, 3 signs",
    ),
    "18 no sequence": (
        lambda: jb.EulerAngles("", []),
        "BAD_SEQUENCE",
        "EulerAngles.sequence",
        "",
        "ZYX yaw",
    ),
    "18 mixed sequence": (
        lambda: jb.EulerAngles("Zyx", [0, 0, 0]),
        "BAD_SEQUENCE",
        "EulerAngles.sequence",
        "Zyx",
        "Capitals small",
    ),
    "18 axis twice": (
        lambda: jb.EulerAngles("ZZX", [0, 0, 0]),
        "BAD_SEQUENCE",
        "EulerAngles.sequence",
        "ZZX",
        "twice",
    ),
    "18 two angles": (
        lambda: jb.EulerAngles("ZYX", [0.1, 0.2]),
        "BAD_SHAPE",
        "EulerAngles.angles",
        (2,),
        "(2,) (3,) letter",
    ),
    "61 degrees": (
        lambda: jb.EulerAngles("ZYX", [30.0, 0, 0]),
        "DEGREES",
        "EulerAngles.angles",
        None,
        "30 deg2rad",
    ),
    "no parts": (
        lambda: jb.Body.of_parts([]),
        "NO_PARTS",
        "Body.of_parts",
        None,
        "position orientation",
    ),
    "10 triangle": (
        lambda: body(inertia=TURN @ np.diag([1, 4, 2]) @ TURN.T),
        "TRIANGLE",
        "Body.inertia",
        None,
        "1, 2, 4 by 1 center units",
    ),
    "10 of a plane": (
        lambda: body(inertia=[0, 0, 0.3]),
        "TRIANGLE",
        "Body.inertia",
        None,
        "0, 0, 0.3 plane 0.15, 0.15, 0.3.",
    ),
    "10 signs of products": (
        lambda: body(inertia=[2, 2, 2, 0.9, 0.9, 0.9]),
        "TRIANGLE",
        "Body.inertia",
        None,
        "1.1, 1.1, 3.8 by 1.6 signs",
    ),
    "15 scaled": (
        lambda: body(orientation=1.1 * TURN),
        "BAD_ROTATION",
        "Body.orientation",
        None,
        "0.36 1.331 SVD",
    ),
    "15 mirrored": (
        lambda: jb.Support(orientation=-TURN),
        "BAD_ROTATION",
        "Support.orientation",
        None,
        "-1 right-handed",
    ),
    "15 rounded": (
        lambda: bushing(orientation=np.round(TURN, 8)),
        "BAD_ROTATION",
        "Bushing.orientation",
        None,
        "e-0 1e-12 SVD",
    ),
    "15 hardly wrong": (
        lambda: body(orientation=TURN * (1 + 2e-12)),
        "BAD_ROTATION",
        "Body.orientation",
        None,
        "e-12",
    ),
    "16 zero": (
        lambda: body(orientation=[0, 0, 0, 0]),
        "BAD_QUATERNION",
        "Body.orientation",
        None,
        "0 zero 1e-3",
    ),
    "16 not unit": (
        lambda: bushing(orientation_b=[1, 0.1, 0, 0]),
        "BAD_QUATERNION",
        "Bushing.orientation_b",
        None,
        "1.00499 1e-3 w, x, y, z",
    ),
    "16 angles": (
        lambda: body(orientation=[0, 0, 1.5]),
        "BAD_SHAPE",
        "Body.orientation",
        (3,),
        "(4,) (3, 3) w, x, y, z",
    ),
    "19 no length": (
        lambda: model(
            bodies={"engine": body(position=[5, 0, 0])},
            elements={
                "m": jb.Spring(
                    ("engine", [0, 0, 0]), ("base", [5, 0, 0]), stiffness=1, free_length=0.1
                )
            },
        ),
        "ZERO_LENGTH",
        "elements['m']",
        0.0,
        "0 m direction Bushing more than 5e-06 m",
    ),
    "19 no length, damped": (
        lambda: model(bodies={"engine": body()}, elements={"m": spring(damping=1.0)}),
        "ZERO_LENGTH",
        "elements['m']",
        0.0,
        "damping",
    ),
    "bushing the wrong way round": (
        lambda: model(elements={"m": bushing(orientation_b=[0, 0, 1, 0])}),
        "HALF_TURN",
        "elements['m']",
        None,
        "180 179 orientation_b",
    ),
    "22 stiffness": (
        lambda: spring(stiffness=-5),
        "NEGATIVE_STIFFNESS",
        "Spring.stiffness",
        -5.0,
        "-5 N/m >= 0 allow_negative",
    ),
    "22 bushing": (
        lambda: bushing(stiffness=[1, -5, 1]),
        "NEGATIVE_STIFFNESS",
        "Bushing.stiffness",
        None,
        "-5 >= 0 allow_negative",
    ),
    "22 free length": (
        lambda: spring(free_length=-1),
        "NEGATIVE_LENGTH",
        "Spring.free_length",
        -1.0,
        "-1 m >= 0",
    ),
    "23 damping": (
        lambda: spring(damping=-2),
        "NEGATIVE_DAMPING",
        "Spring.damping",
        -2.0,
        "-2 N s/m >= 0 allow_negative",
    ),
    "23 bushing": (
        lambda: bushing(damping=[1, -5, 1]),
        "NEGATIVE_DAMPING",
        "Bushing.damping",
        None,
        "-5 >= 0 allow_negative",
    ),
    "24 asymmetric": (
        lambda: bushing(stiffness=SKEWED),
        "NOT_SYMMETRIC",
        "Bushing.stiffness",
        None,
        "0.5 1e-09 (K + K')/2",
    ),
    "24 indefinite": (
        lambda: bushing(stiffness=INDEFINITE),
        "NEGATIVE_STIFFNESS",
        "Bushing.stiffness",
        None,
        "-2, 1, 1, 1, 1, 1 >= 0",
    ),
    "24 shape": (
        lambda: bushing(stiffness=np.eye(3)),
        "BAD_SHAPE",
        "Bushing.stiffness",
        (3, 3),
        "(3, 3) (6, 6)",
    ),
    "26 one body": (
        lambda: spring("engine", "engine"),
        "SELF_SPRING",
        "Spring",
        "engine",
        "both ends different",
    ),
    "26 bushing": (
        lambda: jb.Bushing(("a", [0, 0, 0]), ("a", [1, 0, 0]), stiffness=[1, 1, 1]),
        "SELF_SPRING",
        "Bushing",
        "a",
        "both ends different",
    ),
    "44 object": (lambda: body(mass=object()), "NOT_A_NUMBER", "Body.mass", None, "object number"),
    "44 nothing": (lambda: body(mass=None), "NOT_A_NUMBER", "Body.mass", None, "None number"),
    "44 ragged": (
        lambda: body(inertia=[[1, 0, 0], [0, 1], [0]]),
        "NOT_A_NUMBER",
        "Body.inertia",
        None,
        "[[1, 0, 0] number",
    ),
    "44 dates": (
        lambda: body(mass=np.datetime64("2011-06-19")),
        "NOT_A_NUMBER",
        "Body.mass",
        None,
        "2011-06-19 number",
    ),
    "44 masked": (
        lambda: body(mass=np.ma.masked_array(1.0, True)),
        "NON_FINITE",
        "Body.mass",
        NAN,
        "nan",
    ),
    "45 mass": (lambda: body(mass=1 + 2j), "COMPLEX", "Body.mass", 1 + 2j, "complex real"),
    "45 inertia": (
        lambda: body(inertia=np.eye(3) * 1j),
        "COMPLEX",
        "Body.inertia",
        None,
        "complex real",
    ),
    "45 bushing": (
        lambda: bushing(stiffness=np.eye(6) * 1j),
        "COMPLEX",
        "Bushing.stiffness",
        None,
        "complex real",
    ),
    "45 gravity": (lambda: model(gravity=[0, 0, 1j]), "COMPLEX", "gravity", None, "complex real"),
    "45 under jit": (
        lambda: jax.jit(lambda z: body(mass=z).mass)(1 + 2j),
        "COMPLEX",
        "Body.mass",
        None,
        "complex real",
    ),
    "no body": (lambda: model(bodies={}), "NO_BODY", "bodies", None, "at least one"),
    "no Body": (
        lambda: model(bodies={"engine": 3.0}),
        "WRONG_KIND",
        "bodies['engine']",
        3.0,
        "float Body",
    ),
    "no end": (
        lambda: jb.Spring(["engine"], ("base", [0, 0, 0]), stiffness=1),
        "BAD_END",
        "Spring, first end",
        ["engine"],
        "['engine'] point",
    ),
    "axis of no length": (
        lambda: jb.Guide("base", axis=[0, 0, 0]),
        "ZERO_AXIS",
        "Guide.axis",
        None,
        "zero > 0 direction",
    ),
    "composite of nothing": (
        lambda: composite([], directions=np.zeros((0, 3)), points=np.zeros((0, 3))),
        "BAD_SHAPE",
        "Composite.steps",
        None,
        "empty Fixed",
    ),
    "composite of a word": (
        lambda: composite(["slide"]),
        "UNKNOWN_NAME",
        "Composite.steps",
        "slide",
        "move turn",
    ),
    "composite of a number": (
        lambda: composite([3]),
        "UNKNOWN_NAME",
        "Composite.steps",
        3,
        "move turn",
    ),
    "composite of other rows": (
        lambda: composite(["move"], points=[]),
        "BAD_SHAPE",
        "Composite.points",
        (0,),
        "(1, 3) row each step",
    ),
    "composite without an axis": (
        lambda: composite(["move"], directions=[[0, 0, 0]]),
        "ZERO_AXIS",
        "Composite.directions",
        None,
        "zero > 0 direction",
    ),
    "a body on itself": (
        lambda: model(joints={"engine": jb.Fixed("engine")}),
        "LOOP",
        "joints['engine']",
        "engine",
        "engine on engine tree stiff Bushing",
    ),
}


def error_of(build):
    with pytest.raises(jb.JaxbodyError) as caught:
        build()
    return caught.value


@pytest.mark.parametrize("case", BAD)
def test_bad_input_is_reported_by_name_and_value(case):
    build, code, where, value, words = BAD[case]
    error = error_of(build)
    assert (error.code, error.where) == (code, where)
    assert len(error.problems) == 1
    if value is not None:
        np.testing.assert_equal(error.value, value)
    assert error.limit and error.hint
    message = str(error)
    for word in words.split(" "):
        assert word in message, word


@pytest.mark.parametrize("case", BAD)
def test_a_message_has_object_limit_remedy_and_code_and_no_word_of_the_machinery(case):
    error = error_of(BAD[case][0])
    message = str(error)
    assert error.where in message
    assert error.limit in message
    assert error.hint in message
    assert f"[{error.code}]" in message
    assert len(message.splitlines()) <= 12
    assert not re.search(
        r"jax\b|tracer|xla|equinox|traceback", message.replace("jaxbody", ""), re.IGNORECASE
    )


def test_all_problems_of_a_body_are_reported_at_once():
    error = error_of(
        lambda: jb.Body(
            mass=-1, inertia=[1, 1, 3], com=[0, 0], position=[NAN, 0, 0], orientation=[0, 0, 0, 0]
        )
    )
    assert [problem.code for problem in error.problems] == [
        "BAD_MASS",
        "BAD_SHAPE",
        "TRIANGLE",
        "NON_FINITE",
        "BAD_QUATERNION",
    ]
    assert all(str(problem) in str(error) for problem in error.problems)


def test_all_problems_of_an_element_or_a_joint_are_reported_at_once():
    ends = ("engine", [0, NAN, 0]), ("engine", [0, 0])
    codes = [
        problem.code
        for problem in error_of(
            lambda: jb.Spring(*ends, stiffness=-1, free_length=[1], damping=1j)
        ).problems
    ]
    assert codes == [
        "NON_FINITE",
        "BAD_SHAPE",
        "SELF_SPRING",
        "BAD_SHAPE",
        "COMPLEX",
        "NEGATIVE_STIFFNESS",
    ]
    codes = [
        problem.code
        for problem in error_of(lambda: jb.Hinge("base", axis=[0, 0, 0], at=[1, 2])).problems
    ]
    assert codes == ["ZERO_AXIS", "BAD_SHAPE"]


def test_all_problems_of_a_model_are_reported_at_once():
    error = error_of(
        lambda: jb.Model(
            bodies={
                "engine": BODY,
                "gear": body(),
                "a.b": body(),
                "tank": 3.0,
                "left": body(),
                "right": body(),
            },
            supports={"base": SUPPORT, "gear": SUPPORT},
            elements={
                "m1": spring("enigne"),
                "m2": spring("engine", "floor"),
                "m3": jb.Spring(
                    ("gear", [0, 0, 0]), ("base", [0, 0, 0]), stiffness=1, free_length=1
                ),
            },
            joints={"left": jb.Fixed("right"), "right": jb.Ball("left"), "geer": jb.Fixed("base")},
            gravity=[0, 0, NAN],
        )
    )
    result = {(problem.code, problem.where) for problem in error.problems}
    assert result == {
        ("BAD_NAME", "bodies['a.b']"),
        ("WRONG_KIND", "bodies['tank']"),
        ("DUPLICATE_NAME", "supports['gear']"),
        ("UNKNOWN_BODY", "elements['m1']"),
        ("UNKNOWN_BODY", "elements['m2']"),
        ("UNKNOWN_BODY", "joints['geer']"),
        ("LOOP", "joints['left']"),
        ("LOOP", "joints['right']"),
        ("NON_FINITE", "gravity"),
        ("ZERO_LENGTH", "elements['m3']"),
    }
    assert len(str(error).splitlines()) <= 12


def test_a_message_stays_short_however_many_problems_there_are():
    error = error_of(lambda: model(elements={f"m{i}": spring(f"b{i}") for i in range(40)}))
    assert len(error.problems) == 40
    assert len(str(error).splitlines()) <= 12
    assert "40 problems" in str(error) and "more" in str(error).splitlines()[-1]


def test_a_loop_of_joints_is_reported_by_its_bodies():
    names = ["a", "b", "c"]
    bodies = {name: body() for name in [*names, "tail"]}
    joints = {name: jb.Fixed(parent) for name, parent in zip(names, [*names[1:], "a"], strict=True)}
    error = error_of(lambda: jb.Model(bodies=bodies, joints=joints | {"tail": jb.Fixed("a")}))
    assert {problem.code for problem in error.problems} == {"LOOP"}
    assert "a on b on c on a" in str(error)


@pytest.mark.parametrize(
    ("one", "other"), [("Mount", "mount"), ("caf\u00e9", "cafe\u0301"), ("\ufb01n", "fin")]
)
def test_names_that_look_alike_are_warned_of(one, other):
    with pytest.warns(jb.JaxbodyWarning, match="look alike") as caught:
        model(bodies={one: BODY}, supports={other: SUPPORT})
    assert [warning.message.code for warning in caught] == ["LOOK_ALIKE"]


@pytest.mark.parametrize("name", ["m\u00fcnchen", "left mount 3", "a/b-c_d", "\u7532", "x" * 200])
def test_other_names_are_good(name):
    assert model(bodies={name: BODY})[name].mass == 1.0


def test_elements_without_effect_and_tiny_masses_issue_warnings():
    with pytest.warns(jb.JaxbodyWarning, match="elements\\['m'\\]") as caught:
        model(elements={"m": jb.Spring(("world", [0, 0, 0]), ("base", [0, 0, 1]), stiffness=1.0)})
    assert [warning.message.code for warning in caught] == ["USELESS_SPRING"]
    for tiny, what in (
        (body(mass=1e-13), "mass of 'speck'"),
        (body(inertia=[1e-13, 1e-13, 1e-13]), "inertia of 'speck'"),
    ):
        with pytest.warns(jb.JaxbodyWarning, match=what) as caught:
            model(bodies={"engine": BODY, "speck": tiny})
        assert [warning.message.code for warning in caught] == ["TINY_MASS"]


def rods_and_plates(rng, n):
    """Inertia tensors on the very boundary of the triangle inequality, turned: of rods, of plates,
    of points on a line or in a plane."""
    for _ in range(n):
        R = Rotation.random(rng=rng).as_matrix()
        points = (
            rng.normal(size=(rng.integers(2, 6), 3))
            * rng.choice([[1, 0, 0], [1, 1, 0]])
            * 10 ** rng.uniform(-3, 3)
        )
        masses = rng.uniform(0.1, 1, size=len(points))
        yield masses, points @ R.T


def inertia(masses, points):
    return np.einsum(
        "n,nij->ij",
        masses,
        np.einsum("nk,nk,ij->nij", points, points, np.eye(3))
        - points[:, :, None] * points[:, None],
    )


def test_a_true_inertia_is_never_rejected_for_its_round_off(rng):
    """Also where it was carried over from the reference point, far off: I_O - m (c'c - c c')."""
    for masses, points in rods_and_plates(rng, 300):
        total, center = masses.sum(), masses @ points / masses.sum()
        body(mass=total, inertia=inertia(masses, points - center))
        far = center + 1e3 * np.linalg.norm(points) * rng.normal(size=3)
        about_O = inertia(masses, points - center + far)
        body(mass=total, inertia=about_O - inertia(np.array([total]), far[None]), com=far)


def test_an_inertia_beyond_round_off_is_rejected(rng):
    for masses, points in rods_and_plates(rng, 30):
        I = inertia(masses, points - masses @ points / masses.sum())
        moments, axes = np.linalg.eigh(I)
        moments[2] += 1e-9 * moments[2]
        with pytest.raises(jb.JaxbodyError, match="TRIANGLE"):
            body(inertia=axes @ np.diag(moments) @ axes.T)


@pytest.mark.parametrize(
    "form",
    [
        [2, 3, 4],
        np.array([2, 3, 4], dtype=np.int32),
        (2.0, 3.0, 4.0),
        [2, 3, 4, 0, 0, 0],
        np.diag([2, 3, 4]),
        jnp.array([2, 3, 4]),
    ],
    ids=["list", "integers", "tuple", "six", "matrix", "jax"],
)
def test_every_form_of_an_inertia_is_the_same_matrix_of_floats(form):
    result = body(inertia=form).inertia
    assert result.dtype == np.float64
    assert (result == np.diag([2.0, 3, 4])).all()


def test_six_numbers_of_an_inertia_are_the_entries_of_the_matrix():
    assert (
        body(inertia=[2, 3, 4, 0.1, 0.2, 0.3]).inertia
        == [[2, 0.1, 0.2], [0.1, 3, 0.3], [0.2, 0.3, 4]]
    ).all()


@pytest.mark.parametrize(
    "kind", ["quaternion", "scaled quaternion", "negative quaternion", "matrix"]
)
def test_every_form_of_an_orientation_is_the_same_unit_quaternion(kind, rng):
    half_turns = [Rotation.from_rotvec(np.pi * axis) for axis in np.eye(3)]
    for R in [Rotation.identity(), *half_turns, *Rotation.random(20, rng=rng)]:
        q = R.as_quat(scalar_first=True)
        given = {
            "quaternion": q,
            "scaled quaternion": 1.0005 * q,
            "negative quaternion": -q,
            "matrix": R.as_matrix(),
        }[kind]
        result = body(orientation=given).orientation
        assert abs(np.linalg.norm(result) - 1) <= 1e-15
        assert (
            np.abs(Rotation.from_quat(result, scalar_first=True).as_matrix() - R.as_matrix()).max()
            <= 2e-15
        )


def test_whole_numbers_become_floats_and_what_was_given_is_not_changed():
    point = np.array([1, 2, 3])
    built = jb.Spring(
        ("engine", point), ("base", [0, 0, 0]), stiffness=np.int64(3), free_length=True
    )
    assert built.a.dtype == built.stiffness.dtype == built.free_length.dtype == np.float64
    assert point.dtype.kind == "i" and not np.shares_memory(point, built.a)
    given = np.eye(3)
    made = body(inertia=given)
    given[0, 0] = 5
    assert made.inertia[0, 0] == 1.0


NEGATIVE = {
    "stiffness": (lambda: spring(stiffness=-5.0, allow_negative=True), "-5 N/m.*unstable"),
    "damping": (lambda: spring(damping=-2.0, allow_negative=True), "-2 N s/m.*gain energy"),
    "bushing": (
        lambda: bushing(stiffness=INDEFINITE, allow_negative=True),
        "-2, 1, 1, 1, 1, 1.*unstable",
    ),
}


@pytest.mark.parametrize("case", NEGATIVE)
def test_negative_coefficients_that_are_meant_are_warned_of(case):
    build, words = NEGATIVE[case]
    with pytest.warns(jb.JaxbodyWarning, match=words):
        assert build() is not None


def test_special_cases_that_are_allowed():
    """Zero stiffness along an axis of a bushing (25), and no length without free length (20)."""
    model(
        elements={
            "m": bushing(stiffness=[1, 0, 0]),
            "n": bushing(stiffness=np.diag([1.0, 0, 0, 0, 0, 0])),
        }
    )
    built = model(bodies={"engine": body()}, elements={"m": spring()})
    assert program(lambda built: jb.potential_energy(built, built.reference))(built) == 0


def test_a_body_is_built_from_traced_numbers_in_every_place():
    """Lists that hold traced numbers, a traced rotation matrix, masses and moments under jit: as
    when not traced."""

    def build(x):
        turned = jnp.array([[jnp.cos(x), -jnp.sin(x), 0], [jnp.sin(x), jnp.cos(x), 0], [0, 0, 1]])
        return jb.Body(
            mass=x,
            inertia=[x, 1, 1, 0, 0, x / 10],
            com=[0, x, 0],
            position=[x, 1, 2],
            orientation=turned,
        )

    traced, seen = jax.jit(build)(0.5), build(0.5)
    for a, b in zip(jax.tree.leaves(traced), jax.tree.leaves(seen), strict=True):
        assert a.dtype == b.dtype == np.float64
        assert np.abs(a - b).max() <= 1e-15


def test_angles_in_degrees_are_warned_of():
    """Angles of more than one turn; for a wound spring of one and a half turns the user ignores
    the warning."""
    with pytest.warns(
        jb.JaxbodyWarning,
        match=r"Torsion.free_angle is 30 rad, more than a turn.*np.deg2rad\(30\) \[UNIT\]",
    ):
        jb.Torsion("engine", "base", axis=[0, 0, 1], spring=30.0, free_angle=30.0)
    with pytest.warns(jb.JaxbodyWarning, match=r"Harmonic.rotation is 30 rad.*\[UNIT\]"):
        jb.Harmonic(frequency=1.0, rotation=[0, 0, 30])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        jb.Torsion("engine", "base", axis=[0, 0, 1], spring=30.0, free_angle=-3.0)
        jb.Harmonic(frequency=1.0, rotation=[0, 0, 0.5])


def test_products_with_the_other_sign_are_named_where_they_would_be_valid():
    """Of masses at points: I_xy = -sum m x y. With the other sign the moments are no longer those
    of any body."""
    masses = np.ones(4)
    points = np.array([[1.0, 1, 1], [-1, -1, -1], [1.1, 0.9, 1], [-1.1, -0.9, -1]])
    right = inertia(masses, points)
    body(inertia=right)
    with pytest.raises(
        jb.JaxbodyError, match=r"With the other signs it is valid: .* Ixy = -sum m x y"
    ):
        body(inertia=2 * np.diag(np.diag(right)) - right)
    with pytest.raises(jb.JaxbodyError) as refused:
        body(inertia=[1, 1, 9])
    assert "other signs" not in str(refused.value)


def test_a_model_whose_matrices_exceed_the_memory_is_refused():
    """Ten matrices of 12 000 x 12 000 numbers of 8 bytes are 11.5 GB."""
    many = jb.Model(bodies={f"b{i}": BODY for i in range(2000)})
    state = jb.State(np.zeros(14000), np.zeros(12000))
    for compute in (
        lambda: jb.linearize(many, state),
        lambda: jb.equilibrium(many),
        lambda: jb.find_equilibria(many),
    ):
        with pytest.raises(
            jb.JaxbodyError,
            match=(
                r"12000 coordinates and 0 elements, whose matrices need about 11\.5 "
                r"GB \(allowed: 8 GB\)"
            ),
        ) as refused:
            compute()
        assert refused.value.code == "TOO_LARGE"


@pytest.mark.long
def test_responses_at_too_many_frequencies_are_refused(monkeypatch):
    """Complex matrices of 2 x 2 at a million frequencies need 40 bytes for each number, 0.16 GB."""
    car = jb.presets.quarter_car()
    lin = jb.linearize(car, car.reference)
    inputs, outputs = {"road": jb.BaseMotion("road", "z")}, {"body": jb.Position("body", axis="z")}
    frequencies = np.linspace(0.1, 50, 1_000_000)
    spectra = {"road": jb.vibration.RoadRoughness.iso("C").at_speed(20.0)}
    monkeypatch.setattr("jaxbody.model.preconditions.MOST_MEMORY", 1e8)
    for compute in (
        lambda: jb.frequency_response(lin, frequencies, inputs, outputs),
        lambda: jb.random_response(lin, frequencies, inputs, outputs, spectra),
    ):
        with pytest.raises(
            jb.JaxbodyError,
            match=(
                r"whose matrices at 1000000 frequencies need about 0\.16 GB.*Give fewer frequencies"
            ),
        ) as refused:
            compute()
        assert refused.value.code == "TOO_LARGE"


BATCHED = {
    "equilibrium": jb.equilibrium,
    "linearize": lambda cars: jb.linearize(cars, CAR.reference),
    "simulate": lambda cars: jb.simulate(cars, [0.0, 0.1]),
    "potential_energy": lambda cars: jb.potential_energy(cars, CAR.reference),
    "reference": lambda cars: cars.reference,
}
CAR = jb.presets.quarter_car()


@pytest.mark.parametrize("name", BATCHED)
def test_a_batch_of_models_is_refused_with_the_way(name):
    """Each would end in a message of JAX about shapes; in a vmap all take it."""
    cars = jax.vmap(lambda k: jb.replace(CAR, {"suspension.stiffness": k}))(jnp.array([2e4, 3e4]))
    with pytest.raises(jb.JaxbodyError, match=r"is a batch of 2 models .*Use jax.vmap.*BAD_SHAPE"):
        BATCHED[name](cars)
    assert jax.vmap(lambda car: car.reference.q)(cars).shape == (2, 2)


def test_a_row_of_a_tree_without_rows_is_named():
    norms = jax.tree.map(jnp.linalg.norm, CAR)
    with pytest.raises(
        jb.JaxbodyError,
        match=r"model\['tyre'\]: has leaves without rows .*jb.parameter_paths\(model\)",
    ):
        norms["tyre"]
