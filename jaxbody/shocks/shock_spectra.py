"""Shock response spectra of records: the peaks of oscillators of many frequencies and dampings on a base with this acceleration."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from equinox import field

from jaxbody.compilation.compile_options import jit_vectorized
from jaxbody.core import tables
from jaxbody.core.arguments import check_one_of
from jaxbody.core.arrays import Array, Complex, Float, Int, concrete, device_array
from jaxbody.core.datasets import Labeled, dataset
from jaxbody.core.errors import JaxbodyError, Problem, Problems, Status
from jaxbody.core.results import Result
from jaxbody.responses.frequency_responses import checked_frequencies
from jaxbody.shocks.accelerograms import checked_samples
from jaxbody.shocks.oscillators import SIDES, peaks, poles
from jaxbody.shocks.response_spectra import ResponseSpectrum, as_rows, check_dampings, log_interpolated

KINDS = {"absolute": "m/s2", "relative": "m", "pseudo": "m/s2"}
PEAKS = ("samples", "continuous")
FINEST, FEWEST = 0.1, 4  # rad between the points among which a continuous peak is looked for, and points in a step; the largest of them is
# too low by 0.13 % where the oscillator determines the curvature of the response, and by an h^2/(128 x) where a slow one follows the record
SLOWEST = {"samples": 0.25, "continuous": 0.5}  # largest frequency times step: four samples a period; the highest frequency of a record


class ShockSpectrum(Labeled, ResponseSpectrum, Result):
    """`values` (damping ratios, frequencies), in `unit`, at `damping` and `frequencies` [Hz]; `kind`, `side` and `peaks` as asked for.

    It is a response spectrum: `spectrum(f, zeta)` is the pseudo-acceleration [m/s2] between its points, along straight lines in logarithms
    of frequency and value, and in the damping ratio. Error: BAD_KIND for a spectrum of absolute accelerations, which is none, or of one
    side."""

    index = "frequency"
    frequencies: Float[Array, "nf"]
    damping: Float[Array, "nz"]
    values: Float[Array, "nz nf"]
    status: Int[Array, ""]
    kind: str = field(static=True)
    side: str = field(static=True)
    peaks: str = field(static=True)

    @property
    def unit(self) -> str:
        return KINDS[self.kind]

    @property
    def pseudo_acceleration(self) -> Float[Array, "nz nf"]:
        """w^2 max|x| [m/s2]."""
        if self.kind == "absolute" or self.side != "maximax":
            hint = 'Compute it with kind="pseudo" and side="maximax".'
            message = f"is of {self.kind} responses, {self.side}"
            raise JaxbodyError(Problem("BAD_KIND", "ShockSpectrum.kind", message, self.kind, "pseudo or relative, maximax", hint))
        return self.values * ((2 * jnp.pi * self.frequencies[None]) ** 2 if self.kind == "relative" else 1.0)

    def covers(self) -> tuple[Any, Any]:
        return jnp.min(self.frequencies), jnp.max(self.frequencies)

    def dampings(self) -> tuple[Any, Any]:
        return jnp.min(self.damping), jnp.max(self.damping)

    def __call__(self, frequencies: Any, damping: Any = None) -> Float[Array, "*n"]:
        """The pseudo-acceleration [m/s2]; without a damping ratio, that of the first one. Outside it is constant."""
        f, zeta = jnp.broadcast_arrays(as_rows(frequencies), self.damping[0] if damping is None else as_rows(damping))
        order, rows = jnp.argsort(self.frequencies), jnp.argsort(self.damping)
        at, values = self.frequencies[order], self.pseudo_acceleration[rows][:, order]
        each = jnp.log(jnp.stack([log_interpolated(f, at, row) for row in values], -1))

        def one(zeta, logs):
            return jnp.exp(jnp.interp(zeta, self.damping[rows], logs))

        for _ in range(f.ndim):
            one = jax.vmap(one)
        return one(zeta, each)

    def to_xarray(self) -> Any:
        """An xarray.Dataset: the spectrum by damping ratio and frequency."""
        variables = {"spectrum": (("damping", "frequency"), self.values, self.unit), "status": ((), self.status, "")}
        coordinates = {
            "frequency": ("frequency", np.asarray(self.frequencies), {"units": "Hz"}),
            "damping": ("damping", np.asarray(self.damping), {"units": ""}),
        }
        return dataset(variables, coordinates, f"shock spectrum, {self.kind}, {self.side}")

    @tables.summarized("Shock spectrum", 2, values="values")
    def _tables(self) -> list[tables.PrintedTable]:
        f, values = np.asarray(self.frequencies), np.asarray(self.values)
        heads = ("damping ratio", "at lowest frequency", "largest", "at [Hz]", "at highest frequency", "unit")
        low, high, top = f.argmin(), f.argmax(), values.argmax(1)
        rows = [(zeta, row[low], row[i], f[i], row[high], self.unit) for zeta, row, i in zip(self.damping, values, top, strict=True)]
        title = (
            f"Shock spectrum, {self.kind}, {self.side}, peaks {'at samples' if self.peaks == 'samples' else 'of the continuous response'}"
        )
        return [tables.PrintedTable(f"{title}, {f.min():.6g} to {f.max():.6g} Hz", heads, rows, self.failure)]


def shock_spectrum(
    record: Any,
    frequencies: Any,
    *,
    damping: Any = 0.05,
    kind: str = "absolute",
    side: str = "maximax",
    peaks: str = "samples",
) -> ShockSpectrum:
    """The shock response spectrum of a record of base acceleration a: the largest response, during the record, of oscillators at rest at
    its first sample.

        x'' + 2 zeta w x' + w^2 x = -a,   w = 2 pi frequency,   a in straight lines between samples

    The recurrence is exact for such lines. It is differentiable with respect to the accelerations and damping ratios, and with
    peaks="samples" to the frequencies. The record is all there is: add zeros for the free vibration after a pulse, as in
    `jb.HalfSine(...).samples()`.

    Args:
        record: a Record with one acceleration, or (times, accelerations) [s, m/s2], equally spaced.
        frequencies: natural frequencies in one row [Hz].
        damping: damping ratio or ratios, 0 to below 1.
        kind: "absolute" acceleration x'' + a [m/s2], "relative" displacement x [m], or "pseudo"-acceleration -w^2 x [m/s2].
        side: "maximax", of the magnitude, "positive" or "negative", of the response or of minus the response.
        peaks: of the response at the "samples", or of the "continuous" response between them.

    Errors, all at once: LOW_RATE for frequencies above a quarter of the sampling rate, or with continuous peaks above half of it, TOO_SHORT
    for those whose period is longer than the record, NOT_A_FRACTION, BAD_FREQUENCY, BAD_KIND, BAD_OPTION, WRONG_KIND, WRONG_DIMENSION,
    GAPS, NOT_UNIFORM, BAD_SHAPE, NON_FINITE. Source: ISO 18431-4:2007 (its ramp-invariant filters); N. C. Nigam, P. C. Jennings, Bull.
    Seismol. Soc. Am. 59 (1969) 909.

    >>> times = jnp.arange(0.0, 5.0, 0.001)
    >>> step = shock_spectrum((times, jnp.full(5000, 2.0)), [1.0, 4.0], damping=0.0, peaks="continuous")
    >>> step.values.round(9).tolist()  # twice the acceleration
    [[4.0, 4.0]]
    """
    with Problems() as problems:
        samples = checked_samples(record, "m/s2", "shock_spectrum.record", problems)
        f = problems.gather(lambda: checked_frequencies(frequencies, "shock_spectrum.frequencies"))
        zeta = check_dampings(damping, "shock_spectrum.damping", problems)
        check_one_of(kind, KINDS, "BAD_KIND", "shock_spectrum.kind", problems)
        check_one_of(side, SIDES, "BAD_OPTION", "shock_spectrum.side", problems)
        check_one_of(peaks, PEAKS, "BAD_OPTION", "shock_spectrum.peaks", problems)
        if samples is not None and f is not None and peaks in PEAKS:
            check_record(samples, concrete(f), peaks, "shock_spectrum.record", problems)
    assert samples is not None and f is not None
    zeta = zeta[None] if zeta.ndim == 0 else zeta
    f, zeta, values, status = (_at_samples if peaks == "samples" else _spectrum)(samples, f, zeta, kind, side, peaks)
    return ShockSpectrum(f, zeta, values, status, kind, side, peaks)


def check_record(samples: tuple[Any, Any], f: np.ndarray | None, peaks: str, where: str, problems: Problems) -> None:
    """Whether a record is long enough and sampled fast enough for frequencies [Hz]. Errors: TOO_SHORT, LOW_RATE."""
    known = concrete(samples[1])
    if known is None or f is None:
        return
    step, length = float(known), float(known) * (len(samples[0]) - 1)
    highest = SLOWEST[peaks] / step * (1 + 1e-9)
    if (fast := f[f > highest]).size:
        other = ', or take peaks="continuous"' if peaks == "samples" and fast.max() <= SLOWEST["continuous"] / step else ""
        message = f"has {1 / step:.6g} samples a second, too few for {_some(fast)}"
        hint = f"Record faster, or leave these frequencies out{other}."
        problems.add("LOW_RATE", where, message, value=fast, limit=f"frequencies up to {highest:.6g} Hz", hint=hint)
    if (slow := f[f * length < 1 - 1e-9]).size:
        message = f"is {length:.6g} s long, shorter than a period of {_some(slow)}"
        hint = "Add zeros for the free vibration after the record, or leave these frequencies out."
        problems.add("TOO_SHORT", where, message, value=slow, limit=f"frequencies from {1 / length:.6g} Hz", hint=hint)


def _some(f: np.ndarray) -> str:
    """The frequencies, or the first and last of many."""
    text = ", ".join(f"{x:.6g}" for x in f) if len(f) <= 4 else f"{len(f)} frequencies from {f.min():.6g} to {f.max():.6g}"
    return f"{text} Hz"


def spectrum_values(samples: tuple[Any, Any], f: Float[Array, "nf"], zeta: Float[Array, "nz"], kind: str, side: str, peaks: str):
    """The values (nz, nf) of a spectrum."""
    each, ratio = jnp.broadcast_to(f[None], (len(zeta), len(f))), jnp.broadcast_to(zeta[:, None], (len(zeta), len(f)))
    s = poles(each.ravel(), ratio.ravel())
    return peaks_of(samples, s, weights_of(s, kind), side, peaks).reshape(each.shape)


def _spectrum(samples, f, zeta, kind: str, side: str, peaks: str):
    """All arrays of a result, which one program returns."""
    f, zeta = device_array(f), device_array(zeta)
    return f, zeta, spectrum_values(samples, f, zeta, kind, side, peaks), jnp.array(Status.OK.value)


_at_samples = jit_vectorized(_spectrum)


def weights_of(s: Complex[jax.Array, "n"], kind: str) -> Complex[jax.Array, "n"]:
    """c of the responses of a kind."""
    w2 = (s * s.conj()).real
    return {"absolute": s**2, "relative": jnp.ones_like(s), "pseudo": (-w2).astype(s.dtype)}[kind] / s.imag.astype(s.dtype)


def peaks_of(samples: tuple[Any, Any], s: Complex[jax.Array, "n"], c: Complex[jax.Array, "n"], side: str, kind: str) -> Float[Array, "n"]:
    """Peaks of Im(r) of oscillators with the poles s and the weights c, fast ones of the continuous response at more points a step."""
    a, h = (device_array(x) for x in samples)
    known, step = concrete(s), concrete(h)
    if kind == "samples":
        return peaks(a, h, s, c, side, None)
    if known is None or step is None:
        return peaks(a, h, s, c, side, 32)
    parts = 2 ** np.ceil(np.log2(np.maximum(np.abs(known) * float(step) / FINEST, FEWEST))).astype(int)
    result = jnp.zeros(s.shape, a.dtype)
    for count in sorted(set(parts.tolist())):
        places = np.flatnonzero(parts == count)
        result = result.at[places].set(peaks(a, h, s[places], c[places], side, count))
    return result
