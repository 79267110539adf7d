"""Times of records: even ones are even in few digits, a stated rate moves them, what is no time
is named."""

import datetime
from fractions import Fraction

import numpy as np
import pytest

import jaxbody as jb
from jaxbody.core.errors import Problems
from jaxbody.records.sampling_checks import evenly_spaced
from jaxbody.shock.oscillators import checked_samples

K = np.arange(4000)
EVEN = K / 256
A = np.sin(2 * np.pi * 6 * EVEN)


@pytest.mark.parametrize("digits", [3, 4, 6])
def test_times_written_with_few_digits_are_even(digits):
    """At 256 Hz three digits are a quarter of a step. A row left out, anywhere, is seen."""
    printed = np.round(EVEN, digits)
    assert evenly_spaced(printed)
    assert evenly_spaced(np.float32(EVEN / 1.1).astype(float)) and evenly_spaced(1.6e9 + K * 1e-3)
    for row in (1, 2, 2000, 3997, 3998):
        assert not evenly_spaced(np.delete(printed, row))


def test_what_is_uneven_remains_so():
    """Two digits at 256 Hz repeat times; a clock changes its rate by a tenth of a percent."""
    for times in (
        np.round(EVEN, 2),
        np.round(np.where(K < 2000, K, 2000 + 1.001 * (K - 2000)) / 256, 6),
        EVEN**1.001,
        np.array([0.0, 1, 3]),
    ):
        assert not evenly_spaced(times)


def test_a_printed_record_has_the_spectra_of_the_exact_one():
    printed = np.round(EVEN, 6)
    exact, rounded = (jb.vibration.PSD.from_record(t, A, unit="m/s2") for t in (EVEN, printed))
    np.testing.assert_allclose(rounded.values, exact.values, rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(
        jb.vibration.weighted_signal(printed, A, "Wk").rms,
        jb.vibration.weighted_signal(EVEN, A, "Wk").rms,
        rtol=1e-6,
    )
    with Problems() as problems:
        _, step = checked_samples(
            jb.Record(printed, {"a": (A, "m/s2")}), "m/s2", "here", problems
        ) or (None, None)
    assert step == pytest.approx(1 / 256, rel=1e-7)


def test_times_that_are_uneven_are_refused_with_remedies_that_exist():
    with pytest.raises(
        jb.JaxbodyError,
        match=r"steps from 0.00390625 to 0.0078125 s.*rate=.*fill=.*jb\.resample.*NOT_UNIFORM",
    ):
        jb.vibration.PSD.from_record(np.delete(EVEN, 9), np.delete(A, 9), unit="m/s2")


def test_a_rate_beside_times_moves_them_to_its_steps():
    """Stamps 30 % of a step late or early and two rows missing: whole steps of the rate, the
    missing ones still missing, and a note."""
    late = EVEN + 0.3 / 256 * np.sin(K)
    late, a = np.delete(late, [7, 3000]), np.delete(A, [7, 3000])
    with pytest.raises(jb.JaxbodyError, match=r"rate= if it was sampled evenly.*JITTER"):
        jb.Record(late, {"a": (a, "m/s2")})
    record = jb.Record(late, {"a": (a, "m/s2")}, rate=256.0)
    np.testing.assert_allclose(record.times, np.delete(EVEN, [7, 3000]), rtol=0, atol=1e-14)
    assert (
        record.sampling.missing == 2
        and "moved times by up to 0.0012 s, to whole steps of 256 Hz" in str(record)
    )
    assert jb.Record(EVEN, {"a": (A, "m/s2")}, rate=256.0).notes == ()


def test_a_rate_from_which_times_drift_is_refused():
    """256.1 Hz is 0.04 % off, half a step after 1280 steps, at 5 s."""
    with pytest.raises(
        jb.JaxbodyError,
        match=(
            r"leaves the steps of the stated 256.1 Hz at (4.99|5.00)\d* s.*half a "
            r"step.*RATE_MISMATCH"
        ),
    ):
        jb.Record(EVEN, {"a": (A, "m/s2")}, rate=256.1)
    jb.Record(EVEN[:1000], {"a": (A[:1000], "m/s2")}, rate=256.1)


@pytest.mark.parametrize(
    ("times", "words"),
    [
        ([True, False, True], "True and False, not times"),
        (np.arange(3) > 0, "True and False, not times"),
        (np.array(["2024-05-01T12:00", "2024-05-01T12:01"], "M8[ns]"), "of dates (t - t[0])"),
        ([datetime.datetime(2024, 5, 1), datetime.datetime(2024, 5, 2)], "of dates (t - t[0])"),
        (np.array([1, 2], "m8[ms]"), "of durations t / np.timedelta64"),
        ([0.0, "1 s", 2.0], "element [1] is '1 s'"),
        (np.array([0.0, 1.0, None], object), "element [2] is None"),
        ([[0.0, 1.0], [2.0]], "element [1] has length 1, the first one 2"),
    ],
)
def test_what_is_no_time_is_named(times, words):
    for use in (
        lambda: jb.Record(times, {"a": ([1.0, 2.0], "m")}),
        lambda: jb.signals.Samples(times, [1.0, 2.0]),
        lambda: jb.vibration.weighted_signal(times, A, "Wk"),
    ):
        with pytest.raises(jb.JaxbodyError, match="NOT_A_NUMBER") as refused:
            use()
        assert words in str(refused.value)


def test_numbers_of_several_kinds_are_numbers():
    times = np.array([0, 0.5, Fraction(1), np.float32(1.5)], object)
    assert jb.Record(times, {"a": (np.arange(4.0), "m")}).times.tolist() == [0, 0.5, 1, 1.5]


@pytest.mark.filterwarnings("ignore::jaxbody.JaxbodyWarning")
def test_times_of_which_none_is_known_are_refused():
    with pytest.raises(jb.JaxbodyError, match="NAN_TIME"):
        jb.Record([np.nan, np.nan, np.nan], {"a": ([2.0, 2.0, 2.0], "m")})
