"""Confidence bands: the uncertainty of a fit propagated to any result of the fitted model, such as
a frequency or a response.

    v = G C G',    G = df/du

v is the variance of a result f to first order, u are the transformed free parameters (`transforms`)
and C is their covariance; bounds use Student's t. Alternatively, f is evaluated for random u, or
for draws from a posterior.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxbody.core import tables
from jaxbody.core.arguments import check_key
from jaxbody.core.arrays import Array, Float, PRNGKeyArray
from jaxbody.core.compilation.compile_options import jit
from jaxbody.core.errors import JaxbodyError, Problem, Problems, Status
from jaxbody.core.results import Result, warn_if_failed
from jaxbody.fitting.fit_results import Fit, widening
from jaxbody.fitting.posteriors import Posterior
from jaxbody.fitting.statistics.uncertainties import check_level, quantile
from jaxbody.model.models import Model

DRAWS = 1000  # from a posterior, if no number is given


class Bands(Result):
    """The `value` of a function of the fitted model, its `standard_error`, and the bounds `lower`
    and `upper` at `level`.

    All are arrays of one shape, as are the `degrees_of_freedom` of Student's t, infinite for draws.
    Bounds are infinite where the data do not determine the value. `status` is NONFINITE if the
    value or its derivatives are not finite.
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
        freedoms = self.degrees_of_freedom[np.isfinite(self.standard_error)]
        notes = [self.report(), *filter(None, [widening(freedoms, self.level)])]
        return [
            tables.PrintedTable(f"Bands, {100 * self.level:g} %", heads, rows, "\n".join(notes))
        ]


def confidence_bands(
    fit: Fit | Posterior,
    function: Callable[[Model], Any],
    *,
    level: float = 0.95,
    samples: int | None = None,
    key: PRNGKeyArray | None = None,
) -> Bands:
    """Return value, standard error and confidence interval of a JAX function of the fitted model.

    Args:
        fit: the result of `fit`, or of `posterior`: the value is then the mean of the draws, and
            bounds are their quantiles.
        function: model -> array of real numbers of any shape.
        level: confidence level of the interval.
        samples: number of random draws of the parameters, to be used instead of derivatives if the
            function is nonlinear within the interval; the bounds are then quantiles of the draws.
            By default derivatives are used, and at most 1000 draws of a posterior.
        key: random key of the draws, for instance jax.random.key(0); not for a posterior.

    Equal natural frequencies have no individual derivatives: use their sum or mean, a response, or
    draws.

    Errors: WRONG_KIND for a function that does not return an array of real numbers,
    BAD_LEVEL, NO_KEY, UNDETERMINED for draws if the data do not determine all parameters,
    TRACED. Warns NONFINITE.

    >>> spring = jb.Spring(("mass", [0, 0, 0]), ("world", [0, 0, 0]), stiffness=30.0)
    >>> model = jb.Model(
    ...     bodies={"mass": jb.Body(mass=1.0, inertia=[1, 1, 1], position=[1, 0, 0])},
    ...     elements={"spring": spring},
    ...     joints={"mass": jb.Guide("world", axis=[1, 0, 0])},
    ... )
    >>> times, noise = jnp.linspace(0, 1, 21), 0.05 * jax.random.normal(jax.random.key(0), (21,))
    >>> track = jb.Experiment(
    ...     times,
    ...     sensors={"x": jb.Position("mass", axis=[1, 0, 0])},
    ...     measured={"x": jnp.cos(2 * jnp.pi * times) + noise},
    ... )
    >>> result = jb.fit(model, {"track": track}, free=["spring.stiffness"])
    >>> frequency = jb.confidence_bands(
    ...     result,
    ...     lambda model: jnp.sqrt(model["spring"].stiffness / model["mass"].mass) / (2 * jnp.pi),
    ... )
    >>> bool(frequency.lower < 1.0 < frequency.upper), bool(frequency.standard_error < 0.02)
    (True, True)
    """
    check_level(level, "confidence_bands.level")
    with Problems() as problems:
        needed = samples is not None and isinstance(fit, Fit)
        check_key(key, "confidence_bands.key", problems, "Draws need" if needed else "")
    posterior = fit if isinstance(fit, Posterior) else None
    fit = fit.fit if isinstance(fit, Posterior) else fit
    uncertainty = fit._assessed()
    f = jit(lambda u: function(fit.task.space.place(u)[0]))
    value = f(fit.u)
    if not isinstance(value, jax.Array | np.ndarray) or jnp.iscomplexobj(value):
        kind = "complex numbers" if jnp.iscomplexobj(value) else f"a {type(value).__name__}"
        raise JaxbodyError(
            Problem(
                "WRONG_KIND",
                "confidence_bands.function",
                f"returns {kind}",
                value,
                "an array of real numbers",
                "Return one array; for complex numbers, magnitude and phase or real "
                "and imaginary parts.",
            )
        )
    value = np.asarray(value, float)
    if posterior is not None or samples is not None:
        draws = (
            posterior.drawn(samples or DRAWS)
            if posterior is not None
            else _normal(fit, samples, key)
        )
        drawn = np.asarray(jax.lax.map(f, jnp.asarray(draws), batch_size=min(len(draws), 64)))
        finite, error = np.isfinite(drawn).all(0), drawn.std(0, ddof=1)
        low, high = np.nanquantile(drawn, [(1 - level) / 2, (1 + level) / 2], axis=0)
        value = value if posterior is None else drawn.mean(0)
        freedom = np.full(value.shape, np.inf)
    else:
        G = np.asarray(jit(jax.jacfwd(f))(fit.u)).reshape(value.size, len(fit.u))
        finite = np.isfinite(G).all(1).reshape(value.shape)
        error, freedom = (x.reshape(value.shape) for x in uncertainty.spread(np.nan_to_num(G)))
        error = np.where(finite, error, np.inf)
        half_width = quantile(level, freedom) * error
        low, high = value - half_width, value + half_width
    return warn_if_failed(
        Bands(
            value=value,
            standard_error=error,
            lower=np.asarray(low),
            upper=np.asarray(high),
            degrees_of_freedom=freedom,
            level=level,
            status=np.asarray(
                Status.OK if finite.all() and np.isfinite(value).all() else Status.NONFINITE
            ),
        )
    )


def _normal(fit: Fit, samples: Any, key: Any) -> Float[Array, "samples n"]:
    """Return random draws of u from its normal distribution. Error: UNDETERMINED."""
    uncertainty = fit._assessed()
    if uncertainty.rank < len(fit.u):
        raise JaxbodyError(
            Problem(
                "UNDETERMINED",
                "fit",
                "has parameters that are not determined: "
                + "; ".join([*uncertainty.words, *fit.at_bound]),
                hint="Fix some of them, or leave out samples=: then results that the data "
                "determine still have bands.",
            )
        )
    values, vectors = np.linalg.eigh(uncertainty.covariance)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    return jnp.asarray(fit.u)[None] + jax.random.normal(key, (samples, len(values))) @ root.T
