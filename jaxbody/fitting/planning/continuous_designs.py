"""The continuous design: shares of candidates in place of a choice, which bounds every choice.

    minimize phi(M0 + sum_i w_i M_i) over w,    sum w = n,  0 <= w_i <= 1 (or any w_i >= 0)

phi is convex, so that with its tangent a, G at w, for every design v of the same kind,

    phi(v) >= a + g'(v - w),    g_i = tr(G M_i)

The least right side is the bound: at the optimum it is phi(w) itself, which is the equivalence
theorem (J. Kiefer, J. Wolfowitz, Canad. J. Math. 12 (1960) 363). Shares are moved from the worst
candidate to the best one, by a search along the line (D. Boehning, Metrika 33 (1986) 337).
"""

import numpy as np

from jaxbody.fitting.planning import criteria

GAP = 1e-4  # difference from the bound that ends the search, relative for all but D
MOVES = 3000  # moves of shares at most
EMPTY = 1e-12  # share that counts as none


def continuous_design(
    M: np.ndarray, base: np.ndarray, kind: str, of: np.ndarray, n: int, *, repeated: bool
) -> tuple[np.ndarray, float]:
    """Return the best shares (N,) of candidates, and the bound of the criterion.

    Args:
        M: information of the candidates (draws, N, p, p).
        base: information before (draws, p, p).
        kind, of: the criterion and the indices of the parameters that count.
        n: the sum of the shares.
        repeated: True without an upper bound of one for each share.
    """
    from scipy.optimize import minimize_scalar

    count = M.shape[1]
    most, bound, w = float(n if repeated else 1), -np.inf, np.full(count, n / count)
    for _ in range(MOVES):
        now = base + np.einsum("k,skij->sij", w, M)
        a, G = criteria.tangent(now, kind, of)
        g = np.einsum("sij,skij->k", G, M) / len(M)
        gap = float(g @ w - np.sort(g)[: round(n / most)].sum() * most)
        bound = max(bound, a.mean() - gap)
        if gap <= GAP * (1.0 if kind == "D" else a.mean()):
            break
        to = int(np.argmin(np.where(w < most - EMPTY, g, np.inf)))
        away = int(np.argmax(np.where(w > EMPTY, g, -np.inf)))
        if g[to] >= g[away]:
            break
        span, change = min(w[away], most - w[to]), M[:, to] - M[:, away]

        def along(t, now=now, change=change):
            return criteria.smooth(now + t * change, kind, of).mean()

        step = minimize_scalar(along, bounds=(0.0, span), method="bounded").x
        step = min((step, span), key=along)
        w[to], w[away] = w[to] + step, max(w[away] - step, 0.0)
    return w, float(np.sqrt(max(bound, 0.0)) if kind == "largest interval" else bound)
