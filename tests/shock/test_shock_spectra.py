"""Shock spectra: El Centro and pulses as published and in closed form, peaks between samples,
derivatives, bad input."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from accelerograms import G, el_centro, el_centro_in_g, noise_record
from scipy.integrate import solve_ivp

import jaxbody as jb
from jaxbody.shock.oscillators import history, poles

PERIODS = np.array([0.1, 0.2, 0.5, 1.0, 2.0])


@pytest.fixture(scope="module")
def record():
    return el_centro()


def test_el_centro_at_its_samples(record):
    """The table of references was computed with g = 9.81 m/s2 for displacements."""
    relative = jb.shock.shock_spectrum(
        (record.times, 9.81 * el_centro_in_g()), 1 / PERIODS, kind="relative"
    )
    absolute = jb.shock.shock_spectrum(record, 1 / PERIODS)
    np.testing.assert_allclose(
        relative.values[0], [0.00150965, 0.00787759, 0.05690374, 0.11283152, 0.13646048], rtol=3e-6
    )
    np.testing.assert_allclose(
        absolute.values[0] / G, [0.626258, 0.798267, 0.920509, 0.457986, 0.138086], rtol=4e-6
    )


@pytest.mark.long
def test_el_centro_between_its_samples(record):
    """The references come from sixteen steps a sample; published: 5.37, 7.47, 5.97 and 2.67 in."""
    made = {
        kind: jb.shock.shock_spectrum(
            record, 1 / PERIODS, damping=[0.02, 0.05], kind=kind, peaks="continuous"
        )
        for kind in ("pseudo", "absolute")
    }
    tolerance = [2e-3, 2e-3, 2e-4, 2e-4, 2e-4]
    for kind, values in (
        ("pseudo", [0.648495, 0.820270, 0.918704, 0.455013, 0.137343]),
        ("absolute", [0.650965, 0.824029, 0.923993, 0.458193, 0.138101]),
    ):
        assert np.all(np.abs(made[kind].values[1] / G / np.array(values) - 1) < tolerance)
    np.testing.assert_allclose(
        made["pseudo"].values[0, 2:] / G, [1.099029, 0.610156, 0.190861], rtol=2e-4
    )
    inches = np.asarray(made["pseudo"].values) / (2 * np.pi / PERIODS) ** 2 / 0.0254
    np.testing.assert_allclose(
        [inches[1, 4], inches[0, 4], inches[0, 3], inches[0, 2]],
        [5.37, 7.47, 5.97, 2.687],
        rtol=2e-3,
    )


@pytest.mark.long
def test_a_continuous_peak_is_that_of_a_record_sampled_far_more_often(rng):
    """Straight lines stay straight lines: 200 samples in the place of one change nothing but where
    the response is looked at."""
    times, a = noise_record(rng, duration=4.0, rate=50.0)
    a = a + 0.3  # also where a record does not start at zero
    fine = np.linspace(0, times[-1], 200 * (len(times) - 1) + 1)
    frequencies, damping = np.geomspace(12.0, 25.0, 12), [0.0, 0.05, 0.4]
    for kind, side in (("absolute", "maximax"), ("relative", "negative")):
        options = {"damping": damping, "kind": kind, "side": side}
        coarse = jb.shock.shock_spectrum((times, a), frequencies, **options, peaks="continuous")
        dense = jb.shock.shock_spectrum((fine, np.interp(fine, times, a)), frequencies, **options)
        assert np.all(coarse.values > dense.values * (1 - 1e-12))
        # 1 - cos of half a step
        np.testing.assert_allclose(coarse.values, dense.values, rtol=(np.pi * 25 / 50 / 200) ** 2)


def test_the_recurrence_solves_the_equation_of_an_oscillator(rng):
    times, a = noise_record(rng, duration=1.0, rate=100.0)
    a = a + 0.3
    f, zeta = 3.0, 0.07
    w = 2 * np.pi * f
    s = poles(jnp.array([f]), jnp.array([zeta]))
    x, v, absolute = np.asarray(
        history(jnp.asarray(a), 0.01, s, jnp.stack([1 / s.imag, s / s.imag, s**2 / s.imag]))
    ).T
    solved = solve_ivp(
        lambda t, y: [y[1], -2 * zeta * w * y[1] - w**2 * y[0] - np.interp(t, times, a)],
        (0, 1),
        [0, 0],
        "DOP853",
        times,
        rtol=1e-11,
        atol=1e-13,
        max_step=0.01,
    ).y
    np.testing.assert_allclose(x, solved[0], atol=1e-9 * np.abs(x).max())
    np.testing.assert_allclose(v, solved[1], atol=1e-9 * np.abs(v).max())
    np.testing.assert_allclose(
        absolute, -2 * zeta * w * solved[1] - w**2 * solved[0], atol=1e-9 * np.abs(absolute).max()
    )


def half_sine(ft):
    """Largest response to a half sine of length T, during and after it, over its amplitude; natural
    frequency times T."""
    b = 1 / (2 * ft)
    if b == 1:
        return np.pi / 2, np.pi / 2
    at = np.array([2 * n * b / (1 + b) for n in range(1, 20) if 2 * n * b / (1 + b) <= 1] + [1.0])
    during = (np.sin(np.pi * at) - b * np.sin(2 * np.pi * ft * at)) / (1 - b**2)
    return during.max(), abs(2 * b * np.cos(np.pi / (2 * b)) / (1 - b**2))


T = 0.02
FT = np.array([0.1, 0.25, 0.5, 1.25, 3.0, 10.25, 40.25])  # frequencies times the length of a pulse
PULSES = {  # and the largest error of 2000 straight lines
    "half sine": (jb.inputs.HalfSine(3.0, T), (np.pi / 2000) ** 2 / 8),
    "sawtooth": (jb.inputs.Sawtooth(3.0, T), 1e-11),
    "triangle": (jb.inputs.Triangle(3.0, T), 1e-11),
    "trapezoid": (jb.inputs.Trapezoid(3.0, T, rise=0.0011 * T, fall=0.31 * T), 1e-11),
    "triangle of a trapezoid": (jb.inputs.Trapezoid(3.0, T, rise=0.5 * T, fall=0.5 * T), 3e-9),
}


@pytest.mark.parametrize(
    "name",
    [name if name == "sawtooth" else pytest.param(name, marks=pytest.mark.long) for name in PULSES],
)
def test_residual_spectra_of_pulses_are_their_fourier_transforms(name):
    """After the pulse an undamped oscillator swings with w |int a e^(-i w t) dt| about zero, to
    both sides; far above 1/T the error is that of the lines relative to the pulse."""
    pulse, error = PULSES[name]
    x, weights = np.polynomial.legendre.leggauss(300)
    exact = np.zeros(len(FT), complex)
    for low, high in itertools.pairwise(float(u) for u in pulse.corners()):
        u = low + (high - low) * (x + 1) / 2
        turns = np.exp(-2j * np.pi * FT[:, None] * u[None])
        exact += (
            3.0
            * 2
            * np.pi
            * FT
            * (turns @ (weights * np.asarray(pulse.shape(jnp.asarray(u))[0])))
            * (high - low)
            / 2
        )
    for side in ("maximax", "negative"):
        residual = jb.shock.shock_spectrum(pulse, FT / T, damping=0.0, part="residual", side=side)
        np.testing.assert_allclose(residual.values[0], np.abs(exact), rtol=error, atol=3.0 * error)


@pytest.mark.long
def test_undamped_spectra_of_pulses_in_closed_form():
    """The larger of both parts; while a sawtooth lasts, the response is t/T - sin(w t)/(w T)."""
    few = FT[:5]
    for pulse, exact in (
        ("half sine", [max(half_sine(ft)) for ft in few]),
        ("sawtooth", [saw(ft) for ft in few]),
    ):
        spectrum = jb.shock.shock_spectrum(PULSES[pulse][0], few / T, damping=0.0)
        np.testing.assert_allclose(spectrum.values[0] / 3.0, exact, rtol=1e-6)
    assert "also in the free vibration after it" in str(spectrum)


def saw(ft):
    th = 2 * np.pi * ft
    after = np.sqrt(1 - 2 * np.sin(th) / th + 2 * (1 - np.cos(th)) / th**2)
    return max(after, *(u - np.sin(th * u) / th for u in np.linspace(0, 1, 20001)))


@pytest.mark.long
def test_the_parts_of_a_record_are_those_of_the_record_with_zeros(rng):
    """The free vibration in closed form, against the recurrence through zeros, which the line down
    to the first of them precedes."""
    times, a = noise_record(rng, duration=2.0, rate=100.0)
    a[-1] = 0.0
    longer, step = np.arange(3 * len(a)) * 0.01, 0.01
    f, options = [0.3, 2.0, 11.0], {"damping": [0.0, 0.1], "peaks": "continuous"}
    for side in ("positive", "negative"):
        parts = {
            part: jb.shock.shock_spectrum((times, a), f, side=side, part=part, **options).values
            for part in ("primary", "residual", "both")
        }
        whole = jb.shock.shock_spectrum(
            (longer, np.append(a, np.zeros(2 * len(a)))), f, side=side, **options
        ).values
        np.testing.assert_allclose(parts["both"], whole, rtol=1e-9)
        np.testing.assert_allclose(
            np.maximum(parts["primary"], parts["residual"]), whole, rtol=1e-9
        )
        assert (
            not np.allclose(parts["primary"], parts["residual"], rtol=0.1)
            and step == times[1] - times[0]
        )
    with pytest.raises(jb.JaxbodyError, match=r'add zeros, or give part="both" .*TOO_SHORT'):
        jb.shock.shock_spectrum((times, a), f)
    with pytest.raises(jb.JaxbodyError, match=r"shock_spectrum.part.*BAD_OPTION"):
        jb.shock.shock_spectrum((times, a), [11.0], part="after")


@pytest.mark.long
@pytest.mark.parametrize("f", [40.0, 75.0])
def test_derivatives_by_damping_at_none_are_those_of_the_first_of_equal_peaks(f):
    """Undamped, all peaks of the free vibration are equal; with any damping the first is
    the largest."""
    pulse = jb.inputs.HalfSine(15 * G, 0.011)
    for given in (pulse, pulse.samples(lengths=30)):

        def largest(zeta, given=given):
            return jb.shock.shock_spectrum(given, [f], damping=zeta, peaks="continuous").values[
                0, 0
            ]

        difference = (4 * largest(1e-6) - largest(2e-6) - 3 * largest(0.0)) / 2e-6
        np.testing.assert_allclose(jax.grad(largest)(0.0), difference, rtol=1e-5)


@pytest.mark.long
def test_a_half_sine_of_15_g_and_11_ms():
    """Q = 10; the larger of the maxima in the pulse and after it, and the minimum."""
    frequencies, pulse = [10, 20, 50, 75, 100, 200, 500], jb.inputs.HalfSine(15 * G, 0.011)
    sides = {
        side: jb.shock.shock_spectrum(pulse, frequencies, side=side).values[0] / G
        for side in ("positive", "negative")
    }
    np.testing.assert_allclose(
        sides["positive"], [6.0776, 11.7467, 22.8943, 24.7744, 23.8709, 17.0941, 15.7053], rtol=1e-4
    )
    np.testing.assert_allclose(
        sides["negative"], [5.1931, 10.0372, 19.5656, 19.5196, 13.1006, 4.2628, 1.0485], rtol=1e-4
    )


@pytest.mark.long
@pytest.mark.parametrize("peaks", ["samples", "continuous"])
def test_derivatives_agree_with_differences(rng, peaks):
    times, a = noise_record(rng, duration=2.0, rate=100.0)
    frequencies = [1.0, 4.0, 11.0]
    direction, weights, h = rng.normal(size=len(a)), np.array([1.0, 0.5, 0.2]), 1e-5

    def size(a, zeta):
        return (
            weights
            @ jb.shock.shock_spectrum((times, a), frequencies, damping=zeta, peaks=peaks).values[0]
        )

    by_a, by_zeta = jax.grad(size, (0, 1))(jnp.asarray(a), jnp.array(0.05))
    difference = (size(a + h * direction, 0.05) - size(a - h * direction, 0.05)) / (2 * h)
    np.testing.assert_allclose(by_a @ direction, difference, rtol=1e-6)
    np.testing.assert_allclose(
        by_zeta, (size(a, 0.05 + h) - size(a, 0.05 - h)) / (2 * h), rtol=1e-6
    )


@pytest.mark.long
def test_a_spectrum_is_known_between_its_points(record):
    f, zeta = np.geomspace(0.2, 10.0, 40), [0.02, 0.05, 0.1]
    spectrum = jb.shock.shock_spectrum(record, f, damping=zeta, kind="pseudo")
    np.testing.assert_allclose(spectrum(f, 0.05), spectrum.values[1], rtol=1e-12)
    np.testing.assert_allclose(
        spectrum(np.sqrt(f[3] * f[4]), 0.02) ** 2,
        spectrum.values[0, 3] * spectrum.values[0, 4],
        rtol=1e-12,
    )
    relative = jb.shock.shock_spectrum(record, f, damping=zeta, kind="relative")
    np.testing.assert_allclose(relative(f, 0.1), spectrum.values[2], rtol=1e-12)
    assert [float(x) for x in (*spectrum.covers(), *spectrum.dampings())] == pytest.approx(
        [0.2, 10.0, 0.02, 0.1]
    )
    with pytest.raises(jb.JaxbodyError, match="BAD_KIND"):
        jb.shock.shock_spectrum(record, f)(1.0)


def test_a_table_and_labeled_arrays(record):
    pytest.importorskip("pandas")
    spectrum = jb.shock.shock_spectrum(record, [0.5, 2.0], damping=[0.02, 0.05], kind="relative")
    assert "damping ratio" in str(spectrum) and "0.02" in str(spectrum)
    frame = spectrum.to_pandas()
    np.testing.assert_array_equal(frame["spectrum[0.05]"], spectrum.values[1])
    assert frame.attrs["units"]["spectrum[0.05]"] == "m"


def test_bad_input_is_refused_all_at_once(record):
    with pytest.raises(jb.JaxbodyError) as raised:
        jb.shock.shock_spectrum(
            record,
            [0.01, 1.0, 20.0, 40.0],
            damping=[5.0, 0.05],
            kind="velocity",
            side="both",
            peaks="samples",
        )
    text = str(raised.value)
    assert [p.code for p in raised.value.problems] == [
        "NOT_A_FRACTION",
        "BAD_KIND",
        "BAD_OPTION",
        "LOW_RATE",
        "TOO_SHORT",
    ]
    assert (
        "0.05 for 5 percent" in text
        and "too few for 20, 40 Hz" in text
        and "a period of 0.01 Hz" in text
    )
    with pytest.raises(jb.JaxbodyError, match=r"too few for 40 Hz.*LOW_RATE"):
        jb.shock.shock_spectrum(record, [20.0, 40.0], peaks="continuous")
    times = record.times
    for given, code in (
        (np.zeros(5), "WRONG_KIND"),
        ((times, np.zeros(7)), "BAD_SHAPE"),
        ((np.array([0, 1.0, 3.0]), np.zeros(3)), "NOT_UNIFORM"),
        ((times, np.where(times == 4, np.nan, 0.0)), "GAPS"),
        (jb.Record(times, {"x": (el_centro_in_g(), "mm")}), "WRONG_DIMENSION"),
        (
            jb.Record(times, {"x": (el_centro_in_g(), "m/s2"), "y": (el_centro_in_g(), "m/s2")}),
            "WRONG_DIMENSION",
        ),
    ):
        with pytest.raises(jb.JaxbodyError, match=code):
            jb.shock.shock_spectrum(given, [1.0])
