"""Maxima of outputs from response spectra: the peaks, under a base acceleration, of each mode and
of the part that the modes leave out, and their combination over modes and directions.

With Xi'' = e a(t), S = K^-1 K~ and y = Delta - S Xi, modes phi (phi' M phi = 1) and y = sum
phi_j q_j,

    q_j'' + 2 zeta_j w_j q_j' + w_j^2 q_j = -Gamma_j a,   Gamma_j = phi_j' (M S - M~) e,
    effective mass Gamma_j^2

    output = sum_j Gamma_j (Y0 phi_j x_j + Y1 phi_j x_j' + Y2 phi_j (x_j'' + a)) + g a

where x_j is the displacement of an oscillator of w_j and zeta_j on this base, and g the part of an
acceleration output that the modes leave out. The quasi-static motion S Xi, which strains nothing if
the supports move as one body, is not included. For outputs alpha x + beta x' + gamma (x'' + a) of a
mode the peak is

    of a spectrum A     |alpha - w^2 gamma + i w (beta - 2 zeta w gamma)| A(w, zeta)/w^2
    of a record         that of the exact history

and what modes above the highest frequency leave out (missing mass) follows the base acceleration as
a rigid body does. Peaks of modes, whose times are unknown, are combined by

    SRSS       R^2 = sum_j R_j^2,   coinciding modes count as one, with R_j their sum
    CQC        R^2 = sum_ij rho_ij R_i R_j,   r = w_i/w_j,
               rho_ij = 8 sqrt(z_i z_j) (r z_i + z_j) r^1.5
                        /((1 - r^2)^2 + 4 z_i z_j r (1 + r^2) + 4 (z_i^2 + z_j^2) r^2)
    absolute   R = sum_j |R_j|, an upper bound

rho_ij is the correlation of the displacements of two oscillators under one white noise. Source:
A. K. Chopra, Dynamics of Structures (2012), 13.1 and 13.2, where (M S - M~) e is called the mass
matrix times the influence vector; A. Der Kiureghian, Earthquake Eng. Struct. Dyn. 9 (1981) 419;
E. L. Wilson, A. Der Kiureghian, E. P. Bayo, same volume, 187.
"""

import dataclasses
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from equinox import Module, field

from jaxbody.core import tables
from jaxbody.core.arguments import check_one_of, checked_dict, positive_number
from jaxbody.core.arrays import (
    Array,
    Complex,
    Float,
    Int,
    device_array,
    is_concrete,
)
from jaxbody.core.compilation.compile_options import program
from jaxbody.core.errors import Problems, Status, unknown
from jaxbody.core.results import OfOutputs, warn_if_failed
from jaxbody.geometry.points_and_orientations import DIRECTIONS
from jaxbody.model.inputs.port_inputs import BaseMotion
from jaxbody.numerics.eigenproblems import together
from jaxbody.numerics.elementary_functions import root
from jaxbody.records.records import Record
from jaxbody.shock.oscillators import checked_samples, poles
from jaxbody.shock.response_spectra import ROUNDING, ResponseSpectrum, check_dampings
from jaxbody.shock.shock_spectra import peaks_of
from jaxbody.vibration.linearizations import Linearization, check_system
from jaxbody.vibration.natural_modes import NO_MODES, modes_of
from jaxbody.vibration.ports import Outputs, Ports, outputs_of, port_matrices


class Excitation(NamedTuple):
    """The motion of supports that move together in one direction, by a spectrum or a record."""

    supports: tuple[str, ...]
    direction: str
    spectrum: Any

    @property
    def name(self) -> str:
        """The name in results, such as "base x" or "front and rear x"."""
        return f"{' and '.join(map(str, self.supports))} {self.direction}"


class ModalExcitation(Module):
    """Modes with their `participation` (excitations, modes) and effective `mass` [kg; kg m2 about
    an axis]; `readings` (3, outputs, modes) of outputs per unit of each mode's x, x' and x'' + a;
    `rest` (outputs, excitations) per unit of the base acceleration."""

    frequency: Float[Array, "n"]
    damping: Float[Array, "n"]
    cluster: Int[Array, "n"]
    participation: Float[Array, "ne n"]
    readings: Float[Array, "3 ny n"]
    rest: Float[Array, "ny ne"]
    status: Int[Array, ""]

    @property
    def mass(self) -> Float[Array, "ne n"]:
        return self.participation**2

    def weights(self, e: int, s: Complex[jax.Array, "n"]) -> Complex[jax.Array, "ny n"]:
        """Return the weights c of oscillators with the poles `s`, so that an output is the sum over
        the modes of Im(c r) under the excitation of index `e`, without what the modes leave out."""
        alpha, beta, gamma = (self.readings * self.participation[e][None, None]).astype(s.dtype)
        return (alpha + beta * s[None] + gamma * s[None] ** 2) / s.imag.astype(s.dtype)[None]


