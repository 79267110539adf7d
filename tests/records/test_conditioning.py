"""Records at another rate, filtered, differentiated and integrated, against closed forms."""

import numpy as np
import pytest

import jaxbody as jb

TIMES = np.arange(4000) / 200


def of(x, unit="m/s2", times=TIMES):
    return jb.Record(times, {"x": (x, unit)})


@pytest.mark.parametrize("rate", [50.0, 100.0, 480.0, 150.0])
def test_resampling_keeps_slow_waves_and_removes_fast_ones(rate):
    """A wave of 7 Hz stays, within the ripple of the filter; one above half of the rate, which
    would appear as another, goes."""
    slow = jb.resample(of(np.sin(2 * np.pi * 7 * TIMES)), rate=rate)
    inside = (slow.times > 2) & (slow.times < 18)
    assert abs(slow.sampling.rate - rate) < 1e-9 * rate and slow.times[-1] < TIMES[-1] + 1 / 200
    assert np.abs(slow["x"] - np.sin(2 * np.pi * 7 * slow.times))[inside].max() < 5e-3
    if rate < 180:
        fast = jb.resample(of(np.sin(2 * np.pi * 93 * TIMES)), rate=rate)
        assert np.abs(fast["x"][inside]).max() < 0.02
    assert "resampled from 200" in slow.notes[-1] and slow.units == {"x": "m/s2"}


def test_resampling_is_the_cure_for_uneven_times():
    rng = np.random.default_rng(0)
    uneven = TIMES + 4e-4 * rng.uniform(size=TIMES.size)
    record = jb.Record(uneven, {"x": (np.sin(2 * np.pi * 3 * uneven), "m")}, irregular=True)
    with pytest.raises(jb.JaxbodyError, match=r"jb\.resample"):
        jb.filtered(record, band=(0, 20))
    even = jb.resample(record, rate=200.0)
    assert np.abs(even["x"] - np.sin(2 * np.pi * 3 * even.times))[100:-100].max() < 1e-3
    jb.filtered(even, band=(0, 20))


def test_filters_keep_their_band_without_delay():
    """Two passes of a Butterworth filter of order four: |H|^2 = 1/(1 + (f/f_c)^8) at 10 Hz, with
    the bilinear transform's frequencies tan(pi f/rate)."""
    wave = np.sin(2 * np.pi * 10 * TIMES)
    middle = slice(1000, 3000)
    low = jb.filtered(of(wave), band=(0, 12))["x"]
    gain = 1 / (1 + (np.tan(np.pi * 10 / 200) / np.tan(np.pi * 12 / 200)) ** 8)
    assert np.abs(low - gain * wave)[middle].max() < 1e-6
    high = jb.filtered(of(wave + 3.0), band=(2, np.inf))["x"]
    assert np.abs(high - wave)[middle].max() < 1e-4
    both = jb.filtered(of(wave), band=(2, 40))["x"]
    assert np.abs(both - wave)[middle].max() < 1e-3
    late = jb.filtered(of(wave), band=(0, 12), zero_phase=False)["x"]
    assert abs(np.abs(np.fft.rfft(late[2000:3000])).max() / 500 - np.sqrt(gain)) < 1e-6
    assert np.abs(late - np.sqrt(gain) * wave)[middle].max() > 0.5
    for band in ((20, 10), (-1, 5), (0, 200), (150, 180)):
        with pytest.raises(jb.JaxbodyError, match="BAD_BAND"):
            jb.filtered(of(wave), band=band)


def test_derivative_and_integral_of_a_wave_with_an_offset():
    w = 2 * np.pi
    record = of(np.cos(w * TIMES) + 0.3)
    rate = jb.records.derivative(record, "x")
    assert rate.units["x_rate"] == "m s-3"
    assert np.abs(rate["x_rate"] + w * np.sin(w * TIMES))[5:-5].max() < 1e-4
    drifting = jb.records.integral(record, "x", name="v", remove_drift=False)
    assert drifting.units["v"] == "m/s"
    assert np.abs(drifting["v"] - np.sin(w * TIMES) / w - 0.3 * TIMES).max() < 1e-7
    # the sine itself has the least-squares slope -12/(w T)^2 over 20 periods
    assert f"drifts by {0.3 - 12 / (w * 20) ** 2:.4f}" in drifting.notes[-1]
    v = jb.records.integral(record, "x", name="v")
    assert np.abs(v["v"] - np.sin(w * TIMES) / w).max() < 8e-3  # 6/(w^2 T)
    assert "taken out" in v.notes[-1] and set(v.channels) == {"x", "v"}
    twice = jb.records.integral(v, "v", name="s")
    assert twice.units["s"] == "m" and len(twice.notes) == 2


def test_channels_with_gaps_are_named():
    x = np.sin(TIMES)
    x[7] = np.nan
    for call in (
        lambda r: jb.resample(r, rate=100.0),
        lambda r: jb.filtered(r, band=(0, 10)),
        lambda r: jb.records.derivative(r, "x"),
        lambda r: jb.records.integral(r, "x"),
    ):
        with pytest.raises(jb.JaxbodyError, match=r"MISSING") as error:
            call(of(x))
        assert "'x'" in str(error.value)
    with pytest.raises(jb.JaxbodyError, match="BAD_NUMBER"):
        jb.resample(of(np.sin(TIMES)), rate=-1.0)
    with pytest.raises(jb.JaxbodyError, match="UNKNOWN_CHANNEL"):
        jb.records.derivative(of(np.sin(TIMES)), "y")
