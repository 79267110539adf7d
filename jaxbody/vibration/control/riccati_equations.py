"""Algebraic Riccati equations of regulators and estimators, and the cost and noise of systems
between samples.

The continuous equation is the sampled one of the Cayley transform z = (g + s)/(g - s), which keeps
P. States that the cost does not see and that do not decay by themselves are left out: they span an
invariant subspace V, on which P = 0, and the equation is that of the quotient by V. The sampled
equation is solved by doubling,

    W = 1 + G H,   A <- A W^-1 A,   G <- G + A W^-1 G A',   H <- H + A' H W^-1 A,   H -> P,

and its derivative is that of the linear equation

    dP = A_c' dP A_c + 2 sym(A_c' P (dA - dB K)) + [1, -K'] d[[Q, N], [N', R]] [1; -K],
    V' dP V = 0.

Source: E. K.-W. Chu, H.-Y. Fan, W.-W. Lin, Linear Algebra and its Applications 396 (2005) 55.
"""

import jax
import jax.numpy as jnp
import numpy as np

from jaxbody.core.arrays import Array, Float, rows_or_nan

REST = 1e-7  # decay, relative to the largest rate, that counts as none: the error of a double pole
UNSEEN = 1e-7  # singular values, relative to rows of length 1, that count as zero
ROUNDING = 1e-13  # rows, relative to the largest, that count as zero
BALANCED, DOUBLINGS, TURNS = 40, 60, 40  # the most steps of scaling, doubling and a matrix sign
HALVINGS = 10  # of the time between samples


def care(
    A: Float[Array, "n n"],
    B: Float[Array, "n m"],
    Q: Float[Array, "n n"],
    R: Float[Array, "m m"],
    N: Float[Array, "n m"] | None = None,
) -> Float[Array, "n n"]:
    """Solve A'P + PA - (PB + N) R^-1 (B'P + N') + Q = 0, Q - N R^-1 N' >= 0, R > 0, for the P that
    is the least cost x'Px of the integral of x'Qx + 2 x'Nu + u'Ru along x' = Ax + Bu from x.

    P is zero on what the cost does not see, and NaN where the cost sees a motion that does not
    decay and that u cannot reach. Derivatives of any order by forward and reverse mode; each is a
    linear system of n^2 equations.

    >>> P = jb.control.care(jnp.zeros((1, 1)), jnp.eye(1), jnp.eye(1), 4 * jnp.eye(1))
    >>> round(float(P[0, 0]), 12)  # P^2/4 = 1
    2.0
    """
    return solution(A, B, Q, R, jnp.zeros_like(B) if N is None else N, Q, sampled=False)[0]


def dare(
    A: Float[Array, "n n"],
    B: Float[Array, "n m"],
    Q: Float[Array, "n n"],
    R: Float[Array, "m m"],
    N: Float[Array, "n m"] | None = None,
) -> Float[Array, "n n"]:
    """Solve P = A'PA - (A'PB + N)(R + B'PB)^-1 (B'PA + N') + Q, the equation of `care` for the sum
    of the cost over samples of x_next = Ax + Bu.

    >>> P = jb.control.dare(jnp.eye(1), jnp.eye(1), jnp.eye(1), jnp.eye(1))
    >>> round(float(P[0, 0]), 9)  # P = 1 + P/(1 + P): the golden ratio
    1.618033989
    """
    return solution(A, B, Q, R, jnp.zeros_like(B) if N is None else N, Q, sampled=True)[0]


def solution(A, B, Q, R, N, C, *, sampled: bool) -> tuple[Array, Array]:
    """Return P of `care` or `dare`, and a projector on V.

    C: rows that see what Q sees; by their directions alone it is decided what V is."""
    n, m = B.shape
    d = jnp.concatenate([_balance(jax.lax.stop_gradient(A)), jnp.ones(m, A.dtype)])
    unit, zero, eye = d[:, None] / d[None], jnp.zeros((m, n), A.dtype), np.eye(n)
    AB = jnp.concatenate([A, B], 1) / unit[:n]
    J = jnp.block([[Q, N], [N.T, R]]) * d[:, None] * d[None]
    if not sampled:
        # above the rates of the system and of its best closed loop, about (B R^-1 B' Q)^(1/2)
        turned = AB[:, n:] @ jnp.linalg.solve(R, AB[:, n:].T) @ J[:n, :n]
        g = 2 * (jnp.linalg.norm(AB[:, :n]) + jnp.sqrt(jnp.linalg.norm(turned) + 1e-300))
        g = jax.lax.stop_gradient(g)
        F = jnp.linalg.inv(g * eye - AB[:, :n])
        # x and u of the continuous system, from those of the sampled one
        T = jnp.block([[jnp.sqrt(2 * g) * F, F @ AB[:, n:]], [zero, np.eye(m)]])
        AB, J = jnp.concatenate([2 * g * F - eye, T[:n, :n] @ AB[:, n:]], 1), T.T @ J @ T
    P, V = _solution(AB, (J + J.T) / 2, jax.lax.stop_gradient(C * d[None, :n]))
    return P / d[:n, None] / d[None, :n], V * unit[:n, :n]


