"""Poles of responses for growing orders of a rational function, and those that are stable: the
least-squares complex frequency method for several inputs (pLSCF, "PolyMAX").

    H(f) = B(z) A(z)^-1,   A(z) = 1 + A_1 z + ... + A_n z^n,   z = e^(i angle(f))

The linearized error B - H A, weighted by the random error of H, is least squares in the
coefficients. With the B of each output eliminated,

    sum over outputs of (T - S^H R^-1 S) (A_0 ... A_n)' = 0,   R = X^H X, S = X^H Y, T = Y^H Y,
    X = (1 z ... z^n)/error,   Y = -(1 z ... z^n) x H/error

Poles are the roots of det A, participation factors w solve w' A(p) = 0. Complex coefficients allow
any band.

Source: B. Peeters, H. Van der Auweraer, P. Guillaume, J. Leuridan, Shock and Vibration 11 (2004)
395.
"""

from typing import NamedTuple

import numpy as np

from jaxbody.fitting.modal.pole_functions import damping_ratio_of, frequency_of

ARC = 0.9  # part of the circle that the band takes
# changes from one order to the next, up to which a pole is stable
FREQUENCY, DAMPING, SHAPE = 0.01, 0.1, 0.95
DAMPED = 0.3  # largest damping ratio of a pole that is kept
LEAST = 5  # orders through which a pole has to be stable
SKIPPED = 2  # orders among which the predecessor of a pole is looked for


class Diagram(NamedTuple):
    """A stabilization diagram: for each pole its `order`, `poles` [rad/s], participation factors,
    whether it is `stable` and the `chain` of stable poles to which it belongs (-1: none)."""

    order: np.ndarray
    poles: np.ndarray
    participation: np.ndarray
    stable: np.ndarray
    chain: np.ndarray

    @property
    def frequency(self) -> np.ndarray:
        return frequency_of(self.poles)

    @property
    def damping_ratio(self) -> np.ndarray:
        return damping_ratio_of(self.poles)


def diagram(f: np.ndarray, H: np.ndarray, spread: np.ndarray, orders: np.ndarray) -> Diagram:
    """Return the poles of responses H (nf, ny, nu) with standard deviations, for each order."""
    nf, ny, nu = H.shape
    n = int(orders[-1])
    width = f[-1] - f[0]
    angle = 2 * np.pi * (ARC * (f - f[0]) / width + (1 - ARC) / 2)
    powers = np.exp(1j * angle[:, None] * np.arange(n + 1))  # (nf, n + 1)
    R, S, T = [], [], np.zeros((nu * (n + 1),) * 2, complex)
    for o in range(ny):
        error = np.sqrt(np.mean(spread[:, o] ** 2, 1))
        X = powers / error[:, None]
        Y = -(X[:, :, None] * H[:, o, None, :]).reshape(nf, -1)
        R.append(X.conj().T @ X)
        S.append(X.conj().T @ Y)
        T += Y.conj().T @ Y
    found = []
    for order in orders:
        size, unknown = order + 1, nu * (order + 1)
        M = T[:unknown, :unknown] - sum(
            s[:size, :unknown].conj().T @ np.linalg.solve(r[:size, :size], s[:size, :unknown])
            for r, s in zip(R, S, strict=True)
        )
        found.append(_roots(M, nu, f[0], width))
    return _linked(orders, found)


