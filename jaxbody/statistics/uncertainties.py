"""What an estimate is worth: covariance from the Jacobian and the noise that residuals show, and in words what the data cannot tell.

    J = Q R,    covariance of u = R^-1 M R^-T,    M the covariance of Q'e (`noises`): s^2 I for one white noise, s^2 = r'r/(samples - parameters)

A variance v that is known from few numbers has 2 v^2/var(v) degrees of freedom (F. E. Satterthwaite, Biometrics Bull. 2 (1946) 110), those of
Student's t in intervals. Directions of u whose singular value vanishes against the largest leave the readings as they are; no number is
given for what they touch, nor for a parameter at its bound, which the others are estimated with.
"""

from __future__ import annotations

from dataclasses import replace

import equinox as eqx
import numpy as np

from jaxbody.statistics.autocorrelations import Whiteness, whiteness
from jaxbody.statistics.noises import LEAST, Noise, ResidualSeries, noise_of

CORRELATED = 0.1  # lag-one correlation of residuals that is told, if it is also significant
SIGNIFICANT = 3.0  # standard deviations of the pooled lag-one correlation of white noise
TOGETHER = 0.3  # correlation of two records that is told
TOUCHED = 1e-3  # share of a null direction that makes a parameter undetermined
UNLIKELY = 1e-3  # chance of residuals beyond their stated noise that is told
RANK = 1e-6  # singular values of the scaled Jacobian, relative to the largest, that count as zero


