"""Covariance of the noise, estimated from residuals: variances by sensor, autoregressions by
record, correlations between records.

The error of a least-squares estimate is A^-1 J'e, with A = J'J. With J = Q R it follows from Q'e,
whose covariance this file estimates from the residuals r = (I - QQ') e:

    sum over records a, b of  Q_a' Omega_ab Q_b,      Omega_aa = Toeplitz(gamma_a),
                              Omega_ab = sigma_ab H_a H_b'

For a white record gamma is the variance, common to all white records of its sensor; for another
record it is that of an autoregression. A fit removes from the residuals the part of the noise that
it can explain. Autocovariances are therefore increased until the products of residuals have their
expected value,

    E sum_t r_t r_(t+k) = trace_k[(I - QQ') Omega (I - QQ')].
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from jaxbody.fitting.statistics.autocorrelations import (
    FEWEST,
    Autoregression,
    autocovariances,
    autoregressions,
    chosen_order,
    innovations,
    products,
)

# iterations that correct autocovariances; the last one changes them by far less than their
# standard errors
ROUNDS = 4
# smallest eigenvalue of autocovariances, relative to the largest, that is more than round-off
SINGULAR = 1e-12
LEAST = 0.5  # smallest number of degrees of freedom from which a variance is estimated

STEP = 1e-4  # of central differences, in standard errors


class ResidualSeries(NamedTuple):
    """Residuals of one component of one channel of one run, without missing samples.

    `rows`: their rows among all residuals, in order of time; `group`: records with the same name
    have the same noise level; `run` and `times` (sample numbers): records that agree in both are
    sampled together; `series`: False for numbers that are not a sequence; `known`: True where the
    noise is stated, and the numbers are too few to estimate it."""

    name: str
    group: str
    run: str
    rows: np.ndarray
    times: np.ndarray
    series: bool = True
    known: bool = False

    @property
    def channel(self) -> str:
        return self.group.rsplit(" ", 1)[0]


@dataclass
class Noise:
    """The estimated noise.

    `M`: covariance of Q'e; `parts`: changes of M if one of its estimates, which are independent,
    changes by its standard error; `white`: M if all noise were white; `orders`: {record: order of
    its autoregression}; `pairs`: {pair of records: correlation of their innovations}."""

    M: np.ndarray
    parts: np.ndarray
    white: np.ndarray
    orders: dict[str, int]
    pairs: dict[tuple[str, str], float]


class _Piece:
    """Residuals and rows of Q of one record, with their Fourier transforms."""

    def __init__(self, record: ResidualSeries, r: np.ndarray, Q: np.ndarray):
        self.record, self.r, self.Q, self.n = (
            record,
            r[record.rows],
            Q[record.rows],
            len(record.rows),
        )
        self.square = self.Q.T @ self.Q
        self.fitted = float(np.trace(self.square))  # degrees of freedom that the parameters use
        self.order = chosen_order(self.r) if record.series else 0
        self.process = Autoregression(np.zeros(0), 0.0)

    @cached_property
    def waves(self) -> np.ndarray:
        return np.fft.rfft(self.Q, 2 * self.n, axis=0)

    @cached_property
    def overlaps(self) -> np.ndarray:
        """Sums over t of the scalar products Q_t . Q_(t+l), for the lags l = 0 ... n - 1."""
        return np.fft.irfft((np.abs(self.waves) ** 2).sum(1), 2 * self.n)[: self.n]

    def covariance(self, process: Autoregression) -> np.ndarray:
        """Return Q' Omega Q of an autoregression."""
        if len(process.phi) == 0:
            return process.variance * self.square
        gamma = autocovariances(process, self.n)
        return self.cross_covariance(
            self, np.real(np.fft.rfft(np.concatenate([gamma, [0.0], gamma[:0:-1]])))
        )

    def cross_covariance(self, other: _Piece, S: np.ndarray) -> np.ndarray:
        """Return Q_a' Omega Q_b from a cross spectrum S."""
        weight = np.full(len(S), 1.0 / self.n)
        weight[[0, -1]] /= 2
        return np.real(self.waves.conj().T @ ((S * weight)[:, None] * other.waves))

    def common_covariance(self, other: _Piece) -> np.ndarray:
        """Return Q_a' H_a H_b' Q_b, for innovations of variance one that both records have in
        common."""
        if self.order == other.order == 0:
            return self.Q.T @ other.Q
        H, G = (
            1 / np.fft.rfft(np.append(1.0, -one.process.phi), 2 * self.n) for one in (self, other)
        )
        return self.cross_covariance(other, H * G.conj())

    def corrected(self, M: np.ndarray) -> Autoregression:
        """Return the process whose expected products of residuals, after the fit has removed a part
        of the noise with covariance M, are those observed.

        If no process has such autocovariances, as for residuals of an unfinished fit, return the
        process unchanged."""
        from scipy.linalg import toeplitz

        n, sums, gamma = self.n, products(self.r, self.order), autocovariances(self.process, self.n)
        for k in range(self.order + 1):
            l = np.arange(k - n + 1, n)
            back = float(((self.Q[k:] @ M) * self.Q[: n - k]).sum())
            sums[k] += 2 * (self.overlaps[np.abs(l)] @ gamma[np.abs(l - k)]) - back
        gamma = sums / (n - np.arange(self.order + 1))
        w = np.linalg.eigvalsh(toeplitz(gamma))
        return autoregressions(gamma)[-1] if w[0] > SINGULAR * w[-1] else self.process


