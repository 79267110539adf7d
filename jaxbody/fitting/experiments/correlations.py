"""Correlation of records with their predictions, as they are and shifted in time."""

from __future__ import annotations

import numpy as np


def centered(y: np.ndarray, p: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A record and its prediction from their means, zero for missing samples, and which samples
    are there."""
    valid = np.isfinite(y) & np.isfinite(p)
    return *(np.where(valid, x - np.mean(x, where=valid), 0.0) for x in (y, p)), valid  # pyright: ignore[reportReturnType]


def correlation(y: np.ndarray, p: np.ndarray) -> float:
    """Of two records without means; 0 for a constant one."""
    size = float(np.sqrt((y @ y) * (p @ p)))
    return float(y @ p) / size if size else 0.0


def best_shift(y: np.ndarray, p: np.ndarray) -> tuple[int, float]:
    """By how many samples a record is later than its prediction for the largest correlation, up to
    half the record, and this."""
    from scipy.signal import correlate, correlation_lags

    lags = correlation_lags(len(y), len(p))
    near = np.abs(lags) <= len(y) // 2
    overlap, size = (
        correlate(a, b, method="fft")[near] for a, b in ((y, p), (y**2, np.ones(len(p))))
    )
    other = correlate(np.ones(len(y)), p**2, method="fft")[near]
    r = overlap / np.sqrt(np.maximum(size * other, np.finfo(float).tiny))
    best = int(np.argmax(np.abs(r)))
    return int(lags[near][best]), float(r[best])
