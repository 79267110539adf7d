"""Segments of records and their transforms: windows with overlap, whole periods of a periodic
input, hits of an impact hammer.

    X_s(f) = sum_t w(t) x_s(t) exp(-i 2 pi f t) sqrt(1/(rate sum w^2))

so that 2 |X_s|^2 is a one-sided spectral density. Source of the averages of overlapping segments:
P. D. Welch, IEEE Trans. Audio Electroacoust. 15 (1967) 70.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from jaxbody.core.errors import JaxbodyError, Problem, Problems
from jaxbody.records.conditioning import check_complete, check_even
from jaxbody.records.records import Record

PERIODIC = 0.99  # autocorrelation of an input after one period, from which it counts as periodic
APART = 0.5  # autocorrelation below which the peak at zero shift has ended
SEGMENTS = 16  # of a record, where neither a segment nor a period is given
HIT = 0.1  # force relative to the largest, from which a hit begins
BEFORE = 0.01  # part of a segment before its hit
UNSETTLED = 3.0  # deviation of the first periods relative to that of later ones
LEAST = 0.01  # smallest correlation of the errors of two lines that counts


@dataclass(frozen=True)
class ImpactWindow:
    """Windows of an impact test: the force is set to zero after the `pulse`, and all channels are
    multiplied by exp(-t/decay).

    Args:
        pulse: length of the force pulse [s]; None: no force window
        decay: time constant of the exponential window [s]; None: no such window. It adds
            1/decay [rad/s] to -Re(pole), which `identify_modes` takes out again.

    >>> jb.modal.ImpactWindow(pulse=0.005, decay=0.4).decay
    0.4
    """

    pulse: float | None = None
    decay: float | None = None

    def __post_init__(self):
        with Problems() as problems:
            for name, value in (("pulse", self.pulse), ("decay", self.decay)):
                if value is not None and not value > 0:
                    problems.add(
                        "BAD_NUMBER",
                        f"ImpactWindow.{name}",
                        f"is {value}",
                        value=value,
                        limit="> 0 s",
                    )


class Transforms(NamedTuple):
    """Transforms of the segments of all records.

    `spectra`: (channels, segments, frequencies); `window`: (n,) samples; `effective`: number of
    independent averages that the segments amount to; `periods`: number of periods of each record
    where segments are whole periods of a periodic input, else empty; `decay`: as in ImpactWindow;
    `lags`: correlation of the errors of two lines k lines apart, k = 0, 1, ...; `shared`: how many
    of the next segments have samples in common with one; `notes` for the table."""

    frequencies: np.ndarray
    spectra: np.ndarray
    window: np.ndarray
    rate: float
    effective: float
    periods: tuple[int, ...] = ()
    decay: float | None = None
    lags: tuple[complex, ...] = (1.0,)
    shared: int = 0
    notes: tuple[str, ...] = ()


def channels_of(records: Sequence[Record], names: Sequence[str], where: str) -> list[np.ndarray]:
    """Return the channels (names, samples) of each record. Errors, all at once: UNKNOWN_CHANNEL,
    BAD_SHAPE, MISSING, NOT_UNIFORM, RATE_MISMATCH."""
    with Problems() as problems:
        for i, record in enumerate(records):
            place = f"{where}.record" + (f"[{i}]" if len(records) > 1 else "")
            check_even(record, place, problems)
            check_complete(record, names, place, problems)
            if abs(record.sampling.rate / records[0].sampling.rate - 1) > 1e-6:
                problems.add(
                    "RATE_MISMATCH",
                    place,
                    f"has {record.sampling.rate:.6g} Hz",
                    value=record.sampling.rate,
                    limit=f"{records[0].sampling.rate:.6g} Hz, that of the first record",
                    hint="Use jb.resample(record, rate=...).",
                )
            for name in names:
                if name in record.channels and record[name].ndim > 1:
                    problems.add(
                        "BAD_SHAPE",
                        f"{place}['{name}']",
                        f"has {record[name].shape[1]} components",
                        value=record[name].shape,
                        limit="one number at each time",
                        hint="Read each component as a channel of its own.",
                    )
    return [np.stack([record[name] for name in names]) for record in records]


def period_of(x: np.ndarray) -> int | None:
    """Return the period [samples] of an input x (n,), None if it is not periodic: the first shift
    after which its autocorrelation is again above PERIODIC."""
    n = len(x)
    x = x - x.mean()
    size = 2 ** int(np.ceil(np.log2(2 * n)))
    products = np.fft.irfft(np.abs(np.fft.rfft(x, size)) ** 2, size)[: n // 2 + 1]
    energy = np.concatenate([[0.0], np.cumsum(x * x)])
    shifts = np.arange(len(products))
    sizes = np.sqrt(energy[n - shifts] * np.maximum(energy[n] - energy[shifts], 0.0))
    r = products / np.where(sizes > 0, sizes, np.inf)
    apart = np.flatnonzero(r < APART)
    if not len(apart):
        return None
    back = np.flatnonzero(r[apart[0] :] > PERIODIC)
    if not len(back):
        return None
    first = apart[0] + back[0]
    return int(first + np.argmax(r[first : first + max(first // 20, 2)]))


def cut(
    data: list[np.ndarray],
    inputs: int,
    rate: float,
    segment: float | None,
    window: Any,
    overlap: float | None,
    where: str,
) -> Transforms:
    """Return the transforms of the segments of records; the first `inputs` channels are inputs.
    Errors: TOO_SHORT, BAD_NUMBER, BAD_OPTION."""
    with Problems() as problems:
        if segment is not None and not segment * rate >= 2:
            problems.add("BAD_NUMBER", f"{where}.segment", f"is {segment} s", limit="2 samples")
        if overlap is not None and not 0 <= overlap < 1:
            problems.add("BAD_NUMBER", f"{where}.overlap", f"is {overlap}", limit="0 to 1")
    if isinstance(window, ImpactWindow):
        return _hits(data, inputs, rate, segment, window, where)
    asked = None if segment is None else round(segment * rate)
    if window is None and inputs:
        periods = {period_of(x) for record in data for x in record[:inputs]}
        period = periods.pop() if len(periods) == 1 else None
        if period is not None and (asked is None or asked >= period):
            return _periods(data, rate, period, where)
    name = "hann" if window is None else window
    shortest = min(x.shape[1] for x in data)
    n = asked or max(2 * shortest // (SEGMENTS + 1), 2)
    if n > shortest:
        raise too_short(where, n / rate, shortest / rate)
    w = _window(name, n, where)
    shared = 0.0 if name == "boxcar" else 0.5
    step = max(round(n * (1 - (shared if overlap is None else overlap))), 1)
    spectra = [_transforms(x, rate, w, step, "constant") for x in data]
    counts = [one.shape[1] for one in spectra]
    return Transforms(
        np.arange(n // 2 + 1) * rate / n,
        spectra[0] if len(spectra) == 1 else np.concatenate(spectra, 1),
        w,
        rate,
        independent_averages(w, step, counts),
        shared=(n - 1) // step,
        notes=(
            f"{sum(counts)} segments of {n / rate:.6g} s, window {name}, "
            f"overlap {1 - step / n:.0%}",
        ),
    )


def _window(name: Any, n: int, where: str) -> np.ndarray:
    from scipy.signal import get_window

    try:
        return np.asarray(get_window(name, n))
    except (ValueError, TypeError) as error:
        raise JaxbodyError(
            Problem(
                "BAD_OPTION",
                f"{where}.window",
                f"is {name!r:.60}",
                name,
                "a window of scipy.signal.get_window, or a jb.modal.ImpactWindow",
            )
        ) from error


def too_short(where: str, needed: float, there: float) -> JaxbodyError:
    """Return the error of a record that is shorter than a segment [s]."""
    return JaxbodyError(
        Problem(
            "TOO_SHORT",
            f"{where}.record",
            f"has {there:.6g} s",
            there,
            f"{needed:.6g} s or more",
            "Give a shorter segment=, or a longer record.",
        )
    )


def _transforms(x: np.ndarray, rate: float, w: np.ndarray, step: int, detrend: Any) -> np.ndarray:
    """Return X_s(f) of all channels (channels, segments, frequencies)."""
    from scipy.signal import spectrogram

    spectra = spectrogram(
        x, rate, w, noverlap=len(w) - step, detrend=detrend, mode="complex", axis=-1
    )[2]
    return np.moveaxis(spectra, -1, 1)


def independent_averages(w: np.ndarray, step: int, counts: Sequence[int]) -> float:
    """Return the effective number n_e of independent averages of n overlapping segments of noise,
    `counts` in each record.

        n/n_e = sum over d of (1 - |d|/n) (sum_t w(t) w(t + d step) / sum w^2)^2
    """
    n, N, total = sum(counts), len(w), 1.0
    for d in range(1, (N - 1) // step + 1):
        share = sum(max(count - d, 0) for count in counts) / n
        total += 2 * share * float(w[: N - d * step] @ w[d * step :] / (w @ w)) ** 2
    return n / total


def _periods(data: list[np.ndarray], rate: float, period: int, where: str) -> Transforms:
    """Return the transforms of whole periods, without those of the initial transient."""
    if min(x.shape[1] for x in data) < 2 * period:
        raise too_short(where, 2 * period / rate, min(x.shape[1] for x in data) / rate)
    w, spectra, dropped = np.ones(period), [], 0
    for x in data:
        one = _transforms(x, rate, w, period, False)
        while one.shape[1] > 3:
            deviation = np.linalg.norm(one - one[:, one.shape[1] // 2 :].mean(1)[:, None], axis=2)
            if not (deviation[:, 0] > UNSETTLED * np.median(deviation[:, 1:], 1)).any():
                break
            one, dropped = one[:, 1:], dropped + 1
        spectra.append(one)
    counts = [one.shape[1] for one in spectra]
    note = f"{sum(counts)} periods of {period / rate:.6g} s, found in the inputs"
    return Transforms(
        np.arange(period // 2 + 1) * rate / period,
        np.concatenate(spectra, 1),
        w,
        rate,
        float(sum(counts)),
        periods=tuple(counts),
        notes=(note + (f"; {dropped} at the beginning left out as transient" if dropped else ""),),
    )


def _hits(
    data: list[np.ndarray],
    inputs: int,
    rate: float,
    segment: float | None,
    window: ImpactWindow,
    where: str,
) -> Transforms:
    """Return the transforms of the segments that begin shortly before each hit."""
    if inputs != 1 or segment is None:
        raise JaxbodyError(
            Problem(
                "BAD_OPTION",
                f"{where}.window",
                f"is an ImpactWindow with {inputs} inputs"
                if inputs != 1
                else "is an ImpactWindow without segment=",
                window,
                "one input, the hammer, and the length of a segment [s]",
            )
        )
    n = round(segment * rate)
    pieces, doubled = [], 0
    level = HIT * max(np.abs(x[0] - np.median(x[0])).max() for x in data)
    length = n if window.pulse is None else max(round(window.pulse * rate), 1)
    before = max(round(BEFORE * n), 2)
    for x in data:
        x = x - np.median(x, 1, keepdims=True)
        loud, at = np.flatnonzero(np.abs(x[0]) > level), 0
        while (later := loud[loud >= at]).size:
            begin = max(later[0] - before, 0)
            at = begin + n
            if at > x.shape[1]:
                break
            piece = x[:, begin:at].copy()
            end = later[0] - begin + length
            if (np.abs(piece[0, end:]) > level).any():
                doubled += 1
                continue
            piece[0, end:] = 0.0
            pieces.append(piece)
    if not pieces:
        raise too_short(where, n / rate, max(x.shape[1] for x in data) / rate)
    w = np.ones(n) if window.decay is None else np.exp(-np.arange(n) / rate / window.decay)
    spectra = np.fft.rfft(np.stack(pieces, 1) * w) / np.sqrt(rate * np.sum(w * w))
    lags = np.fft.fft(w * w)[: n // 2].conj() / np.sum(w * w)
    note = f"{len(pieces)} hits, segments of {n / rate:.6g} s"
    return Transforms(
        np.arange(n // 2 + 1) * rate / n,
        spectra,
        np.ones(n),
        rate,
        float(len(pieces)),
        decay=window.decay,
        lags=tuple(lags[: 1 + int(np.flatnonzero(np.abs(lags) > LEAST)[-1])]),
        notes=(note + (f"; {doubled} double hits left out" if doubled else ""),),
    )
