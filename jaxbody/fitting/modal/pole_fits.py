"""Maximum-likelihood fit of poles, participation factors, shapes and residual terms to responses,
and the covariance of what is fitted.

    H_yu(s) = s^d [sum over modes (psi_y l_u g(s, p) + conj(psi_y l_u) g(s, p*)) + U_yu + L_yu/s^2]

d is the number of derivatives between output and input, g the response of a pole
(`pole_functions`), U and L, real, the modes above and below the band. Residuals
e = (H_measured - H) L_x sqrt(2/S_ee), with S_xx = L_x L_x^H, have real and imaginary parts of
variance one. Given poles and l, each output is linear in psi, U, L: these are eliminated by
projection, and a Gauss-Newton search with damping finds poles and l (variable projection in the
form of L. Kaufman, BIT 15 (1975) 49). From the linearized fit, theta = G^-1 Re sum J^H e, follows

    Cov theta = G^-1 Re [sum over k of c_k sum over f of J_f^H Gamma_f J_(f+k)] G^-1,

with the correlations c_k of the errors of two lines and Gamma of the errors of outputs.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from jaxbody.fitting.modal.pole_functions import PoleFunction

ROUNDS = 60  # steps of the search at most
CONVERGED = 1e-9  # relative change of the sum of squares in the last step
FIRST_DAMPING, LEAST_DAMPING = 1e-3, 1e-12
FARTHEST = 0.2  # largest step of a pole, relative to it
SINGULAR = 1e-11  # smallest singular value of an output, relative, that counts
STUCK = 1e6  # damping from which no step reduces the sum of squares

ByOutput = dict[int, np.ndarray]


class Responses(NamedTuple):
    """What is fitted.

    `s` = i 2 pi f (nf,), with an exponential window i 2 pi f + 1/decay; `H` (nf, ny, nu);
    `whitening` L_x sqrt(2/S_ee) (nf, ny, nu, nu); derivatives `d` (ny, nu); `functions` of poles;
    `correlation` Gamma of the errors of outputs (nf, ny, ny); correlations `lags` of lines. If
    there are `replicates` e_k (n, nf, ny, nu), whose mean is the error of H, their products up to
    `shared` steps apart replace both."""

    s: np.ndarray
    H: np.ndarray
    whitening: np.ndarray
    d: np.ndarray
    functions: PoleFunction
    correlation: np.ndarray
    lags: tuple[complex, ...]
    replicates: np.ndarray | None
    shared: int


class PoleFit(NamedTuple):
    """A fit: `poles` (nm,), participation factors `l` (nm, nu), `shapes` psi (nm, ny), `H` that
    they give with the residual terms, and covariances: `of_poles` (nm, 2, 2) of real and imaginary
    parts, `of_shapes` (nm, ny, 2, 2); `chi2` over its degrees of freedom."""

    poles: np.ndarray
    l: np.ndarray
    shapes: np.ndarray
    H: np.ndarray
    of_poles: np.ndarray
    of_shapes: np.ndarray
    chi2: float
    converged: bool


def fit_poles(data: Responses, poles: np.ndarray, l: np.ndarray) -> PoleFit:
    """Return the fit that a search from these poles and participation factors reaches."""
    fixed = np.argmax(np.abs(l), 1)  # the input whose factor stays one
    l = l / l[np.arange(len(l)), fixed][:, None]
    state = _State(data, poles, l, fixed)
    damping = FIRST_DAMPING
    for _ in range(ROUNDS):
        G, gradient = state.normal_equations()
        while True:
            step = np.linalg.solve(G + damping * np.diag(np.diag(G)), gradient)
            trial = state.moved(step)
            if trial.square < state.square or damping > STUCK:
                break
            damping *= 10
        finished = state.square - trial.square <= CONVERGED * state.square
        if trial.square < state.square:
            state = trial
        if finished:
            return state.result(True)
        damping = max(damping / 10, LEAST_DAMPING)
    return state.result(False)


class _State:
    """Poles and participation factors with the outputs fitted to them."""

    def __init__(self, data: Responses, poles: np.ndarray, l: np.ndarray, fixed: np.ndarray):
        self.data, self.poles, self.l, self.fixed = data, poles, l, fixed
        both = [(p, p.conjugate()) for p in poles.tolist()]
        self.functions = [[(p, *data.functions(p)) for p in pair] for pair in both]
        self.outputs = [_Output(self, o) for o in range(data.H.shape[1])]
        self.square = sum(float(o.r @ o.r) for o in self.outputs)

    def moved(self, step: np.ndarray) -> _State:
        nm, nu = self.l.shape
        change = step[:nm] + 1j * step[nm : 2 * nm]
        size = float(np.abs(change / self.poles).max())
        poles = self.poles + change * min(1.0, FARTHEST / max(size, FARTHEST))
        limit = np.real(self.data.s[0])
        # a step to the right of s ends halfway to it
        real = np.where(np.real(poles) < limit, np.real(poles), (np.real(self.poles) + limit) / 2)
        poles = real + 1j * np.imag(poles)
        l = self.l.copy()
        rest = step[2 * nm :].reshape(2, nm, nu - 1)
        for r, one in enumerate(self.fixed):
            l[r, np.arange(nu) != one] += rest[0, r] + 1j * rest[1, r]
        return _State(self.data, poles, l, self.fixed)

    def normal_equations(self) -> tuple[np.ndarray, np.ndarray]:
        G = sum(o.J.T @ o.J for o in self.outputs)
        return np.asarray(G), np.asarray(sum(o.J.T @ o.r for o in self.outputs))

    def result(self, converged: bool) -> PoleFit:
        data, (nm, nu) = self.data, self.l.shape
        ny = len(self.outputs)
        G, _ = self.normal_equations()
        inverse = np.linalg.inv(G)
        projected = [o.J @ inverse for o in self.outputs]
        scores = {k: _complex(J, data.s.size, nu) for k, J in enumerate(projected)}
        covariance = _covariance(data, scores, scores)
        of_shapes = np.zeros((nm, ny, 2, 2))
        for k, o in enumerate(self.outputs):
            own = {k: _complex(o.local, data.s.size, nu)}
            cross = _covariance(data, own, scores)
            B = o.local.T @ o.J_all
            C = _covariance(data, own, own) - cross @ B.T - B @ cross.T + B @ covariance @ B.T
            for r in range(nm):
                of_shapes[r, k] = C[np.ix_([r, nm + r], [r, nm + r])]
        pairs = [np.ix_([r, nm + r], [r, nm + r]) for r in range(nm)]
        count = 2 * data.H.size - len(G) - sum(len(o.c) for o in self.outputs)
        return PoleFit(
            self.poles,
            self.l,
            np.array([o.c[:nm] + 1j * o.c[nm : 2 * nm] for o in self.outputs]).T,
            np.stack([o.H for o in self.outputs], 1),
            np.array([covariance[pair] for pair in pairs]),
            of_shapes,
            self.square / max(count, 1),
            converged,
        )


class _Output:
    """One output: coefficients c = (Re psi, Im psi, U, L) by least squares, residuals r, and the
    Jacobian J of the projected residuals by poles and participation factors."""

    def __init__(self, state: _State, o: int):
        data, l = state.data, state.l
        nm, nu = l.shape
        d, white = data.d[o], data.whitening[:, o]
        each = [[_column(data.s, d, *one) for one in pair] for pair in state.functions]
        # of poles and of their conjugates, with derivatives by them (nm, nf, nu)
        (here, slope), (there, other) = np.moveaxis(np.array(each), 0, 2)
        one, two = here * l[:, None], there * l.conj()[:, None]
        power = data.s[:, None] ** d
        Phi = np.concatenate([one + two, 1j * (one - two)])  # (2 nm, nf, nu)
        terms = np.zeros((2 * nu, *power.shape), complex)
        for u in range(nu):
            terms[u, :, u], terms[nu + u, :, u] = power[:, u], (power / data.s[:, None] ** 2)[:, u]
        Phi = np.concatenate([Phi, terms])
        A = _stacked(np.einsum("cfu,fuv->cfv", Phi, white)).T
        y = _stacked(np.einsum("fu,fuv->fv", data.H[:, o], white)[None])[0]
        size = np.linalg.norm(A, axis=0)
        U, sigma, Vt = np.linalg.svd(A / size, full_matrices=False)
        kept = sigma > SINGULAR * sigma[0]
        U, back = U[:, kept], (Vt[kept].T / sigma[kept]) / size[:, None]
        self.c = back @ (U.T @ y)
        self.r = y - U @ (U.T @ y)
        self.local = U @ back.T  # (rows, coefficients): c = local' y
        self.H = np.einsum("c,cfu->fu", self.c, Phi)
        psi = self.c[:nm] + 1j * self.c[nm : 2 * nm]
        a = psi[:, None, None] * l[:, None] * slope
        b = (psi.conj()[:, None] * l.conj())[:, None] * other
        parts = [a + b, 1j * (a - b)]
        for factor, sign in ((1.0, 1.0), (1j, -1.0)):
            change = factor * (psi[:, None, None] * here + sign * psi.conj()[:, None, None] * there)
            free = np.zeros((nm, nu - 1, *here.shape[1:]), complex)
            for r, fixed in enumerate(state.fixed):
                for k, u in enumerate(np.flatnonzero(np.arange(nu) != fixed)):
                    free[r, k, :, u] = change[r, :, u]
            parts.append(free.reshape(-1, *here.shape[1:]))
        self.J_all = _stacked(np.einsum("cfu,fuv->cfv", np.concatenate(parts), white)).T
        self.J = self.J_all - U @ (U.T @ self.J_all)


def _column(
    s: np.ndarray, d: np.ndarray, p: complex, g: np.ndarray, slope: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return s^d g of a pole (nf, nu), and its derivative by the pole, from g and its derivative.

    s^d/(s - p) is the sum of (s^d - p^d)/(s - p), a polynomial, which windows do not change, and
    p^d/(s - p)."""
    g, slope = g[:, None], slope[:, None]
    polynomial = np.where(d == 0, 0.0, np.where(d == 1, 1.0, s[:, None] + p))
    rise = np.where(d == 0, 0.0, d * p ** np.maximum(d - 1, 0))
    return polynomial + p**d * g, (d == 2) * 1.0 + rise * g + p**d * slope


