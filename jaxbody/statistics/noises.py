"""What the noise in residuals makes of estimates: variances by sensor, autoregressions by record, what records have in common.

Estimates of least squares err by A^-1 J'e; with J = Q R, the covariance of Q'e is what is made here, from residuals (I - QQ') e:

    sum over records a, b of  Q_a' Omega_ab Q_b,      Omega_aa = Toeplitz(gamma_a),   Omega_ab = sigma_ab H_a H_b'

Of a white record gamma is the variance of all white records of its sensor; of another that of an autoregression. The fit has taken
out of residuals what it could explain: autocovariances are raised until what they lead one to expect of residuals is what is found,

    E sum_t r_t r_(t+k) = trace_k[(I - QQ') Omega (I - QQ')].
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from jaxbody.statistics.autocorrelations import (
    FEWEST,
    Autoregression,
    autocovariances,
    autoregressions,
    chosen_order,
    innovations,
    products,
)

ROUNDS = 4  # of raising autocovariances; what the last one changes is far less than what they are known to
SINGULAR = 1e-12  # eigenvalue of autocovariances, relative to the largest, that is round-off
LEAST = 0.5  # degrees of freedom that say anything of a variance
ALL = ""
STEP = 1e-4  # of derivatives by central differences, in standard errors


class ResidualSeries(NamedTuple):
    """One component of one channel of one run: its rows among the residuals in the order of time, missing samples left out; `group`, records of one
    noise level; those of a `run` are sampled together, at `times` (sample numbers). Without `series`, numbers in no order, and if their noise is
    stated, it is `known`: they are too few to tell another."""

    name: str
    group: str
    run: str
    rows: np.ndarray
    times: np.ndarray
    series: bool = True
    known: bool = False


@dataclass
class Noise:
    """M, the covariance of Q'e; `parts`, by how much M changes when one of the numbers behind it moves by its standard error, independent of
    one another; `white`, M if all noise were white; the order of the autoregression of each record by name; correlations of what is new in pairs of records."""

    M: np.ndarray
    parts: np.ndarray
    white: np.ndarray
    orders: dict[str, int]
    pairs: dict[tuple[str, str], float]


class _Piece:
    """Residuals and rows of Q of one record, with their transforms."""

    def __init__(self, record: ResidualSeries, r: np.ndarray, Q: np.ndarray):
        self.record, self.r, self.Q, self.n = record, r[record.rows], Q[record.rows], len(record.rows)
        self.square = self.Q.T @ self.Q
        self.taken = float(np.trace(self.square))  # degrees of freedom
        self.order = chosen_order(self.r) if record.series else 0
        self.process = Autoregression(np.zeros(0), 0.0)

    @cached_property
    def waves(self) -> np.ndarray:
        return np.fft.rfft(self.Q, 2 * self.n, axis=0)

    @cached_property
    def overlaps(self) -> np.ndarray:
        """sum_t Q_t . Q_(t+l), l = 0 ... n - 1"""
        return np.fft.irfft((np.abs(self.waves) ** 2).sum(1), 2 * self.n)[: self.n]

    def made_of(self, process: Autoregression) -> np.ndarray:
        """Q' Omega Q."""
        if len(process.phi) == 0:
            return process.variance * self.square
        gamma = autocovariances(process, self.n)
        return self.through(self, np.real(np.fft.rfft(np.concatenate([gamma, [0.0], gamma[:0:-1]]))))

    def through(self, other: _Piece, S: np.ndarray) -> np.ndarray:
        """Q_a' Omega Q_b of a cross spectrum S."""
        weight = np.full(len(S), 1.0 / self.n)
        weight[[0, -1]] /= 2
        return np.real(self.waves.conj().T @ ((S * weight)[:, None] * other.waves))

    def shared_with(self, other: _Piece) -> np.ndarray:
        """Q_a' H_a H_b' Q_b: innovations of variance one that both have in common."""
        if self.order == other.order == 0:
            return self.Q.T @ other.Q
        H, G = (1 / np.fft.rfft(np.append(1.0, -one.process.phi), 2 * self.n) for one in (self, other))
        return self.through(other, H * G.conj())

    def raised(self, M: np.ndarray) -> np.ndarray:
        """gamma_0 ... gamma_q from what is found, and what the process and M lead one to expect the fit to have taken."""
        n, found, gamma = self.n, products(self.r, self.order), autocovariances(self.process, self.n)
        for k in range(self.order + 1):
            l = np.arange(k - n + 1, n)
            back = float(((self.Q[k:] @ M) * self.Q[: n - k]).sum())
            found[k] += 2 * (self.overlaps[np.abs(l)] @ gamma[np.abs(l - k)]) - back
        return found / (n - np.arange(self.order + 1))