def _roots(M: np.ndarray, nu: int, start: float, width: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the stable poles [rad/s] and participation factors of A. With A_0 = 1 the roots that
    fit noise tend to lie outside of the unit circle, where poles are unstable."""
    unknown = len(M) - nu
    A = -np.linalg.lstsq(M[nu:, nu:], M[nu:, :nu], rcond=None)[0]
    companion = np.eye(unknown, k=nu, dtype=complex)  # of w' sum_k A_k z^(k - n), in 1/z
    for k in range(unknown // nu):
        companion[-nu:, unknown - (k + 1) * nu : unknown - k * nu] = -A[k * nu : (k + 1) * nu].T
    inverse, vectors = np.linalg.eig(companion)
    z = 1 / inverse
    complex_angle = np.mod(np.angle(z), 2 * np.pi) - 1j * np.log(np.abs(z))
    frequency = start + width * (complex_angle / (2 * np.pi) - (1 - ARC) / 2) / ARC
    poles = 2j * np.pi * frequency
    ratio = damping_ratio_of(poles)
    inside = (frequency.real > start) & (frequency.real < start + width)
    kept = inside & (ratio > 0) & (ratio < DAMPED)
    w = vectors[:nu, kept].T
    return poles[kept], w / w[np.arange(len(w)), np.argmax(np.abs(w), 1)][:, None]


def _linked(orders: np.ndarray, found: list[tuple[np.ndarray, np.ndarray]]) -> Diagram:
    """Return the diagram: a pole is stable if it follows one of an order before, and continues the
    chain of that pole."""
    chains: list[np.ndarray] = []
    stable: list[np.ndarray] = []
    count = 0
    for k, (poles, w) in enumerate(found):
        mine = np.full(len(poles), -1)
        steady = np.zeros(len(poles), bool)
        for back in range(1, min(SKIPPED, k) + 1):
            before, w_before = found[k - back]
            if not len(before) or not len(poles):
                continue
            change = np.abs(poles[:, None] - before) / np.abs(before)
            change[:, np.isin(chains[k - back], mine[mine >= 0])] = np.inf
            for i in np.argsort(change.min(1)):
                j = int(np.argmin(change[i]))
                if mine[i] >= 0 or not _same(
                    complex(poles[i]), complex(before[j]), w[i], w_before[j], change[i, j]
                ):
                    continue
                if chains[k - back][j] < 0:
                    chains[k - back][j], count = count, count + 1
                mine[i], steady[i] = chains[k - back][j], True
                change[:, j] = np.inf
        chains.append(mine)
        stable.append(steady)
    sizes = [len(poles) for poles, _ in found]
    return Diagram(
        np.repeat(orders, sizes),
        np.concatenate([poles for poles, _ in found]),
        np.concatenate([w for _, w in found]),
        np.concatenate(stable),
        np.concatenate(chains),
    )


def _same(p: complex, q: complex, w: np.ndarray, v: np.ndarray, change: float) -> bool:
    """Return whether pole p with participation w is stable against q with v."""
    if not np.isfinite(change) or abs(abs(p) / abs(q) - 1) > FREQUENCY:
        return False
    changed = abs(damping_ratio_of(p) / damping_ratio_of(q) - 1)
    return bool(changed < DAMPING and _alike(w, v))


def _alike(w: np.ndarray, v: np.ndarray) -> bool:
    """Return whether participation factors agree, by their modal assurance criterion."""
    return bool(abs(np.vdot(w, v)) ** 2 > SHAPE * (np.vdot(w, w) * np.vdot(v, v)).real)


def chosen(found: Diagram) -> tuple[np.ndarray, np.ndarray]:
    """Return the poles (nm,) and participation factors of the modes: of each chain that is stable
    through LEAST orders or more, the pole at the median damping ratio. Of two chains of one mode,
    which never have poles of the same order, the longer one counts."""
    members = [np.flatnonzero(found.chain == c) for c in range(found.chain.max(initial=-1) + 1)]
    members = sorted((m for m in members if found.stable[m].sum() >= LEAST), key=len)[::-1]
    picks: list[int] = []
    taken: list[np.ndarray] = []
    for m in members:
        order = np.argsort(found.damping_ratio[m])
        pick = int(m[order[len(m) // 2]])
        p, w = found.poles[pick], found.participation[pick]
        twin = False
        for other, those in zip(picks, taken, strict=True):
            q, v = found.poles[other], found.participation[other]
            near = abs(p - q) < max(2 * max(-p.real, -q.real), FREQUENCY * abs(q) / 2)
            both = np.isin(found.order[m], found.order[those]).sum()
            twin = twin or (near and _alike(w, v) and both < LEAST)
        if not twin:
            picks.append(pick)
            taken.append(m)
    picks = sorted(picks, key=lambda i: found.frequency[i])
    return found.poles[picks], found.participation[picks]
