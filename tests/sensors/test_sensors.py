"""Readings of sensors on a rotated body over a moving support, computed by hand; noise; bad input
of an experiment."""

import warnings

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from rigs import turned
from scipy import stats
from scipy.spatial.transform import Rotation

import jaxbody as jb
from jaxbody.motion.trajectories import read

RANDOM = np.random.default_rng(11)
AXIS, AT = np.array([0.6, 0.0, 0.8]), np.array([0.1, 0.2, -0.1])
BASE = {"position": np.array([0.3, -0.2, 0.5]), "orientation": np.array([0.8, 0.0, 0.6, 0.0])}
ARM = {"position": np.array([0.4, 0.1, 0.9]), "orientation": np.array([0.5, 0.5, -0.5, 0.5])}
SHAKING = {
    "frequency": 1.3,
    "translation": [0.1, -0.05, 0.2],
    "rotation": [0.3, 0.5, -0.2],
    "rotation_phase": 0.4,
}
END, POINT = np.array([1.0, 0.5, 0.2]), np.array([0.2, -0.3, 0.4])


@pytest.fixture(scope="module")
def model():
    """An arm on a hinge of a turned base, tied to it and to a free body."""
    return jb.Model(
        bodies={
            "arm": jb.Body(mass=1.0, inertia=[0.2, 0.2, 0.3], **ARM),
            "ball": jb.Body(mass=2.0, inertia=[1, 1, 1], position=[1, 1, 1]),
        },
        supports={"base": jb.Support(**BASE)},
        joints={"arm": jb.Hinge("base", axis=AXIS, at=AT)},
        elements={
            "tie": jb.Spring(
                ("arm", POINT), ("base", END), stiffness=20.0, free_length=0.3, damping=0.1
            ),
            "cord": jb.Spring(
                ("ball", [0, 0, 0]), ("arm", [0, 0, 0.1]), stiffness=30.0, free_length=0.5
            ),
        },
    )


SENSORS = {
    "point": jb.Position("arm", POINT),
    "along": jb.Position("arm", POINT, axis=[0, 3, 4]),
    "anchor": jb.Position("base", END),
    "pose": jb.sensors.BodyPose("arm"),
    "floor": jb.sensors.BodyPose("base"),
    "tie": jb.Elongation("tie"),
    "cord": jb.Elongation("cord"),
}
BALL = np.array([1.2, 0.8, 1.4, 0.1, 0.7, -0.5, 0.5])


def rotation(q):
    return Rotation.from_quat(np.asarray(q)[..., [1, 2, 3, 0]])


@pytest.fixture(scope="module")
def by_hand():
    """The frames of base and arm at time t and angle q, and the readings that follow from them."""
    t, q = 0.37, 2.1
    phase = 2 * np.pi * SHAKING["frequency"] * t
    xi = np.array(SHAKING["translation"]) * np.cos(phase)
    R_base = Rotation.from_rotvec(np.array(SHAKING["rotation"]) * np.cos(phase + 0.4)) * rotation(
        BASE["orientation"]
    )
    p_base = BASE["position"] + xi
    rest = rotation(BASE["orientation"]).inv()
    p_rest, R_rest = (
        rest.apply(ARM["position"] - BASE["position"]),
        rest * rotation(ARM["orientation"]),
    )
    turn = Rotation.from_rotvec(q * AXIS)
    R_arm, p_arm = R_base * turn * R_rest, p_base + R_base.apply(AT + turn.apply(p_rest - AT))
    point, anchor = p_arm + R_arm.apply(POINT), p_base + R_base.apply(END)
    cord = np.linalg.norm(BALL[:3] - p_arm - R_arm.apply([0, 0, 0.1])) - 0.5
    readings = {
        "point": point,
        "along": point @ [0, 0.6, 0.8],
        "anchor": anchor,
        "pose": (p_arm, R_arm),
        "floor": (p_base, R_base),
        "tie": np.linalg.norm(point - anchor) - 0.3,
        "cord": cord,
    }
    return t, jb.State(jnp.concatenate([jnp.array([q]), BALL]), jnp.zeros(7)), readings


