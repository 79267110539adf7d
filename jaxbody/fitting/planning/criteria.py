"""Criteria of a design of experiments: functions of the covariance of the parameters that count,
which are to be minimized.

    C = K' M^-1 K,    M the information, K the columns of the identity of the parameters that count
    D    log det C                   the volume of the confidence ellipsoid
    A    tr C                        the mean of the squared standard errors
    E    largest eigenvalue of C     the longest axis of the ellipsoid
    largest interval    sqrt(max C_ii)

All are convex in M; E and D, A as in F. Pukelsheim, Optimal Design of Experiments, SIAM 2006.
"""

from typing import Any

import numpy as np

from jaxbody.core.arrays import module_of

KINDS = ("D", "A", "E", "largest interval")
POWER = 16  # of the means in place of largest numbers


def criterion(M: Any, kind: str = "D", of: Any = None) -> Any:
    """Return the criterion of an information matrix M (..., p, p), to be minimized, in plain JAX or
    NumPy.

    Args:
        M: J'J of a Jacobian J (rows, p) whose rows are divided by the noise.
        kind: "D", "A", "E" or "largest interval".
        of: indices of the parameters that count; None: all.

    It is infinite where M does not determine the parameters.

    >>> line = jnp.stack([jnp.ones(2), jnp.array([-1.0, 1.0])], 1)  # y = a + b x at x = -1 and 1
    >>> float(jb.fitting.criterion(line.T @ line, "A"))
    1.0
    """
    C = covariance(M, of)
    xp = module_of(C)
    if kind == "D":
        return xp.linalg.slogdet(C)[1]
    if kind == "E":
        return xp.linalg.eigvalsh(C)[..., -1]
    squares = xp.diagonal(C, axis1=-2, axis2=-1)
    return squares.sum(-1) if kind == "A" else xp.sqrt(squares.max(-1))


def covariance(M: Any, of: Any = None) -> Any:
    """Return C = K' M^-1 K."""
    xp = module_of(M)
    K = xp.eye(M.shape[-1], dtype=M.dtype)[:, slice(None) if of is None else of]
    return K.T @ xp.linalg.solve(M, xp.broadcast_to(K, (*M.shape[:-2], *K.shape)))


def smooth(M: np.ndarray, kind: str, of: Any) -> Any:
    """Return the criterion (..., p, p) -> (...), with power means in place of largest numbers:

    (tr C^q)^(1/q) for E,    sqrt((sum of C_ii^q)^(1/q)) for the largest interval"""
    if kind in ("D", "A"):
        return criterion(M, kind, of)
    x = _squares(covariance(M, of), kind)[0]
    most = x.max(-1)
    mean = most * ((x / most[..., None]) ** POWER).sum(-1) ** (1 / POWER)
    return mean if kind == "E" else np.sqrt(mean)


def tangent(M: np.ndarray, kind: str, of: Any) -> tuple[Any, np.ndarray]:
    """Return a and G (..., p, p), so that a + tr(G (X - M)) is at most the criterion at any X, for
    the largest interval at most its square.

    With weights W of trace one, tr(W C) is at most the largest eigenvalue of C, or the largest
    element of its diagonal, and convex in M; W is close to the best for the power means."""
    K = np.eye(M.shape[-1])[:, of]
    half = np.linalg.solve(M, np.broadcast_to(K, (*M.shape[:-2], *K.shape)))
    C = K.T @ half
    if kind == "D":
        a, W = np.linalg.slogdet(C)[1], np.linalg.inv(C)
    else:
        x, V = _squares(C, kind)
        w = (x / x.max(-1, keepdims=True)) ** (POWER - 1)
        w = np.ones_like(x) if kind == "A" else w / w.sum(-1, keepdims=True)
        a, W = (w * x).sum(-1), (V * w[..., None, :]) @ np.swapaxes(V, -1, -2)
    return a, -half @ W @ np.swapaxes(half, -1, -2)


def _squares(C: np.ndarray, kind: str) -> tuple[np.ndarray, np.ndarray]:
    """Return the numbers of which the criterion takes the sum or the largest, with their axes."""
    if kind == "E":
        return np.linalg.eigh(C)
    return np.diagonal(C, axis1=-2, axis2=-1), np.broadcast_to(np.eye(C.shape[-1]), C.shape)
