"""Modes identified from frequency responses or positive spectra: stable poles, refined by maximum
likelihood, with standard errors.

    p = -zeta w + i w sqrt(1 - zeta^2),   f = w/(2 pi),   psi: mode shape

A shape is turned by the angle that makes the sum of squares of its real parts largest. Its
complexity is 1 - MPC, with the modal phase collinearity MPC = ((a - b)/(a + b))^2 of the principal
values a, b of (Re psi, Im psi). With a driving point, psi_y l_u = phi_y phi_u/(2 i w_d) scales the
shapes phi to modal mass one.

Sources: W. Heylen, S. Lammens, P. Sas, Modal Analysis Theory and Testing (1997), A.1 and A.3;
R. S. Pappa, K. B. Elliott, A. Schenk, J. Guid. Contr. Dyn. 16 (1993) 852.
"""

from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from jaxbody.core import tables
from jaxbody.core.arguments import whole_number
from jaxbody.core.arrays import as_numpy
from jaxbody.core.errors import JaxbodyError, Problem, Problems, unknown, warn
from jaxbody.fitting.experiments.measured_responses import MeasuredModes, MeasuredResponse
from jaxbody.fitting.experiments.measurements import small_motions
from jaxbody.fitting.modal import pole_functions
from jaxbody.fitting.modal.pole_fits import PoleFit, Responses, fit_poles
from jaxbody.fitting.modal.response_estimates import (
    SPECTRA,
    Averages,
    EstimatedResponse,
    ResponseEstimate,
    band_of,
    cross,
    deviations,
    residuals,
)
from jaxbody.fitting.modal.segments import Transforms
from jaxbody.fitting.modal.stable_poles import Diagram, chosen, diagram
from jaxbody.model.models import Model
from jaxbody.sensors.kinematic_sensors import Acceleration, Position, Velocity
from jaxbody.vibration.damped_modes import complex_modes
from jaxbody.vibration.mode_branches import mac
from jaxbody.vibration.ports import component_units

POLES = 48  # of the highest order, where none is given
FREEDOM = 200  # degrees of freedom over which S_ee is averaged along the lines
SIGNIFICANT = 4.0  # smallest size of shapes, in standard errors
EXACT = 1e-2  # smallest averaged noise, relative to that of a line, which is not below round-off
MISFIT = 2.0  # rms of residuals over random errors, from which the model does not fit
NARROW = 4.0  # lines within the half-power bandwidth, below which a mode is not resolved
DERIVATIVES = {"m": 0, "rad": 0, "m/s": 1, "rad/s": 1, "m/s2": 2, "rad/s2": 2}


@dataclass(frozen=True, eq=False)
class Identification:
    """Everything that was identified, as NumPy arrays: `poles` [rad/s] (nm,), complex `shapes`
    (nm, ny) at the `outputs`, `participation` (nm, nu) of the `inputs`, standard errors of
    frequency, damping ratio and shapes (real and imaginary part), `complexity` (nm,),
    `modal_mass` None without a driving point; the `diagram`, and the `fit` with the responses `H`
    of the modes at the `frequencies`, beside the `measured` ones (nf, ny, nu)."""

    frequencies: np.ndarray
    measured: np.ndarray
    poles: np.ndarray
    shapes: np.ndarray
    participation: np.ndarray
    frequency_error: np.ndarray
    damping_error: np.ndarray
    shape_error: np.ndarray
    complexity: np.ndarray
    modal_mass: np.ndarray | None
    diagram: Diagram
    fit: PoleFit
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]

    @property
    def frequency(self) -> np.ndarray:
        return pole_functions.frequency_of(self.poles)

    @property
    def damping_ratio(self) -> np.ndarray:
        return pole_functions.damping_ratio_of(self.poles)


