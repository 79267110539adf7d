"""Mistakes planted in a measured record are reported, and a correct record passes."""

import warnings

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from rigs import plate

import jaxbody as jb
from jaxbody.model.models import size_of

TIMES = np.linspace(0, 4, 201)
SENSORS = {
    "corner": jb.Position("plate", [0.4, 0.3, 0.0]),
    "edge": jb.Position("plate", [-0.4, 0.1, 0.0], axis=[0, 0, 1]),
    "side": jb.Position("plate", [0.1, -0.3, 0.0], axis=[1, 0, 0]),
}


@pytest.fixture(scope="module")
def swing():
    """The model, where it starts, and what it reads: along, across and upwards at
    different frequencies."""
    model = plate(damping=0.5)
    eq = jb.equilibrium(model)
    initial = jb.State(
        eq.state.q.at[:3].add(jnp.array([0.02, -0.015, 0.01])),
        jnp.array([0.05, 0.1, -0.1, 0.3, -0.2, 0.4]),
    )
    return model, initial, jb.measure(jb.simulate(model, TIMES, initial=initial), SENSORS)


def diagnosed(swing, change, key=0):
    model, initial, readings = swing
    levels = jax.random.split(jax.random.key(key), 3)
    noisy = {
        name: np.asarray(x + 2e-4 * jax.random.normal(k, x.shape))
        for (name, x), k in zip(readings.items(), levels, strict=True)
    }
    run = jb.Experiment(TIMES, initial=initial, sensors=SENSORS, measured=noisy | change(noisy))
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", jb.JaxbodyWarning)
        result = jb.diagnose(model, {"run": run})
    return result, sorted(
        {w.message.code for w in caught if isinstance(w.message, jb.JaxbodyWarning)}
    )


def later(x, delay):
    return np.interp(TIMES - delay, TIMES, x)


def mirrored(x):
    return x * [1, 1, -1] + [0, 0, 2 * x[:, 2].mean()]


PLANTED = {
    "millimeters": (lambda m: {"edge": 1e3 * m["edge"]}, "GAIN_FACTOR", "run.edge thousandths"),
    "inches": (lambda m: {"side": m["side"] / 0.0254}, "GAIN_FACTOR", "run.side inches"),
    "g": (lambda m: {"edge": m["edge"] / 9.81}, "GAIN_FACTOR", "run.edge in g"),
    "degrees": (lambda m: {"edge": np.rad2deg(m["edge"])}, "GAIN_FACTOR", "run.edge degrees"),
    "sign": (lambda m: {"edge": -m["edge"]}, "GAIN_FACTOR", "run.edge reversed"),
    "late": (lambda m: {"edge": later(m["edge"], 0.012)}, "DELAY", "run.edge 0.6 samples later"),
    "early": (lambda m: {"edge": later(m["edge"], -0.02)}, "DELAY", "run.edge samples earlier"),
    "swapped": (
        lambda m: {"edge": m["side"], "side": m["edge"]},
        "SWAPPED",
        "run.edge run.side exchanged",
    ),
    "another channel": (
        lambda m: {"edge": m["side"]},
        "UNCORRELATED",
        "run.edge hardly follows run.side correlation R2 sign unit times",
    ),
    "much later": (
        lambda m: {"edge": later(m["edge"], 0.5)},
        "UNCORRELATED",
        "run.edge hardly follows 0.5 s later",
    ),
    "not connected": (
        lambda m: {"edge": m["edge"] - m["edge"] + np.random.default_rng(5).normal(0, 1e-4, 201)},
        "UNCORRELATED",
        "run.edge hardly",
    ),
    "left-handed": (
        lambda m: {"corner": mirrored(m["corner"])},
        "LEFT_HANDED",
        "run.corner mirrored",
    ),
}


@pytest.mark.long
@pytest.mark.parametrize("case", PLANTED)
def test_a_planted_blunder_is_named(swing, case):
    change, code, words = PLANTED[case]
    result, codes = diagnosed(swing, change)
    assert code in codes, (codes, str(result))
    text = " ".join(result.words)
    assert [word for word in words.split() if word not in text] == [], text


@pytest.mark.long
def test_sound_records_pass(swing):
    """20 realizations of noise: a delay is reported at four standard errors, which white noise
    exceeds once in 16000."""
    for key in range(20):
        result, codes = diagnosed(swing, lambda m: {}, key)
        assert codes == [] and result.words == () and "no remarks" in str(result)
    assert all(abs(c.gain - 1) < 0.05 and abs(c.delay) < 0.1 for c in result.channels)


