"""Matrices of harmonic motion, D(s) = K + s C + s^2 M + i H, and the solutions of D(s) x = b: by
elimination or by sums over modes.

Frequencies are the last axis of all arrays, so that operations run along them.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from equinox import Module, field

from jaxbody.core.arrays import Array, Bool, Complex, Float
from jaxbody.core.compilation.compile_options import OPTIMIZED, QUICK, Options
from jaxbody.numerics.eigenproblems import companion, eig, first_order, natural
from jaxbody.numerics.precisions import reachable

# number of coordinates above which LAPACK costs less than compiling this elimination
LARGEST_UNROLLED = 16
# real part of an eigenvalue, relative to the largest eigenvalue, above which it is not rounding
GROWS = 1e-6
MANY = 1e6  # frequencies times n^3, above which the solution takes milliseconds
# relative error of the inverse of the modes, above which the modal sum is inaccurate
INVERTED = 1e-7


def options_by_size(lin: Any, f: Float[Array, "nf"], *_: Any) -> Options:
    """Return the compile options for D x = b of the system `lin` at the frequencies `f`: optimized
    where the solution takes long, otherwise those that compile quickly."""
    return OPTIMIZED if f.size * lin.K.size * len(lin.K) > MANY else QUICK


class DynamicMatrices(Module):
    """The matrices of D = K + s C + s^2 M + i H, s = i w; the last `massless` rows of D are those
    of coordinates without mass. `symmetric`: whether the matrices are, as those of potentials."""

    K: Float[Array, "k n"]
    C: Float[Array, "k n"]
    M: Float[Array, "k n"]
    H: Float[Array, "k n"] | None
    massless: int = field(static=True, default=0)
    symmetric: bool = field(static=True, default=True)

    def at(self, s: Complex[Array, "nf"]) -> Complex[Array, "k n nf"]:
        """Return D(s) at each s."""
        K = self.K.astype(s.dtype) if self.H is None else jax.lax.complex(self.K, self.H)
        C, M, s = self.C.astype(s.dtype), self.M.astype(s.dtype), s[None, None]
        return K[:, :, None] + C[:, :, None] * s + M[:, :, None] * s**2

    def times(
        self, s: Complex[Array, "nf"], x: Complex[jax.Array, "n m nf"]
    ) -> Complex[jax.Array, "k m nf"]:
        """Return D(s) x by real products."""
        parts = jax.tree.leaves(self)
        re, im = (
            jnp.split(jnp.tensordot(jnp.concatenate(parts), part, 1), len(parts))
            for part in (x.real, x.imag)
        )
        product = [jax.lax.complex(re_, im_) for re_, im_ in zip(re, im, strict=True)]
        return sum(
            (
                a * b
                for a, b in zip(product[1:], (s[None, None], s[None, None] ** 2, 1j), strict=False)
            ),
            product[0],
        )


def solved(
    own: DynamicMatrices, s, b: Complex[Array, "n m nf"], method: str
) -> tuple[Complex[Array, "n m nf"], Bool[Array, ""]]:
    """Return D(s)^-1 b, differentiable as the solution of a linear system with both methods, and
    whether the modes, if used, are complete."""
    frozen, at = jax.lax.stop_gradient((own, s))
    solve, complete = (
        _modal_sum(frozen, at) if method == "modal" else (_eliminated(frozen, at), jnp.array(True))
    )
    return jax.lax.custom_linear_solve(
        lambda x: own.times(s, x), b, lambda _, b: solve(b, False), lambda _, b: solve(b, True)
    ), complete


def _eliminated(A: DynamicMatrices, s) -> Callable[[jax.Array, bool], jax.Array]:
    """Return the function (b, transposed) -> D^-1 b, or D^-T b, from one elimination. In the
    coordinates of the real modes no pivoting is needed: D is diagonal except for damping, and no
    entry of C exceeds the mean of two on its diagonal."""
    if ((n := len(A.M)) > LARGEST_UNROLLED and not A.massless) or not A.symmetric:
        return _by_lapack(A.at(s))
    if A.massless:
        return _eliminated_with_branches(A, s)
    shapes = natural(A.K, A.M)[1]
    D = jax.tree.map(lambda H: shapes.T @ H @ shapes, A).at(s)
    D = jnp.concatenate([D, jnp.broadcast_to(shapes.T[:, :, None].astype(D.dtype), D.shape)], 1)
    for i in range(n):  # the first column is eliminated and dropped
        row = D[i, 1:] / D[i, :1]
        D = jnp.where((jnp.arange(n) == i)[:, None, None], row, D[:, 1:] - D[:, :1] * row[None])
    inverse = jnp.tensordot(shapes.astype(D.dtype), D, 1)
    return lambda b, transposed: _product(jnp.swapaxes(inverse, 0, 1) if transposed else inverse, b)


def _by_lapack(D: Complex[Array, "n n nf"]) -> Callable[[jax.Array, bool], jax.Array]:
    """Return the map b -> D^-1 b or its transpose, from LU factors at each frequency."""
    from jax.scipy.linalg import lu_factor, lu_solve  # for the few models that need them

    factors = lu_factor(jnp.moveaxis(D, -1, 0))
    return lambda b, transposed: jax.vmap(
        lambda LU, b: lu_solve(LU, b, int(transposed)), (0, -1), -1
    )(factors, b)


def _eliminated_with_branches(A: DynamicMatrices, s) -> Callable[[jax.Array, bool], jax.Array]:
    """Return the map b -> D^-1 b or its transpose for a system with massless coordinates y, which
    are eliminated first, one by one: with K_yy U = C_yy U diag(r) and U' C_yy U = 1,

    D_yy^-1 = U diag(1/(r + s)) U',    D_dd - sum of g g'/(r + s) over the branches,
    g = U' (K_yd + s C_yd)"""
    d, y = slice(n := len(A.M) - A.massless), slice(n, None)
    rates, U = natural(A.K[y, y], A.C[y, y])
    K_yd, C_yd, U = (x.astype(s.dtype) for x in (U.T @ A.K[y, d], U.T @ A.C[y, d], U))
    g, soft = (
        K_yd[:, :, None] + C_yd[:, :, None] * s[None, None],
        1 / (rates.astype(s.dtype)[:, None] + s[None]),
    )
    whole = DynamicMatrices(A.K[d, d], A.C[d, d], A.M[d, d], None).at(s) - jnp.einsum(
        "ynf,yf,ymf->nmf", g, soft, g
    )
    rest = _by_lapack(whole)

    def solve(b, transposed):
        own = jnp.tensordot(U.T, b[y], 1)
        right = b[d] - jnp.einsum("ynf,yf,ymf->nmf", g, soft, own)
        x = rest(right, transposed)
        return jnp.concatenate(
            [x, jnp.tensordot(U, soft[:, None] * (own - jnp.einsum("ynf,nmf->ymf", g, x)), 1)]
        )

    return solve


