"""Eigenvalues and eigenvectors with correct derivatives where eigenvalues coincide, and NaN where a
derivative does not exist.

    K phi = w^2 M phi:   d(w_i^2) = phi_i' (dK - w_i^2 dM) phi_i
                         dphi_j = sum_i phi_i phi_i' (dK - w_j^2 dM) phi_j/(w_j^2 - w_i^2)
                                  - phi_j phi_j' dM phi_j/2
    A x = s x:           ds_i = y_i' dA x_i, y' = X^-1,   dx_j = sum_i x_i y_i' dA x_j/(s_j - s_i)

The sums omit i in the same cluster (coincident eigenvalues) as j. Functions of the space of a
cluster only (sums of its eigenvalues, energies, responses) thus have correct derivatives. A single
eigenvalue of a cluster (a branch) has one derivative to each side: the eigenvalues of phi_i' (dK -
w^2 dM) phi_j, i and j in the cluster, in order (degenerate perturbation theory). Forward mode gives
the derivative along the requested direction. Reverse mode is linear and cannot give it: the result
is NaN unless all branches of a cluster have equal cotangents. Source: A. P. Seyranian, E. Lund, N.
Olhoff, Structural Optimization 8 (1994) 207.
"""

import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxbody.core.arrays import Array, Bool, Complex, Float, Int, module_of
from jaxbody.core.errors import JaxbodyError, Problem
from jaxbody.core.jax_internals import Zero, new_operation, with_tangent
from jaxbody.numerics.lanes import in_lanes

CLUSTERED = 1e-6  # relative distance of eigenvalues below which they belong to one cluster
# relative difference below which cotangents within a cluster count as equal; its eigenvalues differ
# by up to CLUSTERED
ALIKE = 1e-5
ZERO = 1e-12  # eigenvalues, relative to the largest, that count as zero
WITH_EIG = ("cpu", "gpu")  # devices for which JAX has eig
MASSLESS = 1e-13  # pivots of M, relative to its diagonal, that count as zero
SWEPT = 128  # lanes for eigenvalues, whose many short loops take longer to call than to run


def clusters(values: Float[Array, "*n"]) -> Int[Array, "*n"]:
    """Return the number of the cluster, from 0 ascending, of each of the ascending values."""
    top = jnp.max(jnp.abs(values), initial=0.0)
    apart = jnp.diff(values) > CLUSTERED * jnp.abs(values[1:]) + ZERO * top
    return jnp.concatenate([jnp.zeros(min(1, len(values)), int), jnp.cumsum(apart)])


def together(cluster: Int[Array, "*b n"]) -> Bool[Array, "*b n n"]:
    """Return whether i and j belong to one cluster."""
    return cluster[..., :, None] == cluster[..., None, :]


def averaged(x: Float[Array, "*m n"], cluster: Int[Array, "n"]) -> Float[Array, "*m n"]:
    """Return the mean over each cluster, along the last axis."""
    same = together(cluster)
    return x @ (same.astype(x.dtype) / jnp.sum(same, 0).astype(x.dtype)[None])


# First and second derivatives of eigenvalues


def linear_one_way(
    name: str, forward: Callable[..., Any], backward: Callable[..., Any], again: Any = None
) -> Callable[..., Array]:
    """Make a function of a tangent and of known arrays that has its own transpose; all functions
    accept leading axes of batches.

    A custom rule of JAX would transpose `forward`, which here need not be linear, and cannot
    inspect a cotangent.

    Args:
        name: name of the operation
        forward: the function of (tangent, *known)
        backward: its transpose, of (cotangent, *known)
        again: the derivative of forward with respect to the tangent, of (tangent, *known); None:
            forward itself
    """

    def jvp(primals, tangents):
        out = primitive.bind(*primals)
        if type(tangents[0]) is Zero:
            return out, jnp.zeros_like(out)
        return out, (again or primitive.bind)(tangents[0], *primals[1:])

    def transpose(cotangent, t, *known):
        return (
            Zero(t.aval) if type(cotangent) is Zero else backward(cotangent, *known),
            *(None for _ in known),
        )

    def batch(args, axes):
        size = next(x.shape[axis] for x, axis in zip(args, axes, strict=True) if axis is not None)
        moved = (
            jnp.broadcast_to(x, (size, *x.shape)) if axis is None else jnp.moveaxis(x, axis, 0)
            for x, axis in zip(args, axes, strict=True)
        )
        return primitive.bind(*moved), 0

    primitive = new_operation(name, forward, batch=batch, jvp=jvp, transpose=transpose)
    return primitive.bind


