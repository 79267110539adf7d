"""Bands: what the covariance of a fit makes of any number that the fitted model gives, a frequency or a whole response.

    v = G C G',    G = df/du

to first order, with Student's t; or by draws of u.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from jaxbody.core import tables
from jaxbody.core.arguments import check_key
from jaxbody.core.errors import JaxbodyError, Problem, Problems, Status
from jaxbody.core.results import Result, warn_if_failed
from jaxbody.identification.fits import Fit
from jaxbody.identification.intervals import widening
from jaxbody.models.models import Model
from jaxbody.statistics.quantiles import check_level, quantile


class Bands(Result):
    """`value` of a function of the fitted model, `standard_error`, `lower` and `upper` at `level` and the `degrees_of_freedom` of their Student's t (infinite of draws): arrays of one
    shape, bounds infinite where the data cannot tell.
    `status` NONFINITE where the value or its derivatives are not finite.
    """

    value: np.ndarray
    standard_error: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    degrees_of_freedom: np.ndarray
    level: float
    status: np.ndarray

    def _tables(self) -> list[tables.PrintedTable]:
        columns = (np.ravel(x) for x in (self.value, self.standard_error, self.lower, self.upper))
        rows = [tuple(map(float, row)) for row in zip(*columns, strict=True)]
        heads = ("value", "standard error", "lower", "upper")
        known = self.degrees_of_freedom[np.isfinite(self.standard_error)]
        notes = [self.report(), *filter(None, [widening(known, self.level)])]
        return [tables.PrintedTable(f"Bands, {100 * self.level:g} %", heads, rows, "\n".join(notes))]


def bands(
    fit: Fit, function: Callable[[Model], Any], *, level: float = 0.95, samples: int | None = None, key: PRNGKeyArray | None = None
) -> Bands:
    """Value, standard error and interval of any JAX function of the fitted model, real numbers of any shape.

    samples, key: by that many draws of the parameters instead of derivatives, where the function bends within the interval; quantiles are then those
    of the draws. Where natural frequencies coincide single ones have no derivative: give their sum or mean, a response, or draws.

    Errors: WRONG_KIND of a function that gives no real array, BAD_LEVEL, NO_KEY, UNDETERMINED where draws are asked for of what the data do not
    determine, TRACED. Warns NONFINITE.

    >>> spring = Spring(("mass", [0, 0, 0]), ("world", [0, 0, 0]), stiffness=30.0)
    >>> model = Model(bodies={"mass": Body(mass=1.0, inertia=[1, 1, 1], position=[1, 0, 0])}, elements={"spring": spring},
    ...               joints={"mass": Guide("world", axis=[1, 0, 0])})
    >>> times, noise = jnp.linspace(0, 1, 21), 0.05 * jax.random.normal(jax.random.key(0), (21,))
    >>> track = Experiment(times, sensors={"x": Position("mass", axis=[1, 0, 0])}, measured={"x": jnp.cos(2 * jnp.pi * times) + noise})
    >>> found = fit(model, {"track": track}, free=["spring.stiffness"])
    >>> frequency = bands(found, lambda model: jnp.sqrt(model["spring"].stiffness / model["mass"].mass) / (2 * jnp.pi))
    >>> bool(frequency.lower < 1.0 < frequency.upper), bool(frequency.standard_error < 0.02)
    (True, True)
    """
    check_level(level, "bands.level")
    problems = Problems()
    check_key(key, "bands.key", problems, "" if samples is None else "Draws need")
    problems.raise_if_any()
    worth = fit._assessed()
    f = eqx.filter_jit(lambda u: function(fit.task.scatter(u)[0]))
    value = f(fit.u)
    if not isinstance(value, jax.Array | np.ndarray) or jnp.iscomplexobj(value):
        told, hint = f"gives {_kind(value)}", "Give one array; of complex numbers their magnitude and phase, or real and imaginary part."
        raise JaxbodyError(Problem("WRONG_KIND", "bands.function", told, value, "an array of real numbers", hint))
    value = np.asarray(value, float)
    if samples is not None:
        error, low, high, finite = _drawn(fit, f, level, samples, key)
        freedom = np.full(value.shape, np.inf)
    else:
        G = np.asarray(jax.jacfwd(f)(fit.u)).reshape(value.size, len(fit.u))
        finite = np.isfinite(G).all(1).reshape(value.shape)
        error, freedom = (x.reshape(value.shape) for x in worth.spread(np.nan_to_num(G)))
        error = np.where(finite, error, np.inf)
        far = quantile(level, freedom) * error
        low, high = value - far, value + far
    ok = finite.all() and np.isfinite(value).all()
    found = Bands(value, error, low, high, freedom, level, np.asarray(Status.OK if ok else Status.NONFINITE))
    warn_if_failed(found)
    return found


def _kind(value: Any) -> str:
    return "complex numbers" if jnp.iscomplexobj(value) else f"a {type(value).__name__}"


def _drawn(fit: Fit, f: Callable, level: float, samples: int, key: PRNGKeyArray | None):
    """Standard deviation and quantiles over draws of u from the normal distribution of its covariance."""
    worth = fit._assessed()
    if worth.rank < len(fit.u):
        told = "are not determined: " + "; ".join([*worth.words, *fit.at_bound])
        raise JaxbodyError(
            Problem("UNDETERMINED", "fit", told, hint="Fix some, or leave samples out: what the data determine has its band.")
        )
    values, vectors = np.linalg.eigh(worth.covariance)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    u: Float[Array, "samples n"] = fit.u + jax.random.normal(key, (samples, len(values))) @ root.T
    drawn = np.asarray(jax.lax.map(f, u, batch_size=min(samples, 64)))
    finite = np.isfinite(drawn).all(0)
    low, high = np.nanquantile(drawn, [(1 - level) / 2, (1 + level) / 2], axis=0)
    return drawn.std(0, ddof=1), low, high, finite
