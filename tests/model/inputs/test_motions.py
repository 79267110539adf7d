"""Imposed motions against closed forms and SciPy's piecewise polynomials; velocity and acceleration
are derivatives of the motion."""

import warnings

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.interpolate import CubicSpline, PPoly
from scipy.spatial.transform import Rotation

import jaxbody as jb
from jaxbody.geometry import rotations
from jaxbody.model.inputs.motions import as_motion

RNG = np.random.default_rng(1940)
UNEVEN = np.cumsum(RNG.uniform(0.02, 0.1, size=40)) - 1.0
EVEN = np.linspace(-1.0, 1.0, 41)
AXIS = np.array([2.0, -1.0, 2.0]) / 3


@eqx.filter_jit
def with_derivatives(motion, times):
    """Xi, Xi' and Xi'' at many times."""

    def rate(f):
        return lambda t: jax.jvp(f, (t,), (jnp.ones_like(t),))[1]

    return tuple(jax.vmap(f)(times) for f in (motion, rate(motion), rate(rate(motion))))


def within(rng, times, n=300):
    return np.sort(rng.uniform(times[0], times[-1], size=n))


def worst(result, exact):
    """Largest error, relative to the largest value where that exceeds 1."""
    return np.abs(np.asarray(result) - exact).max() / max(1.0, np.abs(exact).max())


def test_at_rest_is_zero():
    assert not any(np.any(x) for x in with_derivatives(jb.inputs.AtRest(), EVEN))


@pytest.mark.parametrize(
    "frequency", [0.8, [0.5, 1.0, 1.5, 2.0, 2.5, 3.0]], ids=["one frequency", "one per axis"]
)
def test_a_harmonic_motion_and_its_derivatives_are_cosines_and_sines(rng, frequency):
    amplitude, phase = rng.normal(size=6), rng.uniform(-3, 3, size=6)
    motion = jb.Harmonic(
        frequency=frequency,
        translation=amplitude[:3],
        rotation=amplitude[3:],
        translation_phase=phase[:3],
        rotation_phase=phase[3:],
    )
    w = 2 * np.pi * np.broadcast_to(frequency, 6)
    angle = w * EVEN[:, None] + phase
    exact = (
        amplitude * np.cos(angle),
        -amplitude * w * np.sin(angle),
        -amplitude * w**2 * np.cos(angle),
    )
    for result, right in zip(with_derivatives(motion, EVEN), exact, strict=True):
        assert worst(result, right) <= 2e-15


def test_one_phase_stands_for_three_axes():
    motion = jb.Harmonic(
        frequency=1.0,
        translation=[1, 2, 3],
        rotation=[4, 5, 6],
        translation_phase=np.pi / 2,
        rotation_phase=np.pi,
    )
    assert worst(motion(0.0), [0, 0, 0, -4, -5, -6]) <= 1e-15


@pytest.mark.long
def test_motions_add_also_with_bare_functions():
    harmonic = jb.Harmonic(frequency=1.0, translation=[1, 0, 0])
    sampled = jb.Sampled(EVEN, rotation=0.1 * np.sin(EVEN)[:, None] * AXIS)
    other = jb.Sampled(UNEVEN[5:], translation=np.cos(UNEVEN[5:])[:, None] * AXIS)

    def function(t):
        return jnp.stack([t**2, t, t, t, t, t**3])

    exact = harmonic(0.3) + sampled(0.3) + other(0.3) + function(0.3)
    for total in (
        harmonic + sampled + other + function,
        function + harmonic + (sampled + other),
        sum([harmonic, sampled, other, function]),
    ):
        assert worst(total(0.3), exact) <= 1e-14
        assert total.covers() == (UNEVEN[5], min(EVEN[-1], UNEVEN[-1]))
    assert harmonic.covers() == (-np.inf, np.inf)


