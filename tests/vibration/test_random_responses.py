"""Random response: white noise in closed form, correlated wheels, roads and weightings as
published, units, derivatives, errors."""

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.signal

import jaxbody as jb

MS, MU, KS, C, KT = 375.0, 75.0, 35000.0, 1800.0, 193000.0
SPEED = 20.0
CAR = jb.presets.quarter_car(sprung=MS, unsprung=MU, stiffness=KS, damping=C, tyre=KT)
ROAD = {"road": jb.BaseMotion("road", "z")}
OUTPUTS = {
    "acceleration": jb.Acceleration("body", axis="z"),
    "stroke": jb.Elongation("suspension"),
    "tyre": jb.Elongation("tyre"),
}
BAND = jb.vibration.Band(0.1, 100.0, points=801)


def exact_variances(W):
    """Of body acceleration, stroke and tyre deflection under white noise road velocity of two-sided
    intensity W."""
    M = MS + MU
    return np.array(
        [
            W / 2 * (M * KS**2 / (C * MS**2) + KT * C / MS**2),
            W * M / (2 * C),
            W
            / 2
            * (
                M**3 * KS**2 / (C * MS**2 * KT**2)
                - 2 * MU * M * KS / (C * MS * KT)
                + MU / C
                + M**2 * C / (MS**2 * KT)
            ),
        ]
    )


def white(road):
    """W = 2 pi^2 n0^2 Gd(n0) U."""
    return 2 * np.pi**2 * 0.1**2 * float(road.level) * SPEED


@pytest.fixture(scope="module")
def lin():
    return jb.linearize(CAR, jb.equilibrium(CAR))


@pytest.fixture(scope="module")
def ride(lin):
    return jb.random_response(
        lin, BAND, ROAD, OUTPUTS, {"road": jb.vibration.RoadRoughness.iso("C").at_speed(SPEED)}
    )


def test_white_noise_variances_in_closed_form(lin):
    """By integration over 26 decades, which leave out less than 1e-12."""
    road = jb.vibration.RoadRoughness.iso("C")
    computed = jb.random_response(
        lin,
        jb.vibration.Band(1e-13, 1e13, points=12001),
        ROAD,
        OUTPUTS,
        {"road": road.at_speed(SPEED)},
    )
    assert np.abs(np.asarray(computed.rms) ** 2 / exact_variances(white(road)) - 1).max() < 1e-9


@pytest.mark.long
def test_damping_of_least_body_acceleration(lin):
    """ks sqrt(M/kt): the derivative of the variance vanishes there."""
    road = {"road": jb.vibration.RoadRoughness.iso("C").at_speed(SPEED)}
    band = jb.vibration.Band(1e-4, 1e6, points=2001)

    def variance(c):
        lin = jb.linearize(jb.replace(CAR, {"suspension.damping": c}), CAR.reference)
        return jb.random_response(lin, band, ROAD, {"a": OUTPUTS["acceleration"]}, road)["a"] ** 2

    best = KS * np.sqrt((MS + MU) / KT)
    value, slope = jax.jit(jax.value_and_grad(variance))(best)
    # the band leaves out 1e-7 of the variance
    assert abs(float(slope) * best / float(value)) < 1e-6
    other = jax.jit(jax.grad(variance))(1.1 * best)
    assert float(other) * best / float(value) > 0.01


@pytest.mark.parametrize("unit, power", [("(m/s)2/Hz", 2), ("(m/s2)2/Hz", 4)])
def test_a_white_rate_is_a_motion_with_a_falling_density(lin, unit, power):
    """S_x = S/w^2 of a white velocity and S/w^4 of a white acceleration, whichever of them the
    input is."""
    f, given = np.linspace(0.5, 20.0, 400), {"road": jb.vibration.PowerLaw(3e-4, unit=unit)}
    motion = {
        "road": jb.vibration.PowerLaw(3e-4 / (2 * np.pi) ** power, exponent=power, unit="m2/Hz")
    }
    expected = jb.random_response(lin, f, ROAD, OUTPUTS, motion).psd
    for kind in ("displacement", "velocity", "acceleration"):
        found = jb.random_response(
            lin, f, {"road": jb.BaseMotion("road", "z", kind=kind)}, OUTPUTS, given
        ).psd
        np.testing.assert_allclose(found, expected, rtol=1e-11, err_msg=kind)


