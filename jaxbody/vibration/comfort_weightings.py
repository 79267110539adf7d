"""Human response to vibration: the frequency weightings of ISO 2631 and the vibration dose value,
for spectral densities and signals.

With w_i = 2 pi f_i, a weighting is the product of a Butterworth high-pass (f1) and low-pass (f2) of
second order, a transition from acceleration to velocity (1 + s/w3)/(1 + s/(Q4 w4) + (s/w4)^2), and
a step K (1 + s/(Q5 w5) + (s/w5)^2)/(1 + s/(Q6 w6) + (s/w6)^2) (w5/w6)^2. Parameters: ISO 8041:2005,
table 3.
"""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from equinox import field

from jaxbody.core import tables
from jaxbody.core.arguments import check_one_of
from jaxbody.core.arrays import Array, Complex, Float, Int, is_concrete
from jaxbody.core.compilation.compile_options import program
from jaxbody.core.errors import Problems, Status, unknown
from jaxbody.core.results import Result
from jaxbody.numerics.elementary_functions import root
from jaxbody.records.sampling_checks import even_samples
from jaxbody.vibration.frequency_responses import check_frequencies
from jaxbody.vibration.random_responses import RandomResponse, root_mean_square

NONE = np.inf


# f1, f2, f3, f4 [Hz], Q4, f5 [Hz], Q5, f6 [Hz], Q6, K
WEIGHTINGS = {
    "Wb": (0.4, 100.0, 16.0, 16.0, 0.55, 2.5, 0.9, 4.0, 0.95, 1.024),
    "Wc": (0.4, 100.0, 8.0, 8.0, 0.63, NONE, 1.0, NONE, 1.0, 1.0),
    "Wd": (0.4, 100.0, 2.0, 2.0, 0.63, NONE, 1.0, NONE, 1.0, 1.0),
    "We": (0.4, 100.0, 1.0, 1.0, 0.63, NONE, 1.0, NONE, 1.0, 1.0),
    "Wf": (0.08, 0.63, NONE, 0.25, 0.86, 0.0625, 0.8, 0.1, 0.8, 1.0),
    "Wj": (0.4, 100.0, NONE, NONE, 1.0, 3.75, 0.91, 5.32, 0.91, 1.0),
    "Wk": (0.4, 100.0, 12.5, 12.5, 0.63, 2.37, 0.91, 3.35, 0.91, 1.0),
}
HINT = (
    "Wk is for z, Wd for x and y, Wb for z in trains, Wc for seat backs, We for rotation, Wj for "
    "recumbent heads, Wf for motion sickness."
)
DECAY_PERIODS = 3.2  # periods of the high-pass in which its transient decays below 1e-6


class WeightedSignal(Result):
    """A signal after weighting. `values` over `times` [s]; `rms` of the whole record; `peak`, the
    largest absolute value; `crest_factor` = peak/rms; `dose`, the vibration dose value [m/s1.75]
    from the beginning to each time; `vdv`, that of the whole record."""

    times: Float[Array, "nt"]
    values: Float[Array, "nt"]
    rms: Float[Array, ""]
    peak: Float[Array, ""]
    crest_factor: Float[Array, ""]
    dose: Float[Array, "nt"]
    status: Int[Array, ""]
    name: str = field(static=True)

    @property
    def vdv(self) -> Float[Array, ""]:
        """The vibration dose value of the whole record [m/s1.75], (int a_w^4 dt)^(1/4)."""
        return self.dose[..., -1]

    @property
    def estimated_vdv(self) -> Float[Array, ""]:
        """The estimated vibration dose value for crest factors below 6 [m/s1.75]: 1.4 rms T^(1/4),
        with the length T of the record."""
        return 1.4 * self.rms * (self.times[..., -1] - self.times[..., 0]) ** 0.25

    def _tables(self) -> list[tables.PrintedTable]:
        unit = _unit(self.name)
        rows = [
            (f"rms [{unit}]", self.rms),
            (f"peak [{unit}]", self.peak),
            ("crest factor", self.crest_factor),
            (f"vibration dose value [{unit[:-1]}1.75]", self.vdv),
        ]
        return [tables.PrintedTable(f"Signal weighted by {self.name}", ("", ""), rows)]


