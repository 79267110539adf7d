"""Uncertainties of estimates for random Jacobians: rank and null directions, coverage, chi-squared,
units, more samples, gaps."""

import dataclasses

import numpy as np
import pytest
from scipy.linalg import toeplitz
from scipy.optimize import brentq, root
from scipy.signal import lfilter
from scipy.stats import chi2, kstest, t

from jaxbody.fitting.fit_results import interval_of_u
from jaxbody.fitting.statistics.autocorrelations import (
    Autoregression,
    autocovariances,
    autoregressions,
    chosen_order,
    products,
    whiteness,
)
from jaxbody.fitting.statistics.noises import ResidualSeries, noise_of
from jaxbody.fitting.statistics.uncertainties import assess, in_words, quantile

N, CHANNELS, LABELS = 250, 3, list("abcde")


def jacobian(n=N):
    """Of three channels of a decaying oscillation, by its frequency, damping, amplitudes and an
    offset: slow columns and fast ones."""
    t, w, z = np.arange(n), 0.31, 0.015
    fade = np.exp(-z * w * t)
    c, s, f, d = (
        fade * np.cos(w * t),
        fade * np.sin(w * t),
        w * t * fade * np.sin(w * t),
        5 * z * w * t * fade * np.cos(w * t),
    )
    channels = [
        [a * c + b * s, a * s - b * c, a * f + b * d, a * d - b * f, 0.3 * o + 0 * t]
        for a, b, o in [(1, 0.2, 1), (0.3, 0.5, 0), (0.1, 1, 0.5)]
    ]
    return np.moveaxis(np.array(channels), (0, 1, 2), (1, 2, 0)).reshape(n * CHANNELS, 5)


def records(n=N, channels=CHANNELS):
    return [
        ResidualSeries(f"y{i}", "y", "run", np.arange(n) * channels + i, np.arange(n))
        for i in range(channels)
    ]


def noise(rho, n=N, *, seed, count=1, common=0.0):
    """AR(1) of variance one; `common` is the part of it that all channels share."""
    rng = np.random.default_rng([seed, int(100 * rho)])
    e = np.sqrt(1 - common) * rng.normal(size=(count, n, CHANNELS)) + np.sqrt(common) * rng.normal(
        size=(count, n, 1)
    )
    e[:, 1:] *= np.sqrt(1 - rho**2)
    return lfilter([1.0], [1.0, -rho], e, axis=1).reshape(count, n * CHANNELS)


def uncertainties(J, E, n=N):
    """Estimates of linear fits to pure noise, whose true value is zero, and their uncertainties."""
    back = np.linalg.pinv(J)
    for e in E:
        u = back @ e
        yield u, assess(e - J @ u, J, [], [], LABELS, records(n))


@pytest.mark.parametrize(("rho", "common"), [(0.0, 0.0), (0.3, 0.0), (0.9, 0.0), (0.6, 0.5)])
def test_intervals_hold_the_truth_and_the_naive_ones_are_flagged(rho, common):
    """400 replicates know 95 % to 1.1 %: limits are three of these; tests/benchmarks/coverage.py
    has 2000 of simulated motions."""
    J, count = jacobian(), 400
    held, flagged, naive = [], [], []
    for u, uncertainty in uncertainties(J, noise(rho, seed=1, count=count, common=common)):
        low, high = interval_of_u(u, uncertainty, 0.95)
        held.append((low <= 0) & (high >= 0))
        naive.append(np.abs(u) <= 1.96 * np.sqrt(np.diag(uncertainty.white_covariance)))
        flagged.append(uncertainty.correlated)
    print(rho, common, np.mean(held, 0), "naive", np.mean(naive, 0), "flagged", np.mean(flagged))
    assert (np.abs(np.mean(held, 0) - 0.95) < 0.033).all()
    assert np.mean(flagged) >= 0.99 if rho else np.mean(flagged) < 0.01
    assert rho == 0 or (np.mean(naive, 0) < 0.93).all()


@pytest.mark.long
def test_normalized_errors_are_chi_squared():
    squares = [
        u @ np.linalg.solve(uncertainty.covariance, u)
        for u, uncertainty in uncertainties(jacobian(), noise(0.0, seed=2, count=1000))
    ]
    assert kstest(squares, chi2(5).cdf).pvalue > 1e-3


