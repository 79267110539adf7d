"""Frequency responses estimated from records of a test, with coherence and random errors.

With the transforms x (inputs) and y (outputs) of n independent segments, and S_yx = mean y x^H,

    H1 = S_yx S_xx^-1                       noise on outputs
    H2 = S_yy / S_xy                        noise on the input, one input
    Hv = sqrt(S_yy / S_xx) S_yx/|S_yx|      noise on both, relative to their size
    S_ee = S_yy - H1 S_xy                   what the inputs do not explain

The coherence of an output is 1 - S_ee/S_yy; for a pair of one input and one output, the influence
of the other inputs taken out, it is g2 = |H|^2/(|H|^2 + S_ee (S_xx^-1)_ii). The standard deviation
of the real part of H, and of the imaginary part, is |H| sqrt((1 - g2)/(2 n g2)), with n - n_inputs
in place of n, as S_ee is estimated. Several inputs: Hv is total least squares.

Sources: J. S. Bendat and A. G. Piersol, Random Data, 4th ed. (2010), ch. 7 and 9;
D. J. Ewins, Modal Testing, 2nd ed. (2000), ch. 3.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import equinox as eqx
import numpy as np

from jaxbody.core import tables
from jaxbody.core.arguments import check_one_of
from jaxbody.core.errors import JaxbodyError, Problem, Problems, warn
from jaxbody.fitting.experiments.measured_responses import (
    MeasuredResponse,
    ResponseChannel,
    response_unit,
)
from jaxbody.fitting.modal.segments import Transforms, channels_of, cut
from jaxbody.records.records import Record

METHODS = ("H1", "H2", "Hv")
SPECTRA = "Positive spectra"  # the method of `positive_spectra`
SILENT = 1e-10  # power of an input relative to its largest, below which a line is not excited
ROUND_OFF = 1e-12  # smallest noise of an output, relative to its size
SAME = 0.999  # coherence of an input with the others, from which it is not independent
CHANCE = 0.05  # probability that a coherence is as large by chance
FEW = 0.2  # part of the lines of an output that may have no coherence without a warning
SMOOTH = 0.15  # correlation of neighboring residuals, from which they are leakage


class Averages(NamedTuple):
    """What an estimate knows of its noise: `input_power` (nf, nu, nu), the sum of x x^H over the
    independent averages, `noise` S_ee (nf, ny) of one average, its degrees of `freedom`."""

    input_power: np.ndarray
    noise: np.ndarray
    freedom: float

    @property
    def spread(self) -> np.ndarray:
        """Standard deviations of the real parts of H, equal to those of the imaginary parts."""
        each = np.real(np.diagonal(np.linalg.inv(self.input_power), axis1=1, axis2=2))
        return np.sqrt(np.maximum(self.noise[:, :, None] * each[:, None] / 2, 0.0))


@dataclass(frozen=True, eq=False)
class ResponseEstimate:
    """Estimated responses as NumPy arrays.

    `H` (nf, ny, nu), NaN at lines that are not excited; `spread`, the standard deviation of real
    and imaginary parts; `coherence` (nf, ny) of outputs with all inputs, `partial` (nf, ny, nu) of
    pairs; `segments`: their transforms at these frequencies; `leaks`: True if lines contain those
    beside them; `replicates` (n, nf, ny, nu): errors that the parts of a record of ambient
    vibration contribute, whose mean is the error of H."""

    frequencies: np.ndarray
    H: np.ndarray
    spread: np.ndarray
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    input_units: tuple[str, ...]
    output_units: tuple[str, ...]
    segments: Transforms
    averages: Averages | None = None
    coherence: np.ndarray | None = None
    partial: np.ndarray | None = None
    leaks: bool = False
    method: str = ""
    replicates: np.ndarray | None = None

    def unit(self, output: str, source: str) -> str:
        """Return the unit of a response from those of output and input, or of a spectrum."""
        if self.method == SPECTRA:
            return f"({output or '1'}) ({source or '1'})/Hz"
        return response_unit(output, source)


class EstimatedResponse(tables.Printed, MeasuredResponse):
    """Frequency responses of a test, a MeasuredResponse for `fit`, with their coherence.

    `estimate` holds H (nf, ny, nu), `coherence` (nf, ny) of the outputs, `partial` coherences
    (nf, ny, nu) and `spread`, the standard deviation of real and imaginary parts, as NumPy arrays.
    The bias of H1 by noise on the inputs is between -(1 - coherence) H and zero, that of H2 by
    noise on the output between zero and (1/coherence - 1) H. `plot()` draws magnitude, phase and
    coherence.

    >>> force = np.random.default_rng(1).normal(size=4096)
    >>> record = jb.Record(None, {"f": (force, "N"), "x": (2e-3 * force, "m")}, rate=256.0)
    >>> test = jb.modal.estimate_responses(record, inputs=["f"], outputs=["x"], segment=1.0)
    >>> isinstance(test, jb.modal.EstimatedResponse), test.estimate.coherence.shape
    (True, (128, 1))
    """

    estimate: ResponseEstimate = eqx.field(static=True)

    def __init__(self, estimate: ResponseEstimate, inputs: dict[str, Any], outputs: dict[str, Any]):
        spread = estimate.spread
        pairs = {
            (y, u): (estimate.H[:, i, j], spread[:, i, j])
            for i, y in enumerate(estimate.outputs)
            for j, u in enumerate(estimate.inputs)
        }
        floor = np.finfo(np.float32).tiny
        super().__init__(
            estimate.frequencies,
            inputs=inputs,
            outputs=outputs,
            measured={pair: H for pair, (H, _) in pairs.items()},
            noise={pair: np.fmax(s, floor) for pair, (_, s) in pairs.items()},
        )
        self.estimate = estimate

    @property
    def channels(self):
        e = self.estimate
        units = dict(zip(e.inputs + e.outputs, e.input_units + e.output_units, strict=False))
        return {f"{y}/{u}": ResponseChannel(unit=e.unit(units[y], units[u])) for y, u in self.pairs}

    def check(self, model, where):
        e = self.estimate
        if e.method == SPECTRA or e.segments.decay is not None:
            raise JaxbodyError(
                Problem(
                    "WRONG_KIND",
                    where,
                    "has positive spectra"
                    if e.method == SPECTRA
                    else "has the damping of an exponential window",
                    limit="frequency responses of the structure alone",
                    hint="Fit the modes, jb.modal.identify_modes(responses).",
                )
            )
        super().check(model, where)

    def _tables(self) -> list[tables.PrintedTable]:
        e, f, rows = self.estimate, self.estimate.frequencies, []
        heads = ["pair", "unit", "largest", "at [Hz]", "standard error"]
        coherent = e.partial is not None
        for i, y in enumerate(e.outputs):
            for j, u in enumerate(e.inputs):
                H, unit = np.abs(e.H[:, i, j]), self.channels[f"{y}/{u}"].unit
                top = int(np.nanargmax(H))
                error = tables.percent(np.nanmedian(e.spread[:, i, j] / H))
                g2 = e.partial[:, i, j] if e.partial is not None else H
                coherence = (np.nanmedian(g2), np.nanmin(g2)) if coherent else ()
                rows.append((f"{y}/{u}", unit or "-", H[top], f[top], error, *coherence))
        heads += ["coherence", "least"] if coherent else []
        what = "Frequency responses by " if coherent else ""
        title = f"{what}{e.method}, {f[0]:.6g} to {f[-1]:.6g} Hz, {len(f)} lines"
        return [tables.PrintedTable(title, tuple(heads), rows, "\n".join(e.segments.notes))]


def random_error(coherence: Any, averages: float) -> Any:
    """Return the relative random error of a frequency response, the standard deviation of its real
    part, and of its imaginary part, over its magnitude (Bendat and Piersol, eq. 9.91).

        e = sqrt((1 - g2)/(2 n g2))

    Args:
        coherence: g2, with several inputs that of the pair alone
        averages: number n of independent averages

    >>> round(float(jb.modal.random_error(0.95, 32)), 11)
    0.02867696673
    """
    g2 = np.asarray(coherence)
    return np.sqrt((1 - g2) / (2 * averages * g2))


def estimate_responses(
    record: Record | Sequence[Record],
    *,
    inputs: dict[str, Any] | Sequence[str],
    outputs: dict[str, Any] | Sequence[str],
    method: str = "H1",
    segment: float | None = None,
    window: Any = None,
    overlap: float | None = None,
    band: tuple[float, float] | None = None,
) -> EstimatedResponse:
    """Estimate frequency responses from the records of a shaker test, an impact test or a test on
    a shaking table, with their coherence and random errors.

    Args:
        record: a record with all channels in it, or several records of the same test
        inputs: {channel: port}, such as {"force": jb.PointForce("plate", [0, 0, 0], "z")} or
            {"table": jb.BaseMotion("base", "z", kind="acceleration")}; or names of channels where
            the responses are not fitted
        outputs: {channel: sensor}, or names of channels
        method: "H1" (noise on outputs), "H2" (noise on the input; one input) or "Hv" (on both)
        segment: length of a segment [s]; None: the period of a periodic input, else one that gives
            16 segments side by side
        window: name of a window of scipy.signal; an ImpactWindow for hits of a hammer; None: whole
            periods without a window if all inputs are periodic, else "hann"
        overlap: part of a segment that the next one shares; None: 0.5, without a window 0
        band: (lowest, highest) frequency that is kept [Hz]; None: all but 0 Hz

    Units of the channels must be those of the ports. The standard deviations become the noise of
    the measurement. Lines that an input does not excite are NaN.

    Errors, all at once: UNKNOWN_CHANNEL, BAD_SHAPE, MISSING, NOT_UNIFORM, RATE_MISMATCH,
    WRONG_DIMENSION, BAD_METHOD, BAD_NUMBER, BAD_OPTION, BAD_BAND, TOO_SHORT, DEPENDENT_INPUTS.
    Warns LOW_COHERENCE with the lines, LEAKAGE.

    >>> rng = np.random.default_rng(1)
    >>> force = rng.normal(size=4096)
    >>> record = jb.Record(None, {"f": (force, "N"), "x": (2e-3 * force, "m")}, rate=256.0)
    >>> test = jb.modal.estimate_responses(record, inputs=["f"], outputs=["x"], segment=1.0)
    >>> round(float(test.estimate.H[10, 0, 0].real), 9), len(test.frequencies)
    (0.002, 128)
    """
    where = "estimate_responses"
    records = [record] if isinstance(record, Record) else list(record)
    x_names, y_names = tuple(inputs), tuple(outputs)
    with Problems() as problems:
        check_one_of(method, METHODS, "BAD_METHOD", f"{where}.method", problems)
        for name, given in (("record", records), ("inputs", x_names), ("outputs", y_names)):
            if not given:
                problems.add("NO_DATA", f"{where}.{name}", "is empty", limit="at least one")
        if method == "H2" and len(x_names) > 1:
            problems.add(
                "BAD_METHOD",
                f"{where}.method",
                f"is H2 with {len(x_names)} inputs",
                limit="H2 with one input",
                hint="Use H1, or Hv.",
            )
    data = channels_of(records, x_names + y_names, where)
    units = tuple(records[0].units[name] for name in x_names + y_names)
    _check_ports(units, x_names + y_names, [inputs, outputs], where)
    rate, count = records[0].sampling.rate, len(x_names)
    segments = cut(data, count, rate, segment, window, overlap, where)
    estimate = estimated(segments, method, x_names, y_names, units, band, where)
    _warn_of_silence(estimate)
    ports = [x if isinstance(x, dict) else dict.fromkeys(x) for x in (inputs, outputs)]
    return EstimatedResponse(estimate, *ports)


def _check_ports(units: Sequence[str], names: Sequence[str], given: list[Any], where: str) -> None:
    """Check that the channels have the units of their ports. Error: WRONG_DIMENSION."""
    ports = {k: port for part in given if isinstance(part, dict) for k, port in part.items()}
    with Problems() as problems:
        for unit, name in zip(units, names, strict=True):
            needed = getattr(ports.get(name), "unit", None)
            if needed is not None and needed != unit:
                problems.add(
                    "WRONG_DIMENSION",
                    f"{where}['{name}']",
                    f"is in {unit or '1'}",
                    value=unit,
                    limit=f"{needed}, the unit of its {type(ports[name]).__name__}",
                )


def estimated(
    segments: Transforms,
    method: str,
    inputs: tuple[str, ...],
    outputs: tuple[str, ...],
    units: tuple[str, ...],
    band: tuple[float, float] | None,
    where: str,
) -> ResponseEstimate:
    """Return the estimate from transforms of segments."""
    nu, kept = len(inputs), band_of(segments.frequencies, band, where)
    lines = slice(kept[0], kept[-1] + 1)
    segments = segments._replace(
        frequencies=segments.frequencies[lines], spectra=segments.spectra[:, :, lines]
    )
    K, n, periodic = segments.spectra.shape[1], segments.effective, bool(segments.periods)
    if periodic:  # means over the periods of each record; the rest is noise
        means = means_of_periods(segments)
        Z, freedom = means * np.sqrt(segments.periods)[:, None], float(K - means.shape[1])
    else:
        Z, freedom = segments.spectra, n - nu
    if freedom < 1:
        raise JaxbodyError(
            Problem(
                "TOO_SHORT",
                f"{where}.record",
                f"gives {n:.3g} independent averages of {nu} inputs",
                n,
                f"{nu + 1} or more",
                "Give a shorter segment=, or more records.",
            )
        )
    S_xx, S_yx = cross(Z[:nu], Z[:nu]) / K, cross(Z[nu:], Z[:nu]) / K
    S_yy = power(Z[nu:]) / K
    own = np.real(np.diagonal(S_xx, axis1=1, axis2=2))
    silent = (own <= SILENT * own.max(0)).any(1)[:, None, None]
    S_xx = np.where(silent, np.eye(nu), S_xx)
    _check_independent(S_xx[~silent[:, 0, 0]], inputs, where)
    inverse = np.linalg.inv(S_xx)
    H1 = S_yx @ inverse
    explained = np.real(np.sum(H1 * S_yx.conj(), 2))
    if method == "Hv":
        H = _total(S_xx, S_yx, S_yy)
    else:
        H = H1 if method == "H1" else S_yy[:, :, None] / S_yx.conj()
    H = np.where(silent, np.nan, H)
    of_one = power(residuals(segments, H)) / freedom if periodic else S_yy - explained
    of_one = np.maximum(of_one, ROUND_OFF**2 * S_yy)
    averages = Averages(S_xx * n, of_one if periodic else of_one * n / freedom, freedom)
    seen = np.abs(H1) ** 2 / np.real(np.diagonal(inverse, axis1=1, axis2=2))[:, None]
    with np.errstate(invalid="ignore", divide="ignore"):
        return ResponseEstimate(
            segments.frequencies,
            H,
            np.where(silent, np.nan, averages.spread),
            inputs,
            outputs,
            units[:nu],
            units[nu:],
            segments,
            averages,
            np.where(silent[..., 0], np.nan, explained / (explained + of_one)),
            np.where(silent, np.nan, seen / (seen + of_one[:, :, None])),
            _leaks(segments, H),
            method,
        )


def _leaks(segments: Transforms, H: np.ndarray) -> bool:
    """Return whether lines contain those beside them; warns LEAKAGE of segments without a window
    that are no periods."""
    if segments.periods or segments.decay is not None:
        return False
    if np.ptp(segments.window) > 0:
        return True
    leaked = leakage(residuals(segments, H))
    if leaked > SMOOTH:
        warn(
            "LEAKAGE",
            f"neighboring lines of the residuals are correlated ({leaked:.2f}), as the segments "
            'have no window and are not periods: give window="hann"',
        )
    return leaked > SMOOTH


def means_of_periods(segments: Transforms) -> np.ndarray:
    """Return the means of the transforms over the periods of each record (channels, records,
    nf)."""
    ends = np.cumsum(segments.periods)[:-1]
    return np.stack([part.mean(1) for part in np.split(segments.spectra, ends, 1)], 1)


def deviations(segments: Transforms) -> np.ndarray:
    """Return the transforms of periods less their mean over the record (channels, n, nf)."""
    return segments.spectra - np.repeat(means_of_periods(segments), segments.periods, 1)


def residuals(segments: Transforms, H: np.ndarray, kept: Any = slice(None)) -> np.ndarray:
    """Return y - H x of each segment (ny, n, nf) at the frequencies `kept`; of periods, less the
    mean of their record; at lines without H, y."""
    Z = deviations(segments) if segments.periods else segments.spectra
    Z, H = Z[:, :, kept], np.nan_to_num(H[kept])
    nu = H.shape[2]
    return Z[nu:] - sum(H[:, :, j].T[:, None] * Z[j] for j in range(nu))


def band_of(f: np.ndarray, band: tuple[float, float] | None, where: str) -> np.ndarray:
    """Return the indices of the frequencies in a band, without 0 Hz. Error: BAD_BAND."""
    low, high = (0.0, np.inf) if band is None else band
    kept = np.flatnonzero((f > 0) & (f >= low) & (f <= high))
    if len(kept) < 2:
        raise JaxbodyError(
            Problem(
                "BAD_BAND",
                f"{where}.band",
                f"is {low:g} to {high:g} Hz, with {len(kept)} lines in it",
                band,
                f"two lines or more of {f[1]:.6g} Hz, up to {f[-1]:.6g} Hz",
            )
        )
    return kept


def cross(Y: np.ndarray, X: np.ndarray) -> np.ndarray:
    """Return the sum over segments of y x^H (nf, ny, nx), for transforms (channels, n, nf)."""
    return np.stack([np.einsum("ikf,kf->fi", Y, x.conj()) for x in X], 2)


def power(Y: np.ndarray) -> np.ndarray:
    """Return the sum over segments of |y|^2 (nf, ny)."""
    re, im = np.real(Y), np.imag(Y)
    return np.einsum("ikf,ikf->fi", re, re) + np.einsum("ikf,ikf->fi", im, im)


def _total(S_xx: np.ndarray, S_yx: np.ndarray, S_yy: np.ndarray) -> np.ndarray:
    """Return total least squares for each output: (H, -1) is the eigenvector of the smallest
    eigenvalue of the spectra of the inputs and this output, each relative to its own size."""
    nu, rows = S_xx.shape[1], []
    for i in range(S_yy.shape[1]):
        one = S_yx[:, i : i + 1]
        S = np.block([[S_xx, one.conj().swapaxes(1, 2)], [one, S_yy[:, i, None, None]]])
        sizes = np.sqrt(np.real(np.diagonal(S, axis1=1, axis2=2)))
        least = np.linalg.eigh(S / sizes[:, :, None] / sizes[:, None])[1][:, :, 0]
        rows.append(-np.conj(least[:, :nu] / least[:, nu:]) * sizes[:, nu:] / sizes[:, :nu])
    return np.stack(rows, 1)


def _check_independent(S_xx: np.ndarray, inputs: tuple[str, ...], where: str) -> None:
    """Check that no input is a combination of the others. Error: DEPENDENT_INPUTS."""
    if len(inputs) == 1:
        return
    own = np.real(np.diagonal(S_xx, axis1=1, axis2=2))
    scale = np.sqrt(own[:, :, None] * own[:, None])
    # a ridge of round-off, as the spectra of equal inputs have no inverse
    relative = S_xx / scale + 1e-12 * np.eye(len(inputs))
    alone = 1 / np.real(np.diagonal(np.linalg.inv(relative), axis1=1, axis2=2))
    shared = 1 - np.median(alone, 0)
    worst = int(np.argmax(shared))
    if shared[worst] > SAME:
        others = " and ".join(f"'{name}'" for k, name in enumerate(inputs) if k != worst)
        raise JaxbodyError(
            Problem(
                "DEPENDENT_INPUTS",
                f"{where}.inputs",
                f"'{inputs[worst]}' has the coherence {shared[worst]:.6f} with {others}",
                shared.tolist(),
                f"below {SAME}",
                "Drive the inputs by independent signals, or leave one out; periodic inputs need "
                "as many records with different phases as there are inputs.",
            )
        )


def _warn_of_silence(estimate: ResponseEstimate) -> None:
    """Issue the warning LOW_COHERENCE for outputs that the inputs do not explain at many lines."""
    assert estimate.averages is not None and estimate.coherence is not None
    f, n = estimate.frequencies, max(estimate.averages.freedom, 1.0)
    chance = 1 - CHANCE ** (1 / n)  # of one input and freedom + 1 averages
    messages = []
    for name, g2 in zip(estimate.outputs, estimate.coherence.T, strict=True):
        low = np.flatnonzero(g2 < chance)
        if len(low) > FEW * len(f):
            runs = np.split(low, 1 + np.flatnonzero(np.diff(low) > 1))
            longest = sorted(sorted(runs, key=len)[-3:], key=lambda run: run[0])
            lines = ", ".join(f"{f[run[0]]:.4g} to {f[run[-1]]:.4g}" for run in longest)
            messages.append(f"'{name}' at {len(low)} of {len(f)} lines, such as {lines} Hz")
    if messages:
        warn(
            "LOW_COHERENCE",
            "the inputs explain nothing of " + "; ".join(messages) + ": give band= without them",
        )


def leakage(residual: np.ndarray) -> float:
    """Return the correlation of the residuals of neighboring lines, which is zero for noise in
    segments without a window; zero if it may be by chance."""
    size = np.sqrt(np.mean(np.abs(residual) ** 2, 1, keepdims=True))
    relative = residual / np.where(size > 0, size, 1.0)
    together = float(np.real(relative[..., 1:] * relative[..., :-1].conj()).mean())
    return together if together > 4 / np.sqrt(residual.size) else 0.0