def excited(lin: Linearization, given: Any, where: str, problems: Problems) -> list[Excitation]:
    """Return the excitations in {support, or several that move together: {direction: spectrum or
    record}}. Errors: WRONG_KIND, UNKNOWN_NAME, BAD_DIRECTION."""
    bases = []
    known = lin.model.layout.supports
    for moved, each in checked_dict(
        given, where, "support: {direction: spectrum}", problems
    ).items():
        together = moved if isinstance(moved, tuple) else (moved,)
        problems.collected += [
            unknown(name, where, known) for name in together if name not in known
        ]
        if not isinstance(each, dict) or not each:
            problems.add(
                "WRONG_KIND",
                f"{where}[{moved!r}]",
                f"is a {type(each).__name__}",
                value=each,
                limit="{direction: spectrum}",
                hint=f'Write {{{moved!r}: {{"x": ...}}}}.',
            )
            continue
        for direction, spectrum in each.items():
            if direction not in DIRECTIONS:
                problems.add(
                    "BAD_DIRECTION",
                    f"{where}[{moved!r}]",
                    f"has {direction!r}",
                    value=direction,
                    limit=" ".join(DIRECTIONS),
                )
            bases.append(Excitation(together, direction, spectrum))
    if not bases and not problems.collected:
        problems.add(
            "WRONG_KIND",
            where,
            "has no excitation",
            value=given,
            limit="at least one",
            hint='Write {"base": {"x": spectrum}}.',
        )
    return bases


def modal_excitation(
    lin: Linearization, bases: list[Excitation], sensors: tuple[Any, ...], ratios: Any
) -> ModalExcitation:
    """Return modes, participations and readings of outputs; massless coordinates of elements follow
    statically, as in `modes`. `ratios`: damping ratios of the modes; None: those of the dampers."""
    lin = lin.condensed
    inputs = tuple(
        BaseMotion(name, base.direction, kind="acceleration")
        for base in bases
        for name in base.supports
    )
    together = np.repeat(np.eye(len(bases)), [len(base.supports) for base in bases], axis=0)
    modal = _modal_excitation(lin, port_matrices(lin, inputs, sensors), together)
    if ratios is not None:
        damping = jnp.broadcast_to(device_array(ratios), modal.damping.shape)
        modal = dataclasses.replace(modal, damping=damping)
    return modal


@program
def _modal_excitation(
    lin: Linearization, ports: Ports, together: Float[Array, "nu ne"]
) -> ModalExcitation:
    frequency, shapes, damping, _, cluster, status = modes_of(lin)
    nv = lin.M.shape[-1]
    e = ports.X @ together.astype(lin.M.dtype)
    slow = jnp.linalg.solve(lin.K, lin.K_tilde @ e)
    participation = (shapes.T @ (lin.M @ slow - lin.M_tilde @ e)).T
    readings = ports.Y[:, :, :nv] @ shapes
    ground = ports.Y[2, :, :nv] @ slow + ports.Y[2, :, nv:] @ e
    rest = ground - readings[2] @ participation.T
    if ports.chains is not None:
        gain = ports.chains.gain[:, None]
        readings, rest = readings * gain[None], rest * gain
    nan = jnp.where(jnp.isin(status, jnp.array((*NO_MODES, Status.SINGULAR_K))), jnp.nan, 1.0)
    return ModalExcitation(
        frequency, damping, cluster, participation * nan, readings * nan, rest * nan, status
    )


COMBINATIONS = ("SRSS", "CQC", "absolute")


def correlations(
    frequency: Float[Array, "n"], damping: Float[Array, "n"], cluster: Int[Array, "n"]
) -> Float[Array, "n n"]:
    """Return rho_ij: 1 within a cluster of coinciding frequencies, 0 between modes without
    damping."""
    same = together(cluster)
    zi, zj, r = damping[:, None], damping[None], frequency[:, None] / frequency[None]
    product = zi * zj
    below = (1 - r**2) ** 2 + 4 * product * r * (1 + r**2) + 4 * (zi**2 + zj**2) * r**2
    return jnp.where(
        same, 1.0, 8 * root(product) * (r * zi + zj) * r**1.5 / jnp.where(same, 1.0, below)
    )