@pytest.mark.long
@pytest.mark.parametrize("noise", [0.0, 0.003, 0.03, 0.3])
def test_a_sound_record_in_much_noise_is_not_called_unrelated(swing, noise):
    """Up to a hundred times the motion, 20 realizations: the correlation is low, but what is left
    is white noise, which is taken for another motion once in 16000."""
    rng = np.random.default_rng(1)
    for _ in range(20):
        result, codes = diagnosed(
            swing, lambda m: {name: x + noise * rng.normal(size=x.shape) for name, x in m.items()}
        )
        assert "UNCORRELATED" not in codes, str(result)
    if noise == 0.3:
        assert all(c.correlation**2 < 0.5 for c in result.channels)


@pytest.mark.long
def test_a_prediction_at_rest_is_unrelated_to_a_motion(swing):
    model, _, readings = swing
    run = jb.Experiment(
        TIMES,
        initial="rest",
        sensors=SENSORS,
        measured={name: np.asarray(x) for name, x in readings.items()},
    )
    with pytest.warns(jb.JaxbodyWarning, match="hardly follows the prediction"):
        words = jb.diagnose(model, {"run": run}).words
    assert len(words) == 5


def test_gravity_that_was_taken_out_of_a_record_is_named(swing):
    """An accelerometer at rest reads +9.81 upwards; a record without it is that of the motion
    alone. The other way round, a model in which nothing weighs anything."""
    model, initial, _ = swing
    sensors = {
        "acc": jb.Accelerometer("plate", [0.4, 0.3, 0.0]),
        "up": jb.Accelerometer("plate", axis=[0, 0, 1]),
        "along": jb.Accelerometer("plate", axis=[1, 0, 0]),
    }
    whole = {
        name: np.asarray(x)
        for name, x in jb.measure(jb.simulate(model, TIMES, initial=initial), sensors).items()
    }
    bare = {"acc": whole["acc"] - [0, 0, 9.81], "up": whole["up"] - 9.81, "along": whole["along"]}

    def codes_and_words(model, measured):
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always", jb.JaxbodyWarning)
            result = jb.diagnose(
                model,
                {"run": jb.Experiment(TIMES, initial=initial, sensors=sensors, measured=measured)},
            )
        return [w.message.code for w in caught], result.words

    assert codes_and_words(model, whole) == ([], ())
    codes, words = codes_and_words(model, bare)
    assert (
        codes == ["GRAVITY"] * 2
        and words[0].startswith("run.acc is ")
        and words[1].startswith("run.up is ")
    )
    assert all("was gravity removed from the record?" in word for word in words)
    codes, words = codes_and_words(jb.replace(model, {"gravity": np.zeros(3)}), whole)
    assert codes.count("GRAVITY") == 2 and any(
        "it reads gravity, but the model has none" in word for word in words
    )


def test_gaps_are_left_out(swing):
    def holed(m):
        x = m["edge"].copy()
        x[20:40] = np.nan
        return {"edge": 1e3 * x}

    result, codes = diagnosed(swing, holed)
    assert codes == ["GAIN_FACTOR"] and "run.edge" in result.words[0]


# Before any measurement: sizes that units make likely


def scaled(model, pattern, factor):
    """The model with numbers as they would be in another unit."""
    return jb.replace(
        model,
        {
            path: np.asarray(value) * factor
            for path, value in jb.parameter_paths(model, pattern).items()
        },
    )


UNITS = {
    "N/mm for N/m": (lambda m: scaled(m, "*.stiffness", 1e-3), "SAG"),
    "points in mm": (lambda m: scaled(scaled(m, "*.a", 1e3), "*.b", 1e3), "GYRATION"),
    "kg mm2 for kg m2": (lambda m: scaled(m, "*.inertia", 1e6), "GYRATION"),
    "mass in g": (lambda m: scaled(m, "plate.mass", 1e3), "SAG"),
    "mass in t": (lambda m: scaled(jb.presets.elastic_pendulum(), "bob.mass", 1e-3), "DENSITY"),
    "places in mm, nothing turns": (
        lambda _: scaled(jb.presets.quarter_car(), "*.position", 1e3),
        "DENSITY",
    ),
    "N/mm without gravity": (
        lambda _: scaled(jb.presets.isolated_table(), "*.stiffness", 1e-3),
        "SAG",
    ),
    "gravity in mm/s2": (lambda m: scaled(m, "gravity", 1e3), "GRAVITY"),
    "stiffness in nothing known": (
        lambda m: scaled(scaled(m, "*.stiffness", 1e-12), "gravity", 0.0),
        "FREQUENCY",
    ),
}


