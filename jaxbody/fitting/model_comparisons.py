"""Comparison of models by their posteriors: evidence by bridge sampling, and the expected log
density of a left-out sample by smoothed importance sampling.

    Z = E_g[h p]/E_post[h g],    h = 1/(s1 p + s2 Z g)

p is the density of data and parameters, g a normal density fitted to half of the draws, and s1, s2
the shares of draws from the posterior and from g.
Sources: X.-L. Meng and W. H. Wong, Statistica Sinica 6 (1996) 831; S. Fruehwirth-Schnatter,
Econometrics Journal 7 (2004) 143 (error); A. Vehtari, A. Gelman, J. Gabry, Statistics and Computing
27 (2017) 1413 (leaving one out).
"""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxbody.core import tables
from jaxbody.core.arrays import Array, Float, Int
from jaxbody.core.compilation.compile_options import OPTIMIZED, program_with
from jaxbody.core.errors import JaxbodyError, Problem, Status, import_extra
from jaxbody.core.results import Result, warn_if_failed
from jaxbody.fitting.experiments.measurements import records_of
from jaxbody.fitting.posteriors import LogDensity, Posterior

TOGETHER = 16  # draws evaluated in one batch
ROUNDS, CLOSE = 1000, 1e-10  # of the iteration for the evidence
UNRELIABLE = 0.7  # Pareto k above which the importance weights of a sample are not reliable
LARGEST = 2e7  # numbers of log likelihoods by draw and sample; fewer draws are used beyond


class Evidence(Result):
    """Result of `evidence`: `log_evidence`, the logarithm of the density of the data, and its
    `standard_error`."""

    log_evidence: float
    standard_error: float
    status: np.ndarray

    def _tables(self) -> list[tables.PrintedTable]:
        row = (float(self.log_evidence), float(self.standard_error))
        heads = ("log evidence", "standard error")
        return [tables.PrintedTable("Evidence", heads, [row], self.report(), digits=6)]


class LeaveOneOut(Result):
    """Result of `leave_one_out`: `elpd`, the sum over all samples of the logarithm of the density
    predicted for each from the others, and its `standard_error`.

    For each of m samples: `pointwise`, its logarithm of the density; `pareto_k`, above 0.7 if it is
    not reliable; `samples`, its name. `status` is NOT_CONVERGED if one is not reliable."""

    elpd: float
    standard_error: float
    pointwise: Float[np.ndarray, "m"]
    pareto_k: Float[np.ndarray, "m"]
    samples: tuple[str, ...]
    status: Int[np.ndarray, ""]

    def explain(self) -> str:
        return (
            f"Pareto k exceeds {UNRELIABLE} for {int((self.pareto_k > UNRELIABLE).sum())} samples"
        )

    def _tables(self) -> list[tables.PrintedTable]:
        worst = np.argsort(-self.pareto_k)[:3]
        rows = [(self.samples[i], float(self.pareto_k[i]), float(self.pointwise[i])) for i in worst]
        total = [(float(self.elpd), float(self.standard_error), len(self.samples))]
        return [
            tables.PrintedTable("Leave one out", ("elpd", "standard error", "samples"), total),
            tables.PrintedTable(
                "", ("largest Pareto k", "k", "log density"), rows, self.report(), digits=3
            ),
        ]