def test_readings_of_a_turned_arm_on_a_moving_base_are_those_by_hand(model, by_hand):
    t, state, expected = by_hand
    result = jax.jit(read)(model, (jb.Harmonic(**SHAKING),), jnp.array(t), state, SENSORS)
    for name in ("point", "along", "anchor", "tie", "cord"):
        assert result[name].shape == SENSORS[name].shape
        np.testing.assert_allclose(result[name], expected[name], rtol=0, atol=3e-15, err_msg=name)
    for name in ("pose", "floor"):
        p, R = expected[name]
        np.testing.assert_allclose(result[name][:3], p, rtol=0, atol=3e-15)
        np.testing.assert_allclose(turned(result[name][3:]), R.as_matrix(), rtol=0, atol=3e-15)


@pytest.fixture(scope="module")
def trajectory(model):
    """Long enough for statistics."""
    initial = jb.State(
        jnp.concatenate([jnp.array([0.5]), BALL]), jnp.array([1.0, 0.1, 0.2, 0.3, 2.0, 1.0, -1.5])
    )
    return jb.simulate(
        model,
        jnp.linspace(0, 4, 4001),
        motion={"base": jb.Harmonic(**SHAKING)},
        initial=initial,
        rtol=1e-6,
    )


@pytest.fixture(scope="module")
def clean(trajectory):
    return jb.measure(trajectory, SENSORS)


@pytest.mark.long
def test_measuring_without_noise_gives_what_the_trajectory_has(trajectory, clean):
    arm, base = trajectory.poses["arm"], trajectory.poses["base"]
    np.testing.assert_allclose(
        clean["point"], arm.p + np.asarray(arm.R) @ POINT, rtol=0, atol=1e-14
    )
    np.testing.assert_allclose(
        clean["anchor"], base.p + np.asarray(base.R) @ END, rtol=0, atol=1e-14
    )
    np.testing.assert_allclose(
        clean["along"], clean["point"] @ np.array([0, 0.6, 0.8]), rtol=0, atol=1e-14
    )
    np.testing.assert_allclose(clean["pose"][:, :3], arm.p, rtol=0, atol=1e-14)
    np.testing.assert_allclose(turned(clean["pose"][:, 3:]), arm.R, rtol=0, atol=1e-13)
    for name in ("tie", "cord"):
        np.testing.assert_allclose(clean[name], trajectory.elongations[name], rtol=0, atol=1e-14)


def is_white(z, level):
    """Independent normal numbers of this standard deviation: each statistic is within four of its
    standard deviations."""
    z = np.asarray(z).reshape(len(z), -1) / level
    n = z.size
    assert abs(z.mean()) < 4 / np.sqrt(n) and abs(z.std() - 1) < 4 / np.sqrt(2 * n)
    assert abs((z[1:] * z[:-1]).mean()) < 4 / np.sqrt(n)
    off = (z.T @ z / len(z))[np.triu_indices(z.shape[1], 1)]
    assert (np.abs(off) < 4 / np.sqrt(len(z))).all()
    assert stats.kstest(z.ravel(), "norm").pvalue > 1e-3


def test_noise_is_white_of_the_stated_level_for_each_sensor(trajectory, clean):
    levels = {"point": 1e-3, "along": 2e-2, "tie": 5e-4, "anchor": 0.0}
    noisy = jb.measure(trajectory, SENSORS, noise=levels, key=jax.random.key(3))
    for name in ("point", "along", "tie"):
        is_white(noisy[name] - clean[name], levels[name])
    for name in ("anchor", "cord", "floor"):
        np.testing.assert_allclose(noisy[name], clean[name], rtol=0, atol=1e-15)
    a, b = (
        np.asarray(noisy[name] - clean[name]).ravel() / levels[name] for name in ("along", "tie")
    )
    assert abs(np.mean(a * b)) < 4 / np.sqrt(len(a))


@pytest.mark.long
@pytest.mark.parametrize(
    ("level", "meters", "radians"), [(2e-3, 2e-3, 2e-3), ([1e-4, 0.3], 1e-4, 0.3)]
)
def test_noise_on_a_pose_keeps_quaternions_unit_and_is_white_in_meters_and_radians(
    trajectory, clean, level, meters, radians
):
    noisy = jb.measure(trajectory, SENSORS, noise={"pose": level}, key=jax.random.key(5))["pose"]
    np.testing.assert_allclose(np.linalg.norm(noisy[:, 3:], axis=1), 1, rtol=0, atol=1e-15)
    residual = SENSORS["pose"].residual(clean["pose"], noisy)
    is_white(residual[:, :3], meters)
    is_white(residual[:, 3:], radians)


