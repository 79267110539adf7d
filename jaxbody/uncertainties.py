"""What an estimate is worth: covariance from the Jacobian, and in words what the data cannot tell.

    covariance of u = s^2 (J'J)^-1,   s^2 = r'r/(samples - parameters)

Directions of u whose singular value vanishes against the largest leave the readings as they are; no number is given for what they touch.
"""

from __future__ import annotations

from typing import Any

import equinox as eqx
import numpy as np

CORRELATED = 0.2  # lag-one correlation of residuals that is told, if it is also significant
TOUCHED = 1e-3  # share of a null direction that makes a parameter undetermined
RANK = 1e-6  # singular values of the scaled Jacobian, relative to the largest, that count as zero


class Uncertainty(eqx.Module):
    """The worth of a fit."""

    covariance: np.ndarray
    standard_errors: dict[str, np.ndarray]
    singular_values: np.ndarray
    rank: int
    words: list[str]
    still: list[str]
    correlation: float
    correlated: bool
    samples: int


def known_directions(S: np.ndarray) -> np.ndarray:
    """Which singular values of the Jacobian in u are more than none."""
    return RANK * S.max(initial=0.0) < S


def assess(r, J, slopes: list[np.ndarray], paths: list[str], labels: list[str], residuals: dict, present: dict) -> Uncertainty:
    """From residuals r and Jacobian J in u, and the slopes of each leaf in u, what is known how well."""
    few = np.zeros((max(J.shape[1] - J.shape[0], 0), J.shape[1]))  # fewer residuals than parameters leave directions unknown too
    _, S, Vt = np.linalg.svd(np.concatenate([J, few]), full_matrices=False)
    known = known_directions(S)
    null = Vt[~known].T
    samples = int(sum(there.sum() for run in present.values() for there in run.values()))
    s2 = float(r @ r) / max(samples - int(known.sum()), 1)
    covariance = s2 * (Vt[known].T / S[known] ** 2) @ Vt[known]
    errors = {}
    for path, G in zip(paths, slopes, strict=True):
        G2 = G.reshape(-1, len(S))
        error = np.sqrt(np.einsum("ij,jk,ik->i", G2, covariance, G2))
        size = np.linalg.norm(G2, axis=1)
        touched = np.linalg.norm(G2 @ null, axis=1) > TOUCHED * np.where(size > 0, size, 1)
        errors[path] = np.where(touched, np.inf, error).reshape(G.shape[:-1])
    still = [label for label, silent in zip(labels, ~J.any(0), strict=True) if silent]
    correlation, significant = lag_one(residuals, present)
    return Uncertainty(covariance, errors, S, int(known.sum()), in_words(null, labels, still), still, correlation, significant, samples)


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


def lag_one(residuals: dict[str, dict[str, Any]], present: dict[str, dict[str, np.ndarray]]) -> tuple[float, bool]:
    """The lag-one correlation of all residuals, pooled, and whether it is more than chance and CORRELATED."""
    top = bottom = 0.0
    pairs = 0
    for run, sensors in residuals.items():
        for name, values in sensors.items():
            r = np.asarray(values).reshape(len(values), -1)
            whole = np.asarray(present[run][name].reshape(len(values), -1).all(axis=1))
            both = whole[1:] & whole[:-1]
            top += float((r[1:] * r[:-1])[both].sum())
            bottom += float((r[whole] ** 2).sum())
            pairs += int(both.sum()) * r.shape[1]
    if bottom == 0 or pairs == 0:
        return 0.0, False
    correlation = top / bottom
    return correlation, bool(abs(correlation) > max(CORRELATED, 4 / np.sqrt(pairs)))
