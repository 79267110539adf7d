"""How people feel vibration: the frequency weightings of ISO 2631-1, on power spectral densities and on signals.

With w_i = 2 pi f_i the modulus and phase of a product of a Butterworth high-pass (f1) and low-pass (f2) of second order, a transition from acceleration to velocity
(1 + s/w3)/(1 + s/(Q4 w4) + (s/w4)^2) and a step (1 + s/(Q5 w5) + (s/w5)^2)/(1 + s/(Q6 w6) + (s/w6)^2) (w5/w6)^2.
"""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from equinox import field, filter_jit
from jaxtyping import Array, Complex, Float, Int

from jaxbody import tables
from jaxbody.arrays import checked
from jaxbody.errors import JaxbodyError, Problem, Problems, Status, is_concrete
from jaxbody.frequency_responses import check_frequencies
from jaxbody.models import unknown
from jaxbody.random_responses import RandomResponse, root_mean_square
from jaxbody.results import Result
from jaxbody.spectra import sampling_step

HIGH_PASS, LOW_PASS = 0.4, 100.0  # Hz
# f3, f4 [Hz], Q4, and of the step f5 [Hz], Q5, f6 [Hz], Q6
WEIGHTINGS = {"Wk": (12.5, 12.5, 0.63, (2.37, 0.91, 3.35, 0.91)), "Wd": (2.0, 2.0, 0.63, None)}
DIES_AWAY = 8.0  # s, in which what the high-pass remembers falls by more than 1e-6


class WeightedSignal(Result):
    """`values` of a signal after weighting, over `times`; `rms` over the whole record, `peak`, the largest absolute value, and
    `crest_factor` = peak/rms."""

    times: Float[Array, "nt"]
    values: Float[Array, "nt"]
    rms: Float[Array, ""]
    peak: Float[Array, ""]
    crest_factor: Float[Array, ""]
    status: Int[Array, ""]
    name: str = field(static=True)

    def _tables(self) -> list[tables.Table]:
        rows = [("rms [m/s2]", self.rms), ("peak [m/s2]", self.peak), ("crest factor", self.crest_factor)]
        return [tables.Table(f"Signal weighted by {self.name}", ("", ""), rows)]


def weighting(name: str, frequencies: Any) -> Complex[Array, "nf"]:
    """The weighting Wk (vertical, seated or standing) or Wd (horizontal) at frequencies [Hz], complex, from acceleration to weighted acceleration.

    Errors: BAD_WEIGHTING, BAD_FREQUENCY, BAD_SHAPE. Source: ISO 2631-1:1997, annex A.

    >>> [round(float(abs(w)), 3) for w in weighting("Wk", [1.0, 8.0])]
    [0.482, 1.036]
    """
    _check_weighting(name, "weighting.name")
    return _weighting(name, check_frequencies(frequencies, "weighting.frequencies"))


def weighted(response: RandomResponse, weights: dict[str, str]) -> RandomResponse:
    """A random response with accelerations as people feel them, {output: "Wk" or "Wd"}: their densities times |W|^2, their weighted rms.

    Outputs that are not named are left out. Errors: UNKNOWN_NAME, BAD_WEIGHTING, BAD_UNIT of what is no acceleration. Source: ISO 2631-1:1997.

    >>> model = jb.presets.quarter_car(damping=1500.0)
    >>> found = random_response(linearize(model, equilibrium(model)), Band(0.1, 100.0), {"road": BaseMotion("road", "z")},
    ...                         {"body": PointMotion("body", kind="acceleration")}, {"road": Unevenness.iso("C").at_speed(20.0)})
    >>> felt = weighted(found, {"body": "Wk"})
    >>> bool(felt["body"] < found["body"])
    True
    """
    problems = Problems()
    for output, name in weights.items():
        if output not in response.outputs:
            problems.found.append(unknown(output, "weighted", response.outputs))
            continue
        if name not in WEIGHTINGS:
            problems.add("BAD_WEIGHTING", f"weighted[{output!r}]", f"is {name!r}", value=name, limit=" ".join(WEIGHTINGS))
        unit = response.units[response.outputs.index(output)]
        if unit != "m/s2":
            problems.add(
                "BAD_UNIT", f"weighted[{output!r}]", f"is in {unit}", value=unit, limit="m/s2", hint='Ask kind="acceleration" of it.'
            )
    problems.raise_if_any()
    rows = np.array([response.outputs.index(output) for output in weights], dtype=int)
    factors = jnp.stack([jnp.abs(_weighting(name, response.frequencies)) ** 2 for name in weights.values()], -2)
    psd = response.psd[..., rows, :] * factors
    return RandomResponse(
        response.frequencies, psd, root_mean_square(psd, response.weights[..., None, :]), response.weights, response.coarse, response.status,
        tuple(weights), tuple("m/s2" for _ in weights),
    )  # fmt: skip


