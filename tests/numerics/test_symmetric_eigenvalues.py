"""Eigenvalues by batched operations against NumPy's LAPACK: alone, in lanes, for
difficult matrices."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxbody.numerics.eigenproblems import natural
from jaxbody.numerics.lanes import LANES, in_lanes
from jaxbody.numerics.symmetric_eigenvalues import eigenvalues, number_below

pytestmark = pytest.mark.everywhere


def symmetric_matrices(n: int, count: int) -> np.ndarray:
    """Random ones; zero, one, all ones, graded over 16 decades, with repeated eigenvalues,
    diagonal, very small and very large."""
    rng = np.random.default_rng(0)
    A = rng.standard_normal((count, n, n))
    Q = np.linalg.qr(rng.standard_normal((n, n)))[0]
    graded = 10.0 ** rng.uniform(-8, 8, n)
    A[:6] = (
        np.zeros((n, n)),
        np.eye(n),
        np.ones((n, n)),
        Q * graded @ Q.T,
        Q * np.arange(n).clip(0, 1) @ Q.T,
        np.diag(graded),
    )
    A[6] *= 1e-200
    A[7] *= 1e200
    return (A + A.transpose(0, 2, 1)) / 2


@pytest.mark.long
@pytest.mark.parametrize("n", [1, 2, 3, 18])
def test_they_are_lapacks(n):
    A = symmetric_matrices(n, LANES + 8)
    theirs = np.linalg.eigvalsh(A)
    # of both: a few round-offs of the largest
    tolerance = 20 * np.finfo(float).eps * np.abs(theirs).max(1, keepdims=True)
    alone = jax.jit(lambda A: jax.lax.map(eigenvalues, A))(A)
    in_a_batch = jax.jit(jax.vmap(in_lanes(jnp.linalg.eigvalsh)))(A)
    for ours in (alone, in_a_batch):
        assert (np.abs(ours - theirs) <= tolerance).all()


@pytest.mark.long
def test_a_matrix_without_eigenvalues_has_none_and_disturbs_no_other():
    for n in (2, 5):
        A = symmetric_matrices(n, 12)
        A[3, 0, -1] = A[3, -1, 0] = np.nan
        assert np.isnan(eigenvalues(jnp.asarray(A[3]))).all()
        ours = jax.jit(jax.vmap(in_lanes(jnp.linalg.eigvalsh)))(A)
        assert np.isnan(ours[3]).all() and np.isfinite(np.delete(ours, 3, 0)).all()


@pytest.mark.parametrize("n", [1, 2, 3, 7])
def test_eigenvalues_are_counted_as_lapack_orders_them(n):
    """Counts are those of a matrix that differs by round-off, so that x between eigenvalues are
    tried, and some far outside."""
    A = symmetric_matrices(max(n, 2), LANES + 8)[:, :n, :n]
    values = np.linalg.eigvalsh(A)
    size = np.abs(values).max(1, keepdims=True)
    x = np.concatenate(
        [(values[:, 1:] + values[:, :-1]) / 2, -2 * size - 1e-300, 2 * size + 1e-300], 1
    )
    apart = (
        np.abs(x[:, :, None] - values[:, None]) > 20 * np.finfo(float).eps * size[:, None]
    ).all(2)
    theirs = (values[:, None] < x[:, :, None]).sum(2)
    alone = jax.jit(lambda A, x: jax.lax.map(lambda args: number_below(*args), (A, x)))(A, x)
    in_a_batch = jax.jit(jax.vmap(in_lanes(number_below)))(A, x)
    for ours in (alone, in_a_batch):
        assert ((np.asarray(ours) == theirs) | ~apart).all()
    assert apart.sum() > 0.8 * apart.size


def test_stacks_and_hermitian_matrices_are_left_to_lapack():
    A = symmetric_matrices(3, 24)[8:]
    H = A + 1j * np.cross(np.eye(3)[:, None], np.eye(3))[0]
    for stack in (A.reshape(4, 4, 3, 3), H):
        np.testing.assert_allclose(
            jax.jit(jax.vmap(in_lanes(jnp.linalg.eigvalsh)))(stack),
            np.linalg.eigvalsh(stack),
            atol=1e-14,
        )


@pytest.mark.long
def test_a_batch_of_frequencies_calls_lapack_for_no_eigenvectors():
    K = symmetric_matrices(5, 8) + 10 * np.eye(5)
    M = np.broadcast_to(np.diag([1.0, 2.0, 3.0, 4.0, 5.0]), K.shape)
    values, both = (
        jax.jit(jax.vmap(f)).lower(K, M).compile().as_text()
        for f in (lambda K, M: natural(K, M)[0], natural)
    )
    assert "syevd" not in values and "syevd" in both
