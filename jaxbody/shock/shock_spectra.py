"""Shock response spectra of records: the peaks of oscillators of many frequencies and damping
ratios on a base with the recorded acceleration."""

import itertools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from equinox import field

from jaxbody.core import tables
from jaxbody.core.arguments import check_one_of
from jaxbody.core.arrays import Array, Complex, Float, Int, concrete, device_array, is_concrete
from jaxbody.core.compilation.compile_options import WIDE, program_with
from jaxbody.core.errors import JaxbodyError, Problem, Problems, Status
from jaxbody.core.results import Labeled, Result, dataset
from jaxbody.model.inputs.pulses import Pulse
from jaxbody.shock.oscillators import SIDES, checked_samples, free_peaks, peaks, poles
from jaxbody.shock.response_spectra import (
    ResponseSpectrum,
    as_rows,
    check_dampings,
    log_interpolated,
)
from jaxbody.vibration.frequency_responses import checked_frequencies

KINDS = {"absolute": "m/s2", "relative": "m", "pseudo": "m/s2"}
PEAKS = ("samples", "continuous")
PARTS = {
    "primary": "",
    "residual": ", in the free vibration after it",
    "both": ", also in the free vibration after it",
}
PULSE_STEPS = 2000  # straight lines in a pulse, from which a half sine deviates by (pi/2000)^2/8
SHORTEST = 1e-9  # fraction of a pulse taken between two coinciding corners
# rad between the points among which a continuous peak is looked for, and points in a step; the
# largest of them is too low by 0.13 % where the oscillator determines the curvature of the
# response, and by an h^2/(128 x) where a slow one follows the record
FINEST, FEWEST = 0.1, 4
# largest frequency times step: four samples a period; the highest frequency of a record
SLOWEST = {"samples": 0.25, "continuous": 0.5}


class ShockSpectrum(Labeled, ResponseSpectrum, Result):
    """A shock response spectrum: `values` (damping ratios, frequencies), in `unit`, at `damping`
    and `frequencies` [Hz]; `kind`, `side`, `peaks` and `part` are the options of `shock_spectrum`.

    `spectrum(f, zeta)` is the pseudo-acceleration [m/s2], interpolated linearly between logarithms
    of frequency and value, and between damping ratios. Error: BAD_KIND for a spectrum of absolute
    accelerations or of one side, which is not one of pseudo-accelerations."""

    index = "frequency"
    frequencies: Float[Array, "nf"]
    damping: Float[Array, "nz"]
    values: Float[Array, "nz nf"]
    status: Int[Array, ""]
    kind: str = field(static=True)
    side: str = field(static=True)
    peaks: str = field(static=True)
    part: str = field(static=True, default="primary")

    @property
    def unit(self) -> str:
        return KINDS[self.kind]

    @property
    def pseudo_acceleration(self) -> Float[Array, "nz nf"]:
        """The pseudo-acceleration w^2 max|x| [m/s2]."""
        if self.kind == "absolute" or self.side != "maximax":
            raise JaxbodyError(
                Problem(
                    "BAD_KIND",
                    "ShockSpectrum.kind",
                    f"is of {self.kind} responses, {self.side}",
                    self.kind,
                    "pseudo or relative, maximax",
                    'Compute it with kind="pseudo" and side="maximax".',
                )
            )
        return self.values * (
            (2 * jnp.pi * self.frequencies[None]) ** 2 if self.kind == "relative" else 1.0
        )

    def covers(self) -> tuple[Any, Any]:
        return jnp.min(self.frequencies), jnp.max(self.frequencies)

    def dampings(self) -> tuple[Any, Any]:
        return jnp.min(self.damping), jnp.max(self.damping)

    def __call__(self, frequencies: Any, damping: Any = None) -> Float[Array, "*n"]:
        """Return the pseudo-acceleration [m/s2] at frequencies [Hz] and damping ratios; without
        `damping`, that of the first damping ratio. It is constant outside the spectrum's range."""
        f, zeta = jnp.broadcast_arrays(
            as_rows(frequencies), self.damping[0] if damping is None else as_rows(damping)
        )
        order, rows = jnp.argsort(self.frequencies), jnp.argsort(self.damping)
        at, values = self.frequencies[order], self.pseudo_acceleration[rows][:, order]
        each = jnp.log(jnp.stack([log_interpolated(f, at, row) for row in values], -1))

        def at_damping(zeta, logarithms):
            return jnp.exp(jnp.interp(zeta, self.damping[rows], logarithms))

        return jnp.vectorize(at_damping, signature="(),(nz)->()")(zeta, each)

    def to_xarray(self) -> Any:
        """Return an xarray.Dataset: the spectrum by damping ratio and frequency."""
        return dataset(
            {
                "spectrum": (("damping", "frequency"), self.values, self.unit),
                "status": ((), self.status, ""),
            },
            {
                "frequency": ("frequency", np.asarray(self.frequencies), {"units": "Hz"}),
                "damping": ("damping", np.asarray(self.damping), {"units": ""}),
            },
            f"shock spectrum, {self.kind}, {self.side}",
        )

    @tables.summarized("Shock spectrum", 2, values="values")
    def _tables(self) -> list[tables.PrintedTable]:
        f, values = np.asarray(self.frequencies), np.asarray(self.values)
        low, high, top = f.argmin(), f.argmax(), values.argmax(1)
        rows = [
            (zeta, row[low], row[i], f[i], row[high], self.unit)
            for zeta, row, i in zip(self.damping, values, top, strict=True)
        ]
        kind = "at samples" if self.peaks == "samples" else "of the continuous response"
        return [
            tables.PrintedTable(
                f"Shock spectrum, {self.kind}, {self.side}, peaks {kind}{PARTS[self.part]}, "
                f"{f.min():.6g} to {f.max():.6g} Hz",
                (
                    "damping ratio",
                    "at lowest frequency",
                    "largest",
                    "at [Hz]",
                    "at highest frequency",
                    "unit",
                ),
                rows,
                self.failure,
            )
        ]