def test_a_delayed_motion_is_the_same_later(rng):
    """Xi, Xi' and Xi'' at t of the motion itself at t - delay; it is known as much later."""
    motion = jb.Sampled(UNEVEN, translation=rng.normal(size=(len(UNEVEN), 3)))
    t = within(rng, UNEVEN)
    for result, exact in zip(
        with_derivatives(jb.signals.Delayed(motion, 0.3), t + 0.3),
        with_derivatives(motion, t),
        strict=True,
    ):
        # t + 0.3 - 0.3 is t to 1e-16, times the slopes of a spline through noise
        assert worst(result, exact) <= 1e-12
    assert jb.signals.Delayed(motion, 0.3).covers() == (UNEVEN[0] + 0.3, UNEVEN[-1] + 0.3)
    assert jb.signals.Delayed(jnp.ones_like, jnp.array(0.3)).covers() == (-np.inf, np.inf)


def cubic(t):
    c = np.array([[0.3, -1.0, 0.5, 2.0], [1.0, 0.2, 0.0, -0.7], [0.0, 1.0, -2.0, 0.4]])
    return [np.stack([np.polyval(np.polyder(row[::-1], n), t) for row in c], 1) for n in range(3)]


@pytest.mark.parametrize(
    "times", [EVEN, UNEVEN, UNEVEN[:4]], ids=["even", "uneven", "four samples"]
)
def test_a_spline_is_exact_for_cubics(rng, times):
    motion = jb.Sampled(times, translation=cubic(times)[0], rotation=0.05 * cubic(times)[0])
    t = within(rng, times)
    for result, exact, limit in zip(
        with_derivatives(motion, t), cubic(t), (1e-14, 1e-12, 1e-10), strict=True
    ):
        assert worst(result, np.concatenate([exact, 0.05 * exact], 1)) <= limit


@pytest.mark.parametrize("times", [EVEN, UNEVEN], ids=["even", "uneven"])
def test_a_spline_is_scipys_and_meets_its_samples(rng, times):
    """SciPy's spline with the same end slopes: those of the cubic through the four
    outermost samples."""
    y = np.cumsum(rng.normal(size=(len(times), 6)), 0) * 0.01
    slopes = []
    for part in (slice(0, 4), slice(-1, -5, -1)):
        t = times[part] - times[part][0]
        slopes.append(np.linalg.solve(np.vander(t, 4), y[part])[2])
    spline = CubicSpline(times, y, bc_type=((1, slopes[0]), (1, slopes[1])))
    motion = jb.Sampled(times, translation=y[:, :3], rotation=y[:, 3:])
    t = within(rng, times)
    for n, (result, limit) in enumerate(
        zip(with_derivatives(motion, t), (1e-14, 1e-12, 1e-11), strict=True)
    ):
        assert worst(result, spline(t, n)) <= limit
    assert (
        np.abs(
            with_derivatives(motion, np.repeat(times, 8)[:300])[0] - np.repeat(y, 8, 0)[:300]
        ).max()
        <= 1e-15
    )


@pytest.mark.long
@pytest.mark.parametrize(
    "build", [jb.Sampled, jb.Sampled.from_accelerations], ids=["positions", "accelerations"]
)
@pytest.mark.parametrize("times", [EVEN, UNEVEN], ids=["even", "uneven"])
def test_position_velocity_and_acceleration_are_continuous_at_the_knots(rng, times, build):
    motion = build(
        times,
        translation=rng.normal(size=(len(times), 3)),
        rotation=0.1 * rng.normal(size=(len(times), 3)),
    )
    near = 1e-12 * np.diff(times).min()
    before, after = (with_derivatives(motion, times[1:-1] + side) for side in (-near, near))
    for a, b in zip(before, after, strict=True):
        assert worst(a, b) <= 1e-9


def test_a_spline_converges_with_the_fourth_order():
    """Errors of value, velocity and acceleration over halved steps: h^4, h^3, h^2."""
    t = np.linspace(0, 2, 1001)
    exact = np.sin(3 * t + 1), 3 * np.cos(3 * t + 1), -9 * np.sin(3 * t + 1)
    errors = []
    for n in (50, 100):
        times = np.linspace(0, 2, n + 1)
        motion = jb.Sampled(times, translation=np.sin(3 * times + 1)[:, None] * [1, 0, 0])
        errors.append(
            [
                np.abs(x[:, 0] - y).max()
                for x, y in zip(with_derivatives(motion, t), exact, strict=True)
            ]
        )
    assert np.abs(np.log2(np.divide(*errors)) - [4, 3, 2]).max() <= 0.2