class IdentifiedModes(tables.Printed, MeasuredModes):
    """Modes of a test with standard errors, a MeasuredModes for `fit`.

    `identification` holds poles, complex shapes, standard errors, complexity and the stabilization
    diagram as NumPy arrays. As a measurement, real shapes stand at the outputs that are sensors of
    a model. `plot()` draws the stabilization diagram, `plot(model=...)` the MAC with a model.

    >>> f = np.linspace(1, 9, 400)
    >>> s, p = 2j * np.pi * f, -0.2 + 20j
    >>> H = -1e-3j / (s - p) + 1e-3j / (s - p.conjugate())
    >>> force, motion = jb.PointForce("mass", direction="y"), jb.Position("mass", axis="y")
    >>> test = jb.MeasuredResponse(
    ...     f, inputs={"f": force}, outputs={"y": motion}, measured={("y", "f"): H}, noise=1e-6
    ... )
    >>> modes = jb.modal.identify_modes(test)
    >>> isinstance(modes, jb.modal.IdentifiedModes), modes.identification.damping_ratio.round(5)
    (True, array([0.01]))
    """

    identification: Identification = eqx.field(static=True)

    def __init__(self, identification: Identification, sensors: dict[str, Any]):
        i = identification
        columns = [i.outputs.index(name) for name in sensors]
        shapes = np.real(i.shapes[:, columns])
        size = np.linalg.norm(shapes, axis=1, keepdims=True)
        noise = {"frequency": i.frequency_error, "damping_ratio": i.damping_error}
        if columns:
            noise["shapes"] = np.real(i.shape_error[:, columns]) / size
        super().__init__(
            frequency=i.frequency,
            damping_ratio=i.damping_ratio,
            shapes=shapes if columns else None,
            sensors=sensors,
            noise=noise,
            pairing="mac" if len(columns) > 1 else "order",
        )
        self.identification = identification

    def mac(self, model: Model) -> Any:
        """Return the modal assurance criterion of the modes of a model about its equilibrium (rows)
        with the identified ones (columns). Error: NO_DATA without sensors of the model."""
        return self.agreement(model)[1]

    def agreement(self, model: Model) -> tuple[Any, Any]:
        """Return the natural frequencies of a model [Hz] and `mac(model)`."""
        if "shapes" not in self.measured:
            raise JaxbodyError(
                Problem(
                    "NO_DATA",
                    "IdentifiedModes.mac",
                    "has no shapes at sensors of a model",
                    hint="Give estimate_responses outputs={channel: sensor}.",
                )
            )
        frequency, _, shapes = self.predicted(small_motions(model))
        return frequency, mac(shapes, self.measured["shapes"].T)

    def predicted(self, lin):
        """Return |p|/(2 pi), damping ratios and turned shapes at the sensors of the poles p of the
        model, which are those of a test also where damping couples the natural modes."""
        found = complex_modes(lin)
        shapes = self.at_sensors(lin, found.shapes)
        turn = jnp.angle(jnp.sum(shapes**2, 0)) / 2
        turned = jnp.cos(turn)[None] * jnp.real(shapes) + jnp.sin(turn)[None] * jnp.imag(shapes)
        return found.natural_frequency, found.damping_ratio, turned

    def _tables(self) -> list[tables.PrintedTable]:
        i = self.identification
        rows = [
            (k + 1, f, df, zeta, dzeta, tables.percent(complexity))
            for k, (f, df, zeta, dzeta, complexity) in enumerate(
                zip(
                    i.frequency,
                    i.frequency_error,
                    i.damping_ratio,
                    i.damping_error,
                    i.complexity,
                    strict=True,
                )
            )
        ]
        heads = (
            "mode",
            "frequency [Hz]",
            "std. error",
            "damping ratio",
            "std. error",
            "complexity",
        )
        note = (
            f"residuals {np.sqrt(i.fit.chi2):.3g} times the random errors of the responses"
            f"{'' if i.fit.converged else '; the search did not converge'}"
        )
        return [tables.PrintedTable("Identified modes", heads, rows, note, digits=8)]