@pytest.fixture(scope="module")
def table():
    """The plate with springs that bear it, relaxed at the reference pose but for their weight."""
    model = plate()
    for path, value in jb.parameter_paths(model, "*.stiffness").items():
        model = jb.replace(model, {path: 30 * value})
    return model


@pytest.mark.long
@pytest.mark.parametrize("case", UNITS)
def test_a_unit_that_moves_a_size_far_away_is_named(table, case):
    change, code = UNITS[case]
    with pytest.warns(jb.JaxbodyWarning) as caught:
        result = jb.fitting.plausibility(change(table))
    codes = {w.message.code for w in caught}
    assert code in codes and result.words and all(word in str(result) for word in result.words)


@pytest.mark.long
def test_geometry_that_is_drawn_apart_and_does_not_stay_is_named():
    """A pendulum drawn sideways, with a mount whose other end is drawn elsewhere and which has no
    stiffness there."""
    bob = jb.Body(2.0, [0.1, 0.1, 0.1], com=[0.5, 0, 0])
    mount = jb.Bushing(("bob", [0.5, 0, 0]), ("world", [0.5, 0.25, 0]), stiffness=[0, 1e-3, 0])
    model = jb.Model(
        bodies={"bob": bob},
        joints={"bob": jb.Hinge("world", axis="y")},
        elements={"mount": mount},
        gravity=[0, 0, -9.81],
    )
    with pytest.warns(jb.JaxbodyWarning) as caught:
        words = jb.fitting.plausibility(model).words
    assert {"DRAWN_APART", "FAR_FROM_DRAWN"} <= {w.message.code for w in caught}
    assert (
        "bushing 'mount' is drawn 0.25 m apart" in words
        and "'bob' is 0.707 m and 90 degrees from it" in words[-1]
    )


@pytest.mark.long
def test_times_in_milliseconds_are_named(table, swing):
    run = jb.Experiment(
        1e3 * TIMES, sensors={"edge": SENSORS["edge"]}, measured={"edge": swing[2]["edge"]}
    )
    with pytest.warns(
        jb.JaxbodyWarning, match=r"step of 'run' over the first period is .*in seconds.*TIME_UNIT"
    ):
        jb.fitting.plausibility(table, {"run": run})


@pytest.mark.long
def test_the_sizes_are_those_of_closed_forms(table):
    """A mass on a spring along gravity: f = sqrt(k/m)/2 pi, sag m g/k; and sound models pass."""
    model = jb.Model(
        bodies={"mass": jb.Body(mass=2.0, inertia=[1, 1, 1])},
        joints={"mass": jb.Guide("world", axis=[0, 0, 1])},
        elements={
            "s": jb.Spring(
                ("mass", [0, 0, 0]), ("world", [0, 0, 0.5]), stiffness=800.0, free_length=0.5
            )
        },
        gravity=[0, 0, -9.81],
    )
    numbers = jb.fitting.plausibility(model).numbers
    assert numbers["first natural frequency"][0] == pytest.approx(
        np.sqrt(800 / 2) / (2 * np.pi), rel=1e-12
    )
    assert numbers["sag under gravity over the size of the model"][0] == pytest.approx(
        2 * 9.81 / 800 / 0.5, rel=1e-12
    )
    assert numbers["mass over the cube of the size of the model"][0] == pytest.approx(
        2 / 0.5**3, rel=1e-12
    )
    weightless = jb.fitting.plausibility(jb.replace(model, {"gravity": [0.0, 0.0, 0.0]})).numbers
    name = "sag along the first mode, were there gravity, over the size of the model"
    assert weightless[name][0] == pytest.approx(2 * 9.80665 / 800 / 0.5, rel=1e-12)
    for sound in (table, jb.presets.quarter_car()):
        assert jb.fitting.plausibility(sound).words == ()