@pytest.mark.parametrize(
    "times",
    [0.02 * np.arange(1560), np.cumsum(RNG.uniform(0.01, 0.03, size=1500))],
    ids=["even", "uneven"],
)
def test_accelerations_are_integrated_exactly(rng, times):
    """A record as of an earthquake: the twofold antiderivative of the broken line through the
    samples, from stated initial values."""
    m, x0, v0 = rng.normal(size=(len(times), 6)), rng.normal(size=6), rng.normal(size=6)
    line = PPoly(np.stack([np.diff(m, axis=0) / np.diff(times)[:, None], m[:-1]]), times)
    t = within(rng, times)
    exact = (
        line.antiderivative(2)(t) + x0 + v0 * (t - times[0])[:, None],
        line.antiderivative(1)(t) + v0,
        line(t),
    )
    motion = jb.Sampled.from_accelerations(
        times, translation=m[:, :3], rotation=m[:, 3:], initial_position=x0, initial_velocity=v0
    )
    for result, right, limit in zip(
        with_derivatives(motion, t), exact, (1e-12, 1e-12, 1e-12), strict=True
    ):
        assert worst(result, right) <= limit


def turning(angle, axis=AXIS):
    return Rotation.from_rotvec(np.asarray(angle)[:, None] * axis)


@pytest.mark.parametrize(
    "form",
    [
        "quaternions",
        "quaternions of either sign",
        "rotation vectors up to half a turn",
        "through identity",
    ],
)
def test_rotations_are_followed_over_more_than_a_turn(rng, form):
    """Three turns and back; the samples know the rotation only up to whole turns and signs."""
    times = np.linspace(0, 2, 73)
    turned = (
        (lambda t: np.deg2rad(360.0) * t)
        if form == "through identity"
        else (lambda t: 17.0 * np.sin(t))
    )
    angle = turned(times)
    R = turning(angle)
    samples = R.as_rotvec() if "vectors" in form else R.as_quat(scalar_first=True)
    if "either" in form:
        samples = samples * rng.choice([-1, 1], size=(len(times), 1))
    if form == "through identity":
        samples[::36] = [1, 0, 0, 0]
    motion = jb.Sampled(times, rotation=samples)
    assert worst(motion.values[:, 3:], angle[:, None] * AXIS) <= 1e-13
    t = np.linspace(0, 2, 300)
    assert (
        np.abs(
            rotations.exp(with_derivatives(motion, t)[0][:, 3:]) - turning(turned(t)).as_matrix()
        ).max()
        <= 1e-5
    )


def test_a_turn_about_a_changing_axis_is_followed_through_half_a_turn():
    """Past half a turn the shortest rotation vector flips to the other side; the motion goes on."""
    times = np.linspace(0, 1, 60)
    phi = np.stack([2.5 + 2 * times, 0.5 * np.sin(3 * times), 0.3 * times], 1)
    q = Rotation.from_rotvec(phi).as_quat(scalar_first=True, canonical=True)
    assert worst(jb.Sampled(times, rotation=q).values[:, 3:], phi) <= 1e-14


RECORDS = {
    "translation": lambda x: jb.Sampled(UNEVEN, translation=x),
    "rotation vectors over turns": lambda x: jb.Sampled(UNEVEN, rotation=x),
    "quaternions over turns": lambda x: jb.Sampled(UNEVEN, rotation=x),
    "times": lambda x: jb.Sampled(x, translation=np.sin(UNEVEN)[:, None] * AXIS),
    "accelerations": lambda x: jb.Sampled.from_accelerations(UNEVEN, translation=x),
    "initial values": lambda x: jb.Sampled.from_accelerations(
        UNEVEN, initial_position=x[0], initial_velocity=x[1]
    ),
    "delay": lambda x: jb.signals.Delayed(
        jb.Sampled(UNEVEN, translation=x[:-1, None] * AXIS), 0.01 * x[-1]
    ),
    "harmonic": lambda x: jb.Harmonic(
        frequency=x[0], translation=[x[1], 0, x[2]], rotation_phase=x[3], rotation=x[4:]
    ),
}
TURN = turning(4 * UNEVEN)
NUMBERS = {
    "translation": RNG.normal(size=(len(UNEVEN), 3)),
    "rotation vectors over turns": TURN.as_rotvec(),
    "quaternions over turns": TURN.as_quat(scalar_first=True)
    * RNG.choice([-1, 1], size=(len(UNEVEN), 1)),
    "times": UNEVEN,
    "accelerations": RNG.normal(size=(len(UNEVEN), 3)),
    "initial values": RNG.normal(size=(2, 6)),
    "delay": RNG.normal(size=len(UNEVEN) + 1),
    "harmonic": RNG.normal(size=7),
}


