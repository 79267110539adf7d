"""Paths name every number of a model or an experiment and nothing else, and `replace` changes these
numbers, traced or not."""

import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxbody as jb

RANDOM = np.random.default_rng(7)


def unit(x):
    return np.asarray(x) / np.linalg.norm(x)


@pytest.fixture(scope="module")
def zoo():
    """One of everything: five joints, springs, bushings of two shapes in between them,
    two supports."""
    at = {"at": [0.1, 0.2, 0.3]}
    return jb.Model(
        bodies={
            name: jb.Body(
                mass=1.0 + i,
                inertia=[1.0, 1.2, 1.3 + 0.1 * i],
                com=[0.1 * i, 0, 0],
                position=[i, 0, 1],
            )
            for i, name in enumerate(["plate", "arm", "cart", "bob", "lid"])
        },
        supports={
            "base": jb.Support(position=[0, 0, 0.5]),
            "wall": jb.Support(orientation=unit([1, 0.2, 0, 0])),
        },
        joints={
            "arm": jb.Hinge("base", axis=[0, 1, 1], **at),
            "cart": jb.Guide("world", axis=[1, 0, 0]),
            "bob": jb.Ball("arm"),
            "lid": jb.Fixed("cart"),
        },
        elements={
            "s1": jb.Spring(
                ("plate", [1, 0, 0]), ("base", [0, 0, 2]), stiffness=10.0, free_length=0.4
            ),
            "pad": jb.Bushing(("plate", [0, 1, 0]), ("arm", [0, 0, 1]), stiffness=[1.0, 2.0, 3.0]),
            "s2": jb.Spring(("bob", [0, 0, 1]), ("wall", [0, 1, 0]), stiffness=20.0, damping=0.5),
            "mount": jb.Bushing(
                ("plate", [0, 0, 0]), ("lid", [0, 0, 0]), stiffness=np.diag([1.0, 2, 3, 4, 5, 6])
            ),
            "s3": jb.Spring(
                ("cart", [0, 0, 0]),
                ("world", [9, 0, 0]),
                stiffness=30.0,
                free_length=1.0,
                damping=0.1,
            ),
        },
        gravity=[0.0, 0.1, -9.8],
    )


FIELDS = {
    "body": ("mass", "inertia", "com", "position", "orientation"),
    "support": ("position", "orientation"),
    "spring": ("a", "b", "stiffness", "free_length", "damping"),
    "bushing": ("a", "b", "stiffness", "damping", "orientation", "orientation_b"),
}
KINDS = {
    **dict.fromkeys(["plate", "arm", "cart", "bob", "lid"], "body"),
    **dict.fromkeys(["base", "wall"], "support"),
    **dict.fromkeys(["s1", "s2", "s3"], "spring"),
    **dict.fromkeys(["pad", "mount"], "bushing"),
}
JOINTS = {"arm": ("axis", "at"), "cart": ("axis",)}


def same(one, other):
    assert list(one) == list(other)
    for path in one:
        np.testing.assert_array_equal(one[path], other[path], err_msg=path)


def other_value(path, value):
    """Another value of the kind that a path leads to."""
    x = RANDOM.uniform(0.5, 1.5, np.shape(value))
    if x.ndim == 2:  # an inertia, a matrix of stiffness
        return np.eye(len(x)) + 0.1 * (x + x.T)
    return unit(x) if path.endswith("axis") or ".orientation" in path else x


def test_paths_lead_to_every_number_of_a_model_once(zoo):
    expected = {f"{name}.{field}" for name, kind in KINDS.items() for field in FIELDS[kind]} | {
        "gravity"
    }
    expected |= {f"{name}.{field}" for name, fields in JOINTS.items() for field in fields}
    result = jb.parameter_paths(zoo)
    assert set(result) == expected and len(result) == len(expected)
    assert sum(value.size for value in result.values()) == sum(
        leaf.size for leaf in jax.tree.leaves(zoo)
    )


