"""Floor spectra against a chain of both oscillators, design spectra by their tables, records that
meet a spectrum."""

import jax
import numpy as np
import pytest
from accelerograms import noise_record
from scipy.signal import lsim

import jaxbody as jb

M, K, C = 2.0, 1200.0, 5.0


@pytest.fixture(scope="module")
def lin():
    model = jb.Model(
        bodies={"floor": jb.Body(M, [1, 1, 1], position=[1, 0, 0])},
        supports={"base": jb.Support()},
        joints={"floor": jb.Guide("world", axis="x")},
        elements={
            "spring": jb.Spring(
                ("floor", [0, 0, 0]), ("base", [0, 0, 0]), stiffness=K, free_length=1.0, damping=C
            )
        },
    )
    return jb.linearize(model, model.reference)


FLOOR = jb.Acceleration("floor", axis="x")


@pytest.mark.long
def test_a_floor_spectrum_of_a_record_is_that_of_the_chain(lin, rng):
    """An oscillator of no weight on the floor: SciPy's linear simulation of both."""
    times, a = noise_record(rng, duration=6.0, rate=100.0)
    frequencies, zeta = np.array([1.0, 3.9, 9.0]), 0.03
    spectrum = jb.shock.floor_spectrum(
        lin, frequencies, {"base": {"x": (times, a)}}, FLOOR, damping=zeta
    )
    fine = np.linspace(0, times[-1], 20 * (len(times) - 1) + 1)
    for f, value in zip(frequencies, spectrum.values[0], strict=True):
        w = 2 * np.pi * f
        floor = [-K / M, -C / M]  # x'' + a of the floor, x its displacement from the base
        A = np.array(
            [
                [0, 1, 0, 0],
                [*floor, 0, 0],
                [0, 0, 0, 1],
                [-floor[0], -floor[1], -(w**2), -2 * zeta * w],
            ]
        )
        y = lsim(
            (
                A,
                np.array([[0], [-1.0], [0], [0]]),
                np.array([[0, 0, -(w**2), -2 * zeta * w]]),
                np.zeros((1, 1)),
            ),
            np.interp(fine, times, a),
            fine,
        )[1]
        np.testing.assert_allclose(value, np.abs(y).max(), rtol=0.01)


@pytest.mark.long
def test_a_floor_spectrum_from_a_spectrum_is_near_the_mean_of_records(lin):
    """Ten records of one spectrum: soft and stiff equipment within 15 %, near resonance
    within 35 %."""
    code, frequencies = jb.shock.Eurocode8(2.0, "B"), np.array([0.8, 2.0, 3.9, 8.0, 15.0])
    direct = np.asarray(
        jb.shock.floor_spectrum(
            lin, frequencies, {"base": {"x": code}}, FLOOR, modal_damping=0.05
        ).values[0]
    )
    found = []
    for i in range(10):
        quake = jb.shock.spectrum_compatible_record(
            code, duration=16.0, key=jax.random.key(i), frequencies=np.geomspace(0.4, 20.0, 40)
        )
        found.append(
            jb.shock.floor_spectrum(
                lin, frequencies, {"base": {"x": quake.samples}}, FLOOR, modal_damping=0.05
            ).values[0]
        )
    ratio = direct / np.mean(found, 0)
    assert np.all(np.abs(ratio - 1) < [0.15, 0.25, 0.35, 0.25, 0.15]), ratio


def test_a_floor_spectrum_from_a_spectrum_is_the_published_formula(lin):
    """sqrt(r^4 + 1) A/sqrt((1 - r^2)^2 + 4 (zeta + zeta_1)^2 r^2), r = f/f_1, for a level ground
    spectrum A and one mode that moves with all of its mass: below, at and above resonance."""
    level, own, zeta, ratio = 3.0, 0.05, np.array([0.02, 0.1]), np.array([0.4, 1.0, 1.7])
    ground = {"base": {"x": jb.shock.DesignSpectrum([1e-3, 1e4], [level, level])}}
    frequencies = ratio * np.sqrt(K / M) / (2 * np.pi)
    found = jb.shock.floor_spectrum(
        lin, frequencies, ground, FLOOR, damping=zeta, modal_damping=own
    ).values
    below = np.sqrt((1 - ratio**2) ** 2 + 4 * (zeta[:, None] + own) ** 2 * ratio**2)
    np.testing.assert_allclose(found, level * np.sqrt(ratio**4 + 1) / below, rtol=1e-9)


def test_a_floor_spectrum_of_soft_and_of_rigid_equipment(lin):
    level = jb.shock.DesignSpectrum([1e-3, 1e4], [3.0, 3.0])
    soft, rigid = jb.shock.floor_spectrum(
        lin, [0.01, 1e3], {"base": {"x": level}}, FLOOR, modal_damping=0.05
    ).values[0]
    np.testing.assert_allclose([soft, rigid], 3.0, rtol=1e-4)
    for output, spectra, code in (
        (jb.Position("floor", axis="x"), {"x": level}, "BAD_UNIT"),
        (FLOOR, {"x": level, "y": (np.arange(9.0), np.ones(9))}, "BAD_OPTION"),
    ):
        with pytest.raises(jb.JaxbodyError, match=code):
            jb.shock.floor_spectrum(lin, [1.0], {"base": spectra}, output)