def frequency_weighting(name: str, frequencies: Any) -> Complex[Array, "nf"]:
    """Compute a frequency weighting at frequencies [Hz]: the complex response from acceleration to
    weighted acceleration [m/s2, or rad/s2 for We].

    Args:
        name: Wk (vertical, seated or standing), Wd (horizontal), Wf (motion sickness), Wc (seat
            back), We (rotation), Wj (head, recumbent), Wb (vertical, in trains).
        frequencies: frequencies in one row [Hz].

    Errors: BAD_WEIGHTING, BAD_FREQUENCY, BAD_SHAPE. Source: ISO 2631-1:1997, annex A; for Wb ISO
    2631-4:2001; parameters as in ISO 8041:2005, table 3.

    >>> [round(float(abs(w)), 3) for w in jb.vibration.frequency_weighting("Wk", [1.0, 8.0])]
    [0.482, 1.036]
    """
    with Problems() as problems:
        check_one_of(name, WEIGHTINGS, "BAD_WEIGHTING", "frequency_weighting.name", problems, HINT)
    return _weighting(name, check_frequencies(frequencies, "frequency_weighting.frequencies"))


def weighted_response(response: RandomResponse, weights: dict[str, str]) -> RandomResponse:
    """Apply frequency weightings W to accelerations of a random response; return it with densities
    times |W|^2 and the weighted rms. `weights`: {output: "Wk", or another `frequency_weighting`}.

    Other outputs are omitted. Errors: UNKNOWN_NAME, BAD_WEIGHTING, BAD_UNIT for an output that is
    not an acceleration (angular for We, else linear). Source: ISO 2631-1:1997.

    >>> model = jb.presets.quarter_car(damping=1500.0)
    >>> response = jb.random_response(
    ...     jb.linearize(model, jb.equilibrium(model)),
    ...     jb.vibration.Band(0.1, 100.0),
    ...     {"road": jb.BaseMotion("road", "z")},
    ...     {"body": jb.Acceleration("body", axis="z")},
    ...     {"road": jb.vibration.RoadRoughness.iso("C").at_speed(20.0)},
    ... )
    >>> bool(jb.vibration.weighted_response(response, {"body": "Wk"})["body"] < response["body"])
    True
    """
    with Problems() as problems:
        for output, name in weights.items():
            if output not in response.outputs:
                problems.collected.append(unknown(output, "weighted_response", response.outputs))
                continue
            where = f"weighted_response[{output!r}]"
            check_one_of(name, WEIGHTINGS, "BAD_WEIGHTING", where, problems, HINT)
            unit = response.units[response.outputs.index(output)]
            if unit != _unit(name):
                problems.add(
                    "BAD_UNIT",
                    where,
                    f"is in {unit}",
                    value=unit,
                    limit=_unit(name),
                    hint="Give an Acceleration; We is for an AngularAcceleration.",
                )
    rows = tuple(response.outputs.index(output) for output in weights)
    names = tuple(weights.values())
    psd, rms = _weighted(
        response.psd, response.rms, response.frequencies, response.weights, rows, names
    )
    return dataclasses.replace(
        response, psd=psd, rms=rms, outputs=tuple(weights), units=tuple(map(_unit, names))
    )


@program
def _weighted(
    psd: Float[Array, "*b ny nf"],
    rms: Float[Array, "*b ny"],
    f: Float[Array, "*b nf"],
    weights: Float[Array, "*b nf"],
    rows: tuple[int, ...],
    names,
):
    """Return these rows of the densities times the squares of the weightings, and their root mean
    squares."""
    factors = jnp.stack([jnp.abs(_weighting(name, f)) ** 2 for name in names], -2)
    places = np.array(rows, int)
    psd = psd[..., places, :] * factors
    infinite = jnp.isinf(rms[..., places])
    return psd, jnp.where(infinite, jnp.inf, root_mean_square(psd, weights[..., None, :]))