def balanced_rack():
    """A rack that hangs on the spring of its pinion, in closed form: f = sqrt(k/(J + m r^2))/2 pi,
    and a sag of m g r^2/k."""
    mass, about, radius, stiffness = 6.0, 0.02, 0.05, 8.0
    rack, pinion = (
        jb.Body(mass=mass, inertia=[0.01] * 3),
        jb.Body(mass=1.0, inertia=[about] * 3, position=[0.2, 0, 0]),
    )
    model = jb.Model(
        bodies={"rack": rack, "pinion": pinion},
        joints={
            "rack": jb.Guide("world", axis=[0, 0, -1]),
            "pinion": jb.Hinge("world", axis="y", at=[0.2, 0, 0]),
        },
        closures={"mesh": jb.closures.Coupling("rack.q", "pinion.q", ratio=radius)},
        elements={"spring": jb.Torsion("world", "pinion", axis="y", spring=stiffness)},
        gravity=[0, 0, -9.81],
    )
    return (
        model,
        np.sqrt(stiffness / (about + mass * radius**2)) / (2 * np.pi),
        mass * 9.81 * radius**2 / stiffness,
    )


@pytest.mark.long
def test_closed_loops_are_diagnosed_and_their_sizes_are_those_of_closed_forms():
    model, frequency, sag = balanced_rack()
    numbers = jb.fitting.plausibility(model).numbers
    assert numbers["first natural frequency"][0] == pytest.approx(frequency, rel=1e-10)
    assert numbers["sag under gravity over the size of the model"][0] == pytest.approx(
        sag / float(size_of(model)), rel=1e-10
    )
    times, sensors = np.linspace(0, 2, 81), {"height": jb.Position("rack", axis="z")}
    height = sag * (np.cos(2 * np.pi * frequency * times) - 1)
    noise = 1e-4 * np.random.default_rng(1).normal(size=81)
    assert (
        jb.diagnose(
            model,
            {"run": jb.Experiment(times, sensors=sensors, measured={"height": height + noise})},
        ).words
        == ()
    )
    with pytest.warns(jb.JaxbodyWarning, match=r"thousandths.*GAIN_FACTOR"):
        jb.diagnose(
            model,
            {
                "run": jb.Experiment(
                    times, sensors=sensors, measured={"height": 1e3 * height + noise}
                )
            },
        )


def two_masses(k1, k2, c1, c2):
    """Guides along x: a on the wall, b on a."""
    bodies = {
        name: jb.Body(m, [1, 1, 1], position=[i, 0, 0])
        for i, (name, m) in enumerate((("a", 2.0), ("b", 1.0)), 1)
    }
    springs = {
        "s1": jb.Spring(
            ("a", [0, 0, 0]), ("world", [0, 0, 0]), stiffness=k1, damping=c1, free_length=1.0
        ),
        "s2": jb.Spring(
            ("b", [0, 0, 0]), ("a", [0, 0, 0]), stiffness=k2, damping=c2, free_length=1.0
        ),
    }
    return jb.Model(
        bodies=bodies,
        joints=dict.fromkeys(bodies, jb.Guide("world", axis=[1, 0, 0])),
        elements=springs,
    )


FREQUENCIES = np.linspace(2.0, 25.0, 231)
RESPONSES = {
    "sound": (lambda H: H, ""),
    "conjugates": (np.conj, "CONJUGATED"),
    "negatives": (lambda H: -H, "GAIN_FACTOR"),
    "negative conjugates": (lambda H: -np.conj(H), "CONJUGATED"),
    "accelerances": (lambda H: -((2 * np.pi * FREQUENCIES) ** 2) * H, "OTHER_RESPONSE"),
}


@pytest.mark.parametrize("case", RESPONSES)
def test_responses_of_another_sign_or_derivative_are_named(case):
    """H = (K + i w C - w^2 M)^-1 with noise of a hundredth of its peak, and a guess that
    is 10 % off."""
    M, K = np.diag([2.0, 1.0]), np.array([[12e3, -4e3], [-4e3, 4e3]])
    C = np.array([[9.0, -3.0], [-3.0, 3.0]])
    H = np.array([np.linalg.inv(K + 1j * w * C - w**2 * M)[:, 0] for w in 2 * np.pi * FREQUENCIES])
    rng = np.random.default_rng(0)
    H = H + 2e-6 * (rng.normal(size=H.shape) + 1j * rng.normal(size=H.shape))
    change, code = RESPONSES[case]
    outputs = {"xa": jb.Position("a", axis=[1, 0, 0]), "xb": jb.Position("b", axis=[1, 0, 0])}
    measured = {("xa", "f"): change(H[:, 0]), ("xb", "f"): change(H[:, 1])}
    hammer = jb.MeasuredResponse(
        FREQUENCIES,
        inputs={"f": jb.PointForce("a", direction="x")},
        outputs=outputs,
        measured=measured,
    )
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", jb.JaxbodyWarning)
        result = jb.diagnose(two_masses(7e3, 4.4e3, 4.0, 4.0), {"hammer": hammer}, progress=False)
    assert {w.message.code for w in caught} == ({code} if code else set()), result.words
    assert len(result.words) == 2 * bool(code) and [c.name for c in result.channels] == [
        "hammer.xa/f",
        "hammer.xb/f",
    ]