def _alone(cluster: Array) -> Array:
    return jnp.sum(together(cluster), -1) == 1


def _one_sided(W: Array, cluster: Array) -> Array:
    """Return the ascending eigenvalues of the block of W of each cluster; a shift keeps clusters
    apart."""
    B = jnp.where(together(cluster), (W + jnp.swapaxes(W, -1, -2)) / 2, 0.0)
    shift = (
        4 * jnp.max(jnp.sum(jnp.abs(B), -1), -1, initial=0.0)[..., None] * cluster.astype(W.dtype)
    )
    split = (
        jnp.linalg.eigvalsh(
            B + shift[..., None] * jnp.broadcast_to(np.eye(W.shape[-1], dtype=W.dtype), W.shape)
        )
        - shift
    )
    return jnp.where(_alone(cluster), jnp.diagonal(W, axis1=-2, axis2=-1), split)


def _if_alike(cotangent: Array, cluster: Array) -> Array:
    """Return a diagonal matrix of the cotangent, NaN where it differs between branches of a
    cluster."""
    same = together(cluster)
    middle = jnp.sum(jnp.where(same, cotangent[..., None, :], 0.0), -1) / jnp.sum(
        same, -1, dtype=cotangent.dtype
    )
    size = jnp.max(jnp.where(same, jnp.abs(cotangent)[..., None, :], 0.0), -1, initial=0.0)
    good = jnp.abs(cotangent - middle) <= ALIKE * size
    return _diagonal(only_alone(jnp.where(good, cotangent, jnp.nan), cluster))


def _diagonal(x: Array) -> Array:
    return x[..., None] * np.eye(x.shape[-1], dtype=x.dtype)


def _nan_if_shared(x: Array, cluster: Array) -> Array:
    return jnp.where(_alone(cluster) | (x == 0), x, jnp.nan)


def _second(W: Array, cluster: Array) -> Array:
    """Return the derivatives of the slopes of eigenvalues, the diagonal of W: NaN in a cluster,
    unless W is zero there."""
    still = jnp.sum(jnp.where(together(cluster), jnp.abs(W), 0.0), -1) == 0
    return jnp.where(_alone(cluster) | still, jnp.diagonal(W, axis1=-2, axis2=-1), jnp.nan)


second = linear_one_way(
    "branch_second_slopes", _second, lambda x, cluster: _diagonal(_nan_if_shared(x, cluster))
)
second_cotangent = linear_one_way("branch_second_cotangent", _nan_if_shared, _nan_if_shared)
slopes = linear_one_way("branch_slopes", _one_sided, _if_alike, again=second)


# returns the cotangent unchanged; its derivative is NaN in a cluster
only_alone = with_tangent(lambda change, cotangent, cluster: second_cotangent(change, cluster))


# Single eigenvectors


def _unless_shared(change: Array, shapes: Array, cluster: Array) -> Array:
    return jnp.where(_alone(cluster)[..., None, :], change, jnp.nan)


def _if_of_the_space(cotangent: Array, shapes: Array, cluster: Array) -> Array:
    """Return the cotangent where rotating the vectors of a cluster within their space has no
    effect, else NaN."""
    X = jnp.where(together(cluster), jnp.swapaxes(shapes, -1, -2) @ cotangent, 0.0)
    turn = jnp.max(jnp.abs(X - jnp.swapaxes(X, -1, -2)), -2, initial=0.0)
    good = turn <= ALIKE * jnp.max(jnp.abs(X), -2, initial=0.0)
    return jnp.where(good[..., None, :], cotangent, jnp.nan)


shape_changes = linear_one_way("shape_changes", _unless_shared, _if_of_the_space)


# a function of (shapes, cluster) that returns the shapes; a single shape of a cluster has no
# derivative (NaN)
refused_in_clusters = with_tangent(shape_changes)