def evidence(posterior: Posterior, *, key: Array | None = None) -> Evidence:
    """Compute the evidence of a model, the density of the data with all unknowns integrated out, by
    bridge sampling.

    Args:
        posterior: the result of `posterior`, with priors of all parameters and noise levels.
        key: random key of the draws to compare with; None takes jax.random.key(1).

    Two models of the same data compare by the difference of their logarithms: 3 is strong evidence
    for the larger one. The variance of the difference is the sum of the variances. It depends on
    the widths of the priors.

    Errors: FLAT_PRIOR for parameters without a prior, by name. Warns NOT_CONVERGED.

    >>> import inspect
    >>> inspect.signature(jb.fitting.evidence).return_annotation.__name__
    'Evidence'
    """
    density = posterior.density
    flat = [
        parameter.path
        for parameter, prior in zip(density.unknowns.parameters, density.priors, strict=True)
        if not prior.proper
    ]
    if flat:
        raise JaxbodyError(
            Problem(
                "FLAT_PRIOR",
                "evidence.posterior",
                f"has no normalized prior of {', '.join(flat)}",
                flat,
                hint="Give posterior(..., priors={path: (mean, standard deviation)}) of all.",
            )
        )
    from scipy.special import logsumexp
    from scipy.stats import multivariate_normal

    array_stats = import_extra("arviz_stats.base", "evidence").array_stats
    half, n = posterior.y.shape[1] // 2, posterior.y.shape[2]
    first = posterior.y[:, :half].reshape(-1, n)
    g: Any = multivariate_normal(mean=first.mean(0), cov=np.cov(first.T))  # pyright: ignore
    y, log_p = posterior.y[:, half:], posterior.log_density[:, half:]
    z = jax.random.normal(jax.random.key(1) if key is None else key, (log_p.size, n))
    other = first.mean(0) + np.asarray(z) @ np.linalg.cholesky(np.cov(first.T).reshape(n, n)).T
    of_draws = log_p - g.logpdf(y).reshape(log_p.shape)
    of_g = np.asarray(_densities(density, jnp.asarray(other))) - g.logpdf(other)
    effective = float(np.median(posterior.ess_bulk)) / 2
    s1 = effective / (effective + log_p.size)
    weights = np.log([s1, 1 - s1])
    log_z, before, above, below = float(np.median(of_draws)), np.inf, of_g, of_draws
    for _ in range(ROUNDS):
        above = of_g - np.logaddexp(weights[0] + of_g, weights[1] + log_z)
        below = -np.logaddexp(weights[0] + of_draws, weights[1] + log_z)
        log_z, before = float(np.asarray(logsumexp(above)) - np.asarray(logsumexp(below))), log_z
        if abs(log_z - before) < CLOSE:
            break
    above, below = np.exp(above - above.max()), np.exp(below - below.max())
    size = array_stats.ess(below, chain_axis=0, draw_axis=1, method="mean")
    squares = above.var() / above.mean() ** 2 / above.size + below.var() / below.mean() ** 2 / size
    status = Status.OK if abs(log_z - before) < CLOSE else Status.NOT_CONVERGED
    return warn_if_failed(
        Evidence(
            log_evidence=log_z,
            standard_error=float(np.sqrt(squares)),
            status=np.asarray(status.value),
        )
    )


@program_with(OPTIMIZED)
def _densities(density: LogDensity, y: Array) -> Array:
    return jax.lax.map(lambda y: density.local(y)[0], y, batch_size=TOGETHER)


@program_with(OPTIMIZED)
def _likelihoods(density: LogDensity, y: Array) -> Array:
    return jax.lax.map(density.pointwise, y, batch_size=TOGETHER)


def leave_one_out(posterior: Posterior) -> LeaveOneOut:
    """Estimate how well the model predicts each sample from all others, from the draws of a
    posterior, without a refit.

    A sample is one number of a record; the real and the imaginary part count as two. Two models of
    the same data compare by the sum of the differences d of `pointwise`, whose standard error is
    sqrt(m) times the standard deviation of d.

    Args:
        posterior: the result of `posterior`.

    Warns NOT_CONVERGED if a sample is so influential that it needs a refit without it: such samples
    are in the table.

    >>> import inspect
    >>> inspect.signature(jb.fitting.leave_one_out).return_annotation.__name__
    'LeaveOneOut'
    """
    array_stats = import_extra("arviz_stats.base", "leave_one_out").array_stats
    density, (chains, draws, n) = posterior.density, posterior.y.shape
    present = np.flatnonzero(density.present)
    every = -(-chains * draws * len(density.present) // int(LARGEST))
    y = posterior.y[:, ::every]
    log = np.asarray(_likelihoods(density, jnp.asarray(y.reshape(-1, n))))[:, present]
    of_one = partial(array_stats.loo, chain_axis=0, draw_axis=1)
    relative = min(float(np.mean(posterior.ess_bulk)) / (chains * draws), 1.0)
    pointwise, k, _ = of_one(log.reshape(chains, -1, len(present)), r_eff=relative)
    names = dict.fromkeys(present.tolist(), "")
    for record in records_of(density.task.experiments):
        place = density.task.experiments[record.run].place
        for row, time in zip(record.rows.tolist(), record.times.tolist(), strict=True):
            names[row] = f"{record.name} at {place(time)[0]}"
    good = bool((k <= UNRELIABLE).all())
    return warn_if_failed(
        LeaveOneOut(
            elpd=float(pointwise.sum()),
            standard_error=float(np.sqrt(len(present)) * pointwise.std(ddof=1)),
            pointwise=pointwise,
            pareto_k=k,
            samples=tuple(names.values()),
            status=np.asarray((Status.OK if good else Status.NOT_CONVERGED).value),
        )
    )