def combined(
    modal: Float[Array, "*b n"], rest: Float[Array, "*b"], rho: Float[Array, "n n"], combine: str
):
    """Combine signed peaks of modes, and the peak of the rest, which is not correlated with them.
    Return the combined peak and the contributions of all modes and of the rest (..., n + 1).

    `rho`: correlations; for SRSS those within clusters only."""
    if combine == "absolute":
        same = (rho == 1).astype(modal.dtype)
        each = jnp.abs(modal @ (same / jnp.sum(same, 0)[None]))
        parts = jnp.concatenate([each, jnp.abs(rest)[..., None]], -1)
        total = jnp.sum(parts, -1)
    else:
        parts = jnp.concatenate([modal * (modal @ rho), rest[..., None] ** 2], -1)
        total = root(jnp.sum(parts, -1))
    return total, parts


MOST_SHOWN = 6  # modes in the table


class SpectrumResponse(OfOutputs):
    """Peaks `values` of outputs in their `units`; `response["anchor"]` is the peak of one output.
    `shares` (outputs, modes and the rest): the share of each mode in the square of a peak, for
    combine="absolute" in the peak; with CQC a share can be negative.

    For each excitation, such as "base x": `by_excitation` (excitations, outputs), the peaks;
    `modal` (excitations, outputs, modes), signed peaks of modes; `rest` (excitations, outputs), the
    peak of the missing mass; `participation` and effective `mass` [kg] (excitations, modes), and
    `total_mass` of all modes. `frequency` [Hz] and `damping_ratio` of the modes; `taken`: the modes
    that do not move as rigid bodies. All are NaN if the modes failed, or if a spectrum does not
    cover a mode."""

    index, main = "output", "values"
    values: Float[Array, "ny"]
    shares: Float[Array, "ny n1"]
    by_excitation: Float[Array, "ne ny"]
    modal: Float[Array, "ne ny n"]
    rest: Float[Array, "ne ny"]
    participation: Float[Array, "ne n"]
    mass: Float[Array, "ne n"]
    frequency: Float[Array, "n"]
    damping_ratio: Float[Array, "n"]
    taken: Array
    status: Int[Array, ""]
    excitations: tuple[str, ...] = field(static=True)
    combine: str = field(static=True)

    @property
    def total_mass(self) -> Float[Array, "ne"]:
        """The sum of the effective masses: the mass that moves in each direction [kg], or the
        inertia about an axis [kg m2]."""
        return self.mass.sum(-1)

    def to_xarray(self) -> Any:
        """Return an xarray.Dataset: peaks and shares by output, excitation and mode."""
        n = np.shape(self.frequency)[-1]
        return self.labeled(
            "spectrum response",
            {
                "peak": (("output",), self.values, "unit"),
                "share": (("output", "part"), self.shares, ""),
                "peak_by_excitation": (("excitation", "output"), self.by_excitation, "unit"),
                "modal_peak": (("excitation", "output", "mode"), self.modal, "unit"),
                "participation": (("excitation", "mode"), self.participation, ""),
                "effective_mass": (("excitation", "mode"), self.mass, "kg, kg m2"),
                "frequency": (("mode",), self.frequency, "Hz"),
                "damping_ratio": (("mode",), self.damping_ratio, ""),
            },
            {
                "excitation": list(self.excitations),
                "mode": list(range(1, 1 + n)),
                "part": [*map(str, range(1, 1 + n)), "rest"],
            },
        )

    @tables.summarized("Spectrum response", 1, values="values")
    def _tables(self) -> list[tables.PrintedTable]:
        shares = np.asarray(self.shares)
        shown = np.sort(np.argsort(-np.nan_to_num(np.abs(shares).max(0)))[:MOST_SHOWN])
        heads = [f"mode {j + 1}" if j + 1 < shares.shape[1] else "rest" for j in shown]
        rows = [
            (name, value, unit, *(tables.percent(row[j]) or "0 %" for j in shown))
            for name, value, unit, row in zip(
                self.outputs, self.values, self.units, shares, strict=True
            )
        ]
        peaks = tables.PrintedTable(
            f"Peaks by {self.combine}, shares of modes", ("output", "peak", "unit", *heads), rows
        )
        total = np.asarray(self.mass).sum(-1, keepdims=True)
        masses = np.asarray(self.mass) / np.where(total > 0, total, 1.0)
        rows = [
            (j + 1, f, zeta, *(tables.percent(share) or "0 %" for share in masses[:, j]))
            for j, (f, zeta) in enumerate(zip(self.frequency, self.damping_ratio, strict=True))
        ]
        heads = (
            "mode",
            "frequency [Hz]",
            "damping ratio",
            *(f"mass, {name}" for name in self.excitations),
        )
        return [peaks, tables.PrintedTable("Modes and effective masses", heads, rows, self.failure)]


