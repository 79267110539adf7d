"""Random response: from power spectral densities of inputs to those of outputs, and their root mean
squares over a band.

S_y(f) = sum_ij H_i S_ij conj(H_j),   rms^2 = int S_y df,   H the frequency response from each input
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxbody.core import tables
from jaxbody.core.arrays import Array, Float, Int, is_concrete
from jaxbody.core.compilation.compile_options import program_with
from jaxbody.core.errors import JaxbodyError, Problem, Problems, Status, unknown
from jaxbody.core.results import OfOutputs, warn_if_failed
from jaxbody.model.inputs.port_inputs import KINDS, UNITS
from jaxbody.model.preconditions import check_memory
from jaxbody.numerics.elementary_functions import root
from jaxbody.numerics.precisions import reachable
from jaxbody.vibration.dynamic_matrices import DynamicMatrices, free_motions, options_by_size
from jaxbody.vibration.frequency_responses import (
    check_frequencies,
    damped,
    response_values,
)
from jaxbody.vibration.linearizations import Linearization, check_system
from jaxbody.vibration.ports import Ports, check_ports, port_matrices
from jaxbody.vibration.spectra import Band, CrossPSD, Spectrum, check_spectra, trapezoids

# relative change of an rms when every other frequency is left out: nearly four times the error
COARSE = 0.03
NEAR = 1e-6  # relative distance from a resonance; at twice it an undamped peak is a quarter


class RandomResponse(OfOutputs):
    """One-sided power spectral densities `psd` (outputs, frequencies), per hertz, of outputs in
    their `units`, over `frequencies` [Hz], and the `rms` of each output over these.
    `response["seat"]` is the rms of one. `status` COARSE if an rms changes by more than 3 % when
    every other frequency is left out, UNDAMPED if the inputs excite a resonance without damping in
    the band (the rms of outputs that contain it is infinite), NOT_POSITIVE if the coherences are
    contradictory, or that of the frequency response."""

    index, main = "frequency", "rms"
    frequencies: Float[Array, "nf"]
    psd: Float[Array, "ny nf"]
    rms: Float[Array, "ny"]
    weights: Float[Array, "nf"]
    coarse: Float[Array, "nf"]
    status: Int[Array, ""]

    def to_xarray(self) -> Any:
        """Return an xarray.Dataset: psd by `output` and `frequency`, rms by `output`."""
        f = np.asarray(self.frequencies)
        return self.labeled(
            "random response",
            {
                "psd": (("output", "frequency"), self.psd, "unit^2/Hz"),
                "rms": (("output",), self.rms, "unit"),
            },
            {"frequency": ("frequency", f.reshape(-1, f.shape[-1])[0], {"units": "Hz"})},
        )

    def explain(self) -> str:
        infinite = np.flatnonzero(np.isinf(self.rms))
        if not len(infinite):
            return ""
        names = ", ".join(self.outputs[i] for i in infinite)
        peak = np.argmax(np.nan_to_num(self.psd[infinite[0]], nan=np.inf))
        return (
            f"{names} near {self.frequencies[peak]:.4g} Hz; give dampers, "
            "modal_damping= or loss_factor="
        )

    @tables.summarized("Random response", 1, rms="rms")
    def _tables(self) -> list[tables.PrintedTable]:
        f = np.asarray(self.frequencies)
        return [
            tables.PrintedTable(
                f"Random response, {f[0]:.6g} to {f[-1]:.6g} Hz",
                ("output", "rms", "unit"),
                [*zip(self.outputs, self.rms, self.units, strict=True)],
                self.failure,
            )
        ]


def random_response(
    lin: Linearization,
    frequencies: Any,
    inputs: dict[str, Any],
    outputs: dict[str, Any],
    spectra: dict[str, Spectrum] | CrossPSD,
    *,
    loss_factor: Any = None,
    modal_damping: Any = None,
) -> RandomResponse:
    """Compute power spectral densities and rms of outputs under stationary random inputs, of small
    motions about an equilibrium.

        S_y(f) = sum_ij H_i S_ij conj(H_j),   rms^2 = int S_y df

    Args:
        lin: `linearize(model, equilibrium(model))`.
        frequencies: a Band, or frequencies [Hz] for the trapezoidal rule, close enough to resolve
            each resonance.
        inputs: as in `frequency_response`.
        outputs: as in `frequency_response`.
        spectra: {input: PSD or PowerLaw}, uncorrelated, or a CrossPSD. The spectrum of a motion may
            be that of its displacement, velocity or acceleration, whatever the kind of the port: it
            is converted by powers of 2 pi f.
        loss_factor: as in `frequency_response`; by default none.
        modal_damping: as in `frequency_response`; by default none.

    Errors: those of `frequency_response`, UNKNOWN_NAME or NO_SPECTRUM (missing), BAD_UNIT for a
    spectrum that does not fit its input; warns COARSE, NOT_POSITIVE, UNDAMPED, UNSTABLE.

    >>> spring = jb.Spring(
    ...     ("mass", [0, 0, 0]), ("base", [0, 1, 0]), stiffness=50.0, free_length=1.0, damping=2.0
    ... )
    >>> model = jb.Model(
    ...     bodies={"mass": jb.Body(mass=2.0, inertia=[1, 1, 1])},
    ...     joints={"mass": jb.Guide("world", axis=[0, 1, 0])},
    ...     supports={"base": jb.Support()},
    ...     elements={"s": spring},
    ... )
    >>> response = jb.random_response(
    ...     jb.linearize(model, jb.equilibrium(model)),
    ...     jb.vibration.Band(1e-7, 1e3),
    ...     {"pull": jb.PointForce("mass", direction="y")},
    ...     {"stroke": jb.Elongation("s")},
    ...     {"pull": jb.vibration.PowerLaw(3.0, unit="N2/Hz")},
    ... )
    >>> round(float(response["stroke"] ** 2 / (3.0 / (4 * 2.0 * 50.0))), 6)
    1.0
    """
    check_system(lin, "random_response")
    (names, ins, _), (y, sensors, y_units) = check_ports(lin, inputs, outputs, "random_response")
    _check_match(inputs, spectra)
    if isinstance(frequencies, Band):
        f, weights, coarse = frequencies.frequencies, frequencies.weights, frequencies.coarse
    else:
        f = check_frequencies(frequencies, "random_response.frequencies")
        with Problems() as problems:
            if len(f) < 2:
                problems.add(
                    "EMPTY_BAND",
                    "random_response.frequencies",
                    f"has {len(f)} frequency",
                    value=len(f),
                    limit=">= 2",
                    hint="Give a Band.",
                )
            elif is_concrete(f) and (np.diff(np.asarray(f)) <= 0).any():
                problems.add(
                    "EMPTY_BAND",
                    "random_response.frequencies",
                    "do not increase",
                    limit="increasing",
                    hint="Sort them.",
                )
        weights, coarse = trapezoids(f)
    check_memory("random_response", lin.model, f.size)
    lin, eta = damped(lin, sensors, loss_factor, modal_damping, "random_response")
    psd, rms, status = _random_response(
        lin, f, weights, coarse, port_matrices(lin, ins, sensors), ins, names, spectra, eta
    )
    return warn_if_failed(
        RandomResponse(f, psd, rms, weights, coarse, status, outputs=y, units=y_units)
    )


def root_mean_square(
    psd: Float[Array, "ny nf"], weights: Float[Array, "*w nf"]
) -> Float[Array, "ny"]:
    """Return the root of the integral of a density with these weights; its derivative at zero is
    zero."""
    return root(jnp.sum(psd * jnp.atleast_2d(weights), -1))


@program_with(options_by_size)
def _random_response(
    lin: Linearization, f, weights, coarse, ports: Ports, inputs: tuple, names, spectra, eta
):
    near = _beside_resonances(lin, f)
    f = jnp.concatenate([f, near])
    H, status = response_values(lin, f, ports, eta)
    each = spectra.spectra if isinstance(spectra, CrossPSD) else spectra
    S = jnp.stack(
        [
            each[name](f) * (2 * jnp.pi * f) ** _order(each[name], port)
            for name, port in zip(names, inputs, strict=True)
        ]
    )
    if isinstance(spectra, CrossPSD):
        order = np.array([spectra.names.index(name) for name in names])
        R = spectra.correlation(f)[order][:, order]
        H = H * jnp.sqrt(S)[None].astype(H.dtype)
        psd = jnp.sum(H[:, :, None] * R[None] * H.conj()[:, None], (1, 2)).real
        positive = spectra.positive(f)
    else:
        psd = jnp.sum((H.real**2 + H.imag**2) * S[None], 1)
        positive = jnp.array(True)
    psd = psd * jnp.where(positive, 1.0, jnp.nan)
    psd, at, beyond = jnp.split(psd, [len(f) - len(near), len(f) - len(near) // 2], 1)
    infinite = jnp.any(at > 3 * beyond, 1)
    rms, rough = root_mean_square(psd, weights), root_mean_square(psd, coarse)
    good = jnp.select(
        [jnp.any(infinite), ~positive, jnp.any(jnp.abs(rms - rough) > COARSE * rms)],
        [Status.UNDAMPED.value, Status.NOT_POSITIVE.value, Status.COARSE.value],
        Status.OK.value,
    )
    own = (status == Status.OK) | jnp.any(infinite) & (status == Status.NONFINITE)
    return psd, jnp.where(infinite, jnp.inf, rms), jnp.where(own, good, status)


def _beside_resonances(lin: Linearization, f: Float[Array, "nf"]) -> Float[Array, "_"]:
    """Return frequencies [Hz] slightly above each resonance in the band: first all those above it
    by the fraction NEAR, then all those by 2 NEAR. A resonance outside the band gives the nearer
    limit of the band, twice."""
    nv = lin.M.shape[-1]
    own = jax.tree.map(lambda A: A[:nv, :nv], DynamicMatrices(*lin.whole, None, lin.massless))
    # without the conjugates
    values = free_motions(own)
    count = len(values) // 2 if lin.model.forces else nv - lin.massless
    resonances = jnp.sort(jnp.imag(values))[-count:] / (2 * jnp.pi)
    within = jnp.clip(resonances, f[0], f[-1])
    near = reachable(NEAR, f.dtype, 256) * jnp.outer(
        jnp.arange(1, 3, dtype=f.dtype), (within == resonances).astype(f.dtype)
    )
    return jax.lax.stop_gradient((within[None] * (1 + near)).ravel())


def _order(spectrum: Spectrum, port: Any) -> int:
    """Return the power of 2 pi f that converts the spectrum of a motion to that of the port: 2 for
    each derivative."""
    if spectrum.quantity == port.unit:
        return 0
    return 2 * (KINDS.index(port.kind) - UNITS[len(port.direction) - 1].index(spectrum.quantity))


def _check_match(inputs: dict[str, Any], spectra: Any) -> None:
    """Check that each input has a spectrum that fits it, and that there are no other spectra."""
    with Problems() as problems:
        each = spectra.spectra if isinstance(spectra, CrossPSD) else spectra
        if not isinstance(each, dict):
            raise JaxbodyError(
                Problem(
                    "WRONG_KIND",
                    "spectra",
                    f"is a {type(each).__name__}",
                    each,
                    "{input: Spectrum} or CrossPSD",
                )
            )
        known = check_spectra(each, "spectra", problems)
        problems.collected += [
            unknown(name, "spectra", tuple(inputs)) for name in set(each) - set(inputs)
        ]
        for name, port in inputs.items():
            if name not in each:
                problems.add(
                    "NO_SPECTRUM",
                    f"spectra[{name!r}]",
                    "is missing",
                    limit="one for each input",
                    hint="Give a PSD or a PowerLaw.",
                )
            elif name in known:
                family = (
                    (port.unit,) if not hasattr(port, "kind") else UNITS[len(port.direction) - 1]
                )
                if known[name].quantity not in family:
                    problems.add(
                        "BAD_UNIT",
                        f"spectra[{name!r}]",
                        f"is of {known[name].quantity}, but the input is in {port.unit}",
                        value=known[name].quantity,
                        limit=" or ".join(family),
                        hint="Give the spectrum in one of these units.",
                    )