@pytest.mark.parametrize("points", [31, 61, 121])
def test_a_band_integrates_to_the_fourth_order(points):
    """int df/f is exact; the error of int df is that of Gregory's rule of the third order, 19/720
    x^4 in the limit of short steps x of the logarithm."""
    band = jb.vibration.Band(0.5, 20.0, points=points)
    step = np.log(40.0) / (points - 1)
    for weights, x in ((band.weights, step), (band.coarse, 2 * step)):
        assert float(jnp.sum(weights / band.frequencies)) == pytest.approx(np.log(40.0), rel=1e-13)
        assert 0.8 < (float(jnp.sum(weights)) / 19.5 - 1) / (19 / 720 * x**4) < 1


@pytest.mark.long
def test_spectra_in_all_units_and_sides_agree(lin, ride):
    """One road as displacement, velocity or acceleration, per Hz, rad/s or cycle/m, one- or
    two-sided, as a formula or through points."""
    level = 64e-6 * 4
    a = level * 0.01 * SPEED  # m2 Hz: a/f^2 one-sided per Hz
    points = np.geomspace(0.01, 200, 400)
    same = [
        jb.vibration.PowerLaw(a, exponent=2.0, unit="m2/Hz"),
        jb.vibration.PowerLaw(a / 2, exponent=2.0, unit="m2/Hz", sides=2),
        jb.vibration.PowerLaw((2 * np.pi) * a, exponent=2.0, unit="m2/(rad/s)"),
        jb.vibration.PowerLaw(level, exponent=2.0, reference=0.1, unit="m3", speed=SPEED),
        jb.vibration.PowerLaw((2 * np.pi) ** 2 * a, unit="(m/s)2/Hz"),
        jb.vibration.PowerLaw((2 * np.pi) ** 4 * a, exponent=-2.0, unit="(m/s2)2/Hz"),
        jb.vibration.PowerLaw((2 * np.pi) ** 4 * a / 9.80665**2, exponent=-2.0, unit="g2/Hz"),
        jb.vibration.PSD(points, a / points**2, unit="m2/Hz"),
        jb.vibration.PSD(
            points / SPEED, a / points**2 * SPEED / 2, unit="m2/(cycle/m)", sides=2, speed=SPEED
        ),
        jb.vibration.PSD(2 * np.pi * points, 0 * points + 2 * np.pi * a, unit="(m/s)2/(rad/s)"),
    ]
    for spectrum in same:
        computed = jb.random_response(lin, BAND, ROAD, OUTPUTS, {"road": spectrum})
        np.testing.assert_allclose(computed.rms, ride.rms, rtol=1e-11)
    faster = jb.random_response(
        lin,
        BAND,
        {"road": jb.BaseMotion("road", "z", kind="acceleration")},
        OUTPUTS,
        {"road": same[4]},
    )
    np.testing.assert_allclose(faster.rms, ride.rms, rtol=1e-11)


def test_any_frequencies_are_integrated_by_trapezoids(lin, ride):
    f = np.linspace(0.1, 100.0, 20001)
    computed = jb.random_response(
        lin, f, ROAD, OUTPUTS, {"road": jb.vibration.RoadRoughness.iso("C").at_speed(SPEED)}
    )
    np.testing.assert_allclose(
        computed.rms, np.sqrt(np.trapezoid(np.asarray(computed.psd), f)), rtol=1e-13
    )
    np.testing.assert_allclose(computed.rms, ride.rms, rtol=1e-3)
    with pytest.warns(jb.JaxbodyWarning, match="too far apart"):
        coarse = jb.random_response(
            lin,
            f[::1000],
            ROAD,
            OUTPUTS,
            {"road": jb.vibration.RoadRoughness.iso("C").at_speed(SPEED)},
        )
    assert jb.Status(int(coarse.status)).name == "COARSE"