def test_the_same_key_gives_the_same_noise_and_another_key_another(trajectory):
    def at(seed):
        return jb.measure(trajectory, SENSORS, noise=1e-3, key=jax.random.key(seed))

    one, again, other = at(0), at(0), at(1)
    for name in SENSORS:
        np.testing.assert_array_equal(one[name], again[name])
        assert (np.asarray(one[name]) != np.asarray(other[name])).mean() > 0.99, name


@pytest.mark.long
def test_a_batch_of_trajectories_is_measured_one_by_one(trajectory):
    two = [jax.tree.map(lambda x, s=s: x * s, trajectory.state) for s in (1.0, 1.1)]
    runs = [
        type(trajectory)(
            trajectory.times,
            state,
            trajectory.status,
            trajectory.statistics,
            trajectory.end,
            trajectory.model,
            trajectory.motions,
        )
        for state in two
    ]
    batch = jax.tree.map(lambda *x: jnp.stack(x), *runs)
    result = jb.measure(batch, SENSORS)
    for name in SENSORS:
        for i, run in enumerate(runs):
            np.testing.assert_allclose(
                result[name][i], jb.measure(run, SENSORS)[name], rtol=0, atol=1e-14
            )
    noise = (
        jb.measure(batch, {"tie": SENSORS["tie"]}, noise=1e-3, key=jax.random.key(0))["tie"]
        - result["tie"]
    )
    assert noise.shape == (2, 4001) and abs(np.corrcoef(noise)[0, 1]) < 4 / np.sqrt(4001)
    is_white(noise.T, 1e-3)


def test_the_residual_of_a_pose_is_the_turn_from_the_measured_to_the_read_orientation():
    pose = jb.sensors.BodyPose("arm")
    residual = jax.jit(pose.residual)
    for angle in (1e-8, 1e-4, 0.1, 1.0, 3.0):
        R, turn = Rotation.random(random_state=RANDOM), angle * np.array([0.48, 0.6, -0.64])
        q, read_q = (x.as_quat()[[3, 0, 1, 2]] for x in (R, Rotation.from_rotvec(turn) * R))
        for sign in (1, -1):  # q and -q are one orientation
            result = residual(
                jnp.array([1.0, 2, 3, *read_q]), jnp.array([0.5, 2, 3.25, *(sign * q)])
            )
            np.testing.assert_allclose(
                result, [0.5, 0, -0.25, *turn], rtol=0, atol=1e-15 * max(1, 10 * angle)
            )
    rounded = residual(jnp.array([0.0, 0, 0, *read_q]), jnp.array([0.0, 0, 0, *(1.0004 * read_q)]))
    np.testing.assert_allclose(rounded, 0, atol=1e-15)


def test_the_residual_of_a_pose_has_its_derivative_where_it_vanishes():
    pose, q = jb.sensors.BodyPose("arm"), np.array([0.1, 0.7, -0.5, 0.5])

    def residual(turn):
        # exp to first order, and that is what is asked
        half = jnp.concatenate([jnp.ones(1), turn / 2])
        w, v = half[0], half[1:]
        read = jnp.concatenate(
            [jnp.array([w * q[0] - v @ q[1:]]), w * q[1:] + q[0] * v + jnp.cross(v, q[1:])]
        )
        return pose.residual(
            jnp.concatenate([jnp.zeros(3), read / jnp.linalg.norm(read)]),
            jnp.array([0.0, 0, 0, *q]),
        )[3:]

    for slope in jax.jit(lambda x: (jax.jacfwd(residual)(x), jax.jacrev(residual)(x)))(
        jnp.zeros(3)
    ):
        np.testing.assert_allclose(slope, np.eye(3), atol=1e-14)