@jax.custom_jvp
def natural(
    K: Float[Array, "n n"], M: Float[Array, "n n"]
) -> tuple[Float[Array, "n"], Float[Array, "n n"]]:
    """Return w^2, ascending, and phi (columns) of K phi = w^2 M phi, with the symmetric parts of K
    and M.

    Normalized to phi' M phi = 1, the largest component positive."""
    A, L = in_lanes(_standard)(K, M)
    values = in_lanes(lambda A: jnp.linalg.eigvalsh(A, symmetrize_input=False), lanes=SWEPT)(A)
    # separate from the values: LAPACK is slow in a batch, and XLA drops it where no shapes are used
    _, vectors = jnp.linalg.eigh(A, symmetrize_input=False)
    shapes = jax.lax.linalg.triangular_solve(
        L, vectors, left_side=True, lower=True, transpose_a=True
    )
    largest = jnp.take_along_axis(shapes, jnp.argmax(jnp.abs(shapes), axis=0)[None], 0)
    return values, shapes * jnp.where(largest < 0, -1.0, 1.0)


def _standard(K, M):
    """Return A and L of the standard problem A y = w^2 y, with y = L' phi and L L' = M."""
    L = cholesky_of_mass(M)
    half = jax.lax.linalg.triangular_solve(L, K, left_side=True, lower=True)
    return _symmetric(jax.lax.linalg.triangular_solve(L, half.T, left_side=True, lower=True)), L


def cholesky_of_mass(M: Float[Array, "n n"]) -> Float[Array, "n n"]:
    """Return L of M = L L'; NaN where M is singular to round-off."""
    L = jnp.linalg.cholesky(_symmetric(M), symmetrize_input=False)
    pivots = jnp.diagonal(L) ** 2
    return jnp.where(jnp.min(pivots - MASSLESS * jnp.diagonal(M), initial=jnp.inf) > 0, L, jnp.nan)


def _symmetric(A):
    return (A + A.T) / 2


@natural.defjvp
def _natural_jvp(primals, tangents):
    values, shapes = natural(*primals)
    dK, dM = map(_symmetric, tangents)
    cluster = clusters(values)
    same = together(cluster)
    N = shapes.T @ (dM @ shapes)
    W = shapes.T @ (dK @ shapes) - N * values[None]
    gap = jnp.where(same, 1.0, values[None] - values[:, None])
    return (values, shapes), (slopes(W, cluster), shapes @ jnp.where(same, -N / 2, W / gap))


# Poles: eigenvalues of an unsymmetric matrix

# smallest 1 - |x' y| of unit vectors of one cluster; below it the matrix cannot be diagonalized
PARALLEL = 1e-9


def coincide(one: Complex[Array, "n"], other: Complex[Array, "n"]) -> Bool[Array, "n n"]:
    """Return, for each pair of poles, whether they coincide. Rounding splits a double pole with a
    single eigenvector by the square root of the relative rounding error."""
    top = jnp.max(jnp.abs(one), initial=0.0)
    size = jnp.maximum(jnp.abs(one)[:, None], jnp.abs(other)[None])
    return jnp.abs(one[:, None] - other[None]) <= CLUSTERED * size + CLUSTERED / 10 * top * (
        size <= CLUSTERED * top
    ).astype(size.dtype)


@functools.partial(jnp.vectorize, signature="(n,n),(n),(n)->(n)")
def _one_sided_poles(W: Array, cluster: Array, order: Array) -> Array:
    """Return the eigenvalues of the block of W of each cluster, assigned to its members by
    imaginary part."""
    same = together(cluster)
    B = jnp.where(same, W, 0.0)
    # a scale for each block, so that small ones keep their digits
    size = jnp.max(jnp.where(same, jnp.sum(jnp.abs(B), -1), 0.0), -1, initial=0.0)
    size = 8 * jnp.where(size > 0, size, 1.0)
    values = jnp.linalg.eigvals(
        B / size[:, None].astype(W.dtype) + jnp.diag(cluster).astype(W.dtype)
    )
    label = jnp.round(values.real)
    members = jnp.lexsort((order, cluster))
    values = (values - label.astype(values.dtype))[jnp.lexsort((values.imag, label))] * size[
        members
    ].astype(values.dtype)
    return jnp.where(
        _alone(cluster), jnp.diagonal(W), jnp.zeros_like(values).at[members].set(values)
    )


pole_slopes = linear_one_way(
    "pole_slopes",
    _one_sided_poles,
    lambda x, cluster, order: _if_alike(x, cluster),
    again=lambda W, cluster, order: second(W, cluster),
)


def companion(M: Any, C: Any, K: Any) -> Any:
    """Return A of x' = A x, x = (Delta, Delta'), where M Delta'' + C Delta' + K Delta = 0."""
    xp, n = module_of(M), len(M)
    rates = xp.linalg.solve(M.astype(K.dtype), xp.concatenate([-K, -C.astype(K.dtype)], 1))
    return xp.concatenate([np.eye(n, 2 * n, n, dtype=K.dtype), rates])