def test_a_path_reads_what_the_name_gives(zoo):
    result = jb.parameter_paths(zoo)
    for name, kind in KINDS.items():
        for field in FIELDS[kind]:
            np.testing.assert_array_equal(result[f"{name}.{field}"], getattr(zoo[name], field))
    for name, fields in JOINTS.items():
        for field in fields:
            np.testing.assert_array_equal(
                result[f"{name}.{field}"], getattr(zoo.joint(name), field)
            )
    np.testing.assert_array_equal(result["gravity"], zoo.gravity)


def test_replace_changes_one_leaf_and_no_other(zoo):
    before = jb.parameter_paths(zoo)
    for path, value in before.items():
        new = other_value(path, value)
        after = jb.parameter_paths(jb.replace(zoo, {path: new}))
        np.testing.assert_allclose(after[path], new, rtol=1e-15, err_msg=path)
        same({**after, path: value}, before)


def test_replacing_all_paths_by_those_of_another_model_gives_that_model(zoo):
    other = jb.replace(
        zoo, {path: other_value(path, value) for path, value in jb.parameter_paths(zoo).items()}
    )
    again = jb.replace(zoo, jb.parameter_paths(other))
    assert jax.tree.structure(again) == jax.tree.structure(zoo)
    same(jb.parameter_paths(again), jb.parameter_paths(other))
    same(jb.parameter_paths(jb.replace(again, jb.parameter_paths(zoo))), jb.parameter_paths(zoo))


def test_matches_come_in_the_order_in_which_things_were_given(zoo):
    assert list(jb.parameter_paths(zoo, "s?.stiffness")) == [
        "s1.stiffness",
        "s2.stiffness",
        "s3.stiffness",
    ]
    assert list(jb.parameter_paths(zoo, "*.mass")) == [
        f"{name}.mass" for name in ("plate", "arm", "cart", "bob", "lid")
    ]
    backwards = jb.Model(
        bodies={"z": jb.Body(mass=1, inertia=[1, 1, 1]), "y": jb.Body(mass=2, inertia=[1, 1, 1])},
        elements={
            name: jb.Spring(("z", [0, 0, 0]), ("y", [1, 0, i]), stiffness=i)
            for i, name in enumerate("cba", 1)
        },
    )
    assert list(jb.parameter_paths(backwards, "*.stiffness")) == [
        "c.stiffness",
        "b.stiffness",
        "a.stiffness",
    ]
    assert list(jb.parameter_paths(backwards, "?.mass").values()) == [1, 2]


def test_wildcards_match_as_in_file_names(zoo):
    assert set(jb.parameter_paths(zoo, "s[13].[ab]")) == {"s1.a", "s1.b", "s3.a", "s3.b"}
    assert set(jb.parameter_paths(zoo, "*.orientation*")) == {
        path for path in jb.parameter_paths(zoo) if ".orientation" in path
    }
    assert set(jb.parameter_paths(zoo, "mount.*")) == {
        f"mount.{field}" for field in FIELDS["bushing"]
    }
    assert list(jb.parameter_paths(zoo, "grav*")) == ["gravity"]
    assert jb.parameter_paths(zoo, "S1.stiffness") == {}


def test_one_value_serves_every_match(zoo):
    after = jb.replace(zoo, {"s?.stiffness": 7, "*.com": [1, 2, 3], "[sp]*.b": np.ones(3)})
    assert all(value == 7.0 for value in jb.parameter_paths(after, "s?.stiffness").values())
    assert all(
        (value == np.array([1, 2, 3])).all()
        for value in jb.parameter_paths(after, "*.com").values()
    )
    assert all((after[name].b == 1).all() for name in ("s1", "s2", "s3", "pad"))
    assert (after["mount"].b == zoo["mount"].b).all()