@pytest.mark.long
@pytest.mark.parametrize("record", RECORDS)
def test_a_motion_can_be_differentiated_in_its_numbers(rng, record):
    """Forward = reverse = central differences, and a motion built under jit is the one
    built outside."""
    build, x = RECORDS[record], jnp.asarray(NUMBERS[record])
    weights = rng.normal(size=6)

    def value(x):
        motion = build(x)
        return jnp.sum(weights * jnp.stack(jax.jvp(motion, (0.3,), (1.0,))))

    direction = jnp.asarray(rng.normal(size=x.shape)) * (0.01 if record == "times" else 1)
    here, forward = jax.jit(lambda x: jax.jvp(value, (x,), (direction,)))(x)
    reverse = jnp.sum(jax.jit(jax.grad(value))(x) * direction)
    h = 1e-5
    outside = [float(value(np.asarray(x + s * h * direction))) for s in (-1, 0, 1)]
    assert abs(here - outside[1]) <= 1e-12 * max(1, abs(here))
    assert abs(forward - reverse) <= 1e-12 * max(1, abs(forward))
    assert abs(forward - (outside[2] - outside[0]) / (2 * h)) <= 2e-8 * max(1, abs(forward))


def test_new_numbers_in_a_motion_compile_nothing():
    traced = []

    @eqx.filter_jit
    def evaluate(motion, t):
        traced.append(t)
        return motion(t)

    for k in (1.0, 2.0, 3.0):
        sampled = jb.Sampled(EVEN, translation=k * np.sin(EVEN)[:, None] * AXIS)
        evaluate(sampled + jb.Harmonic(frequency=k, translation=[k, 0, 0]), jnp.array(0.1 * k))
    assert len(traced) == 1


GOOD = np.zeros((5, 3))
TIMES = np.arange(5.0)
QUARTER = turning(np.deg2rad([0, 10, 20, 51, 60])).as_quat(scalar_first=True)


def with_nan(array, *index):
    array = np.array(array, dtype=float)
    array[index] = np.nan
    return array


