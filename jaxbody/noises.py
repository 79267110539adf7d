"""What the noise in residuals makes of estimates: variances by sensor, autoregressions by channel, and what channels have in common.

Estimates of least squares err by A^-1 J'e; with J = Q R, the covariance of Q'e is what is made here, from residuals (I - QQ') e:

    sum over channels a, b of  Q_a' Omega_ab Q_b,      Omega_aa = Toeplitz(gamma_a),   Omega_ab = sigma_ab H_a H_b'

Of a white channel gamma is the variance of all white channels of its sensor; of another that of an autoregression. The fit has taken
out of residuals what it could explain: autocovariances are raised until what they lead one to expect of residuals is what is found,

    E sum_t r_t r_(t+k) = trace_k[(I - QQ') Omega (I - QQ')].
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from jaxbody.autocorrelations import FEWEST, Autoregression, autocovariances, autoregressions, chosen_order, innovations, products
from jaxbody.experiments import Experiment

ROUNDS = 4  # of raising autocovariances; what the last one changes is far less than what they are known to
STEP = 1e-4  # of derivatives by central differences, in standard errors


class Channel(NamedTuple):
    """One record among residuals: its rows there in the order of time, missing samples left out; `group`, channels of one noise level;
    `run`, channels sampled together at `times` (sample numbers). A channel without `series` is a set of numbers in no order."""

    name: str
    group: str
    run: str
    rows: np.ndarray
    times: np.ndarray
    series: bool = True


def channels_of(experiments: dict[str, Experiment]) -> list[Channel]:
    """The channels of the residuals of all experiments, in their order; one noise level for each unit of a sensor, in all runs."""
    channels, first = [], 0
    for run, experiment in experiments.items():
        for name, sensor in experiment.sensors.items():
            there = ~sensor.missing(np.asarray(experiment.measured[name]))
            labels = [str(list(i)).replace(" ", "") if i else "" for i in np.ndindex(there.shape[1:])]
            there = there.reshape(len(there), -1)
            units = np.broadcast_to(sensor.spread(np.arange(sensor.unit.count(",") + 1)), there.shape[1:])
            for i, (label, unit) in enumerate(zip(labels, units, strict=True)):
                times = np.flatnonzero(there[:, i])
                channels.append(Channel(f"{run}.{name}{label}", f"{name} {unit}", run, first + times * there.shape[1] + i, times))
            first += there.size
    return channels


@dataclass
class Noise:
    """M, the covariance of Q'e; `parts`, by how much M changes when one of the numbers behind it moves by its standard error, independent of
    one another; `white`, M if all noise were white; the order of each channel's autoregression; correlations of innovations of pairs of channels."""

    M: np.ndarray
    parts: np.ndarray
    white: np.ndarray
    orders: list[int]
    pairs: dict[tuple[str, str], float]


class _Record:
    """Residuals and rows of Q of one channel, with their transforms."""

    def __init__(self, channel: Channel, r: np.ndarray, Q: np.ndarray):
        self.channel, self.r, self.Q, self.n = channel, r[channel.rows], Q[channel.rows], len(channel.rows)
        self.square = self.Q.T @ self.Q
        self.taken = float(np.trace(self.square))  # degrees of freedom
        self.order = chosen_order(self.r) if channel.series else 0
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

    def through(self, other: _Record, S: np.ndarray) -> np.ndarray:
        """Q_a' Omega Q_b of a cross spectrum S."""
        weight = np.full(len(S), 1.0 / self.n)
        weight[[0, -1]] /= 2
        return np.real(self.waves.conj().T @ ((S * weight)[:, None] * other.waves))

    def shared_with(self, other: _Record) -> np.ndarray:
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
            back = np.einsum("ti,ij,tj->", self.Q[k:], M, self.Q[: n - k])
            found[k] += 2 * (self.overlaps[np.abs(l)] @ gamma[np.abs(l - k)]) - back
        return found / (n - np.arange(self.order + 1))