def two_directions(damping):
    """A mass held along x by a spring without damping, along y by one with; both at 1 Hz."""
    mount = jb.Bushing(
        ("mass", [0, 0, 0]),
        ("base", [0, 0, 0]),
        stiffness=[4 * np.pi**2] * 2 + [1.0],
        damping=[damping, 2.0, 0.0],
    )
    model = jb.Model(
        bodies={"mass": jb.Body(1.0)},
        joints={"mass": jb.Translation("world")},
        supports={"base": jb.Support()},
        elements={"mount": mount},
    )
    return jb.linearize(model, jb.equilibrium(model))


@pytest.mark.nan
def test_an_undamped_resonance_has_an_infinite_variance_where_it_is_excited_and_read():
    """Also with one that lies midway between two points of the band, where all sums look resolved;
    in what is computed from the response, too; not in outputs that do not contain it, and not with
    any damping."""
    lin, f = two_directions(0.0), np.exp(0.05 * (np.arange(200) - 99.5))
    forces = {name: jb.PointForce("mass", direction=name) for name in "xy"}
    reads = {name: jb.Acceleration("mass", axis=name) for name in "xy"}
    white = {name: jb.vibration.PowerLaw(1.0, unit="N2/Hz") for name in "xy"}
    for band in (np.append(f[:100], [1.0, *f[100:]]), f, jb.vibration.Band(0.1, 10.0)):
        with pytest.warns(
            jb.JaxbodyWarning, match=r"no damping.*; x near (0\.9|1).* Hz; give dampers.*UNDAMPED"
        ):
            both = jb.random_response(lin, band, forces, reads, white)
        assert np.isinf(both["x"])
    assert np.isfinite(both["y"])
    assert np.isinf(jb.vibration.weighted_response(both, {"x": "Wd"})["x"]) and np.isfinite(
        jb.vibration.weighted_response(both, {"y": "Wd"})["y"]
    )
    assert np.isnan(jb.shock.level_crossings(both, "x", 0.0)) and np.isfinite(
        jb.shock.level_crossings(both, "y", 0.0)
    )
    for inputs, outputs in (("y", "xy"), ("xy", "y")):  # not excited, not read
        part = [
            {name: table[name] for name in names}
            for table, names in ((forces, inputs), (reads, outputs), (white, inputs))
        ]
        assert jb.random_response(lin, jb.vibration.Band(0.1, 10.0), *part).ok
    assert jb.random_response(
        two_directions(2e-3), jb.vibration.Band(0.5, 2.0, points=20001), forces, reads, white
    ).ok
    with_loss = jb.random_response(
        lin, jb.vibration.Band(0.5, 2.0), forces, reads, white, loss_factor=0.05
    )
    with_ratio = jb.random_response(
        lin, jb.vibration.Band(0.5, 2.0), forces, reads, white, modal_damping=0.05
    )
    assert with_loss.ok and with_ratio.ok