def shock_spectrum(
    record: Any,
    frequencies: Any,
    *,
    damping: Any = 0.05,
    kind: str = "absolute",
    side: str = "maximax",
    peaks: str = "samples",
    part: str | None = None,
) -> ShockSpectrum:
    """Compute the shock response spectrum of a record or pulse of base acceleration a: the largest
    response of oscillators that start at rest.

        x'' + 2 zeta w x' + w^2 x = -a,   w = 2 pi frequency,
        a in straight lines between samples, zero after the last one

    The recurrence is exact for such lines, and so is the free vibration after them. The spectrum is
    differentiable with respect to accelerations and damping ratios, and with peaks="samples" also
    with respect to frequencies. A pulse may jump, and needs no samples and no zeros after it.

    Args:
        record: a Record with one acceleration, (times, accelerations) [s, m/s2], evenly spaced, or
            a pulse [m/s2] such as jb.inputs.HalfSine(...).
        frequencies: natural frequencies [Hz], in one row.
        damping: damping ratio or ratios, 0 to below 1.
        kind: "absolute" acceleration x'' + a [m/s2] (default), "relative" displacement x [m], or
            "pseudo"-acceleration -w^2 x [m/s2].
        side: largest magnitude of the response, "maximax" (default), or largest "positive" or
            "negative" value.
        peaks: peaks at the "samples" of a record (default), or of the "continuous" response between
            them, which is always used for pulses.
        part: "primary", during the record or pulse; "residual", after it; "both". Default: both for
            a pulse, primary for a record, which must last for a period (TOO_SHORT).

    Errors, all at once: LOW_RATE for frequencies above a quarter of the sampling rate, or with
    continuous peaks above half of it, TOO_SHORT, NOT_A_FRACTION, BAD_FREQUENCY, BAD_KIND,
    BAD_OPTION, WRONG_KIND, WRONG_DIMENSION, GAPS, BAD_SHAPE, NON_FINITE, NOT_UNIFORM and those of
    times. Source: ISO 18431-4:2007 (its ramp-invariant filters); N. C. Nigam, P. C. Jennings, Bull.
    Seismol. Soc. Am. 59 (1969) 909.

    >>> times = jnp.arange(0.0, 5.0, 0.001)
    >>> step = jb.shock.shock_spectrum(
    ...     (times, jnp.full(5000, 2.0)), [1.0, 4.0], damping=0.0, peaks="continuous"
    ... )
    >>> step.values.round(9).tolist()  # twice the acceleration
    [[4.0, 4.0]]
    """
    pulse = isinstance(record, Pulse)
    with Problems() as problems:
        samples = (
            _lines(record)
            if pulse
            else checked_samples(record, "m/s2", "shock_spectrum.record", problems)
        )
        f = problems.gather(lambda: checked_frequencies(frequencies, "shock_spectrum.frequencies"))
        zeta = check_dampings(damping, "shock_spectrum.damping", problems)
        check_one_of(kind, KINDS, "BAD_KIND", "shock_spectrum.kind", problems)
        check_one_of(side, SIDES, "BAD_OPTION", "shock_spectrum.side", problems)
        check_one_of(peaks, PEAKS, "BAD_OPTION", "shock_spectrum.peaks", problems)
        check_one_of(part or "both", PARTS, "BAD_OPTION", "shock_spectrum.part", problems)
        if isinstance(samples, tuple) and f is not None and peaks in PEAKS:
            check_record(
                samples, concrete(f), peaks, "shock_spectrum.record", problems, whole=part is None
            )
    f, zeta = device_array(f), jnp.atleast_1d(device_array(zeta))
    peaks, part = ("continuous", part or "both") if pulse else (peaks, part or "primary")
    values = (_values_at_samples if peaks == "samples" else spectrum_values)(
        samples, f, zeta, kind, side, peaks, part
    )
    return ShockSpectrum(f, zeta, values, jnp.array(Status.OK.value), kind, side, peaks, part)