def test_one_white_noise_is_the_textbooks():
    J, e = jacobian(), noise(0.0, seed=3)[0]
    ((u, uncertainty),) = uncertainties(J, [e])
    r = e - J @ u
    assert not any(uncertainty.orders.values()) and not uncertainty.pairs
    covariance = r @ r / (len(r) - 5) * np.linalg.inv(J.T @ J)
    np.testing.assert_allclose(uncertainty.covariance, covariance, rtol=1e-9)
    _, freedom = uncertainty.spread(np.eye(5))
    np.testing.assert_allclose(freedom, len(r) - 5, rtol=1e-9)
    np.testing.assert_allclose(
        interval_of_u(u, uncertainty, 0.9)[1],
        u + quantile(0.9, len(r) - 5) * np.sqrt(np.diag(covariance)),
        rtol=1e-9,
    )


def test_at_a_bound_the_interval_is_one_sided():
    """It ends where half the sum of squares, least in the other parameters, has risen by t^2 s^2/2,
    t exceeded in 5 %."""
    J, e = jacobian(), noise(0.0, seed=6)[0]
    # so that the bound of zero from below holds it back
    J[:, 0] *= -np.sign(np.linalg.lstsq(J, e)[0][0])
    others = np.linalg.lstsq(J[:, 1:], e)[0]
    r = J[:, 1:] @ others - e
    uncertainty = assess(r, J, [], [], LABELS, records(N), inside=np.arange(5) > 0)
    low, high = interval_of_u(np.append(0.0, others), uncertainty, 0.95)

    def cost(u):
        left = e - J[:, 0] * u
        return np.sum((J[:, 1:] @ np.linalg.lstsq(J[:, 1:], left)[0] - left) ** 2) / 2

    freedom = len(r) - 5
    rise = t.ppf(0.95, freedom) ** 2 * (r @ r) / freedom / 2
    end = brentq(lambda u: cost(u) - cost(0.0) - rise, 0.0, 10 * high[0])
    assert low[0] == 0 and np.linalg.lstsq(J, e)[0][0] < 0
    np.testing.assert_allclose(high[0], end, rtol=1e-9)


def test_of_known_correlation_the_covariance_is_that_of_its_matrix():
    """(J'J)^-1 J' Omega J (J'J)^-1 with the explicit Omega of the fitted autoregressions."""
    J, e = jacobian(), noise(0.8, seed=4)[0]
    ((u, uncertainty),) = uncertainties(J, [e])
    r = (e - J @ u).reshape(N, CHANNELS)
    assert set(uncertainty.orders.values()) == {1} and not uncertainty.pairs
    Omega = np.zeros((N, CHANNELS, N, CHANNELS))
    for i in range(CHANNELS):
        phi = (r[1:, i] @ r[:-1, i]) / (r[:, i] @ r[:, i])
        Omega[:, i, :, i] = np.var(r[:, i]) * toeplitz(phi ** np.arange(N))
    A = np.linalg.pinv(J)
    expected = A @ Omega.reshape(3 * N, 3 * N) @ A.T
    ratio = np.diag(uncertainty.covariance) / np.diag(expected)
    print(ratio)  # above one: what the fit took is put back
    assert (ratio > 1).all() and (ratio < 1.35).all()


def test_autocovariances_are_those_whose_residuals_have_the_products_that_are_there():
    """By SciPy's root of E sum r_t r_(t+k) = trace_k[(I - QQ') Omega (I - QQ')], k = 0, 1, with all
    matrices written out: one record, of which the fit takes so much that variances would be a third
    too small. Left out are products over the ends of the record, of the order of 1/n."""
    n = 80
    J, e = jacobian(n)[::CHANNELS], noise(0.8, n, seed=12)[0][::CHANNELS]
    A = np.linalg.pinv(J)
    P = np.eye(n) - J @ A
    r = P @ e
    products = np.array([r @ r, r[1:] @ r[:-1]])
    uncertainty = assess(
        r, J, [], [], LABELS, [ResidualSeries("y", "y", "run", np.arange(n), np.arange(n))]
    )
    assert uncertainty.orders == {"y": 1}

    def omega(gamma):
        return gamma[0] * toeplitz((gamma[1] / gamma[0]) ** np.arange(n))

    result = root(
        lambda gamma: [np.trace(P @ omega(gamma) @ P, k) / products[k] - 1 for k in (0, 1)],
        products / n,
    )
    assert result.success
    ratio, plain = (
        np.diag(C) / np.diag(A @ omega(result.x) @ A.T)
        for C in (uncertainty.covariance, A @ omega(products / n) @ A.T)
    )
    print(ratio, plain)
    np.testing.assert_allclose(ratio, 1, atol=2 / n)
    assert (plain < 0.75).all()