@pytest.mark.nan
def test_residuals_of_missing_samples_are_zero_with_zero_derivatives():
    measured = np.array(
        [[0.1, np.nan, 0.3, 1, 0, 0, 0], [0.1, 0.2, 0.3, 1, 0, np.nan, 0], np.full(7, np.nan)]
    )
    pose, reading = jb.sensors.BodyPose("arm"), jnp.array([1.0, 2, 3, 0.8, 0.6, 0, 0])
    expected = [[0.9, 0, 2.7, 2 * np.arccos(0.8), 0, 0], [0.9, 1.8, 2.7, 0, 0, 0], np.zeros(6)]
    residual = jax.jit(
        jax.vmap(lambda x, y: (pose.residual(x, y), jax.jacfwd(pose.residual)(x, y)), (None, 0))
    )
    result, slopes = residual(reading, measured)
    np.testing.assert_allclose(result, expected, atol=1e-15)
    there = [[1, 0, 1, 1, 1, 1], [1, 1, 1, 0, 0, 0], np.zeros(6)]
    np.testing.assert_array_equal(~pose.missing(measured), np.array(there, bool))
    assert (
        np.isfinite(slopes).all()
        and not slopes[2].any()
        and not slopes[1, 3:].any()
        and slopes[0, 3:].any()
    )
    point = jb.Position("arm")
    np.testing.assert_array_equal(
        point.residual(jnp.array([1.0, 2, 3]), jnp.array([0.5, np.nan, 3])), [0.5, 0, 0]
    )


def problems_of(function, *arguments, **options):
    with pytest.raises(jb.JaxbodyError) as caught:
        function(*arguments, **options)
    return caught.value.problems


def test_measure_reports_all_that_is_wrong_at_once(trajectory):
    wrong = {"a": jb.Position("armm"), "b": jb.Elongation("arm"), "c": 3.0}
    result = problems_of(jb.measure, trajectory, wrong)
    assert [problem.code for problem in result] == ["UNKNOWN_NAME", "UNKNOWN_NAME", "WRONG_KIND"]
    assert "'arm'" in result[0].hint and "tie, cord" in result[1].hint
    levels = {"point": -1.0, "tie": [1.0, 2.0], "along": np.nan, "cordd": 1.0, "pose": [1e-3, -1]}
    result = problems_of(jb.measure, trajectory, SENSORS, noise=levels)
    assert [problem.code for problem in result] == [
        "BAD_NOISE",
        "BAD_SHAPE",
        "NON_FINITE",
        "UNKNOWN_NAME",
        "BAD_NOISE",
        "NO_KEY",
    ]
    assert "'cord'" in result[3].hint
    assert problems_of(jb.measure, trajectory, SENSORS, noise=1e-3)[0].code == "NO_KEY"


def test_a_sensor_reports_what_is_wrong_with_its_numbers():
    assert problems_of(jb.Position, "arm", [0, 0])[0].code == "BAD_SHAPE"
    assert problems_of(jb.Position, "arm", axis=[0, 0, 0])[0].code == "ZERO_AXIS"
    assert [p.code for p in problems_of(jb.Position, "arm", [0, np.inf, 0], axis=[0, 0, 1, 2])] == [
        "NON_FINITE",
        "BAD_SHAPE",
    ]


TIMES = np.linspace(0, 1, 6)
GOOD = {
    "point": np.arange(18.0).reshape(6, 3),
    "tie": np.arange(6.0),
    "pose": np.tile([0, 0, 0, 1.0, 0, 0, 0], (6, 1)),
}
GOOD["pose"][:, 0] = np.arange(6.0)


def experiment(times=TIMES, sensors=None, noise=None, **measured):
    sensors = {name: SENSORS[name] for name in measured} if sensors is None else sensors
    return jb.Experiment(times, sensors=sensors, measured=measured, noise=noise)


def test_an_experiment_takes_lists_masked_arrays_and_gaps():
    gaps = np.ma.masked_array(np.arange(6.0), mask=[0, 1, 0, 0, 0, 0])
    run = experiment(list(TIMES), tie=gaps, point=np.arange(18.0).reshape(6, 3).tolist())
    np.testing.assert_array_equal(run.measured["tie"], [0, np.nan, 2, 3, 4, 5])
    assert (
        run.measured["point"].shape == (6, 3)
        and run.measured["point"].dtype == jnp.float64
        and run.noise is None
    )
    assert experiment(noise={"pose": [1e-3, 1e-2], "tie": 2}, **GOOD).noise["pose"].shape == (2,)


def test_a_transposed_record_is_reported_to_be_one():
    (problem,) = problems_of(experiment, point=np.zeros((3, 6)))
    assert (
        (problem.code, problem.limit) == ("BAD_SHAPE", "(6, 3)")
        and "measured.T" in problem.hint
        and "point" in problem.where
    )
    (problem,) = problems_of(experiment, point=np.zeros((6, 2)))
    assert problem.code == "BAD_SHAPE" and "Position" in problem.hint and ".T" not in problem.hint
    (problem,) = problems_of(experiment, tie=np.zeros((6, 1)))
    assert problem.code == "BAD_SHAPE" and "one number" in problem.hint