def test_a_leading_axis_gives_a_value_to_each_match_in_the_order_of_paths(zoo):
    stiffness, ends = np.array([3.0, 2.0, 1.0]), RANDOM.normal(size=(5, 3))
    after = jb.replace(zoo, {"s?.stiffness": stiffness, "*.a": ends})
    for name, k in zip(("s1", "s2", "s3"), stiffness, strict=True):
        assert after[name].stiffness == k
    for path, a in zip(jb.parameter_paths(zoo, "*.a"), ends, strict=True):  # over three tables
        np.testing.assert_array_equal(jb.parameter_paths(after)[path], a)
    some = jb.replace(zoo, {"s[13].stiffness": [8, 9]})
    assert [float(some[name].stiffness) for name in ("s1", "s2", "s3")] == [8.0, 20.0, 9.0]


def test_an_axis_of_any_length_is_made_a_direction_as_by_the_joint(zoo):
    model = jb.replace(zoo, {"arm.axis": [0, 3, 4]})
    np.testing.assert_allclose(model.joint("arm").axis, [0, 0.6, 0.8], rtol=1e-15)
    model = jb.replace(zoo, {"*.orientation": [1.0004, 0, 0, 0]})
    np.testing.assert_array_equal(model["base"].orientation, [1, 0, 0, 0])
    traced = jax.jit(lambda n: jb.replace(zoo, {"arm.axis": n}).joint("arm").axis)(
        jnp.array([0.0, 3.0, 4.0])
    )
    np.testing.assert_allclose(traced, [0, 0.6, 0.8], rtol=1e-15)


def energy(model):
    """A number that depends on several leaves."""
    return (
        jnp.sum(model["s1"].stiffness * model["s2"].a ** 2) * model["bob"].mass
        + jnp.sum(model["pad"].stiffness) * model.gravity[2]
    )


def test_replace_inside_jit_grad_and_vmap(zoo):
    def changed(k, a, m):
        return energy(
            jb.replace(
                zoo, {"s?.stiffness": k, "s2.a": a, "*.mass": m, "pad.stiffness": k * jnp.ones(3)}
            )
        )

    k, a, m = 3.0, np.array([1.0, 2.0, 3.0]), np.arange(1.0, 6.0)
    expected = 3.0 * 14.0 * 4.0 + 9.0 * -9.8
    np.testing.assert_allclose([changed(k, a, m), jax.jit(changed)(k, a, m)], expected, rtol=1e-14)
    slopes = jax.grad(changed, (0, 1, 2))(k, a, m)
    np.testing.assert_allclose(slopes[0], 14 * 4 - 3 * 9.8, rtol=1e-14)
    np.testing.assert_allclose(slopes[1], 2 * 3 * 4 * a, rtol=1e-14)
    np.testing.assert_allclose(slopes[2], [0, 0, 0, 3 * 14, 0], rtol=1e-14)
    many = jnp.linspace(1, 2, 4)
    np.testing.assert_allclose(
        jax.vmap(changed, (0, None, None))(many, a, m), [changed(x, a, m) for x in many], rtol=1e-14
    )


def test_paths_and_replace_of_a_batch_of_models_keep_its_leading_axis(zoo):
    stiffness = np.arange(12.0).reshape(4, 3)
    batch = jax.vmap(lambda k: jb.replace(zoo, {"s?.stiffness": k}))(stiffness)
    assert jb.parameter_paths(batch)["s2.a"].shape == (4, 3) and jb.parameter_paths(batch)[
        "gravity"
    ].shape == (4, 3)
    np.testing.assert_array_equal(jb.parameter_paths(batch)["s2.stiffness"], stiffness[:, 1])
    after = jb.replace(
        batch,
        {
            "s2.stiffness": [9, 8, 7, 6],
            "s[13].a": RANDOM.normal(size=(2, 4, 3)),
            "plate.mass": np.full(4, 5.0),
        },
    )
    np.testing.assert_array_equal(after["s2"].stiffness, [9, 8, 7, 6])
    np.testing.assert_array_equal(after["s3"].stiffness, stiffness[:, 2])
    np.testing.assert_array_equal(after["plate"].mass, [5, 5, 5, 5])
    np.testing.assert_array_equal(after["arm"].mass, [2, 2, 2, 2])
    one = jax.tree.map(lambda x: x[2], after)
    assert one["s2"].stiffness == 7.0 and one["s2"].a.shape == (3,)


