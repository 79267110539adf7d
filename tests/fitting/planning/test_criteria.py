"""Criteria of designs against their definitions, and design problems from books."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import root

import jaxbody as jb
from jaxbody.fitting.planning import criteria

KINDS = criteria.KINDS


def random_information(rng, p=4):
    J = rng.normal(size=(3 * p, p)) * 10 ** rng.uniform(-1, 1, p)
    return J.T @ J


@pytest.mark.parametrize("of", [None, [0, 2]])
def test_criteria_are_those_of_the_covariance(rng, of):
    M = random_information(rng)
    C = np.linalg.inv(M)[np.ix_(of or range(4), of or range(4))]
    expected = {
        "D": np.log(np.linalg.det(C)),
        "A": np.trace(C),
        "E": np.linalg.norm(C, 2),
        "largest interval": np.sqrt(C.diagonal().max()),
    }
    for kind, value in expected.items():
        np.testing.assert_allclose(jb.fitting.criterion(M, kind, of), value, rtol=1e-10)
        traced = jax.jit(lambda M, kind=kind: jb.fitting.criterion(M, kind, of))(jnp.asarray(M))
        np.testing.assert_allclose(traced, value, rtol=1e-10)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("of", [None, [0, 2]])
def test_tangents_are_below_the_criterion_everywhere(rng, kind, of):
    """And touch the power means where these are the criterion, with its derivative."""
    of = np.arange(4) if of is None else np.array(of)
    power = 2 if kind == "largest interval" else 1
    for _ in range(50):
        M, X = random_information(rng), random_information(rng)
        a, G = criteria.tangent(M, kind, of)
        assert a + np.sum(G * (X - M)) <= criteria.criterion(X, kind, of) ** power * (1 + 1e-9) + (
            1e-9 if kind == "D" else 0.0
        )
        assert criteria.criterion(M, kind, of) <= criteria.smooth(M, kind, of) + 1e-12
    if kind in ("D", "A"):
        slope = jax.grad(lambda M: criteria.criterion(M, kind, of))(jnp.asarray(M))
        np.testing.assert_allclose(G, (slope + slope.T) / 2, rtol=1e-8, atol=1e-14)


def test_box_and_lucas():
    """REFERENCES2 D3: y = t1/(t1 - t2) (e^(-t2 x) - e^(-t1 x)) at (0.7, 0.2), printed 1.23 and
    6.86; more digits by the root of the closed form of the derivatives (the 6.857666 given there is
    2e-5 off it)."""

    def rows(x):
        y = lambda t, x: t[0] / (t[0] - t[1]) * (jnp.exp(-t[1] * x) - jnp.exp(-t[0] * x))  # noqa: E731
        return jax.vmap(jax.grad(y), (None, 0))(jnp.array([0.7, 0.2]), x)

    grid = jnp.linspace(0.1, 10.0, 100)
    chosen = jb.choose({f"{x:.1f}": row for x, row in zip(grid, rows(grid), strict=True)}, n=2)
    assert chosen.names == ("1.2", "6.9") and chosen.efficiency > 0.999

    def value(x):
        return jb.fitting.criterion(rows(x).T @ rows(x))

    found = root(jax.grad(value), [1.2, 6.9], tol=1e-12).x
    np.testing.assert_allclose(found, [1.2294714, 6.85768905], atol=1e-7)


def test_cubic_on_an_interval():
    """REFERENCES2 D3: a quarter each at -1, -1/sqrt 5, 1/sqrt 5, 1; det of the mean information
    0.00512 [exact]."""
    x = np.unique(np.r_[np.linspace(-1, 1, 21), -1 / np.sqrt(5), 1 / np.sqrt(5)])
    candidates = {f"{each:.4f}": each ** np.arange(4) for each in x}
    result = jb.choose(candidates, n=8, repeated=True)
    assert result.names == tuple(sorted(result.names, key=float)) and len(result.names) == 8
    assert set(result.names) == {"-1.0000", "-0.4472", "0.4472", "1.0000"}
    np.testing.assert_allclose(np.linalg.det(result.information / 8), 0.00512, rtol=1e-12)
    assert result.efficiency > 0.99997  # what ends the search for shares, over four parameters
    assert sum(result.shares > 0.1) == 4
    np.testing.assert_allclose(result.shares[result.shares > 0.1], 2.0, atol=0.02)
