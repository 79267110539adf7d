"""Records at another rate or within a band; derivatives and integrals of channels.

Filters act forwards and backwards, without a shift in time. Derivatives and integrals are those of
the cubic spline through the samples. An offset b of a channel gives its integral the drift b t.
"""

from collections.abc import Sequence
from fractions import Fraction
from typing import Any

import numpy as np

from jaxbody.core import units
from jaxbody.core.arguments import positive_number
from jaxbody.core.errors import JaxbodyError, Problem, Problems
from jaxbody.records.records import Record
from jaxbody.records.sampling_checks import evenly_spaced

ORDER = 4  # of the Butterworth filter
STEPS = 1000  # largest numerator and denominator of a ratio of rates


def resample(record: Record, *, rate: float) -> Record:
    """Return the record at another sampling rate, also one whose steps were uneven.

    A linear-phase low-pass filter below half of the lower of both rates keeps what the new rate
    cannot show from appearing at other frequencies (scipy.signal.resample_poly). Uneven times are
    interpolated by a cubic spline at their mean rate before.

    Args:
        record: a record without gaps
        rate: the new sampling rate [Hz]

    Errors: BAD_NUMBER, MISSING.

    >>> t = np.arange(400) / 100.0
    >>> record = jb.Record(t, {"x": (np.sin(t), "m")})
    >>> slow = jb.resample(record, rate=50.0)
    >>> len(slow.times), round(float(slow["x"][100] - np.sin(2.0)), 4)
    (200, 0.0)
    """
    from scipy.interpolate import CubicSpline
    from scipy.signal import resample_poly

    with Problems() as problems:
        positive_number(rate, "resample.rate", problems)
        check_complete(record, tuple(record.channels), "resample.record", problems)
    own, t = record.sampling.rate, record.times
    even = evenly_spaced(t)
    if not even:
        own = (len(t) - 1) / (t[-1] - t[0])
    ratio = Fraction(rate / own).limit_denominator(STEPS)
    count = -(-len(t) * ratio.numerator // ratio.denominator)
    exact = own * ratio.numerator / ratio.denominator
    channels = {}
    for name, x in record.channels.items():
        if not even:
            x = CubicSpline(t, x)(t[0] + np.arange(len(t)) / own)
        channels[name] = resample_poly(
            x, ratio.numerator, ratio.denominator, axis=0, padtype="line"
        )
    note = f"resampled from {own:.6g} to {exact:.6g} Hz{'' if even else ', uneven before'}"
    return record.changed(t[0] + np.arange(count) / exact, channels, record.units, note)


def filtered(record: Record, *, band: tuple[float, float], zero_phase: bool = True) -> Record:
    """Return the record within a band of frequencies, by a Butterworth filter of order 4.

    Args:
        record: a record with even steps, without gaps
        band: (lowest, highest) frequency [Hz]; 0 as the lowest, or infinity as the highest, for no
            limit on that side
        zero_phase: filter forwards and backwards, without delay, with the attenuation of two
            passes; False: forwards only

    Errors: BAD_BAND, MISSING, NOT_UNIFORM.

    >>> t = np.arange(1000) / 100.0
    >>> record = jb.Record(t, {"x": (np.sin(t) + np.sin(200 * t), "m")})
    >>> bool(abs(jb.filtered(record, band=(0, 5))["x"] - np.sin(t))[100:900].max() < 0.01)
    True
    """
    from scipy.signal import butter, sosfilt, sosfiltfilt

    with Problems() as problems:
        check_complete(record, tuple(record.channels), "filtered.record", problems)
        check_even(record, "filtered.record", problems)
    low, high = band
    half = record.sampling.rate / 2
    if not 0 <= low < high or (low == 0 and not high < half) or low >= half:
        raise JaxbodyError(
            Problem("BAD_BAND", "filtered.band", f"is {band}", band, f"within 0 to {half:.6g} Hz")
        )
    kind: Any = "bandpass" if low > 0 and high < half else "highpass" if low > 0 else "lowpass"
    edges = {"bandpass": [low, high], "highpass": low, "lowpass": high}[kind]
    sections = butter(ORDER, edges, kind, fs=2 * half, output="sos")
    run = sosfiltfilt if zero_phase else sosfilt
    channels = {name: run(sections, x, axis=0) for name, x in record.channels.items()}
    note = f"filtered to {low:g} to {high:g} Hz{'' if zero_phase else ', with delay'}"
    return record.changed(record.times, channels, record.units, note)


def derivative(record: Record, channel: str, *, name: str = "") -> Record:
    """Return the record with the derivative of a channel as a further channel.

    Args:
        record: a record without gaps in the channel
        channel: its name
        name: name of the derivative; by default "channel_rate"

    Errors: UNKNOWN_CHANNEL, MISSING.

    >>> t = np.arange(400) / 100.0
    >>> record = jb.records.derivative(jb.Record(t, {"x": (t**2, "m")}), "x", name="v")
    >>> record.units["v"], round(float(record["v"][100]), 9)
    ('m/s', 2.0)
    """
    from scipy.interpolate import CubicSpline

    with Problems() as problems:
        check_complete(record, (channel,), "derivative.record", problems)
    values = CubicSpline(record.times, record[channel])(record.times, 1)
    return _with_channel(record, name or f"{channel}_rate", values, record.units[channel], -1, "")


def integral(record: Record, channel: str, *, name: str = "", remove_drift: bool = True) -> Record:
    """Return the record with the integral of a channel as a further channel, zero at the first
    time; the drift is stated in the notes of the record.

    Args:
        record: a record without gaps in the channel
        channel: its name
        name: name of the integral; by default "channel_integral"
        remove_drift: take the straight line of least squares out of the integral

    Errors: UNKNOWN_CHANNEL, MISSING.

    >>> t = np.arange(629) / 100.0
    >>> record = jb.Record(t, {"a": (np.cos(t) + 0.02, "m/s2")})
    >>> record = jb.records.integral(record, "a", name="v", remove_drift=False)
    >>> round(float(record["v"][-1]), 4), record.notes[-1][:25]
    (0.1224, "integral of 'a' drifts by")
    """
    from scipy.interpolate import CubicSpline

    with Problems() as problems:
        check_complete(record, (channel,), "integral.record", problems)
    t = record.times - record.times[0]
    values = CubicSpline(t, record[channel]).antiderivative()(t)
    drift, start = np.polyfit(t, values, 1)
    if remove_drift:
        values = values - np.multiply.outer(t, drift) - start
    what = f"{np.array2string(np.asarray(drift), precision=4)} {record.units[channel] or '1'}"
    note = f"integral of '{channel}' {'drifted' if remove_drift else 'drifts'} by {what}" + (
        ", taken out" if remove_drift else ""
    )
    return _with_channel(
        record, name or f"{channel}_integral", values, record.units[channel], 1, note
    )


def _with_channel(
    record: Record, name: str, values: np.ndarray, unit: str, seconds: int, note: str
) -> Record:
    """Return the record with one more channel, whose unit is `unit` times s to the power
    `seconds`."""
    m, kg, s, rad, A = units.parse(unit or "1", name).dimension
    new = units.si_words((m, kg, s + seconds, rad, A))
    return record.changed(
        record.times, record.channels | {name: values}, record.units | {name: new}, note
    )


def check_complete(record: Record, names: Sequence[str], where: str, problems: Problems) -> None:
    """Check that channels have all samples. Errors: UNKNOWN_CHANNEL, MISSING."""
    for name in names:
        x = problems.gather(lambda name=name: record[name])
        if x is not None and np.isnan(x).any():
            problems.add(
                "MISSING",
                f"{where}['{name}']",
                f"lacks {int(np.isnan(x).sum())} samples",
                hint='Read the record with fill="linear" or fill="spline", or take a part.',
            )


def check_even(record: Record, where: str, problems: Problems) -> None:
    """Check that the times have equal steps. Error: NOT_UNIFORM."""
    if not evenly_spaced(record.times):
        problems.add(
            "NOT_UNIFORM",
            where,
            "has steps of different lengths",
            limit="equal steps",
            hint="Use jb.resample(record, rate=...).",
        )