def _balance(A: Float[Array, "n n"]) -> Float[Array, "n"]:
    """Return units d of the states with which rows and columns of A d_j/d_i have like sizes."""

    def step(_, d):
        size = jnp.abs(A * d[None] / d[:, None]) * (1 - np.eye(len(A)))
        both = (size.sum(0) > 0) & (size.sum(1) > 0)
        return d * jnp.where(both, size.sum(1) / jnp.where(both, size.sum(0), 1.0), 1.0) ** 0.25

    return jax.lax.fori_loop(0, BALANCED, step, jnp.ones(len(A), A.dtype))


@jax.custom_jvp
def _solution(AB: Array, J: Array, C: Array) -> tuple[Array, Array]:
    """Return P and the orthogonal projector on V, of AB = [A, B] and J = [[Q, N], [N', R]]."""
    n = len(AB)
    V, eye = lasting(AB[:, :n], C), np.eye(n)
    rest = eye - V
    A, B, N = rest @ AB[:, :n] @ rest, rest @ AB[:, n:], rest @ J[:n, n:]
    turned, R = jnp.concatenate([B, N]), J[n:, n:]
    beyond = jnp.trace(lasting(A.T, B.T)) > 0.5  # motions out of reach of u
    b, c = jnp.split(jnp.linalg.solve(jnp.linalg.cholesky(R), turned.T).T, 2)

    def step(state):
        A, G, H, _, count = state
        X, Y = jnp.split(jnp.linalg.solve(eye + G @ H, jnp.concatenate([A, G], 1)), 2, 1)
        G, more = G + A @ Y @ A.T, A.T @ H @ X
        H = H + (more + more.T) / 2
        change = jnp.linalg.norm(more) / (jnp.linalg.norm(H) + 1e-300)
        return A @ X, (G + G.T) / 2, H, change, count + 1

    start = (A - b @ c.T, b @ b.T, rest @ J[:n, :n] @ rest - c @ c.T, jnp.ones((), A.dtype), 0)
    *_, P, change, _ = jax.lax.while_loop(
        lambda state: (state[3] > 1e-17) & (state[4] < DOUBLINGS), step, start
    )
    return rows_or_nan(~beyond & (change < 1e-8), P), V


@_solution.defjvp
def _solution_jvp(primals, tangents):
    (AB, J, C), (dAB, dJ, _) = primals, tangents
    (P, V), n = _solution(AB, J, C), len(AB)
    A, B = AB[:, :n], AB[:, n:]
    K = jnp.linalg.solve(J[n:, n:] + B.T @ P @ B, B.T @ P @ A + J[n:, :n])
    held = jnp.concatenate([jnp.eye(n), -K])
    A = AB @ held
    right = A.T @ P @ dAB @ held + held.T @ dJ @ held / 2
    right = right + right.T
    equation = np.eye(n * n) - jnp.kron(A.T, A.T) + jnp.kron(A.T @ V, A.T @ V)
    dP = jnp.linalg.solve(equation, (right - V @ right @ V).ravel()).reshape(n, n)
    dV = -jnp.linalg.pinv(P, rtol=1e-12, hermitian=True) @ dP @ V  # of P V = 0
    return (P, V), (dP, dV + dV.T)


def between_samples(
    A: Float[Array, "n n"], Q: Float[Array, "n n"], time: Float[Array, ""]
) -> tuple[Array, Array, Array]:
    """Return exp(A time), the integral M(time) of exp(A's) Q exp(As) ds, and that of M.

    By the exponential of a block matrix over a short step (C. F. Van Loan, IEEE TAC 23 (1978) 395),
    which is then doubled, so that fast motions do not overflow."""
    n, step, zero, eye = len(A), time / 2**HALVINGS, jnp.zeros_like(A), np.eye(len(A))
    blocks = jnp.block([[-A.T, eye, zero], [zero, -A.T, Q], [zero, zero, A]])
    twice, once, F = jnp.split(jax.scipy.linalg.expm(step * blocks)[:, 2 * n :], 3)
    twice, once = F.T @ twice, F.T @ once
    for k in range(HALVINGS):
        twice = twice + step * 2**k * once + F.T @ twice @ F
        once, F = once + F.T @ once @ F, F @ F
    return F, once, twice


def lasting(A: Float[Array, "n n"], C: Float[Array, "m n"]) -> Float[Array, "n n"]:
    """Return the orthogonal projector on the largest invariant subspace of A, sampled, of motions
    that do not decay, |z| > 1 - REST, and that C does not see."""
    n, eye = len(A), np.eye(len(A))

    def turn(_, S):
        inverse = jnp.linalg.inv(S)
        scale = jnp.sqrt(jnp.linalg.norm(inverse) / jnp.linalg.norm(S))
        return (S * scale + inverse / scale) / 2

    # 1 and -1 on motions that do not and do decay
    sign = jnp.linalg.solve(A + (1 - REST) * eye, A - (1 - REST) * eye)
    sign = jax.lax.fori_loop(0, TURNS, turn, sign)
    size = jnp.linalg.norm(C, axis=1, keepdims=True)
    C = C / jnp.where(size > ROUNDING * jnp.max(size, initial=0.0), size, jnp.inf)
    return jax.lax.fori_loop(
        0,
        n,
        lambda _, V: _null(jnp.concatenate([C @ V, (eye - V) @ A @ V, eye - V])),
        _null((eye - sign) / 2),
    )


def _null(M: Float[Array, "m n"]) -> Float[Array, "n n"]:
    """Return the orthogonal projector on the null space."""
    _, size, rows = jnp.linalg.svd(M, full_matrices=False)
    return rows.T @ jnp.where(size[:, None] < UNSEEN, rows, 0.0)
