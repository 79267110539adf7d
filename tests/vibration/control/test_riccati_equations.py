"""Riccati equations: against SciPy, closed forms, what no cost sees, derivatives, batches."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg

from jaxbody.vibration.control.riccati_equations import between_samples, care, dare

CARE, DARE = jax.jit(care), jax.jit(dare)


def drawn(rng, n, m):
    L = rng.normal(size=(n + m, n + m))
    J = L @ L.T + np.eye(n + m)
    return rng.normal(size=(n, n)), rng.normal(size=(n, m)), J[:n, :n], J[n:, n:], J[:n, n:]


@pytest.mark.parametrize("n, m", [(1, 1), (4, 1), (9, 3)])
def test_solutions_are_those_of_scipy(n, m, rng):
    # SciPy's own residuals on these systems are up to 1e-12 of the largest number
    for _ in range(5):
        A, B, Q, R, N = drawn(rng, n, m)
        expected = scipy.linalg.solve_continuous_are(A, B, Q, R, s=N)
        np.testing.assert_allclose(CARE(A, B, Q, R, N), expected, atol=3e-12 * expected.max())
        expected = scipy.linalg.solve_discrete_are(A, B, Q, R, s=N)
        np.testing.assert_allclose(DARE(A, B, Q, R, N), expected, atol=3e-12 * expected.max())


def test_fast_and_slow_motions_in_unlike_units():
    """Two oscillators, 1 and 1000 rad/s, stable and unstable, states in m and 1e6 m/s."""
    A = scipy.linalg.block_diag([[0, 1e6], [-1e-6, -0.02]], [[0, 1.0], [-1e6, 20.0]])
    A[3, 0] = 1.0
    args = A, np.array([[0], [1e-6], [0], [1.0]]), np.diag([1.0, 0, 1, 0]), np.eye(1)
    expected = scipy.linalg.solve_continuous_are(*args)
    size = np.sqrt(np.diag(expected))
    # relative to the cost from each state; rates that differ a thousandfold cost three digits
    np.testing.assert_allclose((CARE(*args) - expected) / np.outer(size, size), 0, atol=1e-9)


DRIFT = np.array([[0.0, 1, 0], [-4, -1, 4], [0, 0, 0]])  # x'' = -4 (x - w) - x', w' = noise


def relative(stretch):
    """The cost sees x - w of DRIFT, in coordinates in which w = stretch w2."""
    T = jnp.diag(jnp.array([1.0, 1.0, 0.0])).at[2, 2].set(stretch).at[0, 1].set(0.1 * stretch)
    C = jnp.array([[1.0, 0, -1]]) @ T
    return jnp.linalg.solve(T, DRIFT @ T), jnp.linalg.solve(T, np.eye(3)[:, 1:2]), C.T @ C, T


def test_a_drift_that_the_cost_does_not_see_costs_nothing():
    """P is that of x - w alone, where the displacement of everything cannot be seen."""
    A, B, Q, T = relative(1.3)
    P = np.linalg.solve(T.T, np.asarray(CARE(A, B, Q, np.eye(1)))) @ np.linalg.inv(T)
    two = scipy.linalg.solve_continuous_are(
        np.array([[0.0, 1], [-4, -1]]), np.eye(2)[:, 1:], np.diag([1.0, 0]), np.eye(1)
    )
    to_two = np.array([[1.0, 0, -1], [0, 1, 0]])
    np.testing.assert_allclose(P, to_two.T @ two @ to_two, atol=1e-13)


@pytest.mark.long
def test_derivatives_hold_where_the_unseen_drift_turns_with_the_parameter():
    def cost(stretch):
        A, B, Q, _ = relative(stretch)
        return jnp.sum(care(A, B, Q, jnp.eye(1)) * np.arange(9.0).reshape(3, 3))

    first, second = jax.jit(jax.grad(cost)), jax.jit(jax.hessian(cost))
    h = 1e-4  # central differences of the second order: errors of 1e-8
    slope = (jax.jit(cost)(1.3 + h) - jax.jit(cost)(1.3 - h)) / (2 * h)
    np.testing.assert_allclose(first(1.3), slope, rtol=1e-6)
    np.testing.assert_allclose(jax.jit(jax.jacfwd(cost))(1.3), first(1.3), rtol=1e-9)
    np.testing.assert_allclose(second(1.3), (first(1.3 + h) - first(1.3 - h)) / (2 * h), rtol=1e-6)


def test_a_weight_of_zero_has_its_derivative():
    """P = 1/(2 a) of an uncoupled decay to first order in the weight."""

    def cost(weight):
        A, Q = -jnp.diag(jnp.array([1.0, 2.0])), jnp.diag(jnp.stack([1.0, weight]))
        return jnp.trace(care(A, jnp.eye(2), Q, jnp.eye(2)))

    np.testing.assert_allclose(jax.jit(jax.grad(cost))(0.0), 1 / 4, rtol=1e-12)


@pytest.mark.nan
@pytest.mark.parametrize("function", [CARE, DARE], ids=["continuous", "sampled"])
@pytest.mark.parametrize("growth", [0.0, 0.5])
def test_what_grows_and_cannot_be_reached_has_no_solution_unless_it_is_unseen(function, growth):
    rate = growth if function is CARE else 1 + growth
    A, B = np.diag([rate, 0.5 * rate - 0.5]), np.array([[0.0], [1]])
    assert np.isnan(function(A, B, np.eye(2), np.eye(1))).all()
    P = function(A, B, np.diag([0.0, 1]), np.eye(1))
    assert np.isfinite(P).all() and P[0, 0] == 0


def test_nothing_is_seen():
    free = np.array([[0.0, 1], [0, 0]])
    np.testing.assert_array_equal(CARE(free, np.eye(2)[:, 1:], np.zeros((2, 2)), np.eye(1)), 0)


@pytest.mark.long
def test_a_thousand_designs_at_once(rng):
    A, B, Q, R, N = drawn(rng, 5, 2)
    several = A[None] * np.linspace(0.5, 1.5, 1000)[:, None, None]
    P = jax.jit(jax.vmap(lambda A: care(A, B, Q, R, N)))(several)
    for i in (0, 777):
        np.testing.assert_allclose(P[i], CARE(several[i], B, Q, R, N), rtol=1e-10)


def test_between_samples_fast_motions_do_not_overflow():
    """Of x' = -a x: M = (1 - exp(-2 a T))/(2 a), its integral T/(2 a) - M/(2 a)."""
    a, T = np.array([1e-3, 3.0, 2e3]), 1.0
    F, M, twice = between_samples(-jnp.diag(a), jnp.eye(3), jnp.asarray(T))
    expected = -np.expm1(-2 * a * T) / (2 * a)
    np.testing.assert_allclose(np.diag(F), np.exp(-a * T), rtol=1e-12, atol=1e-300)
    np.testing.assert_allclose(np.diag(M), expected, rtol=1e-12)
    # the first loses digits in this formula: 4e-4 = 0.9990 - 0.9986
    np.testing.assert_allclose(np.diag(twice)[1:], ((T - expected) / (2 * a))[1:], rtol=1e-12)
    np.testing.assert_allclose(twice[0, 0], T**2 / 2 * (1 - 2 * a[0] * T / 3), rtol=1e-6)