@pytest.fixture(scope="module")
def run():
    base = jb.Harmonic(frequency=2.0, translation=[0.1, 0, 0]) + jb.Harmonic(
        frequency=3.0, rotation=[0, 0.1, 0]
    )
    return jb.Experiment(
        np.linspace(0, 1, 5),
        motion={"base": base, "wall": jb.Harmonic(frequency=1.0)},
        initial=jb.State(np.arange(3.0), np.arange(2.0)),
        sensors={
            "corner": jb.Position("plate", [0, 1, 2]),
            "height": jb.Position("plate", axis=[0, 0, 2]),
            "gap": jb.Elongation("s1"),
        },
        measured={
            "corner": np.arange(15.0).reshape(5, 3),
            "height": np.arange(5.0),
            "gap": np.arange(5.0),
        },
    )


def test_paths_of_an_experiment_are_its_initial_state_motions_and_sensors(run):
    harmonic = ("frequency", "translation", "rotation", "translation_phase", "rotation_phase")
    expected = {"initial.q", "initial.v", "corner.point", "height.point", "height.axis"}
    expected |= {f"wall.{field}" for field in harmonic} | {
        f"base.terms.{i}.{field}" for i in (0, 1) for field in harmonic
    }
    result = jb.parameter_paths(run)
    assert set(result) == expected
    assert result["base.terms.1.frequency"] == 3.0
    np.testing.assert_array_equal(result["height.axis"], [0, 0, 1])


def test_replace_works_on_an_experiment(run):
    after = jb.replace(
        run,
        {
            "base.terms.*.frequency": [4.0, 5.0],
            "corner.point": [1, 1, 1],
            "initial.v": [7, 8],
            "height.axis": [0, 2, 0],
        },
    )
    assert isinstance(after, jb.Experiment)
    assert [float(term.frequency) for term in after.motion["base"].terms] == [4.0, 5.0]
    np.testing.assert_array_equal(after.sensors["corner"].point, [1, 1, 1])
    np.testing.assert_array_equal(after.initial.v, [7, 8])
    np.testing.assert_array_equal(after.sensors["height"].axis, [0, 1, 0])
    np.testing.assert_array_equal(after.measured["corner"], run.measured["corner"])
    same(jb.parameter_paths(jb.replace(after, jb.parameter_paths(run))), jb.parameter_paths(run))


def refused(tree, values):
    with pytest.raises(jb.JaxbodyError) as caught:
        jb.replace(tree, values)
    return caught.value


def test_an_unknown_path_is_reported_with_the_nearest(zoo, run):
    error = refused(zoo, {"s1.stifness": 1.0})
    assert (
        error.code == "UNKNOWN_PATH"
        and error.value == "s1.stifness"
        and "s1.stiffness" in str(error)
    )
    assert refused(run, {"cormer.point": [0, 0, 0]}).hint.startswith("Did you mean corner.point")
    error = refused(zoo, {"gravty": [0, 0, 0], "nothing*": 1.0})
    assert [problem.code for problem in error.problems] == [
        "UNKNOWN_PATH"
    ] * 2 and "gravity" in error.problems[0].hint
    assert refused(zoo, {3: 1.0}).code == "UNKNOWN_PATH"