def test_units_of_parameters_and_the_order_of_samples_do_not_matter():
    J, e = jacobian(), noise(0.6, seed=5)[0]
    # of u, which is of the order of one whatever the units of values
    scale = np.array([1e-2, 30.0, 1.0, 1e2, 1e-1])
    ((u, uncertainty),) = uncertainties(J, [e])
    other = assess(e - J @ u, J * scale, [], [], LABELS, records())
    np.testing.assert_allclose(
        other.covariance * np.outer(scale, scale), uncertainty.covariance, rtol=1e-9, atol=1e-12
    )
    order = np.random.default_rng(0).permutation(CHANNELS * N)
    place = np.argsort(order)
    moved = [one._replace(rows=place[one.rows]) for one in records()]
    again = assess((e - J @ u)[order], J[order], [], [], LABELS, moved)
    np.testing.assert_allclose(again.covariance, uncertainty.covariance, rtol=1e-9)


def test_the_covariance_falls_like_one_over_the_samples():
    """Of the same column again and again: exactly, but for the degrees of freedom."""
    one, e = np.ones((200, 1)), noise(0.0, 200, seed=6)[0][:200]
    r = e - e.mean()
    single, many = (
        assess(
            np.tile(r, k),
            np.tile(one, (k, 1)),
            [],
            [],
            ["a"],
            [ResidualSeries("y", "y", "", *[np.arange(200 * k)] * 2, False)],
        )
        for k in (1, 9)
    )
    np.testing.assert_allclose(
        many.covariance[0, 0] * (9 * 200 - 1) / (200 - 1),
        single.covariance[0, 0] / 9 * 9,
        rtol=1e-12,
    )


def test_gaps_are_as_if_the_samples_had_not_been_there():
    """Every second sample of two channels missing: autocorrelation is between those that
    there are."""
    J, count = jacobian(2 * N), 60
    rows = np.arange(2 * N * CHANNELS).reshape(-1, CHANNELS)
    gone = rows[1::2, 1:].ravel()
    partial = [
        ResidualSeries(
            f"y{i}", "y", "run", rows[:: 2 if i else 1, i], np.arange(2 * N)[:: 2 if i else 1]
        )
        for i in range(CHANNELS)
    ]
    J[gone] = 0
    held = []
    for e in noise(0.6, 2 * N, seed=7, count=count):
        e[gone] = 0
        u = np.linalg.pinv(J) @ e
        uncertainty = assess(e - J @ u, J, [], [], LABELS, partial)
        assert uncertainty.samples == 4 * N and all(uncertainty.orders.values())
        low, high = interval_of_u(u, uncertainty, 0.95)
        held.append((low <= 0) & (high >= 0))
    assert np.mean(held) > 0.95 - 3 * np.sqrt(0.95 * 0.05 / count)


def test_planted_null_directions_are_found_and_no_others():
    """500 problems: of columns over six decades, up to four directions without effect, some of
    single parameters."""
    rng = np.random.default_rng(2011)
    missed = alarms = 0
    for _ in range(500):
        n, m, k = int(rng.integers(3, 16)), int(rng.integers(40, 120)), int(rng.integers(0, 5))
        k = min(k, n - 1)
        J = rng.normal(size=(m, n)) * 10 ** rng.uniform(-1.5, 1.5, n)
        planted = rng.normal(size=(n, k)) * (rng.random((n, k)) < 0.5)
        planted[rng.integers(0, n), :] += 1.0
        planted = np.linalg.qr(planted)[0] if k else planted
        J = J - J @ planted @ planted.T + 1e-13 * rng.normal(size=(m, n))
        uncertainty = assess(rng.normal(size=m), J, [], [], [f"p{i}" for i in range(n)], [])
        result = uncertainty.null
        missed += uncertainty.rank > n - k
        alarms += uncertainty.rank < n - k
        if uncertainty.rank == n - k and k:
            # the sine of the largest angle
            assert np.linalg.norm(planted - result @ (result.T @ planted), 2) < 1e-4
    print(f"missed {missed}, false alarms {alarms}")
    assert missed <= 5 and alarms <= 5


def test_null_directions_in_words():
    labels = ["AB.stiffness", "CD.stiffness", "plate.mass"]
    null = np.array([[1, -1, 0]]).T / np.sqrt(2)
    assert in_words(null, labels, []) == ["AB.stiffness up with CD.stiffness down"]