class Uncertainty(eqx.Module):
    """The worth of a fit: `covariance` of u and what it would be if noise were white; `parts`, by how much it changes with the standard errors of
    the numbers that it is made of; singular values, rank, null directions in `words`, parameters that stand `still`; how residuals of
    channels are correlated in time (`whiteness`, `orders` of autoregressions, pooled `correlation` at lag one) and with one another (`pairs`); of a u `pressed` to its bound the slope of the
    cost, its curvature with all others following, and the standard error, with its degrees of freedom, that it would have without the bound;
    of records whose stated noise is taken as known, and whose residuals are more, how many times more (`beyond_stated`)."""

    covariance: np.ndarray
    white_covariance: np.ndarray
    parts: np.ndarray
    null: np.ndarray
    slopes: list[np.ndarray]
    standard_errors: dict[str, np.ndarray]
    singular_values: np.ndarray
    rank: int
    words: list[str]
    still: list[str]
    correlation: float
    correlated: bool
    whiteness: dict[str, Whiteness | None]
    orders: dict[str, int]
    pairs: dict[tuple[str, str], float]
    pressed: dict[int, tuple[float, float, float, float]]
    beyond_stated: dict[str, float]
    samples: int

    def spread(self, G: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Standard errors, infinite where the data cannot tell, and degrees of freedom of numbers whose slopes in u are the rows of G."""
        error, freedom = _spread(G, self.covariance, self.parts)
        size = np.linalg.norm(G, axis=1)
        touched = np.linalg.norm(G @ self.null, axis=1) > TOUCHED * np.where(size > 0, size, 1)
        return np.where(touched, np.inf, error), freedom

    @property
    def factor(self) -> float:
        """Standard errors over those for white noise: of the parameter for which they differ most."""
        ratio = np.sqrt(np.diag(self.covariance)[self._told] / np.diag(self.white_covariance)[self._told])
        return float(ratio[np.argmax(np.abs(np.log(ratio)))]) if ratio.size else 1.0

    @property
    def _told(self) -> np.ndarray:
        return (np.diag(self.covariance) > 0) & (np.diag(self.white_covariance) > 0)

    @property
    def noise(self) -> str:
        """What standard errors take the noise for."""
        if not self.orders:
            return "noise as stated"
        return f"noise autoregressive of order {self._order}" if any(self.orders.values()) else "noise white"

    @property
    def _order(self) -> str:
        """Of the autoregressions of records that are not white."""
        low, high = min(self.orders.values()), max(self.orders.values())
        return f"{low}" if low == high else f"{low} to {high}" if low else f"up to {high}"

    def _what_of_it(self) -> str:
        """What standard errors make of correlated residuals."""
        if not any(self.orders.values()):
            return ", but no autoregression describes them better than white noise, which standard errors are of"
        size = max(self.factor, 1 / self.factor)
        if f"{size:.2g}" == "1":
            return f"; standard errors, which take autoregressions of order {self._order}, are those of white noise"
        way = "small" if self.factor > 1 else "large"
        return f": standard errors for white noise would be up to {size:.2g} times too {way}; these take autoregressions of order {self._order}"

    def about_noise(self) -> list[str]:
        """What residuals show that white noise would not, in words."""
        said = []
        if self.correlated:
            said.append(f"residuals are correlated (lag one {self.correlation:.2f}){self._what_of_it()}")
        if max((abs(x) for x in self.pairs.values()), default=0.0) > TOGETHER:
            (one, other), most = max(self.pairs.items(), key=lambda pair: abs(pair[1]))
            said.append(f"residuals of channels go together, most {one} with {other} ({most:.2f}); standard errors take it into account")
        told = [f"{name} {ratio:.2g} times" for name, ratio in self.beyond_stated.items()]
        if told:
            said.append(f"residuals exceed the stated noise, which standard errors are of: {', '.join(told)}")
        return said


def _spread(G: np.ndarray, covariance: np.ndarray, parts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    v = np.einsum("ij,ij->i", G @ covariance, G)
    changes = np.einsum("lij,ij->li", G @ parts, G)
    with np.errstate(divide="ignore", invalid="ignore"):
        freedom = np.where(v > 0, 2 * v**2 / (changes**2).sum(0), np.inf)
    return np.sqrt(np.maximum(v, 0.0)), np.maximum(freedom, 1.0)


def known_directions(S: np.ndarray) -> np.ndarray:
    """Which singular values of the Jacobian in u are more than none."""
    return RANK * S.max(initial=0.0) < S


def decomposed(J: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """J = U S V', a V' that is square, and which of S are known."""
    few = np.zeros((max(J.shape[1] - J.shape[0], 0), J.shape[1]))  # fewer residuals than parameters leave directions unknown too
    U, S, Vt = np.linalg.svd(np.concatenate([J, few]), full_matrices=False)
    return U[: len(J)], S, Vt, known_directions(S)


def assess(
    r,
    J,
    slopes: list[np.ndarray],
    paths: list[str],
    labels: list[str],
    records: list[ResidualSeries],
    *,
    inside=None,
    ended=False,
    exact=0.0,
) -> Uncertainty:
    """From residuals r and Jacobian J in u, the slopes of each leaf in u and the records that r is made of, what is known how well.

    inside: which u are at no bound; ended: which went to the end of their domain, where nothing moves them; exact: a norm of r that is no noise."""
    J = np.where(ended, 0.0, J)
    inside = np.ones(J.shape[1], bool) if inside is None else np.asarray(inside)
    U, S, Vt, known = decomposed(J)
    null = np.concatenate([Vt[~known].T, np.eye(J.shape[1])[:, ~inside]], axis=1)
    noise, back = _carried(r, inside, records, (U, S, Vt, known) if inside.all() else decomposed(J[:, inside]))
    covariance, white, *parts = (back @ M @ back.T for M in (noise.M, noise.white, *noise.parts))
    still = [label for label, silent in zip(labels, ~J.any(0) & ~np.asarray(ended), strict=True) if silent]
    tests = {c.name: whiteness(r[c.rows]) if c.series else None for c in records}
    correlation, significant = lag_one(r, U[:, known], records)
    found = Uncertainty(
        covariance, white, np.reshape(parts, (len(parts), *covariance.shape)), null, slopes, {}, S, int(known.sum()),
        in_words(np.where(ended, 0.0, Vt[~known]).T, labels, still), still, correlation, significant and bool(r @ r > exact**2), tests,
        noise.orders, noise.pairs, _pressed(r, J, inside, records), _beyond_stated(r, U[:, known], records), sum(len(c.rows) for c in records),
    )  # fmt: skip
    errors = {path: found.spread(G.reshape(-1, len(S)))[0].reshape(G.shape[:-1]) for path, G in zip(paths, slopes, strict=True)}
    return replace(found, standard_errors=errors)


def _carried(r, inside, records: list[ResidualSeries], parts) -> tuple[Noise, np.ndarray]:
    """The noise in Q' r, of the columns of J inside with their `parts`, and what carries it to u."""
    U, S, Vt, known = parts
    back = np.zeros((len(inside), known.sum()))
    back[inside] = Vt[known].T / S[known]
    return noise_of(r, U[:, known], records), back


def _beyond_stated(r: np.ndarray, Q: np.ndarray, records: list[ResidualSeries]) -> dict[str, float]:
    from scipy.stats import chi2

    found = {}
    for record in (record for record in records if record.known):
        square, freedom = float(r[record.rows] @ r[record.rows]), len(record.rows) - float(np.sum(Q[record.rows] ** 2))
        if freedom > LEAST and chi2.sf(square, freedom) < UNLIKELY:
            found[record.name] = np.sqrt(square / freedom)
    return found


def _pressed(r, J, inside, records: list[ResidualSeries]) -> dict[int, tuple[float, float, float, float]]:
    found = {}
    for i in np.flatnonzero(~inside & J.any(0)):
        one = inside.copy()
        one[i] = True
        noise, back = _carried(r, one, records, decomposed(J[:, one]))
        parts = np.reshape([back @ M @ back.T for M in noise.parts], (-1, J.shape[1], J.shape[1]))
        error, freedom = _spread(np.eye(J.shape[1])[[i]], back @ noise.M @ back.T, parts)
        curvature = 1 / float((back @ back.T)[i, i])
        found[int(i)] = (float(J[:, i] @ r), curvature, float(error[0]), float(freedom[0]))
    return found


def in_words(null: np.ndarray, labels: list[str], still: list[str]) -> list[str]:
    """Null directions as "AB.stiffness up with CD.stiffness down", made as sparse as elimination makes them."""
    words = [f"{label} has no effect on the data" for label in still]
    moving = [i for i, label in enumerate(labels) if label not in still]
    for row in _echelon(null[moving].T):
        parts = [(labels[moving[i]], row[i]) for i in np.argsort(-np.abs(row), kind="stable") if abs(row[i]) > 0.02 * np.abs(row).max()]
        first = np.sign(parts[0][1])
        words.append(
            " with ".join(f"{label} {'up' if x * first > 0 else 'down'}" for label, x in parts[:8])
            + (f" and {len(parts) - 8} more" if len(parts) > 8 else "")
        )
    return words


def _echelon(rows: np.ndarray) -> np.ndarray:
    """The reduced echelon form of the span of rows, by elimination with complete pivoting; rows of noise are dropped."""
    A = rows.copy()
    done: list[int] = []
    while A.size and len(done) < len(A):
        left = [i for i in range(len(A)) if i not in done]
        i, j = np.unravel_index(np.argmax(np.abs(A[left])), A[left].shape)
        i = left[i]
        if abs(A[i, j]) < 1e-3:
            break
        A[i] /= A[i, j]
        for other in range(len(A)):
            if other != i:
                A[other] -= A[other, j] * A[i]
        done.append(i)
    return A[sorted(done)]


def lag_one(r: np.ndarray, Q: np.ndarray, records: list[ResidualSeries]) -> tuple[float, bool]:
    """The lag-one correlation of all records, pooled, and whether it is more than chance and CORRELATED beyond that of white noise without
    what the fit has taken, (I - QQ')e: many parameters leave white noise correlated."""
    series = [(r[c.rows], Q[c.rows]) for c in records if c.series and r[c.rows].any()]
    n = sum(len(x) for x, _ in series)
    if n == 0:
        return 0.0, False
    found = sum(float(x[1:] @ x[:-1]) / float(x @ x) * len(x) for x, _ in series) / n
    taken = sum(float(np.sum(q[1:] * q[:-1])) / max(len(x) - float(np.sum(q**2)), LEAST) * len(x) for x, q in series) / n
    return found, abs(found + taken) > max(CORRELATED, SIGNIFICANT / np.sqrt(n))