def _product(
    A: Complex[jax.Array, "k n nf"], x: Complex[jax.Array, "n m nf"]
) -> Complex[jax.Array, "k m nf"]:
    """Return the product A x at each frequency."""
    pairs = [(A[:, j, None], x[j][None]) for j in range(len(x))]
    none = jnp.zeros((len(A), *x.shape[1:]), A.real.dtype)
    re = sum((a.real * b.real - a.imag * b.imag for a, b in pairs), none)
    return jax.lax.complex(re, sum((a.real * b.imag + a.imag * b.real for a, b in pairs), none))


def _modal_sum(
    A: DynamicMatrices, s
) -> tuple[Callable[[jax.Array, bool], jax.Array], Bool[Array, ""]]:
    """Return the function (b, transposed) -> D^-1 b, or D^-T b, by superposition of modes, D^-1 =
    left diag(1/(s - pole)) right, and whether it is accurate: the modes must be a basis."""
    n = len(A.M) - A.massless
    K = A.K if A.H is None else A.K + 1j * A.H
    matrix, forces = first_order(A.M, A.C, K, n) if A.massless else (companion(A.M, A.C, K), None)
    # scale of frequency, so that displacements and rates have the same size
    unit = jnp.sqrt(jnp.max(jnp.abs(matrix[n : 2 * n, :n])))
    scale = jnp.concatenate([jnp.ones(n), jnp.full(n, unit), jnp.ones(A.massless)]).astype(
        matrix.dtype
    )
    balanced = matrix * scale[None] / scale[:, None]
    poles, vectors = eig(balanced)
    inverse = jnp.linalg.inv(vectors)
    error = jnp.max(
        jnp.abs((vectors * poles[None]) @ inverse - balanced.astype(inverse.dtype))
    ) / jnp.max(jnp.abs(balanced))
    if forces is None:
        right = inverse[:, n:] @ (jnp.linalg.inv(A.M) / unit).astype(inverse.dtype)
    else:
        right = inverse @ (forces / scale[:, None]).astype(inverse.dtype)
    left = jnp.concatenate([vectors[:n], vectors[2 * n :]])

    def solve(b, transposed):
        L, R = (right.T, left.T) if transposed else (left, right)
        return jnp.tensordot(L, jnp.tensordot(R, b, 1) / (s[None] - poles[:, None])[:, None], 1)

    return solve, error < reachable(INVERTED, error.dtype, 1024)


def free_motions(A: DynamicMatrices) -> Complex[Array, "k"]:
    """Return the eigenvalues s of free motions exp(s t), without derivatives and without H."""
    M, C, K = jax.lax.stop_gradient((A.M, A.C, A.K))
    return jnp.linalg.eigvals(
        first_order(M, C, K, len(M) - A.massless)[0] if A.massless else companion(M, C, K)
    )


def is_unstable(A: DynamicMatrices) -> Bool[Array, ""]:
    """Return whether a free motion grows."""
    values = free_motions(A)
    growth = jnp.real(values)
    return jnp.max(growth) > reachable(GROWS, growth.dtype, 256) * jnp.max(jnp.abs(values))