def identify_modes(
    responses: MeasuredResponse,
    *,
    band: tuple[float, float] | None = None,
    order: int | None = None,
    driving_point: tuple[str, str] | None = None,
) -> IdentifiedModes:
    """Identify the modes within a band of frequency responses, with standard errors.

    Poles of rational functions of growing order (pLSCF) that keep frequency (1 %), damping (10 %)
    and participation (MAC 0.95) through five orders start a maximum-likelihood fit of poles, shapes
    and residual terms, which is free of the bias that noise gives to the first. Its covariance
    counts overlap, windows, and noise that outputs have in common. Leakage of windows is part of
    the fitted model.

    Args:
        responses: of `estimate_responses` or `positive_spectra`, or any MeasuredResponse with all
            pairs of its inputs and outputs
        band: (lowest, highest) frequency [Hz]; None: all lines
        order: highest order of the polynomials; None: 48 poles, or fewer for few lines
        driving_point: (output, input) at the same point and in the same direction, which scales the
            shapes to modal mass one; None: no scale

    Errors: NO_DATA (a pair without data; no stable pole), BAD_BAND, BAD_NUMBER, UNDETERMINED (an
    order beyond the data), UNKNOWN_NAME. Warns LEAKAGE where a resonance is narrower than four
    lines, MISFIT, NOT_CONVERGED.

    >>> f = np.linspace(1, 9, 400)
    >>> s, p = 2j * np.pi * f, np.array([-0.2 + 20j, -0.3 + 38j])
    >>> H = sum(-1e-3j / (s - q) + 1e-3j / (s - q.conjugate()) for q in p)
    >>> force, motion = jb.PointForce("mass", direction="y"), jb.Position("mass", axis="y")
    >>> test = jb.MeasuredResponse(
    ...     f, inputs={"f": force}, outputs={"y": motion}, measured={("y", "f"): H}, noise=1e-6
    ... )
    >>> jb.modal.identify_modes(test).identification.frequency.round(4).tolist()
    [3.1833, 6.0481]
    """
    where = "identify_modes"
    e = responses.estimate if isinstance(responses, EstimatedResponse) else _as_estimate(responses)
    kept = band_of(e.frequencies, band, where)
    kept = kept[np.isfinite(e.H[kept]).all((1, 2))]
    _check(e, kept, order, driving_point, where)
    most = _most(len(kept))
    last = order or max(min(-(-POLES // len(e.inputs)), most), 2)
    data = _data(e, kept)
    spread = 1 / np.abs(np.diagonal(data.whitening, axis1=2, axis2=3))
    found = diagram(e.frequencies[kept], data.H, spread, np.arange(1, last + 1))
    poles, l = chosen(found)
    if not len(poles):
        raise JaxbodyError(
            Problem(
                "NO_DATA",
                f"{where}.responses",
                "shows no pole that is stable from order to order",
                limit="resonances within the band",
                hint="Give another band=, or a higher order=.",
            )
        )
    scaled = bool(np.isnan(e.spread[kept]).any())  # no noise is stated
    fit = fit_poles(data, poles + np.real(data.s[0]), l)
    while len(fit.poles) > 1 and (size := _significance(fit, data)).min() < 1:
        others = np.arange(len(size)) != np.argmin(size)
        fit = fit_poles(data, fit.poles[others], fit.l[others])
    if not fit.converged:
        warn("NOT_CONVERGED", f"{where}: the search ended after its largest number of steps")
    if not scaled and fit.chi2 > MISFIT**2:
        warn(
            "MISFIT",
            f"{where}: residuals are {np.sqrt(fit.chi2):.2g} times the random errors of the "
            "responses, so that standard errors are too small: does the band end in a resonance, "
            "or is the structure nonlinear?",
        )
    made = _identified(e, kept, fit, found, driving_point, scaled)
    width = 2 * made.damping_ratio * made.frequency * len(e.segments.window) / e.segments.rate
    if e.leaks and (width < NARROW).any():
        k = int(np.argmin(width))
        warn(
            "LEAKAGE",
            f"{where}: mode {k + 1} at {made.frequency[k]:.4g} Hz is {width[k]:.1f} lines wide at "
            f"half power: give a segment= that makes it {NARROW:g} or more",
        )
    known = {name: x for name, x in responses.outputs.items() if name in made.outputs}
    return IdentifiedModes(made, _positions(known))


def _most(lines: int) -> int:
    """Return the highest order for a number of lines: of an output, the coefficients of numerator
    and denominator are fewer than its lines."""
    return int(0.8 * lines / 2)


def _check(
    e: ResponseEstimate, kept: np.ndarray, order: Any, driving_point: Any, where: str
) -> None:
    with Problems() as problems:
        most = _most(len(kept))
        if order is not None and whole_number(order, f"{where}.order", problems, least=2) > most:
            problems.add(
                "UNDETERMINED",
                f"{where}.order",
                f"is {order} for {len(kept)} lines",
                value=order,
                limit=f"{most} or less",
                hint="Give a lower order, or longer segments.",
            )
        if len(kept) < 8:
            problems.add(
                "NO_DATA",
                f"{where}.responses",
                f"has {len(kept)} complete lines",
                limit="8 or more",
            )
        for name, known in zip(driving_point or (), (e.outputs, e.inputs), strict=False):
            if name not in known:
                problems.collected.append(unknown(name, f"{where}.driving_point", known))


def _as_estimate(responses: MeasuredResponse) -> ResponseEstimate:
    """Return measured responses of another source as an estimate. Error: NO_DATA for a pair that is
    missing."""
    outputs, inputs = (tuple(dict.fromkeys(names)) for names in zip(*responses.pairs, strict=True))
    missing = [(y, u) for y in outputs for u in inputs if (y, u) not in responses.pairs]
    if missing:
        raise JaxbodyError(
            Problem(
                "NO_DATA",
                "identify_modes.responses",
                f"lacks the pair {missing[0]}",
                missing,
                "all pairs of its inputs and outputs",
            )
        )
    f = np.asarray(responses.frequencies, float)

    def each(of: Any) -> np.ndarray:
        return np.stack([np.stack([of(f"{y}/{u}") for u in inputs], -1) for y in outputs], 1)

    H = each(lambda name: np.asarray(responses.measured[name], complex))
    noise = responses.noise or {}
    spread = each(lambda name: np.broadcast_to(as_numpy(noise.get(name, np.nan)), f.shape))
    units = component_units(responses.outputs)
    return ResponseEstimate(
        f,
        H,
        spread,
        inputs,
        outputs,
        tuple(responses.inputs[u].unit for u in inputs),
        tuple(units[y] for y in outputs),
        Transforms(f, H, np.ones(1), rate=1.0, effective=1.0),
    )


def _data(e: ResponseEstimate, kept: np.ndarray) -> Responses:
    """Return what is fitted."""
    f, H = e.frequencies[kept], e.H[kept]
    # windowed by e^(-t/decay), a response H(s) is that at s + 1/decay
    s = 2j * np.pi * f + (0.0 if e.segments.decay is None else 1 / e.segments.decay)
    rise = [DERIVATIVES.get(unit, 0) for unit in (*e.output_units, *e.input_units)]
    ny = len(e.outputs)
    d = np.maximum(np.subtract.outer(rise[:ny], rise[ny:]), 0) * (e.method != SPECTRA)
    a, replicates, gamma = e.averages, None, np.broadcast_to(np.eye(ny), (len(f), ny, ny))
    if a is None:
        spread = e.spread[kept]
        # without stated noise one level for each pair, from the sizes of its responses
        spread = np.where(np.isnan(spread), np.sqrt(np.mean(np.abs(H) ** 2, 0)), spread)
        white = np.eye(H.shape[2]) / spread[:, :, :, None]
        replicates = None if e.replicates is None else e.replicates[:, kept]
    else:
        noise = _noise(e, a, H, kept)
        own = np.real(np.diagonal(noise, axis1=1, axis2=2))
        own = np.maximum(own, EXACT * a.noise[kept])
        root = np.linalg.cholesky(a.input_power[kept])
        white = root[:, None] * np.sqrt(2 / own)[:, :, None, None]
        gamma = noise / np.sqrt(own[:, :, None] * own[:, None])
        if e.leaks:  # errors are correlated along the lines, and follow from their scatter
            X = e.segments.spectra[: len(e.inputs), :, kept]
            seen = np.einsum("jsf,fji->sfi", X.conj(), np.linalg.inv(a.input_power[kept]))
            seen = seen * np.sqrt(e.segments.effective / a.freedom) * X.shape[1]
            E = residuals(e.segments, e.H, kept)
            replicates = np.einsum("osf,sfi->sfoi", E, seen)
    if e.method == SPECTRA:
        functions = pole_functions.by_samples(s, 1 / e.segments.rate)
    elif e.leaks:
        functions = pole_functions.by_windows(s, e.segments.window, e.segments.rate)
    else:
        functions = pole_functions.exact(s)
    return Responses(
        s, H, white, d, functions, gamma, e.segments.lags, replicates, e.segments.shared
    )


def _noise(e: ResponseEstimate, a: Averages, H: np.ndarray, kept: np.ndarray) -> np.ndarray:
    """Return S_ee (nf, ny, ny), averaged along the lines where few segments estimate it. Between
    periods, inputs vary by noise alone: that of all channels is averaged, as S_ee has peaks where
    the noise of an input meets a resonance."""
    from scipy.ndimage import uniform_filter1d

    lines = int(np.ceil(FREEDOM / a.freedom))
    size = lines + 1 - lines % 2
    if not e.segments.periods:
        E = residuals(e.segments, e.H, kept)
        share = e.segments.effective / E.shape[1] / a.freedom
        return uniform_filter1d(cross(E, E), size, axis=0) * share
    Z = deviations(e.segments)
    N = uniform_filter1d(cross(Z, Z), size, axis=0)[kept] / a.freedom
    ny = H.shape[1]
    G = np.concatenate([-H, np.broadcast_to(np.eye(ny), (len(H), ny, ny))], 2)
    return G @ N @ np.conj(np.swapaxes(G, 1, 2))


def _significance(fit: PoleFit, data: Responses) -> np.ndarray:
    """Return by how much modes exceed what is significant, the smaller of two ratios: of damping to
    its standard error, and of shapes, in the mean of squares, to SIGNIFICANT times theirs; zero for
    modes outside of the lines."""
    error = np.sqrt(fit.of_poles[:, 0, 0])
    of_shapes = fit.of_shapes[..., 0, 0] + fit.of_shapes[..., 1, 1]
    ratio = np.sqrt(np.mean(np.abs(fit.shapes) ** 2 / of_shapes, 1)) / SIGNIFICANT
    w, f = np.abs(fit.poles), np.imag(data.s)
    inside = (w > f[0]) & (w < f[-1])
    return inside * np.minimum((np.real(data.s[0]) - np.real(fit.poles)) / error, ratio)


def _identified(
    e: ResponseEstimate,
    kept: np.ndarray,
    fit: PoleFit,
    found: Diagram,
    driving_point: tuple[str, str] | None,
    scaled: bool,
) -> Identification:
    """Return the identified modes. `scaled`: True if the noise is that of the residuals."""
    order = np.argsort(np.abs(fit.poles))
    scale = fit.chi2 if scaled else 1.0
    p: Any = fit.poles[order]
    psi, l = fit.shapes[order], fit.l[order]
    size = np.abs(p)
    # derivatives of |p| and of -Re p/|p| by the real and the imaginary part
    by_size = np.stack([p.real / size, p.imag / size], 1)
    by_ratio = np.stack([-(p.imag**2), p.real * p.imag], 1) / size[:, None] ** 3
    C = scale * fit.of_poles[order]
    errors = [np.sqrt(np.einsum("mi,mij,mj->m", x, C, x)) for x in (by_size, by_ratio)]
    turn = np.exp(-0.5j * np.angle(np.sum(psi * psi, 1)))
    factor = turn / np.abs(psi).max(1)
    mass = None
    if driving_point is not None:
        y, u = e.outputs.index(driving_point[0]), e.inputs.index(driving_point[1])
        own = 2j * p.imag * psi[:, y] * l[:, u]  # phi_y^2
        factor = np.sqrt(own) / psi[:, y]
        mass = 1 / (np.abs(factor) * np.abs(psi).max(1)) ** 2
    shapes = factor[:, None] * psi
    largest = np.take_along_axis(shapes, np.abs(shapes).argmax(1)[:, None], 1)
    sign = np.where(largest.real < 0, -1.0, 1.0)
    shapes, factor = sign * shapes, sign[:, 0] * factor
    rotation = np.stack(
        [np.stack([factor.real, -factor.imag], 1), np.stack([factor.imag, factor.real], 1)], 1
    )
    of_shapes = scale * np.einsum("mij,mojk,mlk->moil", rotation, fit.of_shapes[order], rotation)
    variances = np.diagonal(of_shapes, axis1=2, axis2=3)
    parts = np.stack([shapes.real, shapes.imag], 2)
    parts = np.concatenate([parts, np.zeros_like(parts)], 1)  # of one output, two values too
    a, b = np.moveaxis(np.linalg.svd(parts, compute_uv=False) ** 2, 1, 0)
    return Identification(
        e.frequencies[kept],
        e.H[kept],
        p,
        shapes,
        l,
        errors[0] / (2 * np.pi),
        errors[1],
        np.sqrt(variances[:, :, 0]) + 1j * np.sqrt(variances[:, :, 1]),
        1 - ((a - b) / (a + b)) ** 2,
        mass,
        found,
        fit,
        e.inputs,
        e.outputs,
    )


def _positions(outputs: dict[str, Any]) -> dict[str, Position]:
    """Return positions in place of the positions, velocities and accelerations along one axis, the
    sensors of real shapes."""
    return {
        name: Position(x.on, x.point, axis=x.axis, relative_to=x.relative_to)
        for name, x in outputs.items()
        if isinstance(x, Position | Velocity | Acceleration) and x.axis is not None
    }
