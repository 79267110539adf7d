"""Priors as densities of the transformed free parameters u: normal, log-normal, or flat in u.

    log p(u) = log p(t) + log |dt/du|,    t = x or log x

A normal prior of a number whose domain or bounds have an end is truncated there. A flat prior of
positive numbers is flat in their logarithms, and uniform between two finite bounds.
"""

from collections.abc import Iterable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxbody.core.arguments import checked_dict
from jaxbody.core.arrays import Array, Float, device_array
from jaxbody.core.errors import JaxbodyError, Problem, Problems
from jaxbody.fitting.parameters.spaces import Parameter
from jaxbody.fitting.parameters.ties_and_bounds import Factor, prior_of
from jaxbody.fitting.parameters.transforms import Elementwise, Parametrization
from jaxbody.model.leaf_paths import Leaf, matching


class LogNormal(eqx.Module):
    """A prior of positive numbers: the logarithm has a normal distribution.

    Args:
        median: median of the number, in its unit.
        deviation: standard deviation of its natural logarithm; 0.1 is about ten percent.

    Error: BAD_PRIOR.

    >>> jb.fitting.LogNormal(2e4, 0.1).deviation
    0.1
    """

    median: Any
    deviation: Any

    def __post_init__(self):
        numbers = np.append(np.ravel(self.median), self.deviation)
        if not (np.isfinite(numbers) & (numbers > 0)).all():
            raise JaxbodyError(
                Problem(
                    "BAD_PRIOR", "LogNormal", f"is {self!r:.60}", self, "finite numbers above 0"
                )
            )


class Prior(eqx.Module):
    """The density of one parameter, in its u.

    `mean` and `deviation` are those of t, the number or its logarithm, None for a flat prior;
    `mass`: logarithm of the probability of each number between its ends, or for a flat prior of
    the distance of the bounds; infinite or NaN where no number normalizes the density."""

    form: Parametrization
    low: Float[Array, "n"]
    high: Float[Array, "n"]
    mean: Array | None
    deviation: Array | None
    mass: Array
    logarithmic: bool = eqx.field(static=True)

    @property
    def proper(self) -> bool:
        return bool(np.isfinite(self.mass).all())

    def scaled(self, u: Float[Array, "n"]) -> Array:
        """Return (t - mean)/deviation; an empty array for a flat prior."""
        if self.mean is None or self.deviation is None:
            return jnp.zeros(0)
        x = self.form.value(u)
        return (((jnp.log(x) if self.logarithmic else x) - self.mean) / self.deviation).ravel()

    def log_density(self, u: Float[Array, "n"]) -> Float[Array, ""]:
        """Return the logarithm of the density of u, without a constant if it is not proper."""
        z = self.scaled(u)
        # numbers with priors depend on their own u and those before
        slopes = jnp.diagonal(jax.jacfwd(self.scaled)(u))
        density = jnp.sum(jnp.log(jnp.abs(slopes)) - 0.5 * jnp.log(2 * jnp.pi) - 0.5 * z**2)
        inside = jnp.all((u >= self.low) & (u <= self.high))
        mass = jnp.sum(jnp.where(jnp.isfinite(self.mass), self.mass, 0.0))
        return jnp.where(inside, density - mass, -jnp.inf)

    def density(self, x: np.ndarray, k: int) -> np.ndarray:
        """Return the density of number k of the parameter at x, for a picture."""
        t = np.log(x) if self.logarithmic else x
        mean, deviation = (np.ravel(given)[k] for given in (self.mean, self.deviation))
        slope = 1 / x if self.logarithmic else 1.0
        log = -0.5 * ((t - mean) / deviation) ** 2 - np.ravel(self.mass)[k]
        return np.exp(log) * slope / (deviation * np.sqrt(2 * np.pi))


def priors_of(parameters: Iterable[Parameter], given: Any, where: str) -> tuple[Prior, ...]:
    """Return the prior of each parameter.

    Args:
        parameters: the free parameters, each perhaps with a normal prior of its own.
        given: {path or pattern: (mean, standard deviation) or LogNormal}, which replace these.
        where: name of the argument, for messages.

    Errors: WRONG_KIND, UNKNOWN_PATH, BAD_PRIOR.
    """
    parameters = list(parameters)
    with Problems() as problems:
        given = checked_dict(given, where, "path: (mean, standard deviation)", problems)
        leaves = [leaf for parameter in parameters for _, leaf in parameter.places]
        matched = matching(leaves, given, where, problems)
        priors = [
            _prior(
                parameter,
                [
                    (leaf, factor, given[pattern])
                    for (_, leaf), factor in zip(parameter.places, parameter.factors, strict=True)
                    for pattern in given
                    if leaf in matched.get(pattern, ())
                ],
                where,
                problems,
            )
            for parameter in parameters
        ]
    return tuple(priors)


def _prior(
    parameter: Parameter, given: list[tuple[Leaf, Factor, Any]], where: str, problems: Problems
) -> Prior:
    form, u = parameter.form, (parameter.low, parameter.high)
    ends = [np.full(form.start.shape, np.nan)] * 2
    if isinstance(form, Elementwise):
        with np.errstate(invalid="ignore", over="ignore"):
            ends = [np.asarray(jax.tree.map(np.asarray, form).value(end)) for end in u]
    logarithmic = bool(given) and isinstance(given[-1][2], LogNormal)
    pair = parameter.prior
    if logarithmic:
        leaf, factor, prior = given[-1]
        if not (ends[0] >= 0).all() or not np.all(np.asarray(factor) > 0):
            problems.add("BAD_PRIOR", f"{where}['{leaf.path}']", "is for positive numbers only")
        given = [(leaf, 1.0, (np.log(np.asarray(prior.median) / np.abs(factor)), prior.deviation))]
        with np.errstate(divide="ignore", invalid="ignore"):
            ends = [np.log(end) for end in ends]
    if given:
        pair = prior_of(form, given, where, problems)
    if pair is None:
        mass = np.log(u[1] - u[0])
    else:
        mass = _log_mass(*((end - np.asarray(pair[0])) / np.asarray(pair[1]) for end in ends))
    mean, deviation = pair or (None, None)
    low, high = map(device_array, u)
    return Prior(
        form=form,
        low=low,
        high=high,
        mean=mean,
        deviation=deviation,
        mass=device_array(mass),
        logarithmic=logarithmic,
    )


def _log_mass(a: Any, b: Any) -> Any:
    """Return the logarithm of the probability of a standard normal number between a and b."""
    from scipy.special import log_ndtr

    a, b = np.where(a > 0, -b, a), np.where(a > 0, -a, b)  # the lower tail has more digits
    low, high = log_ndtr(a), log_ndtr(b)
    return high + np.log1p(-np.exp(low - high))