def _lines(pulse: Pulse) -> list[tuple[Array, Array]]:
    """Return the accelerations of a pulse at equal steps and the step [s], one pair from each
    corner of the pulse to the next."""
    ends = list(map(jnp.asarray, pulse.corners()))
    count = PULSE_STEPS // (len(ends) - 1)
    lines = []
    for low, high in itertools.pairwise(ends):
        step = jnp.maximum(high - low, SHORTEST) / count
        lines.append(
            (
                pulse.amplitude * pulse.shape(low + step * np.arange(count + 1.0))[0],
                pulse.duration * step,
            )
        )
    return lines


def check_record(
    samples: tuple[Any, Any],
    f: np.ndarray | None,
    peaks: str,
    where: str,
    problems: Problems,
    *,
    whole: bool = True,
) -> None:
    """Check that a record is sampled fast enough for frequencies `f` [Hz] and, with `whole`, that
    it lasts a period of each. `samples`: accelerations and the step between them [s]. Errors:
    LOW_RATE, TOO_SHORT."""
    known = concrete(samples[1])
    if known is None or f is None:
        return
    step, length = float(known), float(known) * (len(samples[0]) - 1)
    highest = SLOWEST[peaks] / step * (1 + 1e-9)
    if (fast := f[f > highest]).size:
        other = (
            ', or take peaks="continuous"'
            if peaks == "samples" and fast.max() <= SLOWEST["continuous"] / step
            else ""
        )
        problems.add(
            "LOW_RATE",
            where,
            f"has {1 / step:.6g} samples a second, too few for {_some(fast)}",
            value=fast,
            limit=f"frequencies up to {highest:.6g} Hz",
            hint=f"Record faster, or leave these frequencies out{other}.",
        )
    if whole and (slow := f[f * length < 1 - 1e-9]).size:
        problems.add(
            "TOO_SHORT",
            where,
            f"is {length:.6g} s long, shorter than a period of {_some(slow)}",
            value=slow,
            limit=f"frequencies from {1 / length:.6g} Hz",
            hint='For the free vibration after the record add zeros, or give part="both" to '
            "shock_spectrum; or leave these frequencies out.",
        )


def _some(f: np.ndarray) -> str:
    """Return the frequencies [Hz] as text; of more than four their number and range."""
    if len(f) > 4:
        return f"{len(f)} frequencies from {f.min():.6g} to {f.max():.6g} Hz"
    return f"{', '.join(f'{x:.6g}' for x in f)} Hz"


def spectrum_values(
    samples: Any,
    f: Float[Array, "nf"],
    zeta: Float[Array, "nz"],
    kind: str,
    side: str,
    peaks: str,
    part: str = "primary",
):
    """Return the values (nz, nf) of a spectrum at frequencies f [Hz] and damping ratios zeta."""
    each, ratio = jnp.broadcast_arrays(f[None], zeta[:, None])
    s = poles(each.ravel(), ratio.ravel())
    return peaks_of(samples, s, weights_of(s, kind), side, peaks, part).reshape(each.shape)


_values_at_samples = program_with(WIDE)(spectrum_values)


def weights_of(s: Complex[jax.Array, "n"], kind: str) -> Complex[jax.Array, "n"]:
    """Return the weights c of oscillators with the poles s for responses of a kind."""
    w2 = (s * s.conj()).real
    return {"absolute": s**2, "relative": jnp.ones_like(s), "pseudo": (-w2).astype(s.dtype)}[
        kind
    ] / s.imag.astype(s.dtype)


def peaks_of(
    samples: Any,
    s: Complex[jax.Array, "n"],
    c: Complex[jax.Array, "n"],
    side: str,
    kind: str,
    part: str = "primary",
) -> Float[Array, "n"]:
    """Return the peaks of Im(r) of oscillators with the poles s and the weights c. Continuous peaks
    of fast oscillators are searched at more points in each step.

    Args:
        samples: accelerations and the step between them [s], or a list of such pairs, one after the
            other
        s: poles [1/s]
        c: weights
        side: "maximax", "positive" or "negative"
        kind: peaks at the "samples" or of the "continuous" response
        part: "primary" (default), during the samples, "residual", after them, or "both" of these"""
    pairs = jax.tree.map(device_array, samples if isinstance(samples, list) else [samples])

    def largest(s, c, count):
        best, r = jnp.zeros(s.shape, pairs[0][0].dtype), jnp.zeros_like(s)
        for a, h in pairs:
            value, r = peaks(a, h, s, c, side, count, r)
            best = jnp.maximum(best, value)
        free = free_peaks(r, s, side) if part != "primary" else best
        return {"primary": best, "residual": free, "both": jnp.maximum(best, free)}[part]

    if kind == "samples":
        return largest(s, c, None)
    steps = [h for _, h in pairs]
    if not is_concrete(s, steps):
        return largest(s, c, 32)
    fastest = np.abs(np.asarray(s)) * max(map(float, steps))
    parts = 2 ** np.ceil(np.log2(np.maximum(fastest / FINEST, FEWEST))).astype(int)
    result = jnp.zeros(s.shape, pairs[0][0].dtype)
    for count in sorted(set(parts.tolist())):
        places = np.flatnonzero(parts == count)
        result = result.at[places].set(largest(s[places], c[places], count))
    return result