@pytest.mark.long
def test_a_wheelbase_filters_the_excitation_of_both_axles():
    """Heave and pitch of a symmetric half car behind each other at a distance: |1 + exp(-i w
    d)|^2/4 and |1 - exp(-i w d)|^2 of what coherent axles give."""
    car = jb.presets.half_car(
        front=1.25,
        rear=1.25,
        front_stiffness=2e4,
        rear_stiffness=2e4,
        front_damping=1500.0,
        rear_damping=1500.0,
    )
    lin = jb.linearize(car, jb.equilibrium(car))
    inputs = {axle: jb.BaseMotion(axle, "z") for axle in ("front", "rear")}
    outputs = {
        "heave": jb.Position("body", axis="z"),
        "pitch": jb.sensors.Rotation("body", axis="y"),
    }
    road = jb.vibration.RoadRoughness.iso("B").at_speed(SPEED)
    f, delay = np.array([0.7, 1.3, 2.9, 7.0]), 2.5 / SPEED
    both = {"front": road, "rear": road}
    H = np.asarray(jb.frequency_response(lin, f, inputs, outputs).values)
    S = np.asarray(road(jnp.asarray(f)))
    phase = np.exp(-2j * np.pi * f * delay)
    for coherence in (1.0, 0.6, lambda f: jnp.exp(-0.1 * f)):
        g = coherence(f) if callable(coherence) else coherence
        spectra = jb.vibration.CrossPSD(
            both, delays={"rear": delay}, coherence={("front", "rear"): coherence}
        )
        response = jb.random_response(lin, np.linspace(0.5, 8, 751), inputs, outputs, spectra)
        assert response.ok
        computed = np.asarray(response.psd)[:, np.rint((f - 0.5) / 0.01).astype(int)]
        part = (
            np.abs(H[:, 0]) ** 2
            + np.abs(H[:, 1]) ** 2
            + 2 * g * (H[:, 0] * (H[:, 1] * phase).conj()).real
        )
        np.testing.assert_allclose(computed, S * part, rtol=1e-10)
        if coherence == 1.0:  # at 4 Hz heave feels nothing, at 8 Hz pitch, but for rounding
            at = np.array([4.0, 8.0])
            each = np.asarray(jb.frequency_response(lin, at, inputs, outputs).values)
            terms = np.sum(np.abs(each) ** 2, 1) * np.asarray(road(jnp.asarray(at)))
            silent = np.diag(np.asarray(response.psd)[:, [350, 750]] / terms)
            assert (silent <= 4 * np.finfo(float).eps).all()


def test_weightings_as_tabulated():
    tabulated = {
        "Wk": {0.5: 418, 1: 482, 2: 531, 4: 967, 5: 1039, 8: 1036},
        "Wd": {0.5: 853, 1: 1011, 2: 890, 4: 512},
    }
    for name, values in tabulated.items():
        computed = 1000 * np.abs(np.asarray(jb.vibration.frequency_weighting(name, list(values))))
        np.testing.assert_allclose(computed, list(values.values()), rtol=5e-3)


def test_a_weighted_signal_is_that_of_the_analog_filter():
    """SciPy's solution of the differential equation for a signal that is linear between samples;
    only the tail of its spectrum differs."""
    t = np.arange(0, 12.0, 0.002)
    a = np.sin(2 * np.pi * 3.0 * t) * np.exp(-0.3 * t) + 0.4 * np.sin(2 * np.pi * 11.0 * t + 1) * (
        t > 2
    ) * (1 - np.exp(-(t - 2).clip(0)))
    w = 2 * np.pi
    for name in ("Wk", "Wd"):
        f3, Q4 = {"Wk": (12.5, 0.63), "Wd": (2.0, 0.63)}[name]
        high = [1, 0, 0], [1, 2**0.5 * w * 0.4, (w * 0.4) ** 2]
        low = [1], [1 / (w * 100) ** 2, 2**0.5 / (w * 100), 1]
        change = [1 / (w * f3), 1], [1 / (w * f3) ** 2, 1 / (Q4 * w * f3), 1]
        step = ([1], [1])
        if name == "Wk":
            step = (
                np.array([1 / (w * 2.37) ** 2, 1 / (0.91 * w * 2.37), 1]) * (2.37 / 3.35) ** 2,
                [1 / (w * 3.35) ** 2, 1 / (0.91 * w * 3.35), 1],
            )
        top, bottom = (
            np.polymul(np.polymul(a_, b_), np.polymul(c_, d_))
            for a_, b_, c_, d_ in zip(high, low, change, step, strict=True)
        )
        _, reference, _ = scipy.signal.lsim((top, bottom), a, t)
        computed = jb.vibration.weighted_signal(t, a, name)
        assert (
            np.abs(np.asarray(computed.values) - reference).max() < 3e-3 * np.abs(reference).max()
        )
        np.testing.assert_allclose(computed.rms, np.sqrt(np.mean(reference**2)), rtol=1e-3)
        np.testing.assert_allclose(
            computed.crest_factor, np.abs(computed.values).max() / computed.rms, rtol=1e-12
        )