@pytest.mark.parametrize("rounding", [[0, 1e-12, 2e-12], [2e-12, 0, 1e-12], [1e-12, 2e-12, 0]])
def test_parameters_that_count_equally_are_named_in_their_order(rounding):
    """A scale of all forces: whichever rounding makes the largest, the words are the same."""
    null = (np.ones((3, 1)) + np.array(rounding)[:, None]) / np.sqrt(3)
    labels = ["AB.stiffness", "AB.damping", "plate.mass"]
    assert in_words(null, labels, []) == ["AB.stiffness up with AB.damping up with plate.mass up"]


def test_autoregressions_are_those_of_yule_and_walker():
    process = Autoregression(np.array([1.2, -0.5]), 2.0)
    gamma = autocovariances(process, 50)
    np.testing.assert_allclose(
        gamma[2:], 1.2 * gamma[1:-1] - 0.5 * gamma[:-2], rtol=1e-9, atol=1e-12
    )
    np.testing.assert_allclose(gamma[0] - 1.2 * gamma[1] + 0.5 * gamma[2], 2.0, rtol=1e-12)
    result = autoregressions(gamma[:5])[-1]
    np.testing.assert_allclose(result.phi, [1.2, -0.5, 0, 0], atol=1e-12)
    x = lfilter([1.0], [1, -1.2, 0.5], np.random.default_rng(0).normal(size=3000))[500:]
    assert chosen_order(x) == 2 and chosen_order(np.random.default_rng(1).normal(size=2000)) == 0
    assert np.allclose(products(x, 1), [x @ x, x[1:] @ x[:-1]])


def test_whiteness_is_reported_by_ljung_and_box():
    """p-values of white noise are uniform; Durbin and Watson's d is near 2 (1 - r1)."""
    rng = np.random.default_rng(9)
    tests = [whiteness(rng.normal(size=300)) for _ in range(400)]
    assert kstest([test.p for test in tests], "uniform").pvalue > 1e-3
    colored = whiteness(noise(0.5, seed=8)[0].reshape(N, CHANNELS)[:, 0])
    assert colored.p < 1e-6 and colored.d == pytest.approx(2 * (1 - colored.r1), abs=0.02)
    assert whiteness(np.ones(5)) is None and whiteness(np.zeros(100)) is None


@pytest.mark.parametrize(
    ("orders", "times", "noise", "text"),
    [
        (
            [0, 0],
            1.0,
            "noise white",
            (
                ", but no autoregression describes them better than white noise, which "
                "standard errors assume"
            ),
        ),
        (
            [1, 1],
            1.04,
            "noise autoregressive of order 1",
            "; standard errors, which assume autoregressions of order 1, are those of white noise",
        ),
        (
            [0, 3],
            2.5,
            "noise autoregressive of order up to 3",
            (
                ": standard errors for white noise would be up to 2.5 times too small; these "
                "assume autoregressions of order up to 3"
            ),
        ),
        (
            [2, 3],
            0.5,
            "noise autoregressive of order 2 to 3",
            (
                ": standard errors for white noise would be up to 2 times too large; these assume "
                "autoregressions of order 2 to 3"
            ),
        ),
    ],
)
def test_correlated_residuals_are_said_without_empty_figures(orders, times, noise, text):
    """No "up to 1 times too large", no "autoregressions of order 0"."""
    J = jacobian()
    ((_, uncertainty),) = uncertainties(J, [np.random.default_rng(5).normal(size=len(J))])
    uncertainty = dataclasses.replace(
        uncertainty,
        covariance=times**2 * uncertainty.white_covariance,
        orders=dict(zip("ab", orders, strict=True)),
        correlated=True,
    )
    assert uncertainty.noise == noise and uncertainty.about_noise() == [
        f"residuals are correlated (lag one {uncertainty.correlation:.2f}){text}"
    ]


def test_residuals_of_an_unfinished_fit_have_a_stationary_noise():
    """Sines that are not orthogonal to the columns, as a fit has left them that ended early: no
    process has the autocovariances that the correction for the columns makes of them. Q'e cannot
    vary more than n times the mean square of the residuals."""
    t = 0.02 * np.arange(401)
    for seed in (155, 266):
        rng = np.random.default_rng(seed)
        w = rng.uniform(1, 30, (5, 1))
        Q = np.linalg.qr(np.sin(w * t + rng.uniform(0, 6, (5, 1))).T)[0]
        r = sum(np.sin(rng.uniform(1, 30) * t + rng.uniform(0, 6)) for _ in range(5))
        found = noise_of(r, Q, [ResidualSeries("y", "y", "run", np.arange(401), np.arange(401))])
        assert 0 < np.linalg.eigvalsh(found.M)[-1] <= r @ r and np.isfinite(found.parts).all()