def spectrum_response(
    lin: Linearization,
    spectra: dict[Any, dict[str, Any]],
    outputs: dict[str, Any],
    *,
    combine: str = "CQC",
    modal_damping: Any = None,
    highest: float | None = None,
) -> SpectrumResponse:
    """Compute peaks of outputs in an earthquake or shock of supports, from response spectra or
    records, mode by mode.

        peak of mode j = |Gamma_j (Y0 + i w_j Y1 - (w_j^2 + 2 i zeta_j w_j^2) Y2) phi_j|
                         A(f_j, zeta_j)/w_j^2

    Gamma_j = phi_j' (M S - M~) e is the participation; Y0, Y1 and Y2 are the readings of an output
    per displacement, velocity and acceleration, so that a force is mass times acceleration with
    damping too. For a record the peak of a mode is that of its history, also between samples. Peaks
    at samples are lower, by some percent where a period has few samples: to use them, give the
    `shock_spectrum` of the record with peaks="samples".
    Forces, strokes, absolute accelerations and reactions are those of the whole motion;
    displacements and velocities are relative to the quasi-static motion S Xi of the supports. Where
    supports move relative to each other, add the static forces of their displacements. Peaks of
    different excitations are combined by their squares, with combine="absolute" by their sum. The
    result is differentiable with respect to the model and the spectra.

    Args:
        lin: `linearize(model, equilibrium(model))`.
        spectra: {support: {direction: spectrum}}, or {(support, support): ...} of supports that
            move together; directions x, y, z, rx, ry or rz; a ResponseSpectrum, such as a result of
            `shock_spectrum`, Eurocode8 or ASCE7, or a record as for `shock_spectrum`. Different
            excitations are taken as independent.
        outputs: {name: sensor}, such as LoadCell, Elongation, Acceleration or Reaction.
        combine: rule by which modes are combined, "CQC" (default), "SRSS" or "absolute".
        modal_damping: damping ratios of the modes, one for all or one for each; default: those of
            the model's dampers.
        highest: frequency [Hz] above which modes move as rigid bodies; default: none.

    Errors, all at once: NOT_COVERED for modes or dampings outside a spectrum, UNKNOWN_NAME,
    BAD_DIRECTION, WRONG_KIND, BAD_OPTION, BAD_CHAIN for a lag, NOT_A_FRACTION, and those of
    records; warns SINGULAR_K, UNSTABLE, NOT_SYMMETRIC, SINGULAR_M. Source: A. K. Chopra, Dynamics
    of Structures (2012), ch. 13; for the missing mass, U.S. NRC Regulatory Guide 1.92 (2006).

    >>> spring = jb.Spring(
    ...     ("mass", [0, 0, 0]), ("base", [1, 0, 0]), stiffness=800.0, free_length=1.0, damping=4.0
    ... )
    >>> model = jb.Model(
    ...     bodies={"mass": jb.Body(2.0, [1, 1, 1])},
    ...     supports={"base": jb.Support()},
    ...     elements={"s": spring},
    ...     joints={"mass": jb.Guide("world", axis="x")},
    ... )
    >>> level = jb.shock.DesignSpectrum([0.1, 100.0], [3.0, 3.0], damping=0.05)
    >>> peaks = jb.shock.spectrum_response(
    ...     jb.linearize(model, jb.equilibrium(model)),
    ...     {"base": {"x": level}},
    ...     {"force": jb.Elongation("s", gain=800.0)},
    ... )
    >>> (
    ...     round(float(peaks["force"]), 9),
    ...     round(float(peaks.total_mass[0]), 9),
    ... )  # mass times pseudo-acceleration
    (6.0, 2.0)
    """
    check_system(lin, "spectrum_response")
    with Problems() as problems:
        bases, ports, given = checked_excitation(
            lin, spectra, outputs, "spectrum_response", problems
        )
        check_one_of(combine, COMBINATIONS, "BAD_OPTION", "spectrum_response.combine", problems)
        ratios = (
            None
            if modal_damping is None
            else check_dampings(
                modal_damping, "spectrum_response.modal_damping", problems, modes=lin.nv
            )
        )
        top = (
            None
            if highest is None
            else positive_number(highest, "spectrum_response.highest", problems, "BAD_FREQUENCY")
        )
    modal = modal_excitation(lin, bases, ports.sensors, ratios)
    taken = modal.frequency <= (jnp.inf if top is None else top)
    check_covered(modal, taken, bases, given, "spectrum_response.spectra")
    peaks, rigid = zip(
        *(modal_peaks(modal, each, e, taken) for e, each in enumerate(given)), strict=True
    )
    return warn_if_failed(
        SpectrumResponse(
            *_combined(modal, taken, jnp.stack(peaks), jnp.stack(rigid), combine),
            tuple(base.name for base in bases),
            combine,
            outputs=ports.names,
            units=ports.units,
        )
    )