@pytest.mark.parametrize("times", [[], [0.5]])
def test_no_data_and_one_sample_are_no_experiment(times):
    result = problems_of(experiment, times, tie=np.zeros(len(times)))
    assert result[0].code == "NO_DATA" and "times" in result[0].where


def test_an_empty_record_is_no_data():
    assert problems_of(experiment, tie=[])[0].code == "NO_DATA"
    result = problems_of(jb.Experiment, TIMES, sensors={}, measured={})
    assert result[0].code == "NO_DATA" and "sensors" in result[0].where


def test_a_channel_without_any_sample_is_named():
    point = np.zeros((6, 3))
    point[:, 1] = np.nan
    with pytest.warns(jb.JaxbodyWarning, match=r"33 %.*MISSING"):
        result = problems_of(experiment, point=point, tie=np.full(6, np.nan))
    assert [problem.code for problem in result] == ["ALL_NAN", "ALL_NAN"]
    assert "component 1" in result[0].message and "point" in result[0].where
    assert "tie" in result[1].where and "component" not in result[1].message


def test_above_a_fifth_missing_warns_and_below_does_not():
    tie = np.arange(6.0)
    tie[2] = np.nan
    experiment(tie=tie)
    tie[4] = np.nan
    with pytest.warns(jb.JaxbodyWarning, match=r"tie.*33 %.*MISSING"):
        experiment(tie=tie)


def test_an_experiment_reports_all_that_is_wrong_at_once():
    pose = GOOD["pose"].copy()
    pose[3, 3:] = [0, 0, 0, 2]
    result = problems_of(
        jb.Experiment,
        [0.0, 1, 1],
        sensors={
            "a.b": jb.Position("arm"),
            "base": jb.Elongation("tie"),
            "c": None,
            "lost": jb.Position("arm"),
        },
        measured={
            "a.b": [[1j] * 3] * 3,
            "base": np.zeros(3),
            "c": np.zeros(3),
            "spare": np.zeros(3),
        },
        motion={"base": jb.inputs.AtRest()},
        noise={"base": 0.0, "b": 1.0},
    )
    codes = [problem.code for problem in result]
    assert codes == [
        "DUPLICATE_TIME",
        "UNKNOWN_NAME",
        "UNKNOWN_NAME",
        "COMPLEX",
        "WRONG_KIND",
        "BAD_NOISE",
        "UNKNOWN_NAME",
        "DUPLICATE_NAME",
        "BAD_NAME",
    ]
    assert result[-2].message == "is the name of a support too"
    result = problems_of(experiment, point=np.full((6, 3), np.inf), pose=pose)
    assert [problem.code for problem in result] == [
        "NON_FINITE",
        "BAD_QUATERNION",
    ] and "row 3" in result[1].message


@pytest.mark.parametrize("noise", [0.0, -1e-3, np.nan, {"tie": 0.0}])
def test_noise_of_an_experiment_must_be_positive(noise):
    (problem,) = problems_of(experiment, tie=np.arange(6.0), noise=noise)
    assert problem.code in ("BAD_NOISE", "NON_FINITE") and "tie" in problem.where


def test_a_dead_or_saturated_channel_of_an_experiment_is_warned_of():
    times, place = np.linspace(0, 1, 101), jb.Position("mass", axis=[0, 0, 1])
    wave = np.sin(20 * times)

    def run(values, sensor=place):
        return jb.Experiment(times, sensors={"z": sensor}, measured={"z": values})

    with pytest.warns(
        jb.JaxbodyWarning, match=r"measured\['z'\] is 0.3 m throughout, 0 to 1 s \[DEAD\]"
    ):
        run(np.full(101, 0.3))
    with pytest.warns(
        jb.JaxbodyWarning,
        match=r"measured\['z'\] stays at 0.8 m for \d+ of 101 samples: .*\[SATURATED\]",
    ):
        run(np.clip(wave, -2, 0.8))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        run(wave)
        run(np.stack([wave, 0 * wave, 0 * wave], 1), jb.Position("mass"))  # in a plane
