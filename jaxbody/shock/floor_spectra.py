"""Floor spectra: the response spectrum of an acceleration of a model, for equipment on it, from
records or directly from a spectrum.

From a record: the response spectrum of the exact history of the small motion. Directly from a
spectrum A: for mode j of the model and equipment of frequency w and damping ratio zeta,

    B_j = sqrt(((w/w_j)^2 A(f_j, zeta_j))^2 + A(f, zeta)^2)
          /sqrt((1 - (w/w_j)^2)^2 + 4 (zeta + zeta_j)^2 (w/w_j)^2)

times the reading of the output per unit of the mode, combined by squares over modes and
excitations. It is exact for soft and for rigid equipment, and an estimate near resonance. Source:
Y. Yasui et al., Proc. SMiRT-12 (1993), K13/1, as given by P. Vukobratovic, P. Fajfar, Bull.
Earthquake Eng. 14 (2016) 1683.
"""

from typing import Any

import jax.numpy as jnp
import numpy as np

from jaxbody.core.arrays import Array, Float, concrete, device_array
from jaxbody.core.compilation.compile_options import program
from jaxbody.core.errors import Problems, Status
from jaxbody.core.results import warn_if_failed
from jaxbody.numerics.eigenproblems import together
from jaxbody.numerics.elementary_functions import root
from jaxbody.records.sampling_checks import IRREGULAR
from jaxbody.shock.oscillators import history, interpolated, poles
from jaxbody.shock.response_spectra import ResponseSpectrum, check_dampings
from jaxbody.shock.shock_spectra import ShockSpectrum, check_record, spectrum_values
from jaxbody.shock.spectrum_responses import (
    ModalExcitation,
    check_covered,
    checked_excitation,
    covered,
    modal_excitation,
)
from jaxbody.vibration.frequency_responses import check_frequencies
from jaxbody.vibration.linearizations import Linearization, check_system

# steps in a period of the fastest mode and equipment; the history is linear within each step, an
# error below 1 %
FINE = 20


def floor_spectrum(
    lin: Linearization,
    frequencies: Any,
    spectra: dict[Any, dict[str, Any]],
    output: Any,
    *,
    damping: Any = 0.05,
    modal_damping: Any = None,
) -> ShockSpectrum:
    """Compute the response spectrum of absolute acceleration of light equipment on a model, at the
    point whose motion `output` reads.

    Records of several directions act together: their histories are added. Spectra of several
    directions are combined by their squares. Records and spectra cannot be mixed. Equipment is
    light: its reaction on the model is neglected.

    Args:
        lin: `linearize(model, equilibrium(model))`.
        frequencies: natural frequencies of the equipment [Hz], in one row.
        spectra: {support: {direction: record or ResponseSpectrum}}, as in `spectrum_response`.
        output: a sensor of one acceleration, such as Acceleration("cabinet", [0, 0, 1.8],
            axis="x").
        damping: damping ratio or ratios of the equipment.
        modal_damping: damping ratios of the model's modes, one for all or one for each; default:
            those of the model's dampers.

    Errors: those of `spectrum_response` and `shock_spectrum`, BAD_UNIT for an output that is not an
    acceleration, BAD_OPTION for records of different times, or records with spectra.

    >>> spring = jb.Spring(
    ...     ("floor", [0, 0, 0]), ("base", [1, 0, 0]), stiffness=800.0, free_length=1.0, damping=4.0
    ... )
    >>> model = jb.Model(
    ...     bodies={"floor": jb.Body(2.0, [1, 1, 1])},
    ...     supports={"base": jb.Support()},
    ...     elements={"s": spring},
    ...     joints={"floor": jb.Guide("world", axis="x")},
    ... )
    >>> level = jb.shock.Eurocode8(2.0)
    >>> floor = jb.shock.floor_spectrum(
    ...     jb.linearize(model, jb.equilibrium(model)),
    ...     [0.3, 1e3],
    ...     {"base": {"x": level}},
    ...     jb.Acceleration("floor", axis="x"),
    ... )
    >>> soft, rigid = floor.values[0].tolist()  # of the ground, and of the floor's peak
    >>> round(soft / float(level(0.3)), 2), round(rigid / float(level(3.1831)), 2)
    (1.02, 1.0)
    """
    check_system(lin, "floor_spectrum")
    where = "floor_spectrum.spectra"
    with Problems() as problems:
        bases, ports, given = checked_excitation(
            lin, spectra, {"output": output}, "floor_spectrum", problems
        )
        f = problems.gather(lambda: check_frequencies(frequencies, "floor_spectrum.frequencies"))
        zeta = check_dampings(damping, "floor_spectrum.damping", problems)
        ratios = (
            None
            if modal_damping is None
            else check_dampings(
                modal_damping, "floor_spectrum.modal_damping", problems, modes=lin.nv
            )
        )
        if ports.units and ports.units != ("m/s2",):
            problems.add(
                "BAD_UNIT",
                "floor_spectrum.output",
                f"is in {', '.join(ports.units)}",
                value=output,
                limit="one in m/s2",
                hint='Give jb.Acceleration("cabinet", [0, 0, 1.8], axis="x").',
            )
        records = [each for each in given if isinstance(each, tuple)]
        lengths, steps = {np.shape(a)[0] for a, _ in records}, [float(h) for _, h in records]
        if records and (
            len(records) < len(given)
            or len(lengths) > 1
            or np.ptp(steps) * max(lengths) > IRREGULAR * min(steps)
        ):
            problems.add(
                "BAD_OPTION",
                where,
                "mixes records with spectra, or records of different times",
                value=spectra,
                limit="records of the same times, or spectra",
                hint="Interpolate the records, or give spectra alone.",
            )
        if records and f is not None and not problems.collected:
            check_record(records[0], concrete(f), "continuous", where, problems)
    assert f is not None
    zeta = jnp.atleast_1d(device_array(zeta))
    modal = modal_excitation(lin, bases, ports.sensors, ratios)
    if records:
        floor = _history(modal, records, f)
        values = spectrum_values(floor, f, zeta, "absolute", "maximax", "continuous")
    else:
        check_covered(modal, jnp.ones(modal.frequency.shape, bool), bases, given, where)
        values = _direct(modal, given, f, zeta)
    status = jnp.where(
        (modal.status == Status.OK) & ~jnp.isfinite(values).all(),
        Status.NONFINITE.value,
        modal.status,
    )
    return warn_if_failed(
        ShockSpectrum(f, zeta, values, status, "absolute", "maximax", "continuous")
    )


