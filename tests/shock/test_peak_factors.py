"""Peak factors and crossings: oscillators under white noise by exact moments, Gaussian signals by
simulation, derivatives, bad input."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxbody as jb
from jaxbody.shock.peak_factors import crossing_rate, factors, quantile, width

RATE, SAMPLES = 64.0, 2**18  # Hz, of an hour and more


def oscillator(f, zeta):
    """The rate and width of the displacement of an oscillator under white noise, from its
    exact moments."""
    w, q = 2 * np.pi * f, np.sqrt(1 - zeta**2)
    l0, l1, l2 = (np.pi / (4 * zeta * w**k) for k in (3, 2, 1))
    moments = jnp.array([l0, l1 * (1 - 2 / np.pi * np.arctan(zeta / q)) / q, l2])
    return crossing_rate(moments[0], moments[2]), width(*moments)


@pytest.mark.parametrize(
    "f, T, davenport, kiureghian, vanmarcke",
    [
        (1.0, 30.0, 3.063300, (2.819873, 0.450292), (2.744871, 2.785936)),
        (5.0, 20.0, 3.432566, (3.216620, 0.392111), (3.171771, 3.213943)),
    ],
)
def test_an_oscillator_under_white_noise(f, T, davenport, kiureghian, vanmarcke):
    rate, delta = oscillator(f, 0.05)
    np.testing.assert_allclose(delta, 0.24561207, rtol=1e-7)
    np.testing.assert_allclose(factors(rate, delta, T, "Davenport")[0], davenport, rtol=1e-5)
    np.testing.assert_allclose(factors(rate, delta, T, "Der Kiureghian"), kiureghian, rtol=1e-5)
    np.testing.assert_allclose(quantile(rate, delta, T, "Vanmarcke", 0.5), vanmarcke[0], rtol=1e-5)
    np.testing.assert_allclose(factors(rate, delta, T, "Vanmarcke")[0], vanmarcke[1], rtol=1e-5)


def driven(zeta=0.05):
    """A mass on a spring, driven by noise from 0.5 to 12 Hz; its natural frequency is 3 Hz."""
    k = 2.0 * (2 * np.pi * 3.0) ** 2
    model = jb.Model(
        bodies={"mass": jb.Body(2.0, [1, 1, 1], position=[1, 0, 0])},
        joints={"mass": jb.Guide("world", axis="x")},
        elements={
            "s": jb.Spring(
                ("mass", [0, 0, 0]),
                ("world", [0, 0, 0]),
                stiffness=k,
                free_length=1.0,
                damping=2 * zeta * np.sqrt(2 * k),
            )
        },
    )
    return jb.linearize(model, model.reference)


def shaken(lin, frequencies=None):
    band = jb.vibration.Band(0.5, 12.0, points=1601) if frequencies is None else frequencies
    noise = jb.vibration.PowerLaw(1.0, unit="N2/Hz")
    ports = (
        {"pull": jb.PointForce("mass", direction="x")},
        {"x": jb.Position("mass", axis="x"), "force": jb.sensors.LoadCell("s")},
    )
    return jb.random_response(lin, band, *ports, {"pull": noise})


@pytest.fixture(scope="module")
def response():
    return shaken(driven())


def signal_of(response, rng, samples=SAMPLES, rate=RATE):
    """A Gaussian signal with the density of the displacement: random Fourier coefficients on a grid
    of frequencies."""
    f = np.fft.rfftfreq(samples, 1 / rate)
    S = np.interp(f, np.asarray(response.frequencies), np.asarray(response.psd)[0], left=0, right=0)
    size = np.sqrt(S * rate * samples / 2)
    return np.fft.irfft(
        size * (rng.normal(size=len(f)) + 1j * rng.normal(size=len(f))) / np.sqrt(2), samples
    )


def test_crossings_agree_with_a_simulation(response, rng):
    """Upward crossings of four levels in 4096 s, in ten signals: the mean within three of its
    standard errors."""
    sigma = float(response["x"])
    levels = sigma * np.array([0.0, 1.0, 2.0, 3.0])
    counts = []
    for _ in range(10):
        x = signal_of(response, rng)
        np.testing.assert_allclose(x.std(), sigma, rtol=0.1)
        fine = np.fft.irfft(
            np.concatenate([np.fft.rfft(x), np.zeros(3 * SAMPLES // 2)]) * 4, 4 * SAMPLES
        )  # so that none is missed
        counts.append(
            [np.sum((fine[:-1] < b) & (fine[1:] >= b)) / (SAMPLES / RATE) for b in levels]
        )
    rates = np.asarray(jb.shock.level_crossings(response, "x", levels))
    error = np.std(counts, 0, ddof=1) / np.sqrt(10)
    assert np.all(np.abs(np.mean(counts, 0) - rates) < 3 * error), (
        np.mean(counts, 0),
        rates,
        error,
    )


@pytest.mark.nan
def test_peaks_agree_with_a_simulation(response, rng):
    """The mean of the largest magnitudes in 30 s, of 1360 pieces: Der Kiureghian and Vanmarcke
    within 3 %, Davenport above both."""
    T, sigma = 30.0, float(response["x"])
    pieces = np.concatenate([signal_of(response, rng) for _ in range(10)])
    count = int(T * RATE)
    peaks = np.abs(pieces[: len(pieces) // count * count].reshape(-1, count)).max(1) / sigma
    found = {
        formula: jb.shock.peak_factor(response, T, formula=formula)
        for formula in ("Davenport", "Der Kiureghian", "Vanmarcke")
    }
    assert abs(float(found["Der Kiureghian"].factor[0]) / peaks.mean() - 1) < 0.03
    assert abs(float(found["Vanmarcke"].factor[0]) / peaks.mean() - 1) < 0.03
    assert found["Davenport"].factor[0] > found["Der Kiureghian"].factor[0]
    np.testing.assert_allclose(
        found["Vanmarcke"]["x"], sigma * found["Vanmarcke"].factor[0], rtol=1e-9
    )
    high = jb.shock.peak_factor(response, T, formula="Vanmarcke", probability=0.9).factor[0]
    assert abs(np.mean(peaks < float(high)) - 0.9) < 3 * np.sqrt(0.09 / len(peaks)) + 0.02


@pytest.mark.nan
def test_derivatives_agree_with_differences(response):
    for formula, p in (
        ("Davenport", None),
        ("Der Kiureghian", None),
        ("Vanmarcke", None),
        ("Vanmarcke", 0.9),
    ):

        def peak(T, formula=formula, p=p):
            return jb.shock.peak_factor(response, T, formula=formula, probability=p).maximum[0]

        h = 1e-3
        np.testing.assert_allclose(
            jax.grad(peak)(30.0), (peak(30.0 + h) - peak(30.0 - h)) / (2 * h), rtol=1e-6
        )


@pytest.mark.nan
def test_bad_input_is_refused(response):
    with pytest.raises(jb.JaxbodyError) as raised:
        jb.shock.peak_factor(response, -1.0, formula="Rice", probability=2.0)
    assert [p.code for p in raised.value.problems] == ["BAD_NUMBER", "BAD_OPTION", "NOT_A_FRACTION"]
    with pytest.raises(jb.JaxbodyError, match="no distribution"):
        jb.shock.peak_factor(response, 10.0, probability=0.5)
    with pytest.raises(jb.JaxbodyError, match="WRONG_KIND"):
        jb.shock.peak_factor(3.0, 10.0)
    with pytest.raises(jb.JaxbodyError, match="UNKNOWN_NAME"):
        jb.shock.level_crossings(response, "y", 0.0)
    with pytest.warns(jb.JaxbodyWarning, match="NONFINITE"):
        jb.shock.peak_factor(response, 0.1)
