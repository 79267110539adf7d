"""Simulation-based calibration (D7): the rank of the truth among draws of the posterior is uniform,
for parameters drawn from the prior and data simulated with them; not so for posteriors that are too
narrow or too wide. Source: S. Talts et al., arXiv 1804.06788 (2018)."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import straight_lines as lines

import jaxbody as jb
from jaxbody.fitting import LogNormal
from jaxbody.fitting.posteriors import drawn_further, prepared, warmed

pytest.importorskip("blackjax", reason="needs jaxbody[posterior]")
pytest.importorskip("arviz_stats", reason="needs jaxbody[posterior]")
LIMIT = 43.82  # 99.9 % of chi-square with 19 degrees of freedom
SETS, DRAWS, BINS, THIN, WARMUP, BURN_IN = 1000, 99, 20, 2, 300, 20


def squares(ranks):
    """Chi-square of ranks 0 ... DRAWS, which are uniform for a right posterior, in BINS bins."""
    counts = np.bincount(ranks * BINS // (DRAWS + 1), minlength=BINS)
    expected = len(ranks) / BINS
    return ((counts - expected) ** 2).sum() / expected


def calibrated(density, run, truths, key):
    """The draws (SETS, DRAWS, n) for data simulated with each truth, in y. The chain of each data
    set starts apart from the truth; the steps of all are those adapted to one of them."""
    blackjax = pytest.importorskip("blackjax")
    channel = next(iter(density.task.experiments[run].channels))
    measured = lambda d: d.task.space.runs[run].measured[channel]  # noqa: E731
    level = density.task.noise[run][channel]

    def root_at(y, own):
        J, G = own.local(y)[2], jax.jacfwd(own.scaled_priors)(y)
        return jnp.linalg.cholesky(jnp.linalg.inv(J.T @ J + G.T @ G))

    z_to_y = (truths[0], root_at(truths[0], density))
    _, tuning = warmed(density, z_to_y, jnp.zeros((1, truths.shape[1])), key[None], WARMUP)

    def one(y, key):
        ours = jax.random.split(key, 4)
        reading = density.task.runs(y)[run][0][channel]
        noisy = reading + level * jax.random.normal(ours[0], reading.shape)
        own = eqx.tree_at(measured, density, noisy)
        root = root_at(y, own)
        z = 1.5 * jax.random.normal(ours[1], (1, len(y)))
        states = jax.vmap(lambda z: blackjax.nuts.init(z, lambda z: own(y + root @ z)))(z)
        draws = BURN_IN + DRAWS * THIN
        _, (z, *_) = drawn_further(own, (y, root), states, tuning, ours[3][None], draws)
        return y + z[0, BURN_IN::THIN] @ root.T

    return np.asarray(jax.jit(jax.vmap(one))(truths, jax.random.split(key, len(truths))))


def check_calibration(truths, draws):
    truths = np.asarray(truths)[:, None]
    mean = draws.mean(1, keepdims=True)
    for scale, right in ((1.0, True), (0.8, False), (1.25, False)):
        ranks = (mean + scale * (draws - mean) < truths).sum(1)
        for k in range(draws.shape[-1]):
            value = squares(ranks[:, k])
            print(f"scaled by {scale}: {value:.1f}")
            assert (value < LIMIT) == right, (scale, k, value)


@pytest.mark.long
def test_a_linear_problem_is_calibrated():
    """1000 data sets, 99 draws each."""
    density, _ = prepared(lines.fitted(), None)
    numbers = lines.DEVIATIONS * np.random.default_rng(1).normal(size=(SETS, 2))
    forms = [parameter.form for parameter in density.unknowns.parameters]
    truths = np.stack(
        [[form.inverse(x)[0] for form, x in zip(forms, row, strict=True)] for row in numbers]
    )
    check_calibration(truths, calibrated(density, "run", jnp.asarray(truths), jax.random.key(2)))


@pytest.mark.long
def test_two_stiffnesses_of_a_car_are_calibrated():
    """Suspension and tyre of a quarter car, by its two natural frequencies."""
    car = jb.presets.quarter_car()
    free = ("suspension.stiffness", "tyre.stiffness")
    frequency = jb.modes(jb.linearize(car, jb.equilibrium(car))).frequency
    test = jb.MeasuredModes(frequency=frequency, noise={"frequency": 0.03 * frequency})
    fit = jb.fit(car, {"test": test}, free=free)
    k = fit.task.space.values(jnp.zeros(2))
    density, _ = prepared(fit, {path: LogNormal(float(k[path]), 0.2) for path in free})
    truths = 0.2 * np.random.default_rng(1).normal(size=(SETS, 2))
    check_calibration(truths, calibrated(density, "test", jnp.asarray(truths), jax.random.key(2)))