def test_roads_by_class():
    """ISO 8608: class A 16e-6 m3, each four times the one before; at a speed Gd(f/U)/U; a path has
    the density at every wave, and its key makes it."""
    n = np.array([0.02, 0.1, 1.7])
    for i, name in enumerate("ABCDEFGH"):
        np.testing.assert_allclose(
            jb.vibration.RoadRoughness.iso(name)(n), 16e-6 * 4**i * (n / 0.1) ** -2, rtol=1e-14
        )
    road = jb.vibration.RoadRoughness.iso("D")
    for count in (2000, 2001):
        s, z = (
            np.asarray(x)
            for x in jb.vibration.road_profile(
                road, length=250.0, spacing=250.0 / count, key=jax.random.key(3)
            )
        )
        assert len(s) == count + 1 and s[-1] == pytest.approx(250) and z[0] == z[-1]
        k = np.arange(1, (count + 1) // 2)
        density = 2 * np.abs(np.fft.rfft(z[:-1])[k]) ** 2 / count**2 * 250
        np.testing.assert_allclose(density, road(k / 250), rtol=1e-9)
    again = jb.vibration.road_profile(
        road, length=250.0, spacing=250.0 / 2001, key=jax.random.key(3)
    )[1]
    other = jb.vibration.road_profile(
        road, length=250.0, spacing=250.0 / 2001, key=jax.random.key(4)
    )[1]
    assert np.array_equal(again, z) and not np.allclose(other, z)


def test_a_record_gives_back_its_density():
    """Welch's estimate of white noise of 0.5 (m/s2)2/Hz: its mean over the band within three
    standard errors."""
    rate, S = 200.0, 0.5
    a = np.random.default_rng(0).normal(size=40_000) * np.sqrt(S * rate / 2)
    psd = jb.vibration.PSD.from_record(np.arange(40_000) / rate, a, unit="m/s2", segment=512)
    mean = float(jnp.mean(psd(jnp.linspace(1.0, 99.0, 500))))
    # half as many independent powers as samples
    assert psd.quantity == "m/s2" and abs(mean / S - 1) < 3 / np.sqrt(20_000)


@pytest.mark.nan
def test_contradictory_coherences_are_refused(lin):
    """One wheel coherent with two that are not with each other; by numbers at once, by functions in
    a status."""
    road = jb.vibration.RoadRoughness.iso("B").at_speed(SPEED)
    names = ("one", "two", "three")
    with pytest.raises(jb.JaxbodyError, match="NOT_POSITIVE"):
        jb.vibration.CrossPSD(
            dict.fromkeys(names, road), coherence={("one", "two"): 1.0, ("one", "three"): 1.0}
        )
    spectra = jb.vibration.CrossPSD(
        {"road": road, "pull": jb.vibration.PowerLaw(1.0, unit="N2/Hz")},
        coherence={("road", "pull"): lambda f: 0.5 + f},
    )
    with pytest.warns(jb.JaxbodyWarning, match="NOT_POSITIVE"):
        computed = jb.random_response(
            lin, BAND, ROAD | {"pull": jb.PointForce("body")}, OUTPUTS, spectra
        )
    assert np.isnan(computed.rms).all()


@pytest.mark.long
@pytest.mark.parametrize(
    ("code", "call"),
    [
        ("BAD_UNIT", lambda lin: jb.vibration.PowerLaw(1.0, unit="m/Hz")),
        ("BAD_UNIT", lambda lin: jb.vibration.PSD([1, 2], [1, 1], unit="furlong2/Hz")),
        ("NO_SPEED", lambda lin: jb.vibration.PowerLaw(1.0, unit="m3")),
        ("NO_SPEED", lambda lin: jb.vibration.PowerLaw(1.0, unit="m2/Hz", speed=20.0)),
        ("NO_SPEED", lambda lin: jb.vibration.RoadRoughness.iso("A").at_speed(-3.0)),
        ("BAD_SIDES", lambda lin: jb.vibration.PowerLaw(1.0, unit="m2/Hz", sides=3)),
        ("NEGATIVE", lambda lin: jb.vibration.PSD([1, 2], [1, -1], unit="m2/Hz")),
        ("BAD_FREQUENCY", lambda lin: jb.vibration.PSD([0, 2], [1, 1], unit="m2/Hz")),
        ("BAD_SHAPE", lambda lin: jb.vibration.PSD([1, 2, 3], [1, 1], unit="m2/Hz")),
        ("EMPTY_BAND", lambda lin: jb.vibration.Band(10.0, 1.0)),
        ("BAD_FREQUENCY", lambda lin: jb.vibration.Band(0.0, 1.0)),
        (
            "EMPTY_BAND",
            lambda lin: jb.random_response(
                lin, [1.0], ROAD, OUTPUTS, {"road": jb.vibration.PowerLaw(1.0, unit="m2/Hz")}
            ),
        ),
        (
            "EMPTY_BAND",
            lambda lin: jb.random_response(
                lin, [2.0, 1.0], ROAD, OUTPUTS, {"road": jb.vibration.PowerLaw(1.0, unit="m2/Hz")}
            ),
        ),
        (
            "BAD_UNIT",
            lambda lin: jb.random_response(
                lin, BAND, ROAD, OUTPUTS, {"road": jb.vibration.PowerLaw(1.0, unit="N2/Hz")}
            ),
        ),
        (
            "BAD_UNIT",
            lambda lin: jb.random_response(
                lin, BAND, ROAD, OUTPUTS, {"road": jb.vibration.PowerLaw(1.0, unit="rad2/Hz")}
            ),
        ),
        ("NO_SPECTRUM", lambda lin: jb.random_response(lin, BAND, ROAD, OUTPUTS, {})),
        (
            "UNKNOWN_NAME",
            lambda lin: jb.random_response(
                lin, BAND, ROAD, OUTPUTS, {"rood": jb.vibration.PowerLaw(1.0, unit="m2/Hz")}
            ),
        ),
        ("WRONG_KIND", lambda lin: jb.random_response(lin, BAND, ROAD, OUTPUTS, {"road": 1.0})),
        (
            "BAD_FREQUENCY",
            lambda lin: jb.random_response(
                lin, [0.0, 1.0], ROAD, OUTPUTS, {"road": jb.vibration.PowerLaw(1.0, unit="m2/Hz")}
            ),
        ),
        ("BAD_FREQUENCY", lambda lin: jb.vibration.frequency_weighting("Wk", [0.0, 1.0])),
        ("BAD_FREQUENCY", lambda lin: jb.frequency_response(lin, [-1.0], ROAD, OUTPUTS)),
        ("BAD_SHAPE", lambda lin: jb.frequency_response(lin, [], ROAD, OUTPUTS)),
        ("NON_FINITE", lambda lin: jb.frequency_response(lin, [np.nan], ROAD, OUTPUTS)),
        ("BAD_METHOD", lambda lin: jb.frequency_response(lin, [1.0], ROAD, OUTPUTS, method="fast")),
        (
            "NEGATIVE",
            lambda lin: jb.frequency_response(lin, [1.0], ROAD, OUTPUTS, loss_factor=-0.1),
        ),
        (
            "UNKNOWN_NAME",
            lambda lin: jb.frequency_response(lin, [1.0], ROAD, OUTPUTS, loss_factor={"tire": 0.1}),
        ),
        (
            "UNKNOWN_NAME",
            lambda lin: jb.frequency_response(
                lin, [1.0], {"r": jb.BaseMotion("rood", "z")}, OUTPUTS
            ),
        ),
        (
            "UNKNOWN_NAME",
            lambda lin: jb.frequency_response(lin, [1.0], ROAD, {"t": jb.sensors.LoadCell("tire")}),
        ),
        (
            "UNKNOWN_NAME",
            lambda lin: jb.frequency_response(lin, [1.0], ROAD, OUTPUTS)["axle", "road"],
        ),
        (
            "BAD_COMPONENT",
            lambda lin: jb.frequency_response(
                lin, [1.0], ROAD, {"t": jb.sensors.LoadCell("tyre", component=2)}
            ),
        ),
        ("WRONG_KIND", lambda lin: jb.frequency_response(lin, [1.0], OUTPUTS, ROAD)),
        ("WRONG_KIND", lambda lin: jb.frequency_response(lin, [1.0], {}, OUTPUTS)),
        (
            "WRONG_KIND",
            lambda lin: jb.frequency_response(
                jb.vibration.linearize_spin(lin.model, lin.state), [1.0], ROAD, OUTPUTS
            ),
        ),
        (
            "WRONG_KIND",
            lambda lin: jb.frequency_response(lin, [1.0], ROAD, {"p": jb.BaseMotion("road", "z")}),
        ),
        ("BAD_DIRECTION", lambda lin: jb.BaseMotion("road", "up")),
        ("BAD_DIRECTION", lambda lin: jb.sensors.Rotation("body", axis="w")),
        ("BAD_KIND", lambda lin: jb.BaseMotion("road", "z", kind="jerk")),
        ("BAD_CHAIN", lambda lin: lin.state_space(ROAD, {"p": jb.Position("body", delay=0.1)})),
        ("ZERO_AXIS", lambda lin: jb.PointForce("body", direction=[0, 0, 0])),
        ("BAD_CLASS", lambda lin: jb.vibration.RoadRoughness.iso("Z")),
        (
            "BAD_LENGTH",
            lambda lin: jb.vibration.road_profile(
                jb.vibration.RoadRoughness.iso("A"), length=1.0, spacing=2.0, key=jax.random.key(0)
            ),
        ),
        ("BAD_WEIGHTING", lambda lin: jb.vibration.frequency_weighting("Wz", [1.0])),
        ("NOT_UNIFORM", lambda lin: jb.vibration.weighted_signal([0, 1, 3.0], [0, 1, 2.0], "Wk")),
    ],
)
def test_invalid_arguments_are_refused(lin, code, call):
    with pytest.raises(jb.JaxbodyError) as refused:
        call(lin)
    assert refused.value.code == code


def test_only_accelerations_are_weighted(lin, ride):
    felt = jb.vibration.weighted_response(ride, {"acceleration": "Wk"})
    W = np.abs(np.asarray(jb.vibration.frequency_weighting("Wk", BAND.frequencies)))
    np.testing.assert_allclose(felt.psd[0], ride.psd[0] * W**2, rtol=1e-12)
    np.testing.assert_allclose(
        felt["acceleration"] ** 2, jnp.sum(felt.psd[0] * BAND.weights), rtol=1e-12
    )
    for code, weights in (
        ("BAD_UNIT", {"stroke": "Wk"}),
        ("UNKNOWN_NAME", {"seat": "Wk"}),
        ("BAD_WEIGHTING", {"acceleration": "Wx"}),
    ):
        with pytest.raises(jb.JaxbodyError) as refused:
            jb.vibration.weighted_response(ride, weights)
        assert refused.value.code == code


@pytest.mark.long
def test_results_print_and_export(lin, ride):
    response = jb.frequency_response(lin, [1.0, 2.0], ROAD, OUTPUTS)
    for result, words in (
        (ride, ("stroke", "rms", "m/s2")),
        (response, ("stroke", "road", "m/s2 per m")),
    ):
        assert all(word in str(result) for word in words)
    data = ride.to_xarray()
    np.testing.assert_array_equal(data["rms"].sel(output="tyre"), ride["tyre"])
    np.testing.assert_array_equal(
        response.to_xarray()["response"].sel(output="tyre", input="road"), response["tyre", "road"]
    )
    assert "stroke" in str(
        lin.state_space({"road": jb.BaseMotion("road", "z", kind="acceleration")}, OUTPUTS)
    )


@pytest.mark.long
def test_pictures_show_their_data(lin, ride, monkeypatch):
    monkeypatch.setenv("MPLBACKEND", "Agg")
    import matplotlib.pyplot as plt

    from jaxbody import plots

    outputs = {
        "body": jb.Position("body", axis="z"),
        "wheel": jb.Position("wheel", axis="z"),
        "stroke": OUTPUTS["stroke"],
    }
    response = jb.frequency_response(lin, np.geomspace(0.1, 50, 200), ROAD, outputs)
    _, axes = plt.subplots(3, 1)
    ax = plots.plot_frequency_response(response, ax=axes[0])
    assert ax is axes[0] and [line.get_label() for line in ax.lines] == ["body", "wheel", "stroke"]
    np.testing.assert_allclose(
        ax.lines[1].get_ydata(), np.abs(response["wheel", "road"]), rtol=1e-14
    )
    phases = ax.figure.axes[-1].lines
    assert abs(phases[0].get_ydata()[0]) < 5 and phases[0].get_ydata()[-1] < -150
    assert plots.plot_transmissibility(response, ax=axes[1]).get_ylabel() == "transmissibility [-]"
    ax = plots.plot_psd(ride, outputs=("stroke", "tyre"), ax=axes[2])
    assert f"{float(ride['stroke']):.3g} m" in ax.lines[0].get_label()
    np.testing.assert_array_equal(ax.lines[1].get_ydata(), ride.psd[2])
    with pytest.raises(jb.JaxbodyError, match="UNKNOWN_NAME"):
        plots.plot_psd(ride, outputs=("seat",))
    forces = jb.frequency_response(lin, [1.0, 2.0], ROAD, {"tyre": jb.sensors.LoadCell("tyre")})
    with pytest.raises(jb.JaxbodyError, match="BAD_UNIT"):
        plots.plot_transmissibility(forces)
    plt.close("all")


@pytest.mark.long
def test_variances_by_simulation(lin):
    """The model driven on twelve random walks, white noise velocity: mean variances within three
    standard errors of the closed form; and on a path of a class C road, whose density is exact:
    within half a percent of the sum over the waves that it has (steps of 5 cm take from waves of
    20 cm)."""
    road, eq = jb.vibration.RoadRoughness.iso("C"), jb.equilibrium(CAR)
    length, spacing, n = 400.0, 0.05, 8000
    times = jnp.linspace(0.0, 2 * length / SPEED, 2 * n + 1)

    def variances(s, z):
        wheel = jb.inputs.Road(s, z - z[0], speed=SPEED)
        steps = dict(
            stepsize_controller=diffrax.ConstantStepSize(), dt0=spacing / SPEED, max_steps=20_000
        )
        run = jb.simulate(CAR, times, motion={"road": wheel}, initial=eq.state, **steps)
        signals = jnp.stack(
            [run.forces["suspension"] / MS, run.elongations["suspension"], run.elongations["tyre"]]
        )
        assert run.ok
        return jnp.var(signals[:, n:-1], axis=1)

    walks = np.random.default_rng(1).normal(size=(12, 2 * n)) * np.sqrt(
        white(road) * spacing / SPEED
    )
    s = spacing * np.arange(2 * n + 1)
    values = np.array([variances(s, np.append(0.0, np.cumsum(walk))) for walk in walks])
    error = values.std(0, ddof=1) / np.sqrt(len(values))
    exact = exact_variances(white(road))
    print("random walks: error, standard error", values.mean(0) / exact - 1, error / exact)
    assert (np.abs(values.mean(0) - exact) < 3 * error).all()

    s, z = (
        np.asarray(x)
        for x in jb.vibration.road_profile(
            road, length=length, spacing=spacing, key=jax.random.key(1)
        )
    )
    # twice, the first time to settle
    computed = variances(np.concatenate([s, s[1:] + length]), np.concatenate([z, z[1:]]))
    f = SPEED / length * np.arange(1, n // 2)
    psd = jb.random_response(lin, f, ROAD, OUTPUTS, {"road": road.at_speed(SPEED)}).psd
    expected = jnp.sum(psd, 1) * SPEED / length
    print("path of a road:", computed / expected - 1)
    assert np.abs(computed[:2] / expected[:2] - 1).max() < 5e-3