def noise_of(r: np.ndarray, Q: np.ndarray, records: list[ResidualSeries]) -> Noise:
    """From residuals r, the orthonormal columns Q of what could be fitted and the records; rows in no record, as those of priors, have a noise of one, known, too."""
    pieces = [_Piece(record, r, Q) for record in records if not record.known]
    known = np.ones(len(r), bool)
    known[np.concatenate([np.zeros(0, int), *(one.record.rows for one in pieces)])] = False
    of_known = Q[known].T @ Q[known]
    variances = _variances(pieces)
    white = of_known + sum(variances[one.record.group][0] * one.square for one in pieces)
    colored = [one for one in pieces if one.order]
    plain, freedoms = [one for one in pieces if not one.order], _variances([one for one in pieces if not one.order])
    for one in plain:
        one.process = Autoregression(np.zeros(0), freedoms[one.record.group][0])
    rest = of_known + sum(one.made_of(one.process) for one in plain)
    for one in colored:
        one.process = autoregressions(products(one.r, one.order) / one.n)[-1]
    for _ in range(ROUNDS if colored else 0):
        M = rest + sum(one.made_of(one.process) for one in colored)
        for one in colored:
            one.process = autoregressions(one.raised(M))[-1]
    M = rest + sum(one.made_of(one.process) for one in colored)
    parts = [
        np.sqrt(2 / freedom) * s2 * sum(one.square for one in plain if one.record.group == group)
        for group, (s2, freedom) in freedoms.items()
    ]
    parts += [part for one in colored for part in _parts(one)]
    pairs = {}
    for one, other, correlation in _pairs(pieces):
        pairs[one.record.name, other.record.name] = correlation
        size = np.sqrt(one.process.variance * other.process.variance)
        both = one.shared_with(other)
        both = size * (both + both.T)
        M = M + correlation * both
        parts.append(np.sqrt((1 + correlation**2) / one.n) * both)
    return Noise(M, np.reshape(parts, (len(parts), *M.shape)), white, {one.record.name: one.order for one in pieces}, pairs)


def _variances(pieces: list[_Piece]) -> dict[str, tuple[float, float]]:
    """Of each group the variance r'r/(n - p), where p is what parameters take of its degrees of freedom, and these; of a group that
    parameters take whole that of all, and with nothing left one: noise as it was stated."""
    left = {group: [0.0, 0.0] for group in [*(one.record.group for one in pieces), ALL]}
    for one in pieces:
        for group in (one.record.group, ALL):
            left[group][0] += float(one.r @ one.r)
            left[group][1] += one.n - one.taken
    square, freedom = left.pop(ALL)
    pooled = (square / freedom, freedom) if freedom > LEAST else (1.0, 1.0)
    return {group: (square / freedom, freedom) if freedom > LEAST else pooled for group, (square, freedom) in left.items()}


def _parts(one: _Piece) -> list[np.ndarray]:
    """Changes of Q' Omega Q with the variance and with phi, whose covariance is that of Yule and Walker, variance/n Gamma^-1."""
    from scipy.linalg import toeplitz

    process, q = one.process, one.order
    w, V = np.linalg.eigh(toeplitz(autocovariances(process, q)))
    spread = V * np.sqrt(process.variance / (one.n * np.maximum(w, SINGULAR * w[-1])))  # residuals of an exact fit may be one wave
    parts = [np.sqrt(2 / max(one.n - one.taken - q, 1.0)) * one.made_of(process)]
    for change in STEP * spread.T:
        ends = [one.made_of(Autoregression(process.phi + sign * change, process.variance)) for sign in (1, -1)]
        parts.append((ends[0] - ends[1]) / (2 * STEP))
    return parts


def _pairs(pieces: list[_Piece]) -> list[tuple[_Piece, _Piece, float]]:
    """Pairs of records sampled together, where the innovations of any of these are correlated by more than chance."""
    found = []
    together: dict[tuple[str, bytes], list[_Piece]] = {}
    for one in pieces:
        if one.record.series and one.n >= FEWEST and one.process.variance > 0:
            together.setdefault((one.record.run, one.record.times.tobytes()), []).append(one)
    for members in together.values():
        members = [one for one in members if np.ptp(one.r) > 0]  # one that is constant goes with none
        if len(members) < 2:
            continue
        E = np.array([innovations(one.process, one.r) for one in members])
        rho = np.corrcoef(E)
        i, j = np.triu_indices(len(members), 1)
        n = members[0].n
        if n * np.max(rho[i, j] ** 2) > np.log(n) + 2 * np.log(len(i)):
            found += [(members[a], members[b], float(rho[a, b])) for a, b in zip(i, j, strict=True)]
    return found