def weighted_signal(times: Any, acceleration: Any, name: str) -> WeightedSignal:
    """An acceleration [m/s2] over equally spaced times [s] as people feel it, from rest: its rms and crest factor.

    The filter's frequency response acts on the Fourier transform of the record, followed by silence until the filter has come to rest: exact up to half
    the sampling rate, where digital filters of the same order are not, and differentiable. Sample at 200 Hz or more, as people feel up to 80 Hz.
    Errors: BAD_WEIGHTING, NOT_UNIFORM, BAD_SHAPE, NON_FINITE. Source: ISO 2631-1:1997.

    >>> t = jnp.arange(0.0, 20.0, 0.005)
    >>> felt = weighted_signal(t, jnp.sin(2 * jnp.pi * 5.0 * t), "Wk")
    >>> round(float(felt.rms * 2**0.5), 2), round(float(felt.crest_factor), 1)
    (1.04, 1.5)
    """
    _check_weighting(name, "weighted_signal.name")
    problems = Problems()
    step = sampling_step(times, "weighted_signal.times", problems)
    a = checked(acceleration, ((np.size(times),),), "weighted_signal.acceleration", problems, "One number for each time.")
    problems.raise_if_any()
    rest = int(np.ceil(DIES_AWAY / float(step))) if is_concrete(step) else np.size(times)
    values, rms, peak = _weighted_signal(jnp.asarray(a, float), jnp.asarray(step), name, rest)
    crest = peak / jnp.where(rms > 0, rms, 1.0)
    return WeightedSignal(jnp.asarray(times, float), values, rms, peak, crest, jnp.array(Status.OK.value), name)


@filter_jit
def _weighting(name: str, f: Float[Array, "nf"]) -> Complex[Array, "nf"]:
    f3, f4, Q4, step = WEIGHTINGS[name]
    s = 1j * f
    W = s**2 / (s**2 + 2**0.5 * HIGH_PASS * s + HIGH_PASS**2)
    W = W / (1 + 2**0.5 * s / LOW_PASS + (s / LOW_PASS) ** 2)
    W = W * (1 + s / f3) / (1 + s / (Q4 * f4) + (s / f4) ** 2)
    if step is None:
        return W
    f5, Q5, f6, Q6 = step
    return W * (1 + s / (Q5 * f5) + (s / f5) ** 2) / (1 + s / (Q6 * f6) + (s / f6) ** 2) * (f5 / f6) ** 2


@eqx.filter_jit
def _weighted_signal(a: Float[Array, "nt"], step: Float[Array, ""], name: str, rest: int):
    n = len(a) + rest
    W = _weighting(name, jnp.fft.rfftfreq(n) / step)
    values = jnp.fft.irfft(jnp.fft.rfft(a, n) * W, n)[: len(a)]
    square = jnp.mean(values**2)
    rms = jnp.where(square > 0, jnp.sqrt(jnp.where(square > 0, square, 1.0)), 0.0)
    return values, rms, jnp.max(jnp.abs(values))


def _check_weighting(name: Any, where: str) -> None:
    if name not in WEIGHTINGS:
        raise JaxbodyError(Problem("BAD_WEIGHTING", where, f"is {name!r}", name, " ".join(WEIGHTINGS), "Wk is for z, Wd for x and y."))
