"""Uncertainty of estimates: covariance from the Jacobian and the estimated noise, quantiles, and
descriptions of what the data do not determine.

    J = Q R,    covariance of u = R^-1 M R^-T

M is the covariance of Q'e (`noises`); for white noise of one level it is s^2 I with
s^2 = r'r/(samples - parameters).
An estimated variance v has 2 v^2/var(v) degrees of freedom (F. E. Satterthwaite, Biometrics
Bull. 2 (1946) 110); intervals use Student's t with this number.
Directions of u with a negligible singular value do not change the readings. Parameters that such a
direction changes have no standard error. A parameter at its bound has none either; the others are
estimated with it fixed there.
"""

from typing import Any

import equinox as eqx
import numpy as np

from jaxbody.core.errors import JaxbodyError, Problem
from jaxbody.fitting.statistics.autocorrelations import Whiteness, whiteness
from jaxbody.fitting.statistics.noises import LEAST, Noise, ResidualSeries, noise_of


def quantile(level: float, freedom: Any, *, sides: int = 2) -> np.ndarray:
    """Return the quantile of Student's t for a confidence level with `freedom` degrees of freedom,
    for two-sided intervals by default."""
    from scipy.special import stdtrit  # as scipy.stats, which takes 0.4 s to import, does

    return np.asarray(stdtrit(freedom, 1 - (1 - level) / sides))


def check_level(level: float, where: str) -> None:
    """Check that a confidence level is between 0 and 1. Error: BAD_LEVEL."""
    if not 0 < level < 1:
        raise JaxbodyError(
            Problem(
                "BAD_LEVEL", where, f"is {level}", level, "between 0 and 1", "Give 0.95 for 95 %."
            )
        )


CORRELATED = 0.1  # lag-one correlation of residuals that is reported, if it is also significant
SIGNIFICANT = 3.0  # standard deviations of the pooled lag-one correlation of white noise
TOGETHER = 0.3  # correlation of two records that is reported
# probability of residuals this large, given the stated noise, below which they are reported
UNLIKELY = 1e-3
ZERO = 1e-13  # eigenvalue of a covariance, relative to the largest, that is round-off
LESS = 0.99  # of a standard error: a measurement that leaves more of it does not help
RANK = 1e-6  # singular values of the scaled Jacobian, relative to the largest, that count as zero