def test_a_leaf_that_two_patterns_match_is_an_error(zoo):
    error = refused(zoo, {"s1.stiffness": 1.0, "s?.stiffness": 2.0})
    assert (
        error.code == "LISTED_TWICE" and "s1.stiffness" in str(error) and len(error.problems) == 1
    )


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"s1.a": [1.0, 2.0]}, "(3,)"),
        ({"s1.a": 0.0}, "(3,)"),
        ({"s?.stiffness": [1.0, 2.0]}, "(3,)"),
        ({"mount.stiffness": 5.0}, "(6, 6)"),
        ({"*.stiffness": 5.0}, "Use one pattern for each shape"),
        ({"gravity": np.zeros((2, 3))}, "(1, 3)"),
    ],
)
def test_a_value_of_a_wrong_shape_is_an_error_that_states_the_right_ones(zoo, values, message):
    error = refused(zoo, values)
    assert error.code == "BAD_SHAPE" and message in str(error) + error.limit


@pytest.mark.parametrize(
    ("path", "value", "code"),
    [
        ("s1.stiffness", np.nan, "NON_FINITE"),
        ("gravity", [0, np.inf, 0], "NON_FINITE"),
        ("s1.stiffness", 1j, "COMPLEX"),
        ("s1.stiffness", "much", "NOT_A_NUMBER"),
        ("plate.mass", -1.0, "BAD_MASS"),
        ("arm.axis", [0, 0, 0], "ZERO_AXIS"),
        ("base.orientation", [1, 1, 1, 1], "BAD_QUATERNION"),
        ("mount.orientation_b", [0, 0, 0, 0], "BAD_QUATERNION"),
    ],
)
def test_a_value_that_the_constructor_would_refuse_is_refused(zoo, path, value, code):
    error = refused(zoo, {path: value})
    assert error.code == code and path in str(error)


def test_all_problems_of_values_are_reported_at_once(zoo):
    error = refused(
        zoo,
        {
            "s1.a": [1, 2],
            "s1.stiffness": np.nan,
            "plate.mass": 0.0,
            "s1.damping": 1j,
            "s?.damping": 1.0,
        },
    )
    assert [problem.code for problem in error.problems] == [
        "BAD_SHAPE",
        "NON_FINITE",
        "BAD_MASS",
        "COMPLEX",
        "LISTED_TWICE",
    ]


@pytest.mark.parametrize(
    "part",
    [lambda zoo: zoo["plate"], lambda zoo: jb.suspension.double_wishbone(), lambda zoo: {"a": 1.0}],
    ids=["body", "corner", "dict"],
)
def test_what_is_no_model_or_experiment_is_refused(zoo, part):
    for call in (jb.parameter_paths, lambda tree: jb.replace(tree, {"mass": 2.0})):
        with pytest.raises(
            jb.JaxbodyError, match=r"got a (Body|Corner|dict).*a model or an experiment.*WRONG_KIND"
        ):
            call(part(zoo))


@pytest.mark.long
@pytest.mark.untyped
def test_two_hundred_springs_are_replaced_in_a_few_operations():
    n = 200
    model = jb.Model(
        bodies={"plate": jb.Body(mass=1, inertia=[1, 1, 1])},
        elements={
            f"s{i}": jb.Spring(("plate", [0, 0, 0]), ("world", [1 + i, 0, 0]), stiffness=1.0 + i)
            for i in range(n)
        },
    )

    def total(k):
        new = jb.replace(model, {"*.stiffness": k, "s1*.damping": k[0]})
        return jnp.sum(new.elements[0].rows.stiffness) + jnp.sum(new.elements[0].rows.damping)

    k = jnp.arange(1.0, n + 1)
    assert len(jax.make_jaxpr(total)(k).eqns) < 30  # not one or more for each spring
    np.testing.assert_allclose(jax.jit(total)(k), k.sum() + 111, rtol=1e-14)
    values = jb.parameter_paths(model)
    called = []
    sys.setprofile(lambda frame, event, argument: called.append(event))
    try:
        again = jb.replace(model, values)
    finally:
        sys.setprofile(None)
    # one sweep over 1006 paths, and not one for each of them
    assert len(called) < 400 * len(values), len(called)
    same(jb.parameter_paths(again, "*.stiffness"), jb.parameter_paths(model, "*.stiffness"))