def weighted_signal(times: Any, acceleration: Any, name: str) -> WeightedSignal:
    """Weight an acceleration [m/s2] over evenly spaced times [s], from rest, and compute its rms,
    crest factor and vibration dose value.

        VDV = (int a_w^4 dt)^(1/4)

    `name` is that of a `frequency_weighting`. The Fourier transform of the record, padded with
    zeros until the filter has decayed, is multiplied by the frequency response: exact up to half
    the sampling rate, unlike digital filters of the same order, and differentiable. Sample at 200
    Hz or more, as weightings extend to 80 Hz. Errors: BAD_WEIGHTING, NOT_UNIFORM, BAD_SHAPE,
    NON_FINITE. Source: ISO 2631-1:1997, 6.1 and 6.3.2.

    >>> t = jnp.arange(0.0, 20.0, 0.005)
    >>> signal = jb.vibration.weighted_signal(t, jnp.sin(2 * jnp.pi * 5.0 * t), "Wk")
    >>> round(float(signal.rms * 2**0.5), 2), round(float(signal.crest_factor), 1)
    (1.04, 1.5)
    >>> round(float(signal.vdv / (3 / 8 * 20.0) ** 0.25), 2)
    1.04
    """
    with Problems() as problems:
        check_one_of(name, WEIGHTINGS, "BAD_WEIGHTING", "weighted_signal.name", problems, HINT)
        a, step = even_samples(
            times, acceleration, ("weighted_signal.times", "weighted_signal.acceleration"), problems
        )
    f1, *_ = WEIGHTINGS[name]
    padding = (
        int(np.ceil(DECAY_PERIODS / f1 / float(step))) if is_concrete(step) else np.size(times)
    )
    return WeightedSignal(
        jnp.asarray(times, float),
        *_weighted_signal(jnp.asarray(a, float), jnp.asarray(step), name, padding),
        jnp.array(Status.OK.value),
        name,
    )


@program
def _weighting(name: str, f: Float[Array, "nf"]) -> Complex[Array, "nf"]:
    f1, f2, f3, f4, Q4, f5, Q5, f6, Q6, K = WEIGHTINGS[name]
    s = jax.lax.complex(jnp.zeros_like(f), f)
    W = K * s**2 / (s**2 + 2**0.5 * f1 * s + f1**2)
    W = W / (1 + 2**0.5 * s / f2 + (s / f2) ** 2)
    W = W * (1 + s / f3) / (1 + s / (Q4 * f4) + (s / f4) ** 2)
    if f5 == NONE:
        return W
    W = W * (1 + s / (Q5 * f5) + (s / f5) ** 2) / (1 + s / (Q6 * f6) + (s / f6) ** 2)
    return W * (f5 / f6) ** 2


@program
def _weighted_signal(a: Float[Array, "nt"], step: Float[Array, ""], name: str, padding: int):
    n = len(a) + padding
    W = _weighting(name, jnp.fft.rfftfreq(n) / step)
    values = jnp.fft.irfft(jnp.fft.rfft(a, n) * W, n)[: len(a)]
    rms, peak = root(jnp.mean(values**2)), jnp.max(jnp.abs(values))
    return values, rms, peak, peak / jnp.where(rms > 0, rms, 1.0), dose(values, step)


def dose(values: Float[Array, "nt"], step: Any) -> Float[Array, "nt"]:
    """Return (int a^4 dt)^(1/4) from the beginning to each time, by the trapezoidal rule."""
    fourth = values**4
    return root(
        jnp.concatenate([jnp.zeros(1), jnp.cumsum((fourth[1:] + fourth[:-1]) / 2)]) * step, 4
    )


def _unit(name: str) -> str:
    return "rad/s2" if name == "We" else "m/s2"
