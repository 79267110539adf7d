"""Fatigue: Dirlik against rainflow on an hour of a Gaussian signal, narrow bands and constant
cycles in closed form, bad input."""

from math import gamma

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import quad
from test_peak_factors import driven, shaken, signal_of

import jaxbody as jb
from jaxbody.shock.fatigue_damages import dirlik

K, N0, S0 = 5.0, 1e6, 0.02  # of ranges of displacement [m]


def curve(**more):
    return jb.shock.SNCurve(
        **({"exponent": K, "cycles": N0, "level": 1e3 * S0, "unit": "mm"} | more)
    )


@pytest.fixture(scope="module")
def response():
    return shaken(driven())


def test_dirlik_and_rainflow_agree_on_an_hour(rng):
    """Within 10 %, of a wide band: an oscillator of 30 % damping."""
    pytest.importorskip("rainflow")
    wide = shaken(driven(zeta=0.3))
    rate, hour = 64.0, 3600.0
    x = signal_of(wide, rng, int(hour * rate), rate)
    fine = np.fft.irfft(np.concatenate([np.fft.rfft(x), np.zeros(len(x) // 2)]) * 2, 2 * len(x))
    counted = jb.shock.fatigue_damage(
        jb.Record(np.arange(len(fine)) / (2 * rate), {"x": (fine, "m")}), {"x": curve()}
    )
    expected = jb.shock.fatigue_damage(wide, {"x": curve()}, duration=hour)
    np.testing.assert_allclose(counted["x"], expected["x"], rtol=0.1)
    np.testing.assert_allclose(counted.cycles, expected.cycles, rtol=0.03)
    narrow = jb.shock.fatigue_damage(wide, {"x": curve()}, duration=hour, method="narrow band")
    assert narrow["x"] > expected["x"] and counted.method == "rainflow"


def test_a_narrow_band_in_closed_form():
    """Within 1 %: an oscillator of 0.1 % damping, whose ranges are those of Rayleigh; Dirlik has
    the same limit."""
    f = np.concatenate(
        [
            np.linspace(0.5, 2.9, 200)[:-1],
            np.linspace(2.9, 3.1, 4001),
            np.linspace(3.1, 12.0, 300)[1:],
        ]
    )
    narrow = shaken(driven(zeta=1e-3), f)
    sigma = float(narrow["x"])
    exact = 3600 * 3.0 * (2 * np.sqrt(2) * sigma / S0) ** K * gamma(1 + K / 2) / N0
    for method in ("narrow band", "Dirlik"):
        damage = jb.shock.fatigue_damage(narrow, {"x": curve()}, duration=3600.0, method=method)
        np.testing.assert_allclose(
            damage["x"], exact, rtol=0.01 if method == "narrow band" else 0.03
        )
        np.testing.assert_allclose(damage.life[0], 3600 / damage["x"], rtol=1e-12)


@pytest.mark.parametrize("high", [1.6, 3.0, 8.0])
def test_dirlik_is_the_integral_of_the_published_density(high):
    """Over normalized ranges, by SciPy, for a flat spectrum from 1 to `high` hertz; the mean range
    of a Gaussian signal is known."""
    m0, m1, m2, m4 = ((high ** (j + 1) - 1) / (j + 1) for j in (0, 1, 2, 4))
    regularity, x = m2 / np.sqrt(m0 * m4), m1 / m0 * np.sqrt(m2 / m4)
    D1 = 2 * (x - regularity**2) / (1 + regularity**2)
    R = (regularity - x - D1**2) / (1 - regularity - D1 + D1**2)
    D2 = (1 - regularity - D1 + D1**2) / (1 - R)
    D3 = 1 - D1 - D2
    Q = 1.25 * (regularity - D3 - D2 * R) / D1

    def density(z):
        return (
            D1 / Q * np.exp(-z / Q)
            + D2 * z / R**2 * np.exp(-(z**2) / (2 * R**2))
            + D3 * z * np.exp(-(z**2) / 2)
        )

    for k in (1.0, 3.0, 5.0):
        expected = quad(lambda z, k=k: z**k * density(z), 0, np.inf, epsabs=0, epsrel=1e-10)[0]
        np.testing.assert_allclose(dirlik(m0, m1, m2, m4, jnp.asarray(k)), expected, rtol=1e-8)
    np.testing.assert_allclose(
        dirlik(m0, m1, m2, m4, jnp.asarray(1.0)), np.sqrt(np.pi / 2) * regularity, rtol=3e-3
    )  # 1.25 for 1.2533


def test_constant_cycles_are_counted_one_by_one():
    """100 cycles of 40 mm from valley to peak: 100 over N(40 mm), whether the curve states ranges
    or amplitudes, for any repetition."""
    pytest.importorskip("rainflow")
    t = np.arange(100 * 64 + 1) / 64
    record = jb.Record(t, {"x": (20.0 * np.cos(2 * np.pi * t), "mm")})
    once = jb.shock.fatigue_damage(record, {"x": curve()})
    np.testing.assert_allclose(once["x"], 100 * (0.04 / S0) ** K / N0, rtol=1e-9)
    np.testing.assert_allclose([once.range[0], once.cycles[0]], [0.04, 100], rtol=1e-9)
    half = jb.shock.fatigue_damage(
        record, {"x": curve(level=0.5e3 * S0, of="amplitude")}, duration=1000.0
    )
    np.testing.assert_allclose(half["x"], 10 * once["x"], rtol=1e-9)
    direct = jb.shock.fatigue_damage(
        {"x": (20.0 * np.cos(2 * np.pi * t), "mm")}, {"x": curve()}, duration=100.0
    )
    np.testing.assert_allclose(direct["x"], once["x"], rtol=1e-12)
    assert "equivalent range" in str(once)


def test_counting_has_no_derivative_and_says_so():
    def damage(x):
        return jb.shock.fatigue_damage({"x": (x, "m")}, {"x": curve()}, duration=10.0).damage[0]

    with pytest.raises(jb.JaxbodyError, match=r"rainflow cycles has no derivative.*Dirlik.*TRACED"):
        jax.grad(damage)(jnp.zeros(50))


def test_derivatives_of_dirlik_agree_with_differences(response):
    def damage(k, level):
        return jb.shock.fatigue_damage(
            response, {"x": curve(exponent=k, level=level)}, duration=3600.0
        ).damage[0]

    by_k, by_level = jax.grad(damage, (0, 1))(K, 20.0)
    h = 1e-4
    np.testing.assert_allclose(
        by_k, (damage(K + h, 20.0) - damage(K - h, 20.0)) / (2 * h), rtol=1e-6
    )
    np.testing.assert_allclose(by_level, -K / 20.0 * damage(K, 20.0), rtol=1e-9)


def test_bad_input_is_refused_with_what_is_wrong(response):
    with pytest.raises(jb.JaxbodyError) as raised:
        jb.shock.SNCurve(-1.0, cycles=1e6, level=1.0, of="peak")
    assert [p.code for p in raised.value.problems] == ["BAD_NUMBER", "BAD_OPTION", "NO_UNIT"]
    with pytest.raises(jb.JaxbodyError, match="UNKNOWN_UNIT"):
        curve(unit="Mpa")
    with pytest.raises(jb.JaxbodyError) as raised:
        jb.shock.fatigue_damage(
            response, {"x": curve(unit="MPa"), "y": curve(), "force": 3.0}, method="rainflow"
        )
    assert [p.code for p in raised.value.problems] == [
        "BAD_OPTION",
        "BAD_NUMBER",
        "BAD_UNIT",
        "UNKNOWN_NAME",
        "WRONG_KIND",
    ]
    with pytest.raises(jb.JaxbodyError, match="WRONG_KIND"):
        jb.shock.fatigue_damage(np.zeros(5), {"x": curve()})
