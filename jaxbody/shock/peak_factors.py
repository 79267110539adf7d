"""Peak factors: the largest magnitude of a stationary Gaussian response in a time T over its
standard deviation, by the moments of its spectrum, lambda_k = int w^k S dw.

With moments lambda_k of the density over w, nu = sqrt(lambda_2/lambda_0)/pi the rate of zero
crossings in both directions, and delta = sqrt(1 - lambda_1^2/(lambda_0 lambda_2)) the width of the
band, L = sqrt(2 ln(nu T)):

    Davenport         mean L + 0.5772/L, deviation pi/(sqrt(6) L);
                      L + G/L has Gumbel's distribution, P(G < g) = exp(-exp(-g))
    Der Kiureghian    the same mean with (1.63 delta^0.45 - 0.38) nu where delta < 0.69;
                      deviation 1.2/L - 5.4/(13 + L^6.4)
    Vanmarcke         P(peak < a) = (1 - e) exp(-nu T (1 - exp(-sqrt(pi/2) delta^1.2 a))/(1/e - 1)),
                      e = exp(-a^2/2)

Source: A. G. Davenport, Proc. ICE 28 (1964) 187; A. Der Kiureghian, ASCE J. Eng. Mech. 106 (1980)
1195; E. H. Vanmarcke, J. Appl. Mech. 42 (1975) 215.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from equinox import field

from jaxbody.core import tables
from jaxbody.core.arguments import check_one_of, positive_number
from jaxbody.core.arrays import (
    Array,
    Float,
    Int,
    checked,
    device_array,
    float_array,
    is_concrete,
)
from jaxbody.core.compilation.compile_options import program
from jaxbody.core.errors import JaxbodyError, Problem, Problems, Status, unknown
from jaxbody.core.results import OfOutputs, warn_if_failed
from jaxbody.vibration.random_responses import RandomResponse


def moments(response: RandomResponse, *orders: int) -> tuple[Float[Array, "ny"], ...]:
    """Return the moments int w^k S dw of these orders k for each output, with w in rad/s; infinite
    where the variance is infinite."""
    w = 2 * jnp.pi * response.frequencies
    weights = [(response.weights * w**k)[..., None, :] for k in orders]
    infinite = jnp.isinf(response.rms)
    return tuple(jnp.where(infinite, jnp.inf, jnp.sum(response.psd * W, -1)) for W in weights)


def check_response(response: Any, where: str) -> None:
    """Check that an argument is a RandomResponse. Error: WRONG_KIND."""
    if not isinstance(response, RandomResponse):
        raise JaxbodyError(
            Problem(
                "WRONG_KIND",
                where,
                f"is a {type(response).__name__}",
                response,
                "a RandomResponse",
                "Give the result of random_response.",
            )
        )


def level_crossings(response: RandomResponse, output: str, levels: Any) -> Float[Array, "*n"]:
    """Compute how often per second a Gaussian output with mean zero crosses levels upward [1/s].

        nu(b) = sqrt(lambda_2/lambda_0)/(2 pi) exp(-b^2/(2 lambda_0))

    There are as many downward crossings. The band of the response must contain all of the output's
    velocity, because of the second moment lambda_2.

    Args:
        response: a result of `random_response`.
        output: name of one of its outputs.
        levels: one level or several, in the unit of the output.

    Errors: UNKNOWN_NAME, WRONG_KIND, BAD_SHAPE, NON_FINITE. Source: S. O. Rice, Bell System Tech.
    J. 24 (1945) 46.

    >>> car = jb.presets.quarter_car(damping=1500.0)
    >>> ride = jb.random_response(
    ...     jb.linearize(car, car.reference),
    ...     jb.vibration.Band(0.1, 50.0),
    ...     {"road": jb.BaseMotion("road", "z")},
    ...     {"travel": jb.Elongation("suspension")},
    ...     {"road": jb.vibration.RoadRoughness.iso("C").at_speed(20.0)},
    ... )
    >>> rates = jb.shock.level_crossings(ride, "travel", [0.0, 2 * ride["travel"]])
    >>> round(float(rates[1] / rates[0]), 6)  # exp(-2)
    0.135335
    """
    check_response(response, "level_crossings.response")
    with Problems() as problems:
        if output not in response.outputs:
            problems.collected.append(unknown(output, "level_crossings.output", response.outputs))
        array = problems.gather(lambda: float_array(levels, "level_crossings.levels"))
        b = (
            None
            if array is None
            else checked(array, ((), (max(1, np.size(array)),)), "level_crossings.levels", problems)
        )
    zeroth, second = (x[..., response.outputs.index(output)] for x in moments(response, 0, 2))
    return (
        jnp.sqrt(second / zeroth) / (2 * jnp.pi) * jnp.exp(-(device_array(b) ** 2) / (2 * zeroth))
    )


FORMULAS = ("Davenport", "Der Kiureghian", "Vanmarcke")
FEWEST = 1.5  # crossings below which L has no meaning: ln(nu T) would be near zero or negative
# standard deviations up to which a distribution is integrated, and points for it
HIGHEST, POINTS = 12.0, 2400
HALVINGS = 60


class PeakFactors(OfOutputs):
    """Peak factors of outputs. For each output: the peak `factor`, its standard `deviation` (NaN
    for a given probability) and the `maximum` = factor rms in its unit; `peaks["seat"]` is the
    maximum of one output. `rate` [1/s] of zero crossings in both directions, and the `bandwidth`
    delta, 0 for a sine."""

    index, main, word = "output", "maximum", "peaks"
    factor: Float[Array, "ny"]
    deviation: Float[Array, "ny"]
    maximum: Float[Array, "ny"]
    rms: Float[Array, "ny"]
    rate: Float[Array, "ny"]
    bandwidth: Float[Array, "ny"]
    duration: Float[Array, ""]
    status: Int[Array, ""]
    formula: str = field(static=True)

    def to_xarray(self) -> Any:
        """Return an xarray.Dataset of all numbers by output."""
        units = {
            "factor": "",
            "deviation": "",
            "maximum": "unit",
            "rms": "unit",
            "rate": "1/s",
            "bandwidth": "",
        }
        return self.labeled(
            f"peak factors, {self.formula}",
            {name: (("output",), getattr(self, name), unit) for name, unit in units.items()},
        )

    @tables.summarized("Peak factors", 1, maximum="maximum")
    def _tables(self) -> list[tables.PrintedTable]:
        columns = {
            "output": self.outputs,
            "rms": self.rms,
            "peak factor": self.factor,
            "maximum": self.maximum,
            "unit": self.units,
            "crossings [1/s]": self.rate,
            "bandwidth": self.bandwidth,
        }
        return [
            tables.PrintedTable(
                f"Peaks in {tables.number(self.duration)} s, {self.formula}",
                tuple(columns),
                [*zip(*columns.values(), strict=True)],
                self.failure,
            )
        ]


def peak_factor(
    response: RandomResponse,
    duration: Any,
    *,
    formula: str = "Der Kiureghian",
    probability: float | None = None,
) -> PeakFactors:
    """Compute the expected largest magnitude of each output of a random response within a duration,
    as a multiple of its rms and in its unit.

    The response is taken as stationary and Gaussian with mean zero. The result is differentiable
    with respect to the model, the spectra and the duration.

    Args:
        response: a result of `random_response`, whose band contains the velocities of the outputs.
        duration: T [s].
        formula: "Davenport", for independent crossings, too large for a narrow band; "Der
            Kiureghian" (default), corrected for crossings in clumps, fitted for 10 <= nu T <= 1000;
            "Vanmarcke", the distribution for crossings as a two-state Markov process.
        probability: probability with which the peak is not exceeded, by Davenport's or Vanmarcke's
            distribution; default: the mean of the peak.

    Errors: WRONG_KIND, BAD_OPTION, BAD_NUMBER, NOT_A_FRACTION; warns NONFINITE where a response has
    fewer than 1.5 crossings in T.

    >>> car = jb.presets.quarter_car(damping=1500.0)
    >>> ride = jb.random_response(
    ...     jb.linearize(car, car.reference),
    ...     jb.vibration.Band(0.1, 50.0),
    ...     {"road": jb.BaseMotion("road", "z")},
    ...     {"travel": jb.Elongation("suspension")},
    ...     {"road": jb.vibration.RoadRoughness.iso("C").at_speed(20.0)},
    ... )
    >>> peaks = jb.shock.peak_factor(ride, 60.0)
    >>> round(float(peaks["travel"] / ride["travel"]), 2)
    3.62
    """
    check_response(response, "peak_factor.response")
    with Problems() as problems:
        T = positive_number(duration, "peak_factor.duration", problems)
        check_one_of(formula, FORMULAS, "BAD_OPTION", "peak_factor.formula", problems)
        p = (
            None
            if probability is None
            else checked(probability, ((),), "peak_factor.probability", problems)
        )
        if p is not None and is_concrete(p) and not 0 < p < 1:
            problems.add(
                "NOT_A_FRACTION",
                "peak_factor.probability",
                f"is {p:g}",
                value=float(p),
                limit="0 to 1",
            )
        if p is not None and formula == "Der Kiureghian":
            problems.add(
                "BAD_OPTION",
                "peak_factor.probability",
                "is given, but this formula is no distribution",
                value=p,
                hint="Take Davenport or Vanmarcke.",
            )
    return warn_if_failed(
        PeakFactors(
            *_peaks(response, device_array(T), formula, p),
            formula,
            outputs=response.outputs,
            units=response.units,
        )
    )


@program
def _peaks(response: RandomResponse, T: Float[Array, ""], formula: str, p: Any):
    zeroth, first, second = moments(response, 0, 1, 2)
    rate, bandwidth = crossing_rate(zeroth, second), width(zeroth, first, second)
    if p is None:
        factor, deviation = factors(rate, bandwidth, T, formula)
    else:
        factor = quantile(rate, bandwidth, T, formula, p)
        deviation = jnp.full_like(factor, jnp.nan)
    rms = jnp.sqrt(zeroth)
    status = jnp.where(
        (response.status == Status.OK) & ~jnp.isfinite(factor).all(),
        Status.NONFINITE.value,
        response.status,
    )
    return factor, deviation, factor * rms, rms, rate, bandwidth, T, status


def crossing_rate(zeroth: Float[Array, "*n"], second: Float[Array, "*n"]) -> Float[Array, "*n"]:
    """Return the rate of zero crossings in both directions [1/s]."""
    return jnp.sqrt(second / zeroth) / jnp.pi


def width(
    zeroth: Float[Array, "*n"], first: Float[Array, "*n"], second: Float[Array, "*n"]
) -> Float[Array, "*n"]:
    """Return the bandwidth delta."""
    square = 1 - first**2 / (zeroth * second)
    return jnp.sqrt(jnp.where(square > 0, square, 1.0)) * (square > 0).astype(square.dtype)


def factors(
    rate: Float[Array, "*n"], delta: Float[Array, "*n"], T: Any, formula: str
) -> tuple[Array, Array]:
    """Return mean and standard deviation of the peak factor."""
    if formula == "Vanmarcke":
        a = jnp.broadcast_to(jnp.linspace(0.0, HIGHEST, POINTS + 1), (*rate.shape, POINTS + 1))
        above = 1 - _vanmarcke(a, rate[..., None] * T, delta[..., None])
        mean, square = jnp.trapezoid(above, a, axis=-1), 2 * jnp.trapezoid(a * above, a, axis=-1)
        return mean, jnp.sqrt(square - mean**2)
    if formula == "Der Kiureghian":
        rate = rate * jnp.where(delta < 0.69, 1.63 * jnp.maximum(delta, 1e-12) ** 0.45 - 0.38, 1.0)
    L = _root_log(rate * T)
    davenport = formula == "Davenport"
    deviation = np.pi / 6**0.5 / L if davenport else 1.2 / L - 5.4 / (13 + L**6.4)
    return L + np.euler_gamma / L, deviation


def quantile(
    rate: Float[Array, "*n"], delta: Float[Array, "*n"], T: Any, formula: str, p: Any
) -> Float[Array, "*n"]:
    """Return the peak factor that is not exceeded with probability p."""
    if formula == "Davenport":
        L = _root_log(rate * T)
        return L - jnp.log(-jnp.log(p)) / L
    fixed = jax.lax.stop_gradient((rate * T, delta))

    def halve(ends, _):
        middle = (ends[0] + ends[1]) / 2
        below = _vanmarcke(middle, *fixed) < p
        return (jnp.where(below, middle, ends[0]), jnp.where(below, ends[1], middle)), None

    (low, high), _ = jax.lax.scan(
        halve, (jnp.zeros_like(rate), jnp.full_like(rate, HIGHEST)), None, length=HALVINGS
    )
    a = (low + high) / 2
    slope = jax.jvp(lambda a: _vanmarcke(a, *fixed), (a,), (jnp.ones_like(a),))[1]
    # the value is a; the last term is about zero and adds the derivatives of the root
    return a - (_vanmarcke(a, rate * T, delta) - p) / slope


def _vanmarcke(a, crossings, delta):
    """Return P(peak < a); `crossings` is nu T."""
    inside = a > 0
    a = jnp.where(inside, a, 1.0)
    clumped = 1 - jnp.exp(-((np.pi / 2) ** 0.5) * delta**1.2 * a)
    return jnp.where(
        inside, -jnp.expm1(-(a**2) / 2) * jnp.exp(-crossings * clumped / jnp.expm1(a**2 / 2)), 0.0
    )


def _root_log(crossings):
    """Return L = sqrt(2 ln(nu T)), NaN for too few crossings nu T."""
    return jnp.sqrt(2 * jnp.log(jnp.where(crossings > FEWEST, crossings, jnp.nan)))