def noise_of(r: np.ndarray, Q: np.ndarray, channels: list[Channel]) -> Noise:
    """From residuals r, the orthonormal columns Q of what could be fitted and the channels; rows in no channel have a noise of one, known."""
    records = [_Record(channel, r, Q) for channel in channels]
    known = np.ones(len(r), bool)
    known[np.concatenate([np.zeros(0, int), *(channel.rows for channel in channels)])] = False
    of_known = Q[known].T @ Q[known]
    variances = _variances(records)
    white = of_known + sum(variances[one.channel.group][0] * one.square for one in records)
    colored = [one for one in records if one.order]
    plain, freedoms = [one for one in records if not one.order], _variances([one for one in records if not one.order])
    for one in plain:
        one.process = Autoregression(np.zeros(0), freedoms[one.channel.group][0])
    rest = of_known + sum(one.made_of(one.process) for one in plain)
    for one in colored:
        one.process = autoregressions(products(one.r, one.order) / one.n)[-1]
    for _ in range(ROUNDS if colored else 0):
        M = rest + sum(one.made_of(one.process) for one in colored)
        for one in colored:
            one.process = autoregressions(one.raised(M))[-1]
    M = rest + sum(one.made_of(one.process) for one in colored)
    parts = [
        np.sqrt(2 / freedom) * s2 * sum(one.square for one in plain if one.channel.group == group)
        for group, (s2, freedom) in freedoms.items()
    ]
    parts += [part for one in colored for part in _parts(one)]
    pairs = {}
    for one, other, correlation in _pairs(records):
        pairs[one.channel.name, other.channel.name] = correlation
        size = np.sqrt(one.process.variance * other.process.variance)
        both = one.shared_with(other)
        both = size * (both + both.T)
        M = M + correlation * both
        parts.append(np.sqrt((1 + correlation**2) / one.n) * both)
    return Noise(M, np.array(parts).reshape(-1, *M.shape), white, [one.order for one in records], pairs)


def _variances(records: list[_Record]) -> dict[str, tuple[float, float]]:
    """Of each group the variance r'r/(n - p), where p is what parameters take of its degrees of freedom, and these."""
    found = {}
    for group in dict.fromkeys(one.channel.group for one in records):
        members = [one for one in records if one.channel.group == group]
        freedom = max(sum(one.n - one.taken for one in members), 1e-3)
        found[group] = (float(sum(one.r @ one.r for one in members)) / freedom, freedom)
    return found


def _parts(one: _Record) -> list[np.ndarray]:
    """Changes of Q' Omega Q with the variance and with phi, whose covariance is that of Yule and Walker, variance/n Gamma^-1."""
    from scipy.linalg import toeplitz

    process, q = one.process, one.order
    spread = np.linalg.cholesky(np.linalg.inv(toeplitz(autocovariances(process, q))) * process.variance / one.n)
    parts = [np.sqrt(2 / max(one.n - one.taken - q, 1.0)) * one.made_of(process)]
    for change in STEP * spread.T:
        ends = [one.made_of(Autoregression(process.phi + sign * change, process.variance)) for sign in (1, -1)]
        parts.append((ends[0] - ends[1]) / (2 * STEP))
    return parts


def _pairs(records: list[_Record]) -> list[tuple[_Record, _Record, float]]:
    """Pairs of channels sampled together, where the innovations of any of these are correlated by more than chance."""
    found = []
    together: dict[tuple[str, bytes], list[_Record]] = {}
    for one in records:
        if one.channel.series and one.n >= FEWEST and one.process.variance > 0:
            together.setdefault((one.channel.run, one.channel.times.tobytes()), []).append(one)
    for members in together.values():
        if len(members) < 2:
            continue
        E = np.array([innovations(one.process, one.r) for one in members])
        rho = np.corrcoef(E)
        i, j = np.triu_indices(len(members), 1)
        n = members[0].n
        if n * np.max(rho[i, j] ** 2) > np.log(n) + 2 * np.log(len(i)):
            found += [(members[a], members[b], float(rho[a, b])) for a, b in zip(i, j, strict=True)]
    return found