def noise_of(r: np.ndarray, Q: np.ndarray, records: list[ResidualSeries]) -> Noise:
    """Return the noise estimated from residuals r, an orthonormal basis Q of the columns of the
    Jacobian, and the records.

    Rows that belong to no record, such as those of priors, and rows of known noise have the
    standard deviation one."""
    pieces = [_Piece(record, r, Q) for record in records if not record.known]
    known = np.ones(len(r), bool)
    known[np.concatenate([np.zeros(0, int), *(one.record.rows for one in pieces)])] = False
    of_known = Q[known].T @ Q[known]
    variances = _variances(pieces)
    white = of_known + sum(variances[one.record.group][0] * one.square for one in pieces)
    plain = [one for one in pieces if not one.order]
    colored = [one for one in pieces if one.order]
    freedoms = _variances(plain)
    for one in plain:
        one.process = Autoregression(np.zeros(0), freedoms[one.record.group][0])
    rest = of_known + sum(one.covariance(one.process) for one in plain)
    for one in colored:
        one.process = autoregressions(products(one.r, one.order) / one.n)[-1]
    for _ in range(ROUNDS if colored else 0):
        M = rest + sum(one.covariance(one.process) for one in colored)
        for one in colored:
            one.process = one.corrected(M)
    M = rest + sum(one.covariance(one.process) for one in colored)
    parts = [
        np.sqrt(2 / freedom) * s2 * sum(one.square for one in plain if one.record.group == group)
        for group, (s2, freedom) in freedoms.items()
    ]
    parts += [part for one in colored for part in _parts(one)]
    pairs = {}
    for one, other, correlation in _pairs(pieces):
        pairs[one.record.name, other.record.name] = correlation
        size = np.sqrt(one.process.variance * other.process.variance)
        both = one.common_covariance(other)
        both = size * (both + both.T)
        M = M + correlation * both
        parts.append(np.sqrt((1 + correlation**2) / one.n) * both)
    return Noise(
        M,
        np.reshape(parts, (len(parts), *M.shape)),
        white,
        {one.record.name: one.order for one in pieces},
        pairs,
    )


def _variances(pieces: list[_Piece]) -> dict[str, tuple[float, float]]:
    """Return {group: (variance r'r/(n - p), degrees of freedom n - p)}, where the parameters use p
    degrees of freedom.

    A group without degrees of freedom has the variance of all groups together; if these have none
    either, the variance is one, that of the stated noise."""
    pooled = _variance(pieces, (1.0, 1.0))
    return {
        group: _variance([one for one in pieces if one.record.group == group], pooled)
        for group in dict.fromkeys(one.record.group for one in pieces)
    }


def _variance(pieces: list[_Piece], otherwise: tuple[float, float]) -> tuple[float, float]:
    """Return (r'r/(n - p), n - p) of all `pieces`, or `otherwise` if they have no degrees of
    freedom."""
    freedom = sum(one.n - one.fitted for one in pieces)
    square = sum(float(one.r @ one.r) for one in pieces)
    return (square / freedom, freedom) if freedom > LEAST else otherwise


def _parts(one: _Piece) -> Iterator[np.ndarray]:
    """Yield changes of Q' Omega Q for standard errors of the variance and of phi, whose Yule-Walker
    covariance is variance/n Gamma^-1."""
    from scipy.linalg import toeplitz

    process, q = one.process, one.order
    w, V = np.linalg.eigh(toeplitz(autocovariances(process, q)))
    # residuals of an exact fit may be a single wave
    spread = V * np.sqrt(process.variance / (one.n * np.maximum(w, SINGULAR * w[-1])))
    yield np.sqrt(2 / max(one.n - one.fitted - q, 1.0)) * one.covariance(process)
    for change in STEP * spread.T:
        ends = [
            one.covariance(Autoregression(process.phi + sign * change, process.variance))
            for sign in (1, -1)
        ]
        yield (ends[0] - ends[1]) / (2 * STEP)


def _pairs(pieces: list[_Piece]) -> Iterator[tuple[_Piece, _Piece, float]]:
    """Yield pairs of records sampled together and the correlation of their innovations, if any pair
    among them is significantly correlated."""
    together: dict[tuple[str, bytes], list[_Piece]] = {}
    for one in pieces:
        if one.record.series and one.n >= FEWEST and one.process.variance > 0:
            together.setdefault((one.record.run, one.record.times.tobytes()), []).append(one)
    for members in together.values():
        # constant residuals have no correlation
        members = [one for one in members if np.ptp(one.r) > 0]
        if len(members) < 2:
            continue
        rho = np.corrcoef([innovations(one.process, one.r) for one in members])
        i, j = np.triu_indices(len(members), 1)
        n = members[0].n
        if n * np.max(rho[i, j] ** 2) > np.log(n) + 2 * np.log(len(i)):
            for a, b in zip(i, j, strict=True):
                yield members[a], members[b], float(rho[a, b])