def checked_excitation(
    lin: Linearization, spectra: Any, outputs: Any, where: str, problems: Problems
) -> tuple[list[Excitation], Outputs, tuple[Any, ...]]:
    """Check the excitations and outputs of a model. Return the excitations, the outputs, and for
    each excitation its spectrum or the samples of its record. Sensors with a lag are refused, as
    their peaks are not those of the modes. Errors: those of `excited`, `outputs_of` and
    `checked_spectra`, BAD_CHAIN."""
    bases = excited(lin, spectra, f"{where}.spectra", problems)
    ports = outputs_of(lin.model, outputs, where, problems)
    if any(sensor.lag is not None for sensor in ports.sensors):
        problems.add(
            "BAD_CHAIN",
            f"{where}.outputs",
            "has a sensor with a lag",
            limit="no lag",
            hint="Leave it out, or simulate the motion.",
        )
    return bases, ports, checked_spectra(bases, f"{where}.spectra", problems)


def checked_spectra(bases: list[Excitation], where: str, problems: Problems) -> tuple[Any, ...]:
    """Check the excitation of each base and return its spectrum or the samples of its record.
    Errors: WRONG_KIND and those of records."""
    spectra = []
    for base in bases:
        given, place = base.spectrum, f"{where} '{base.name}'"
        if isinstance(given, ResponseSpectrum):
            if (
                getattr(given, "kind", "pseudo") == "absolute"
                or getattr(given, "side", "maximax") != "maximax"
            ):
                problems.add(
                    "BAD_KIND",
                    place,
                    "is not of pseudo-accelerations",
                    value=given,
                    limit="pseudo or relative",
                    hint='Compute it with kind="pseudo" and side="maximax".',
                )
            spectra.append(given)
        elif isinstance(given, tuple | Record):
            unit = "m/s2" if len(base.direction) == 1 else "rad/s2"
            spectra.append(checked_samples(given, unit, place, problems))
        else:
            problems.add(
                "WRONG_KIND",
                place,
                f"is a {type(given).__name__}",
                value=given,
                limit="a ResponseSpectrum or a record",
            )
    return tuple(spectra)


def check_covered(
    modal: ModalExcitation,
    taken: Array,
    bases: list[Excitation],
    given: tuple[Any, ...],
    where: str,
) -> None:
    """Check that each spectrum is known at the frequencies and damping ratios of the modes that it
    excites. `taken`: the modes to check. Error: NOT_COVERED."""
    spectra = [each for each in given if isinstance(each, ResponseSpectrum)]
    if not is_concrete(modal, spectra) or np.asarray(modal.status).any() or np.ndim(modal.status):
        return
    with Problems() as problems:
        for e, (base, each) in enumerate(zip(bases, given, strict=True)):
            if not isinstance(each, ResponseSpectrum):
                continue
            wrong = np.flatnonzero(
                np.asarray(
                    taken & _is_excited(modal, e) & ~covered(each, modal.frequency, modal.damping)
                )
            )
            if wrong.size:
                (low, high), (least, most) = (
                    tuple(map(float, ends)) for ends in (each.covers(), each.dampings())
                )
                listed = [
                    (
                        f"{j + 1} ({float(modal.frequency[j]):.6g} Hz, damping ratio "
                        f"{float(modal.damping[j]):.4g})"
                    )
                    for j in wrong[:6]
                ]
                problems.add(
                    "NOT_COVERED",
                    f"{where} '{base.name}'",
                    f"does not cover mode{'s' * (wrong.size > 1)} "
                    f"{', '.join(listed)}{', ...' * (wrong.size > 6)}",
                    value=wrong,
                    limit=f"{low:.6g} to {high:.6g} Hz, damping ratios {least:.4g} to {most:.4g}",
                    hint="Compute it there, give the record itself, state modal_damping=, or "
                    "highest= for rigid modes.",
                )


