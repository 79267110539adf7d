"""The response of one pole as an estimate shows it.

    exact:        1/(s - p)
    by windows:   int_0^T r(t) e^((p - s) t) dt,   r: autocorrelation of the window, r(0) = 1
    by samples:   (h/2) coth((s - p) h/2)

The second is the expected H1 of segments with a window for an input with a flat spectrum: the
leakage of the estimate is part of the model, so that it does not widen the resonances. The third is
the transform of sampled correlations e^(p k h), of which the one at zero shift counts half.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

PoleFunction = Callable[[complex], tuple[np.ndarray, np.ndarray]]


def frequency_of(poles: Any) -> Any:
    """Return |p|/(2 pi) [Hz]."""
    return np.abs(poles) / (2 * np.pi)


def damping_ratio_of(poles: Any) -> Any:
    """Return -Re p/|p|."""
    return -np.real(poles) / np.abs(poles)


def exact(s: np.ndarray) -> PoleFunction:
    """Return p -> (1/(s - p), its derivative by p)."""
    return lambda p: (1 / (s - p), 1 / (s - p) ** 2)


def by_samples(s: np.ndarray, step: float) -> PoleFunction:
    """Return p -> (h/2 coth((s - p) h/2), its derivative by p) for samples `step` apart."""

    def of(p: complex) -> tuple[np.ndarray, np.ndarray]:
        x = (s - p) * step / 2
        return step / 2 / np.tanh(x), (step / 2 / np.sinh(x)) ** 2

    return of


def by_windows(s: np.ndarray, window: np.ndarray, rate: float) -> PoleFunction:
    """Return p -> (response seen through the window, its derivative by p). The difference from the
    exact one, int (1 - r) e^((p - s) t) dt, is smooth, so that a sum over samples suffices."""
    n = len(window)
    T, t = n / rate, np.arange(n) / rate
    padded = np.fft.rfft(window, 2 * n)
    r = np.fft.irfft(np.abs(padded) ** 2, 2 * n)[:n]
    lost = (1 - r / r[0]) / rate
    lines = np.rint(np.imag(s) * T / (2 * np.pi)).astype(int)

    def of(p: complex) -> tuple[np.ndarray, np.ndarray]:
        x, end = s - p, np.exp((p - s) * T)
        decay = lost * np.exp(p * t)
        # half of the last sample belongs to this interval, half to the rest beyond T
        half = end / (2 * rate)
        D = np.fft.fft(decay)[lines] + half + end / x
        dD = np.fft.fft(t * decay)[lines] + T * half + (T / x + 1 / x**2) * end
        return 1 / x - D, 1 / x**2 - dD

    return of