def _stacked(x: np.ndarray) -> np.ndarray:
    """Return complex rows (n, nf, nu) as real ones (n, 2 nf nu): real, then imaginary parts."""
    return np.concatenate([np.real(x), np.imag(x)], 1).reshape(len(x), -1)


def _complex(rows: np.ndarray, nf: int, nu: int) -> np.ndarray:
    """Return real rows (2 nf nu, n) as complex ones (nf, nu, n)."""
    parts = rows.reshape(2, nf, nu, -1)
    return parts[0] + 1j * parts[1]


def _covariance(data: Responses, left: ByOutput, right: ByOutput) -> np.ndarray:
    """Return Cov(Re sum A_f^H e_f, Re sum B_f^H e_f) of two linear functions of the residuals,
    given by output (nf, nu, n)."""
    if data.replicates is not None:
        from scipy.stats import norm, t

        a, b = (_scores(data, side) for side in (left, right))
        n, weights = len(a), 1 - np.arange(1, data.shared + 1) / (data.shared + 1)
        sums = a.T @ b
        for k, weight in enumerate(weights, start=1):  # Newey and West, Econometrica 55 (1987) 703
            sums = sums + weight * (a[k:].T @ b[:-k] + a[:-k].T @ b[k:])
        # so few parts estimate it that Student's limits are wider than the normal ones
        freedom = (n - 1) / (1 + 2 * weights @ weights)
        return sums * (t.ppf(0.975, freedom) / norm.ppf(0.975) / n) ** 2
    total, nf = 0.0, data.s.size
    for i, A in left.items():
        for j, B in right.items():
            gamma = data.correlation[:, i, j]
            for k, c in enumerate(data.lags[:nf]):
                near, far = slice(0, nf - k), slice(k, nf)
                weight = (gamma[near] + gamma[far]) / 2
                total = total + _paired(A[near], weight * c, B[far])
                if k:
                    total = total + _paired(A[far], weight * np.conj(c), B[near])
    return np.asarray(total)


def _paired(A: np.ndarray, weight: np.ndarray, B: np.ndarray) -> np.ndarray:
    rows = A.reshape(-1, A.shape[-1]).conj().T
    return np.real(rows @ (weight[:, None, None] * B).reshape(-1, B.shape[-1]))


def _scores(data: Responses, side: ByOutput) -> np.ndarray:
    """Return Re sum A_f^H e_f for each replicate e, (n, parameters)."""
    assert data.replicates is not None
    white = np.einsum("nfou,fouv->nfov", data.replicates, data.whitening)
    parts = [np.einsum("fup,nfu->np", A.conj(), white[:, :, i]) for i, A in side.items()]
    return np.real(np.sum(parts, 0))