BAD = {
    "unsorted": (
        lambda: jb.Sampled([0, 1, 3, 2, 4], translation=GOOD),
        "UNSORTED_TIME",
        "Sampled.times",
        3,
    ),
    "duplicated": (
        lambda: jb.Sampled([0, 1, 1, 2, 4], translation=GOOD),
        "DUPLICATE_TIME",
        "Sampled.times",
        2,
    ),
    "NaN time": (
        lambda: jb.Sampled(with_nan(TIMES, 2), translation=GOOD),
        "NAN_TIME",
        "Sampled.times",
        np.nan,
    ),
    "infinite time": (
        lambda: jb.Sampled([0, 1, 2, 3, 1e999], translation=GOOD),
        "NAN_TIME",
        "Sampled.times",
        np.inf,
    ),
    "too few": (
        lambda: jb.Sampled(TIMES[:3], translation=GOOD[:3]),
        "NO_DATA",
        "Sampled.times",
        (3,),
    ),
    "empty": (
        lambda: jb.Sampled([], translation=np.zeros((0, 3))),
        "NO_DATA",
        "Sampled.times",
        (0,),
    ),
    "NaN motion": (
        lambda: jb.Sampled(TIMES, translation=with_nan(GOOD, 3, 1)),
        "NON_FINITE",
        "Sampled.translation",
        [0, np.nan, 0],
    ),
    "NaN turn": (
        lambda: jb.Sampled(TIMES, rotation=with_nan(GOOD, 0, 2)),
        "NON_FINITE",
        "Sampled.rotation",
        [0, 0, np.nan],
    ),
    "jump": (
        lambda: jb.Sampled(TIMES, rotation=QUARTER),
        "ORIENTATION_JUMP",
        "Sampled.rotation",
        2,
    ),
    "transposed": (
        lambda: jb.Sampled(TIMES, translation=GOOD.T),
        "BAD_SHAPE",
        "Sampled.translation",
        (3, 5),
    ),
    "scalar": (lambda: jb.Sampled(TIMES, translation=0.0), "BAD_SHAPE", "Sampled.translation", ()),
    "long quaternion": (
        lambda: jb.Sampled(TIMES, rotation=2 * QUARTER),
        "BAD_QUATERNION",
        "Sampled.rotation",
        None,
    ),
    "complex": (
        lambda: jb.Sampled(TIMES, translation=GOOD * 1j),
        "COMPLEX",
        "Sampled.translation",
        None,
    ),
    "text": (
        lambda: jb.Sampled(["0", "1", "2", "3"], translation=GOOD[:4]),
        "NOT_A_NUMBER",
        "Sampled.times",
        None,
    ),
    "quaternions as accelerations": (
        lambda: jb.Sampled.from_accelerations(TIMES, rotation=np.zeros((5, 4))),
        "BAD_SHAPE",
        "Sampled.rotation",
        (5, 4),
    ),
    "three initial numbers": (
        lambda: jb.Sampled.from_accelerations(TIMES, translation=GOOD, initial_velocity=[0, 0, 0]),
        "BAD_SHAPE",
        "Sampled.initial_velocity",
        (3,),
    ),
    "NaN amplitude": (
        lambda: jb.Harmonic(frequency=1.0, translation=[0, np.nan, 0]),
        "NON_FINITE",
        "Harmonic.translation",
        [0, np.nan, 0],
    ),
    "two amplitudes": (
        lambda: jb.Harmonic(frequency=1.0, rotation=[0, 1]),
        "BAD_SHAPE",
        "Harmonic.rotation",
        (2,),
    ),
    "three frequencies": (
        lambda: jb.Harmonic(frequency=[1, 2, 3], rotation=[0, 1, 0]),
        "BAD_SHAPE",
        "Harmonic.frequency",
        (3,),
    ),
    "two delays": (
        lambda: jb.signals.Delayed(jb.inputs.AtRest(), [0, 1]),
        "BAD_SHAPE",
        "Delayed.delay",
        (2,),
    ),
    "no delayed motion": (
        lambda: jb.signals.Delayed(3.0, 0.1),
        "WRONG_KIND",
        "Delayed.signal",
        3.0,
    ),
    "no function": (lambda: as_motion(3.0), "WRONG_KIND", "motion", 3.0),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_samples_are_reported_by_name(case):
    build, code, where, value = BAD[case]
    with pytest.raises(jb.JaxbodyError) as caught:
        build()
    error = caught.value
    assert (error.code, error.where) == (code, where)
    assert error.limit and error.hint
    if value is not None:
        np.testing.assert_equal(np.asarray(error.value), np.asarray(value))


def test_all_that_is_wrong_with_a_record_is_reported_at_once():
    with pytest.raises(jb.JaxbodyError) as caught:
        jb.Sampled([0, 1, 1, 2, 3], translation=with_nan(GOOD, 0, 0), rotation=2 * QUARTER)
    assert [problem.code for problem in caught.value.problems] == [
        "DUPLICATE_TIME",
        "NON_FINITE",
        "BAD_QUATERNION",
    ]


@pytest.mark.long
def test_a_sampled_motion_that_jumps_is_warned_of():
    """One step of 1 cm in 500 samples of a slow sine is over twenty times the standard deviation of
    the steps."""
    times = np.linspace(0, 5, 501)
    x = np.zeros((501, 3))
    x[:, 2] = 1e-3 * np.sin(times)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        jb.Sampled(times, translation=x)
    x[300:, 2] += 0.01
    for build in (jb.Sampled, jb.Sampled.from_accelerations):
        with pytest.warns(
            jb.JaxbodyWarning,
            match=(
                r"Sampled.translation jumps by 0\.00999 along z at 2\.99 s, 22\.\d times the "
                r"usual step \[BASE_JUMP\]"
            ),
        ):
            build(times, translation=x)
