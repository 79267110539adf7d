"""Positive spectra of ambient vibration, whose input is not measured.

    R(k) = mean over t of y(t + k) r(t)
    S+(f) = h [R(0)/2 + sum over k > 0 of R(k) e^(-k h/decay) e^(-i 2 pi f k h)]

For inputs that are white, the correlations R of the outputs y with references r are sums of free
vibrations of the modes, and positive spectra S+ have the poles of frequency responses, moved by the
exponential window as those of an impact test. Errors follow from the scatter of the parts of the
record.

Source: B. Peeters, H. Van der Auweraer, F. Vanhollebeke, P. Guillaume, J. Sound Vib. 301 (2007) 19.
"""

from typing import Any

import numpy as np

from jaxbody.core.arguments import positive_number, whole_number
from jaxbody.core.errors import Problems
from jaxbody.fitting.modal.response_estimates import (
    SPECTRA,
    EstimatedResponse,
    ResponseEstimate,
    band_of,
)
from jaxbody.fitting.modal.segments import Transforms, channels_of, too_short
from jaxbody.records.records import Record

DECAYS = 5.0  # time constants of the exponential window within a segment


def positive_spectra(
    record: Record,
    *,
    references: Any,
    outputs: Any,
    segment: float,
    decay: float | None = None,
    parts: int = 40,
    band: tuple[float, float] | None = None,
) -> EstimatedResponse:
    """Estimate the positive spectra of ambient vibration for `identify_modes`.

    Args:
        record: a record with all channels in it
        references: names of the channels with which all are correlated, among them one that moves
            in every mode
        outputs: {channel: sensor}, or names of channels
        segment: longest shift of the correlations [s]
        decay: time constant of the exponential window [s], which `identify_modes` takes out again;
            None: a fifth of the segment
        parts: number of parts of the record, from whose scatter the errors follow
        band: (lowest, highest) frequency that is kept [Hz]; None: all but 0 Hz

    Errors, all at once: UNKNOWN_CHANNEL, BAD_SHAPE, MISSING, NOT_UNIFORM, BAD_NUMBER, BAD_BAND,
    TOO_SHORT.

    >>> x = np.random.default_rng(1).normal(size=8192)
    >>> record = jb.Record(None, {"x": (x, "m")}, rate=64.0)
    >>> spectra = jb.modal.positive_spectra(
    ...     record, references=["x"], outputs=["x"], segment=1.0
    ... )
    >>> round(float(spectra.estimate.H.real.mean() * 64 / np.mean(x * x)), 1)
    0.5
    """
    where = "positive_spectra"
    with Problems() as problems:
        positive_number(segment, f"{where}.segment", problems)
        if decay is not None:
            positive_number(decay, f"{where}.decay", problems)
        whole_number(parts, f"{where}.parts", problems, least=3)
    r_names, y_names = tuple(references), tuple(outputs)
    data = channels_of([record], y_names + r_names, where)[0]
    rate, lags = record.sampling.rate, round(segment * record.sampling.rate)
    length = data.shape[1] // parts
    if length < 2 * lags:
        raise too_short(where, 2 * parts * lags / rate, data.shape[1] / rate)
    tau = segment / DECAYS if decay is None else decay
    x = data - data.mean(1, keepdims=True)
    pieces = x[:, : parts * length].reshape(len(x), parts, length)
    Z = np.fft.rfft(pieces, 2 * length)
    y, r = Z[: len(y_names)], Z[len(y_names) :]
    each = [_correlations(y, one, lags, length) for one in r]
    window = np.exp(-np.arange(lags) / rate / tau)
    window[0] = 0.5
    spectra = np.fft.rfft(np.stack(each, -1) * window[:, None], axis=2) / rate
    f = np.arange(lags // 2 + 1) * rate / lags
    kept = band_of(f, band, where)
    S = np.moveaxis(spectra[:, :, kept], 0, 2)  # (parts, nf, ny, nr)
    mean = S.mean(0)
    replicates = (S - mean) * np.sqrt(parts / (parts - 1))
    note = f"{parts} parts of {length / rate:.6g} s, correlations up to {lags / rate:.6g} s"
    units = [tuple(record.units[name] for name in names) for names in (r_names, y_names)]
    estimate = ResponseEstimate(
        f[kept],
        mean,
        np.sqrt(np.mean(np.abs(replicates) ** 2, 0) / (2 * parts)),
        r_names,
        y_names,
        *units,
        segments=Transforms(
            f, np.zeros((0, 0, 0)), np.ones(lags), rate, float(parts), decay=tau, notes=(note,)
        ),
        method=SPECTRA,
        replicates=replicates,
    )
    ports = outputs if isinstance(outputs, dict) else dict.fromkeys(outputs)
    return EstimatedResponse(estimate, dict.fromkeys(r_names), ports)


def _correlations(y: np.ndarray, r: np.ndarray, lags: int, length: int) -> np.ndarray:
    """Return R(k) of all outputs with one reference in each part (ny, parts, lags), unbiased."""
    sums = np.fft.irfft(y * r.conj(), 2 * length)[:, :, :lags]
    return sums / (length - np.arange(lags))