def _history(modal: ModalExcitation, records: list[tuple[Any, Any]], f: Any) -> tuple[Array, Any]:
    """Return the acceleration of the floor [m/s2] under records, and the step [s] between its
    samples, which is small enough for the fastest mode and equipment. `f`: frequencies of the
    equipment [Hz]."""
    step, fastest = records[0][1], [concrete(x) for x in (f, modal.frequency)]
    top = max(
        [float(np.nanmax(x)) for x in fastest if x is not None and np.isfinite(x).any()],
        default=0.0,
    )
    parts = max(1, int(np.ceil(step * top * FINE)))
    floor = jnp.zeros(())
    s = poles(modal.frequency, modal.damping)
    for e, (a, _) in enumerate(records):
        a = interpolated(device_array(a), parts)
        c = modal.weights(e, s)
        floor = floor + history(a, step / parts, s, c)[:, 0] + modal.rest[0, e] * a
    return floor, step / parts


@program
def _direct(
    modal: ModalExcitation,
    given: tuple[ResponseSpectrum, ...],
    f: Float[Array, "nf"],
    zeta: Float[Array, "nz"],
):
    """Return the floor spectrum (nz, nf) from the spectra `given` of the excitations."""
    same = together(modal.cluster).astype(f.dtype)
    f_, z_ = f[None, :, None], zeta[:, None, None]
    ratio = f_ / modal.frequency[None, None]
    below = jnp.sqrt((1 - ratio**2) ** 2 + 4 * (z_ + modal.damping[None, None]) ** 2 * ratio**2)
    square = jnp.zeros(())
    for e, spectrum in enumerate(given):
        own = spectrum(modal.frequency, modal.damping)
        own = jnp.where(covered(spectrum, modal.frequency, modal.damping), own, jnp.nan)
        ground = spectrum(
            jnp.broadcast_to(f, (len(zeta), len(f))),
            jnp.broadcast_to(zeta[:, None], (len(zeta), len(f))),
        )
        reading = modal.readings[2, 0] * modal.participation[e]
        own = jnp.where(reading == 0, 0.0, own)
        each = (
            reading[None, None]
            * root((ratio**2 * own[None, None]) ** 2 + ground[..., None] ** 2)
            / below
        )
        square = square + jnp.sum(each * (each @ same), -1) + (modal.rest[0, e] * ground) ** 2
    return root(square)