def test_a_response_below_its_noise_is_not_called_another_derivative():
    """Above the resonances, noise of half of the static response grows beside it."""
    model = two_masses(8e3, 4e3, 6.0, 3.0)
    ports = {"f": jb.PointForce("a", direction="x")}, {"xb": jb.Position("b", axis=[1, 0, 0])}
    lin = jb.linearize(model, jb.equilibrium(model))
    H = np.asarray(jb.frequency_response(lin, FREQUENCIES, *ports)["xb", "f"])
    rng = np.random.default_rng(0)
    noise = 0.5 * abs(H[0]) * (rng.normal(size=H.shape) + 1j * rng.normal(size=H.shape))
    hammer = jb.MeasuredResponse(
        FREQUENCIES, inputs=ports[0], outputs=ports[1], measured={("xb", "f"): H + noise}
    )
    found = jb.diagnose(model, {"hammer": hammer}, progress=False)
    assert not any("grows as" in words for words in found.words)


def test_modes_and_stiffnesses_in_other_units_are_named():
    """Angular frequencies, damping in percent, a sensor that was mounted upside down; a data sheet
    in N/mm and degrees."""
    model = two_masses(8e3, 4e3, 6.0, 3.0)
    modes = jb.modes(jb.linearize(model, jb.equilibrium(model)))
    f, shapes = np.asarray(modes.frequency), np.array([[1.0, 1.56], [1.0, -1.28]])
    sensors = {name: jb.Position(name, axis=[1, 0, 0]) for name in "ab"}
    sheet = jb.fitting.MeasuredStiffness(
        "s1", [5.0, 10.0], magnitude=np.array([8.0, 8.1]), loss_angle=np.rad2deg([0.0236, 0.047])
    )
    tests = {
        "modal": jb.MeasuredModes(
            frequency=2 * np.pi * f, damping_ratio=100 * np.asarray(modes.damping_ratio)
        ),
        "shapes": jb.MeasuredModes(frequency=f, shapes=shapes * [1, -1], sensors=sensors),
        "sheet": sheet,
    }
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", jb.JaxbodyWarning)
        text = "\n".join(jb.diagnose(model, tests, progress=False).words)
        assert (
            jb.diagnose(
                model,
                {"modal": jb.MeasuredModes(frequency=f, shapes=shapes, sensors=sensors)},
                progress=False,
            ).words
            == ()
        )
    for words in (
        "modal.frequency is 6.283 times the prediction: is it in rad/s",
        "modal.damping_ratio is 100 times",
        "is its sign or its axis reversed",
        "sheet.magnitude is 0.001",
        "times the prediction: is it in degrees",
    ):
        assert words in text, text


@pytest.mark.parametrize("turn", [2 * np.pi, 360.0])
def test_an_encoder_that_starts_again_after_a_turn_is_named(turn):
    """A wheel that spins at 12 rad/s against a drag of 0.05 N m s: q = 24 (1 - exp(-t/2)), pi
    at 0.281 s."""
    wheel = jb.Model(
        bodies={"wheel": jb.Body(1.0, [0.1, 0.1, 0.1])},
        joints={"wheel": jb.Hinge("world", axis=[0, 0, 1])},
        elements={"drag": jb.Torsion("wheel", "world", axis=[0, 0, 1], damper=0.05)},
    )
    angle = 24 * (1 - np.exp(-TIMES / 2)) * turn / (2 * np.pi)
    start = jb.State(q=jnp.zeros(1), v=jnp.array([12.0]))
    for x, codes in (
        ((angle + turn / 2) % turn - turn / 2, ["WRAPPED"]),
        (angle, [] if turn < 10 else ["GAIN_FACTOR"]),
    ):
        run = jb.Experiment(
            TIMES,
            initial=start,
            sensors={"turn": jb.sensors.JointAngle("wheel")},
            measured={"turn": x},
        )
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always", jb.JaxbodyWarning)
            words = jb.diagnose(wheel, {"run": run}, progress=False).words
        assert [w.message.code for w in caught] == codes, words
        assert (
            not codes
            or "WRAPPED" not in codes
            or ("np.unwrap" in words[0] and " 3 times, first at t = 0.3 s" in words[0])
        )