def test_eurocode_8_by_its_formulas():
    """EN 1998-1:2004, (3.2) to (3.5) and (3.8) to (3.11)."""
    spectrum = jb.shock.Eurocode8(1.5, "C")  # S 1.15, T_B 0.2, T_C 0.6, T_D 2.0
    periods = np.array([0.1, 0.4, 1.2, 3.0])
    exact = 1.5 * 1.15 * np.array([1 + 0.5 * 1.5, 2.5, 2.5 / 2, 2.5 * 0.6 * 2 / 9])
    np.testing.assert_allclose(spectrum(1 / periods), exact, rtol=1e-12)
    eta = np.sqrt(10 / 15)
    np.testing.assert_allclose(spectrum(1 / 0.4, 0.1), 1.5 * 1.15 * 2.5 * eta, rtol=1e-12)
    np.testing.assert_allclose(spectrum(1 / 0.4, 0.9), 1.5 * 1.15 * 2.5 * 0.55, rtol=1e-12)
    up = jb.shock.Eurocode8(
        1.5, "C", type=2, vertical=True
    )  # a_vg 0.45 a_g, T_B 0.05, T_C 0.15, T_D 1.0
    np.testing.assert_allclose(
        up(1 / np.array([0.1, 0.5])), 1.5 * 0.45 * 3.0 * np.array([1, 0.15 / 0.5]), rtol=1e-12
    )
    assert "T_C [s]      0.6" in str(spectrum)
    with pytest.raises(jb.JaxbodyError) as raised:
        jb.shock.Eurocode8(-1.0, "F", type=3)
    assert [p.code for p in raised.value.problems] == ["BAD_NUMBER", "BAD_OPTION", "BAD_OPTION"]


def test_asce_7_by_its_formulas():
    """ASCE 7-16, (11.4-5) to (11.4-7); B 1.2 at 10 %."""
    # T_0 0.1, T_S 0.5
    spectrum, periods = jb.shock.ASCE7(1.2, 0.6, long_period=6.0), np.array([0.05, 0.3, 2.0, 12.0])
    exact = 9.80665 * np.array([1.2 * 0.7, 1.2, 0.3, 0.6 * 6 / 144])
    np.testing.assert_allclose(spectrum(1 / periods), exact, rtol=1e-12)
    np.testing.assert_allclose(spectrum(1 / periods[1:], 0.1), exact[1:] / 1.2, rtol=1e-12)


def test_points_are_joined_in_logarithms():
    spectrum = jb.shock.DesignSpectrum([1.0, 10.0], [1.0, 100.0])
    np.testing.assert_allclose(
        spectrum([0.1, 1.0, 3.0, 10.0, 50.0]), [1.0, 1.0, 9.0, 100.0, 100.0], rtol=1e-12
    )
    with pytest.raises(jb.JaxbodyError) as raised:
        jb.shock.DesignSpectrum([2.0, 1.0], [1.0, -1.0], damping=5.0)
    assert [p.code for p in raised.value.problems] == [
        "NOT_A_FRACTION",
        "BAD_FREQUENCY",
        "NOT_POSITIVE",
    ]


@pytest.fixture(scope="module")
def quake():
    return jb.shock.spectrum_compatible_record(
        jb.shock.Eurocode8(2.0, "B"),
        duration=10.0,
        key=jax.random.key(3),
        frequencies=np.geomspace(0.5, 10.0, 24),
    )


@pytest.mark.long
def test_a_matched_record_has_its_spectrum_and_ends_at_rest(quake):
    """Its spectrum by `shock_spectrum` alone; its end by integration of straight lines."""
    again = jb.shock.shock_spectrum(
        quake.samples, quake.frequencies, kind="pseudo", peaks="continuous"
    ).values[0]
    np.testing.assert_allclose(again, jb.shock.Eurocode8(2.0, "B")(quake.frequencies), rtol=0.05)
    np.testing.assert_allclose(again, quake.reached, rtol=2e-3)
    h, a = float(quake.times[1]), np.asarray(quake.acceleration)
    v = np.concatenate([[0], np.cumsum((a[1:] + a[:-1]) * h / 2)])
    x = np.concatenate([[0], np.cumsum(h * v[:-1] + h * h * (2 * a[:-1] + a[1:]) / 6)])
    assert abs(v[-1]) < 1e-12 * np.abs(v).max() * len(v) and abs(x[-1]) < 1e-12 * np.abs(
        x
    ).max() * len(x)
    np.testing.assert_allclose(quake.displacement, x, atol=1e-12)
    assert quake.ok and quake.deviation <= 0.05 and "largest deviation" in str(quake)
    moved = jax.vmap(quake.motion([0, 0, 2.0]))(quake.times)
    np.testing.assert_allclose(moved[:, 2], x, atol=1e-10)


def test_a_record_that_cannot_be_matched_is_refused_with_what_is_wrong():
    with pytest.raises(jb.JaxbodyError) as raised:
        jb.shock.spectrum_compatible_record(3.0, duration=-1.0, key=None, damping=2.0)
    assert {p.code for p in raised.value.problems} == {
        "WRONG_KIND",
        "BAD_NUMBER",
        "NO_KEY",
        "NOT_A_FRACTION",
    }
    key, code = jax.random.key(0), jb.shock.Eurocode8(2.0)
    for options, expected in (
        ({"frequencies": [0.1, 1.0]}, "NOT_COVERED"),
        ({"frequencies": [0.3, 1.0], "duration": 2.0}, "TOO_SHORT"),
        ({"frequencies": [1.0, 20.0], "rate": 50.0}, "LOW_RATE"),
    ):
        with pytest.raises(jb.JaxbodyError, match=expected):
            jb.shock.spectrum_compatible_record(code, **({"duration": 20.0, "key": key} | options))
