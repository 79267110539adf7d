"""Natural modes against SciPy, poles against the roots of a polynomial, and the derivatives
of both."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg

from jaxbody.numerics.eigenproblems import natural, poles


@pytest.fixture
def matrices(rng):
    """Stiffness and mass of five coordinates, and a change of each."""
    A, B, dK, dM = rng.normal(size=(4, 5, 5))
    return A @ A.T + np.diag([1.0, 30, 5, 60, 12]), B @ B.T + np.eye(5), dK + dK.T, dM + dM.T


def test_they_are_scipys_ascending_with_unit_modal_mass_and_the_largest_component_positive(
    matrices,
):
    K, M, *_ = matrices
    values, shapes = jax.jit(natural)(K, M)
    expected, vectors = scipy.linalg.eigh(K, M)
    np.testing.assert_allclose(values, expected, rtol=1e-12)
    largest = np.abs(vectors).argmax(0)
    np.testing.assert_allclose(
        shapes, vectors * np.sign(vectors[largest, range(5)]), rtol=0, atol=1e-12
    )


def test_their_derivatives_are_those_of_differences(matrices):
    """By stiffness and by mass, of values and of shapes; differences of SciPy's with an error of
    the order of h^2."""
    K, M, dK, dM = matrices
    h = 1e-5
    derivatives = jax.jit(
        lambda K, M: jax.jvp(natural, (K, M), (jnp.asarray(dK), jnp.asarray(dM)))[1]
    )(K, M)
    ends = []
    for sign in (1, -1):
        values, vectors = scipy.linalg.eigh(K + sign * h * dK, M + sign * h * dM)
        ends.append((values, vectors * np.sign(vectors[np.abs(vectors).argmax(0), range(5)])))
    for found, high, low in zip(derivatives, *ends, strict=True):
        np.testing.assert_allclose(found, (high - low) / (2 * h), rtol=1e-6, atol=1e-6)


def test_derivatives_of_poles_are_those_of_the_characteristic_polynomial():
    """s^2 + c s + k = 0, ds/dk = -1/(2 s + c), ds/dc = -s/(2 s + c), for a pair and for two
    real poles."""

    def of(p):
        return poles(jnp.array([[0.0, 1.0], [-p[0], -p[1]]]))[0]

    for k, c in ((25.0, 2.0), (4.0, 5.0)):
        p = jnp.array([k, c])
        s = np.asarray(of(p))
        np.testing.assert_allclose(s**2 + c * s + k, 0.0, atol=1e-12)
        np.testing.assert_allclose(
            jax.jit(jax.jacfwd(of))(p),
            np.stack([-1 / (2 * s + c), -s / (2 * s + c)], 1),
            rtol=1e-12,
        )