class Uncertainty(eqx.Module):
    """The uncertainty of a fit.

    `covariance`: covariance of u; `white_covariance`: the same for white noise; `parts`: changes of
    the covariance for standard errors of the noise estimates; `singular_values`, `rank`, `null`:
    singular values of the scaled Jacobian, the number that are not zero, and null directions, which
    `words` describes; `ineffective`: parameters without effect on the data. `whiteness`: test of
    the residuals of each record; `orders`: orders of the autoregressions; `correlation`: pooled
    correlation of residuals at lag one; `pairs`: correlations between records. `at_bounds` {index
    of a u at its bound: slope of the cost, its curvature with all others free, standard error
    without the bound, degrees of freedom}. `beyond_stated`: ratio of residuals to the stated noise
    where they exceed it."""

    covariance: np.ndarray
    white_covariance: np.ndarray
    parts: np.ndarray
    null: np.ndarray
    slopes: list[np.ndarray]
    standard_errors: dict[str, np.ndarray]
    singular_values: np.ndarray
    rank: int
    words: list[str]
    ineffective: list[str]
    correlation: float
    correlated: bool
    whiteness: dict[str, Whiteness | None]
    orders: dict[str, int]
    pairs: dict[tuple[str, str], float]
    at_bounds: dict[int, tuple[float, float, float, float]]
    beyond_stated: dict[str, float]
    samples: int

    def spread(self, G: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return standard errors, infinite where not determined, and degrees of freedom of numbers
        whose gradients in u are the rows of G."""
        return _spread(G, self.covariance, self.parts, self.null)

    @property
    def factor(self) -> float:
        """Ratio of the standard error to that for white noise, for the parameter with the largest
        difference."""
        ratio = np.sqrt(
            np.diag(self.covariance)[self._positive]
            / np.diag(self.white_covariance)[self._positive]
        )
        return float(ratio[np.argmax(np.abs(np.log(ratio)))]) if ratio.size else 1.0

    @property
    def _positive(self) -> np.ndarray:
        return (np.diag(self.covariance) > 0) & (np.diag(self.white_covariance) > 0)

    @property
    def noise(self) -> str:
        """The model of the noise in the standard errors."""
        if not self.orders:
            return "noise as stated"
        return (
            f"noise autoregressive of order {self._order}"
            if any(self.orders.values())
            else "noise white"
        )

    @property
    def _order(self) -> str:
        """The orders of the autoregressions, in words."""
        low, high = min(self.orders.values()), max(self.orders.values())
        return f"{low}" if low == high else f"{low} to {high}" if low else f"up to {high}"

    def _effect_of_correlation(self) -> str:
        """Describe the effect of correlated residuals on standard errors."""
        if not any(self.orders.values()):
            return (
                ", but no autoregression describes them better than white noise, which "
                "standard errors assume"
            )
        size = max(self.factor, 1 / self.factor)
        if f"{size:.2g}" == "1":
            return (
                f"; standard errors, which assume autoregressions of order {self._order}, are "
                "those of white noise"
            )
        error = f"{size:.2g} times too {'small' if self.factor > 1 else 'large'}"
        return (
            f": standard errors for white noise would be up to {error}; these assume "
            f"autoregressions of order {self._order}"
        )

    def about_noise(self) -> list[str]:
        """Return remarks on residuals that differ from white noise of the stated level."""
        remarks = []
        if self.correlated:
            remarks.append(
                "residuals are correlated (lag one "
                f"{self.correlation:.2f}){self._effect_of_correlation()}"
            )
        if max((abs(x) for x in self.pairs.values()), default=0.0) > TOGETHER:
            (one, other), most = max(self.pairs.items(), key=lambda pair: abs(pair[1]))
            remarks.append(
                f"residuals of channels are correlated, most strongly {one} with {other} "
                f"({most:.2f}); standard errors include this"
            )
        excesses = [f"{name} {ratio:.2g} times" for name, ratio in self.beyond_stated.items()]
        if excesses:
            remarks.append(
                "residuals exceed the stated noise, which standard errors assume: "
                f"{', '.join(excesses)}"
            )
        return remarks


def _spread(
    G: np.ndarray, covariance: np.ndarray, parts: np.ndarray, null: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    v = np.einsum("ij,ij->i", G @ covariance, G)
    changes = np.einsum("lij,ij->li", G @ parts, G)
    with np.errstate(divide="ignore", invalid="ignore"):
        freedom = np.where(v > 0, 2 * v**2 / (changes**2).sum(0), np.inf)
    size = np.linalg.norm(G, axis=1)
    # a smaller component in a null direction is round-off
    undetermined = np.linalg.norm(G @ null, axis=1) > 1e-3 * np.where(size > 0, size, 1)
    return np.where(undetermined, np.inf, np.sqrt(np.maximum(v, 0.0))), np.maximum(freedom, 1.0)


def decomposed(J: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return U, S, V' of J = U S V' with a square V', and which of S differ from zero."""
    # with fewer residuals than parameters, some directions are not determined
    few = np.zeros((max(J.shape[1] - J.shape[0], 0), J.shape[1]))
    U, S, Vt = np.linalg.svd(np.concatenate([J, few]), full_matrices=False)
    return U[: len(J)], S, Vt, RANK * S.max(initial=0.0) < S


def information_of(J: np.ndarray, noise: Any) -> np.ndarray:
    """Return J'J over the square of the noise; zero if it is not finite, as of what has no
    derivatives or no noise."""
    with np.errstate(divide="ignore", invalid="ignore"):
        rows = J / noise
    return rows.T @ rows if np.isfinite(rows).all() else np.zeros(2 * (J.shape[1],))


def scaled_eigenvalues(M: np.ndarray, total: np.ndarray) -> tuple[np.ndarray, ...]:
    """Return eigenvalues and eigenvectors of the information M, in scales of u that are returned
    too, and which eigenvalues differ from zero. `total`: information whose diagonal gives the
    scales."""
    size = np.sqrt(np.where(np.diag(total) > 0, np.diag(total), 1.0))
    S, V = np.linalg.eigh(M / np.outer(size, size))
    return S, V, size, RANK**2 * S.max(initial=0.0) < S


def errors_of(M: np.ndarray, total: np.ndarray) -> np.ndarray:
    """Return the standard errors of u by the information M, infinite where it does not determine
    them; `total` as in `scaled_eigenvalues`."""
    S, V, size, known = scaled_eigenvalues(M, total)
    errors = np.sqrt((V[:, known] ** 2 / S[known]).sum(1)) / size
    return np.where((V[:, ~known] ** 2).sum(1) > RANK, np.inf, errors)


def unknown_and_largest(errors: np.ndarray) -> tuple[int, float]:
    """Return the number of infinite standard errors and the largest of the others; the smaller this
    pair, the better a measurement."""
    finite = np.isfinite(errors)
    return int((~finite).sum()), float(errors[finite].max(initial=0.0))


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
    """Return the uncertainty of estimates.

    Args:
        r: residuals, in units of their noise
        J: Jacobian of r with respect to the unknowns u
        slopes: derivatives of the leaves with respect to u
        paths: names of the leaves
        labels: names of the unknowns
        records: series of residuals in r
        inside: False for unknowns at a bound; None: all True
        ended: True for unknowns at the end of their domain, where they have no effect
        exact: norm of r up to which residuals are round-off
    """
    J = np.where(ended, 0.0, J)
    inside = np.ones(J.shape[1], bool) if inside is None else np.asarray(inside)
    U, S, Vt, known = decomposed(J)
    null = np.concatenate([Vt[~known].T, np.eye(J.shape[1])[:, ~inside]], axis=1)
    noise, back = _noise_and_map(
        r, inside, records, (U, S, Vt, known) if inside.all() else decomposed(J[:, inside])
    )
    covariance, white, *changes = (back @ M @ back.T for M in (noise.M, noise.white, *noise.parts))
    parts = np.reshape(changes, (len(changes), *covariance.shape))
    ineffective = [
        label
        for label, silent in zip(labels, ~J.any(0) & ~np.asarray(ended), strict=True)
        if silent
    ]
    correlation, significant = lag_one(r, U[:, known], records)
    return Uncertainty(
        covariance=covariance,
        white_covariance=white,
        parts=parts,
        null=null,
        slopes=slopes,
        standard_errors={
            path: _spread(G.reshape(-1, len(S)), covariance, parts, null)[0].reshape(G.shape[:-1])
            for path, G in zip(paths, slopes, strict=True)
        },
        singular_values=S,
        rank=int(known.sum()),
        words=in_words(np.where(ended, 0.0, Vt[~known]).T, labels, ineffective),
        ineffective=ineffective,
        correlation=correlation,
        correlated=significant and bool(r @ r > exact**2),
        whiteness={c.name: whiteness(r[c.rows]) if c.series else None for c in records},
        orders=noise.orders,
        pairs=noise.pairs,
        at_bounds=_at_bounds(r, J, inside, records),
        beyond_stated=_beyond_stated(r, U[:, known], records),
        samples=sum(len(c.rows) for c in records),
    )


def _noise_and_map(r, inside, records: list[ResidualSeries], parts) -> tuple[Noise, np.ndarray]:
    """Return the noise in Q'e and its linear map to u, for the columns of J that are `inside`, with
    their decomposition `parts`."""
    U, S, Vt, known = parts
    back = np.zeros((len(inside), known.sum()))
    back[inside] = Vt[known].T / S[known]
    return noise_of(r, U[:, known], records), back


def _beyond_stated(r: np.ndarray, Q: np.ndarray, records: list[ResidualSeries]) -> dict[str, float]:
    from scipy.special import chdtrc

    ratios = {}
    for record in (record for record in records if record.known):
        square, freedom = (
            float(r[record.rows] @ r[record.rows]),
            len(record.rows) - float(np.sum(Q[record.rows] ** 2)),
        )
        if freedom > LEAST and chdtrc(freedom, square) < UNLIKELY:
            ratios[record.name] = np.sqrt(square / freedom)
    return ratios


def _at_bounds(
    r, J, inside, records: list[ResidualSeries]
) -> dict[int, tuple[float, float, float, float]]:
    at_bounds = {}
    for i in np.flatnonzero(~inside & J.any(0)):
        one = inside.copy()
        one[i] = True
        noise, back = _noise_and_map(r, one, records, decomposed(J[:, one]))
        parts = np.reshape([back @ M @ back.T for M in noise.parts], (-1, J.shape[1], J.shape[1]))
        (error,), (freedom,) = _spread(
            np.eye(J.shape[1])[[i]], back @ noise.M @ back.T, parts, np.zeros((J.shape[1], 0))
        )
        curvature = 1 / float((back @ back.T)[i, i])
        at_bounds[int(i)] = (float(J[:, i] @ r), curvature, float(error), float(freedom))
    return at_bounds


def in_words(null: np.ndarray, labels: list[str], ineffective: list[str]) -> list[str]:
    """Describe null directions, as "AB.stiffness up with CD.stiffness down". Elimination finds
    directions with few parameters in each; if components are equal up to round-off, the first is
    the pivot."""
    words = [f"{label} has no effect on the data" for label in ineffective]
    moving = [i for i, label in enumerate(labels) if label not in ineffective]
    for row in _echelon(null[moving].T):
        parts = [
            (labels[moving[i]], row[i])
            for i in np.argsort(-_size(row), kind="stable")
            if abs(row[i]) > 0.02 * np.abs(row).max()
        ]
        first = np.sign(parts[0][1])
        words.append(
            " with ".join(f"{label} {'up' if x * first > 0 else 'down'}" for label, x in parts[:8])
            + (f" and {len(parts) - 8} more" if len(parts) > 8 else "")
        )
    return words


def _size(x: np.ndarray) -> np.ndarray:
    return np.round(np.abs(x), 6)


def _echelon(rows: np.ndarray) -> np.ndarray:
    """Return the reduced echelon form of the span of rows, by elimination with complete pivoting;
    negligible rows are dropped."""
    A = rows.copy()
    done: list[int] = []
    while A.size and len(done) < len(A):
        size = _size(A)
        size[done] = -1.0
        i, j = np.unravel_index(np.argmax(size), A.shape)
        if abs(A[i, j]) < 1e-3:
            break
        A[i] /= A[i, j]
        others = np.arange(len(A)) != i
        A[others] -= np.outer(A[others, j], A[i])
        done.append(int(i))
    return A[sorted(done)]


def lag_one(r: np.ndarray, Q: np.ndarray, records: list[ResidualSeries]) -> tuple[float, bool]:
    """Return the pooled lag-one correlation of all records, and whether it is significant and above
    CORRELATED.

    It is compared with that of white noise after a fit, (I - QQ')e, because a fit of many
    parameters leaves white noise correlated."""
    series = [(r[c.rows], Q[c.rows]) for c in records if c.series and r[c.rows].any()]
    n = sum(len(x) for x, _ in series)
    if n == 0:
        return 0.0, False
    pooled = sum(float(x[1:] @ x[:-1]) / float(x @ x) * len(x) for x, _ in series) / n
    by_fit = (
        sum(
            float(np.sum(q[1:] * q[:-1])) / max(len(x) - float(np.sum(q**2)), LEAST) * len(x)
            for x, q in series
        )
        / n
    )
    return pooled, bool(abs(pooled + by_fit) > max(CORRELATED, SIGNIFICANT / np.sqrt(n)))
