"""Autocorrelation of one record: autocovariances, autoregressions with the order selected by BIC,
and tests for whiteness; correlation of a record with a prediction, also shifted in time.

    r_t = phi_1 r_(t-1) + ... + phi_q r_(t-q) + e_t,   e_t white,   gamma_k = E r_t r_(t+k)

Sources: J. Durbin, The fitting of time-series models, Rev. Inst. Int. Stat. 28 (1960) 233;
G. Schwarz, Ann. Stat. 6 (1978) 461; G. M. Ljung and G. E. P. Box, Biometrika 65 (1978) 297.
"""

from typing import NamedTuple

import numpy as np

# largest partial autocorrelation; beyond it a finite record looks like a random walk
SHARPEST = 0.995
FEWEST = 20  # smallest number of samples for an analysis of autocorrelation
UNLIKELY = 6e-5  # p-value of a test at four standard errors, below which residuals are not white


class Autoregression(NamedTuple):
    """An autoregression: coefficients phi (q,) and the variance of the innovations e_t."""

    phi: np.ndarray
    variance: float


def products(r: np.ndarray, most: int) -> np.ndarray:
    """Return the sums over t of r_t r_(t+k), for the lags k = 0 ... `most`."""
    return np.array([r[k:] @ r[: len(r) - k] for k in range(most + 1)])


def autoregressions(gamma: np.ndarray) -> list[Autoregression]:
    """Return the autoregressions of all orders up to len(gamma) - 1, by Durbin's recursion; partial
    autocorrelations are limited to SHARPEST."""
    phi, variance = np.zeros(0), float(gamma[0])
    processes = [Autoregression(phi, variance)]
    for k in range(1, len(gamma)):
        partial = (
            np.clip((gamma[k] - phi @ gamma[1:k][::-1]) / variance, -SHARPEST, SHARPEST)
            if variance > 0
            else 0.0
        )
        phi, variance = np.append(phi - partial * phi[::-1], partial), variance * (1 - partial**2)
        processes.append(Autoregression(phi, variance))
    return processes


def most_lags(n: int) -> int:
    """Return the largest order considered for n samples."""
    return 0 if n < FEWEST else int(min(10 * np.log10(n), n / 10))


def chosen_order(r: np.ndarray) -> int:
    """Return the order q of the autoregression of residuals r that has the smallest n log(variance)
    + q log(n), the Bayesian information criterion."""
    n = len(r)
    if most_lags(n) == 0 or not r.any():
        return 0
    return int(
        np.argmin(
            [
                n * np.log(a.variance) + len(a.phi) * np.log(n)
                for a in autoregressions(products(r, most_lags(n)) / n)
            ]
        )
    )


def autocovariances(process: Autoregression, n: int) -> np.ndarray:
    """Return gamma_0 ... gamma_(n-1) of a stationary autoregression, by the Yule-Walker equations
    and then the recursion."""
    phi, variance = process
    q = len(phi)
    A = np.eye(q + 1)
    for i in range(q + 1):
        for j in range(q):
            A[i, abs(i - j - 1)] -= phi[j]
    first = np.linalg.solve(A, np.append(variance, np.zeros(q)))
    if q == 0 or n <= q + 1:
        return np.append(first, np.zeros(n))[:n]
    from scipy.signal import lfilter, lfiltic  # slow to import, not needed for white noise

    b, a = np.ones(1), np.append(1.0, -phi)
    return np.append(first, lfilter(b, a, np.zeros(n - q - 1), zi=lfiltic(b, a, first[:0:-1]))[0])


def innovations(process: Autoregression, r: np.ndarray) -> np.ndarray:
    """Return the innovations e_t."""
    return np.convolve(np.append(1.0, -process.phi), r)[: len(r)]


class Whiteness(NamedTuple):
    """Lag-one correlation r1, Durbin and Watson's d, Ljung and Box's Q over `lags`, and its p-value
    p (probability of a larger Q)."""

    r1: float
    d: float
    Q: float
    lags: int
    p: float


def whiteness(r: np.ndarray) -> Whiteness | None:
    """Test a record for whiteness; return None if it is too short or zero.

    Q = n (n + 2) sum_k rho_k^2/(n - k),   d = sum (r_t - r_(t-1))^2 / sum r_t^2
    """
    from scipy.special import chdtrc

    n, lags = len(r), most_lags(len(r))
    if lags == 0 or not r.any():
        return None
    rho = products(r, lags) / (r @ r)
    Q = n * (n + 2) * float((rho[1:] ** 2 / (n - np.arange(1, lags + 1))).sum())
    return Whiteness(
        float(rho[1]), float(np.diff(r) @ np.diff(r) / (r @ r)), Q, lags, float(chdtrc(lags, Q))
    )


def centered(y: np.ndarray, p: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return a record and its prediction minus their means, zero for missing samples, and which
    samples are present."""
    valid = np.isfinite(y) & np.isfinite(p)
    return *(np.where(valid, x - np.mean(x, where=valid), 0.0) for x in (y, p)), valid  # pyright: ignore[reportReturnType]


def correlation(y: np.ndarray, p: np.ndarray) -> float:
    """Return the correlation of two records without means; 0 for a constant record."""
    size = float(np.sqrt((y @ y) * (p @ p)))
    return float(y @ p) / size if size else 0.0


def best_shift(y: np.ndarray, p: np.ndarray) -> tuple[int, float]:
    """Return the number of samples, up to half the record, by which a record is later than its
    prediction where their correlation is largest, and this correlation."""
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