def _is_excited(modal: ModalExcitation, e: int) -> Array:
    """Return which modes have more than rounding of the mass that excitation e moves."""
    mass = modal.mass[e]
    return mass > 1e-12 * jnp.sum(mass)


def covered(spectrum: ResponseSpectrum, f: Float[Array, "n"], zeta: Float[Array, "n"]) -> Array:
    """Return whether a spectrum is known at frequencies f [Hz] and damping ratios zeta."""
    (low, high), (least, most) = spectrum.covers(), spectrum.dampings()
    return (
        (f >= low * (1 - ROUNDING))
        & (f <= high * (1 + ROUNDING))
        & (zeta >= least * (1 - ROUNDING))
        & (zeta <= most * (1 + ROUNDING))
    )


def modal_peaks(
    modal: ModalExcitation, given: Any, e: int, taken: Array
) -> tuple[Float[Array, "ny n"], Float[Array, ""]]:
    """Return signed peaks of all modes under excitation e, and the peak of the base acceleration
    [m/s2]. `given`: the spectrum, or the samples of the record and their step [s]."""
    w = 2 * jnp.pi * modal.frequency
    alpha, beta, gamma = modal.readings * modal.participation[e][None, None]
    direct, quadrature = (
        alpha - w[None] ** 2 * gamma,
        w[None] * (beta - 2 * (modal.damping * w)[None] * gamma),
    )  # as x'' + a = -2 zeta w x' - w^2 x
    sign = jnp.where(
        jnp.where(jnp.abs(direct) >= jnp.abs(quadrature), direct, quadrature) < 0, -1.0, 1.0
    )
    if isinstance(given, ResponseSpectrum):
        here = covered(given, modal.frequency, modal.damping) | ~taken | ~_is_excited(modal, e)
        level = jnp.where(here, given(modal.frequency, modal.damping), jnp.nan) / w**2
        return sign * root(direct**2 + quadrature**2) * level[None], given.rigid()
    s = poles(modal.frequency, modal.damping)
    c = modal.weights(e, s)
    peaks = peaks_of(
        given, jnp.broadcast_to(s[None], c.shape).ravel(), c.ravel(), "maximax", "continuous"
    )
    return sign * peaks.reshape(c.shape), jnp.max(jnp.abs(device_array(given[0])))


@program
def _combined(
    modal: ModalExcitation,
    taken: Array,
    peaks: Float[Array, "ne ny n"],
    rigid: Float[Array, "ne"],
    combine: str,
):
    """Return the fields of a SpectrumResponse, up to its status."""
    w2 = (2 * jnp.pi * modal.frequency) ** 2
    follows = (
        modal.participation[:, None] * (modal.readings[2] - modal.readings[0] / w2[None])[None]
    )  # of modes that move with the base
    rest = (modal.rest.T + jnp.sum(jnp.where(taken[None, None], 0.0, follows), -1)) * rigid[:, None]
    peaks = jnp.where(taken[None, None], peaks, 0.0)
    rho = (
        correlations(modal.frequency, modal.damping, modal.cluster)
        if combine == "CQC"
        else together(modal.cluster).astype(w2.dtype)
    )
    each, parts = combined(peaks, rest, rho, combine)
    parts = jnp.sum(parts, 0)
    whole = jnp.sum(parts, -1)
    values = whole if combine == "absolute" else root(whole)
    shares = parts / jnp.where(whole == 0, 1.0, whole)[:, None]
    status = jnp.where(
        (modal.status == Status.OK) & ~jnp.isfinite(values).all(),
        Status.NONFINITE.value,
        modal.status,
    )
    of_modes = (modal.participation, modal.mass, modal.frequency, modal.damping)
    return values, shares, each, peaks, rest, *of_modes, taken, status