def first_order(M: Any, C: Any, K: Any, n: int) -> tuple[Any, Any]:
    """Return A and B of x' = A x + B f, x = (Delta, Delta', y), where

        M (Delta, y)'' + C (Delta, y)' + K (Delta, y) = f.

    The columns of y, those after the first n, have M = 0: (Delta'', y') follow from the matrix
    [M_d, C_y] of their columns."""
    m = len(M)
    d, y = slice(n), slice(n, None)
    rates = jnp.linalg.solve(
        highest_rates(M, C, n).astype(K.dtype),
        jnp.concatenate([-K[:, d], -C[:, d].astype(K.dtype), -K[:, y], np.eye(m)], 1),
    )
    top = np.eye(n, n + m, n, dtype=K.dtype)
    return jnp.concatenate([top, rates[:, : n + m]]), jnp.concatenate(
        [jnp.zeros((n, m), K.dtype), rates[:, n + m :]]
    )


def highest_rates(M: Any, C: Any, n: int) -> Any:
    """Return the matrix [M_d, C_y] of (Delta'', y'), the highest rates of n coordinates with mass
    and of those without."""
    return jnp.concatenate([M[:, :n], C[:, n:]], 1)


def rows_of_one_size(K: Float[Array, "n m"]) -> Float[Array, "n m"]:
    """Return K with its rows divided by their largest number, so that it is singular where K is,
    whatever the units of the rows."""
    return K / jnp.max(jnp.abs(K), 1, initial=1e-300, keepdims=True)


def eig(A: Float[Array, "n n"]) -> tuple[Complex[Array, "n"], Complex[Array, "n n"]]:
    """Return s and x (columns, unit length) of A x = s x, in the order of LAPACK. Error: DEVICE."""
    if (device := jax.default_backend()) not in WITH_EIG:
        raise JaxbodyError(
            Problem(
                "DEVICE",
                "poles",
                f"JAX has no eig for the device {device}",
                device,
                ", ".join(WITH_EIG),
                'Set jax.config.update("jax_platforms", "cpu") first.',
            )
        )
    values, vectors = jnp.linalg.eig(A)
    return values, vectors


@jax.custom_jvp
def poles(A: Float[Array, "n n"]) -> tuple[Complex[Array, "n"], Array]:
    """Return s and x of A x = s x as `eig` does, with derivatives."""
    return eig(A)


def pole_clusters(values: Complex[Array, "n"]) -> Int[Array, "n"]:
    """Return a number for each pole, equal for poles that coincide."""
    return jnp.argmax(coincide(values, values), axis=0)


@poles.defjvp
def _poles_jvp(primals, tangents):
    (A,), (dA,) = primals, tangents
    s, X = poles(A)
    left, Y = poles(A.T)
    cluster = pole_clusters(s)
    same = together(cluster)
    overlap = jnp.abs(jnp.conj(X).T @ X) - 2 * np.eye(len(s), dtype=A.dtype)
    defective = jnp.any(same & (overlap > 1 - PARALLEL), axis=0)  # where derivatives are infinite
    match = coincide(left, s)
    broken = jnp.any(match & defective[None], axis=1)
    stand_in = (
        (jnp.cumsum(broken)[:, None] == jnp.cumsum(defective)[None])
        & broken[:, None]
        & defective[None]
    )
    G = jnp.where(match & ~defective[None] & ~broken[:, None], Y.T @ X, stand_in.astype(X.dtype))
    W = jnp.linalg.solve(G, Y.T @ (dA.astype(X.dtype) @ X))
    W = jnp.where(defective[:, None] | defective[None], 0.0, W)
    gap = jnp.where(same, 1.0, s[None] - s[:, None])
    ds = pole_slopes(W, cluster, jax.lax.stop_gradient(jnp.imag(s)))
    ds = jnp.where(defective, jnp.nan, ds)
    return (s, X), (ds, X @ jnp.where(same, 0.0, W / gap))


# a function of (vectors, cluster) that returns the vectors; those of a cluster have no derivatives
# (NaN)
refused_if_shared = with_tangent(
    lambda changes, vectors, cluster: jax.vmap(second_cotangent, (0, None))(changes, cluster)
)
