"""Objectives and constraints for `tune`, smooth even where modes cross or another value becomes
the maximum.

Each takes results of the library and returns one number, differentiable with respect to
all parameters.
"""

from typing import Any

import jax
import jax.numpy as jnp
import jax.scipy.special
import numpy as np

from jaxbody.core.arrays import Array, Float, Inexact, concrete, float_array, is_concrete
from jaxbody.core.compilation.compile_options import program
from jaxbody.core.errors import JaxbodyError, Problem
from jaxbody.vibration.comfort_weightings import weighted_response
from jaxbody.vibration.frequency_responses import FrequencyResponse
from jaxbody.vibration.linearizations import Linearization
from jaxbody.vibration.modal_energies import kinetic_shares
from jaxbody.vibration.mount_axes import torque_roll_axis
from jaxbody.vibration.random_responses import RandomResponse

__all__ = [
    "band_intrusion",
    "comfort",
    "coupling_of_modes",
    "dominant_shares",
    "peak",
    "road_holding",
    "smooth_max",
    "smooth_min",
    "stroke",
    "torque_roll_coupling",
    "transmitted",
]


def __dir__():
    return __all__


LEAST_SHARE = 1e-6  # shares of energy below this are rounded off to avoid a kink at zero


def smooth_max(x: Any, width: Any) -> Float[Array, ""]:
    """Return a smooth maximum, for example over load cases.

        width log(sum of exp(x/width)),   above the largest by at most width log(n)

    `width` in the unit of x. Errors: BAD_WIDTH, NOT_A_NUMBER, NO_DATA.

    >>> round(float(jb.objectives.smooth_max([1.0, 2.0, 3.0], 0.1)), 4)
    3.0
    """
    return _smooth_extreme(_numbers(x, "smooth_max.x"), _width(width, "smooth_max.width"), 1)


def smooth_min(x: Any, width: Any) -> Float[Array, ""]:
    """Return a smooth minimum, -smooth_max(-x), which is below the smallest number by at most width
    log(n). Errors: BAD_WIDTH, NOT_A_NUMBER, NO_DATA.

    >>> round(float(jb.objectives.smooth_min([1.0, 2.0, 3.0], 0.1)), 4)
    1.0
    """
    return _smooth_extreme(_numbers(x, "smooth_min.x"), _width(width, "smooth_min.width"), -1)


@program
def _smooth_extreme(x: Float[Array, "*n"], width: Float[Array, ""], sign: int) -> Float[Array, ""]:
    return sign * width * jax.scipy.special.logsumexp(sign * x / width)


def peak(x: Any, *, power: float = 50.0) -> Float[Array, ""]:
    """Return a smooth maximum of absolute values, for example of a force in an earthquake.

        (sum of |x|^power)^(1/power),
        above the largest by at most the factor n^(1/power), n the number of values near it

    NaN if one of them is not finite. Errors: NOT_A_NUMBER, NO_DATA, BAD_NUMBER if the power
    is below 1.

    >>> round(float(jb.objectives.peak([-3.0, 1.0, 2.0])), 6)
    3.0
    """
    if not power >= 1:
        raise JaxbodyError(Problem("BAD_NUMBER", "peak.power", f"is {power}", power, ">= 1"))
    return _peak(_numbers(x, "peak.x", allow_complex=True), power)


@program
def _peak(x: Inexact[Array, "*n"], power: float) -> Float[Array, ""]:
    x = jnp.abs(x)
    largest = jax.lax.stop_gradient(jnp.max(x, initial=0.0))
    largest = jnp.where(largest > 0, largest, 1.0)  # a factor that cancels and avoids overflow
    total = jnp.sum((x / largest) ** power)
    # 0 or NaN
    return jnp.where(total > 0, largest * jnp.where(total > 0, total, 1.0) ** (1 / power), total)


@program
def dominant_shares(lin: Linearization) -> Float[Array, "n"]:
    """Return for each mode the largest share of kinetic energy in one body and direction [%]; it is
    100 for an uncoupled mode.

    The derivatives jump where another share becomes the largest: minimize `coupling_of_modes`
    instead.

    >>> model = jb.presets.engine_on_mounts()
    >>> [
    ...     round(float(x), 2)
    ...     for x in jb.objectives.dominant_shares(jb.linearize(model, model.reference))
    ... ]
    [99.4, 98.21, 37.13, 49.36, 65.54, 78.84]
    """
    return 100 * jnp.max(kinetic_shares(lin), axis=0)


@program
def coupling_of_modes(lin: Linearization) -> Float[Array, ""]:
    """Return a measure of the coupling of modes: zero if each mode moves one body in one direction
    only. Minimize it to decouple modes.

        sum over modes j of sum over i != k of |e_ij| |e_kj|,
        e_ij = v_i (M v)_i/(v' M v), shares of kinetic energy as in `mode_energies`

    It is 0 if each mode has one share only, and 5/6 per mode for six equal shares. Products of
    inertia can make shares negative, so the sum uses absolute values, smoothed as
    sqrt(e^2 + 1e-12). Modes with equal frequencies are aligned with the directions, so that equal
    frequencies alone cause no coupling. Source: kinetic energy decoupling, T. Jeong, R. Singh,
    Journal of Sound and Vibration 234 (2000) 85.

    >>> model = jb.presets.isolated_table(at=(0.45, 0.3, 0.0))  # in the plane of its center of mass
    >>> round(float(jb.objectives.coupling_of_modes(jb.linearize(model, model.reference))), 4)
    0.0
    """
    size = jnp.sqrt(kinetic_shares(lin) ** 2 + LEAST_SHARE**2) - LEAST_SHARE
    return jnp.sum(jnp.sum(size, 0) ** 2 - jnp.sum(size**2, 0))


def torque_roll_coupling(lin: Linearization, body: str, torque: Any) -> Float[Array, ""]:
    """Return how far rotation about the torque roll axis is from being a mode; zero if it is one.
    The value is a square, which is smooth at zero.

        |K r - w^2 M r|^2/(w^2 |M r|)^2 in the norm of M^-1,
        r the rotation about the torque roll axis, w^2 = r' K r/(r' M r)

    Errors and source: `torque_roll_axis`.

    >>> model = jb.presets.engine_on_mounts()
    >>> round(
    ...     float(
    ...         jb.objectives.torque_roll_coupling(
    ...             jb.linearize(model, model.reference), "engine", [1, 0, 0]
    ...         )
    ...     ),
    ...     4,
    ... )
    0.1387
    """
    return torque_roll_axis(lin, body, torque).coupling ** 2


def band_intrusion(frequencies: Any, band: tuple[float, float]) -> Float[Array, ""]:
    """Return a penalty on frequencies [Hz] in a band to be avoided, such as the firing frequency of
    an idling engine.

        sum of max(0, 1 - ((f - m)/h)^2)^2,   m the middle of the band, h half its width

    It is 0 if all frequencies are outside and 1 for one in the middle; as a sum over all, it is
    smooth where frequencies cross. To keep frequencies inside a band, limit them:
    limits={"frequency": (6, 18)}. Errors: BAD_BAND, NOT_A_NUMBER.

    >>> [
    ...     round(float(jb.objectives.band_intrusion([f, 40.0], (20.0, 30.0))), 4)
    ...     for f in (25.0, 29.0, 31.0)
    ... ]
    [1.0, 0.1296, 0.0]
    """
    f = _numbers(frequencies, "band_intrusion.frequencies")
    low, high = band
    if not low < high:
        raise JaxbodyError(
            Problem(
                "BAD_BAND",
                "band_intrusion.band",
                f"is {band}",
                band,
                "lower < upper",
                "Give (lower, upper) [Hz].",
            )
        )
    return _band_intrusion(f, float_array([low, high], "band_intrusion.band"))


@program
def _band_intrusion(f: Float[Array, "*n"], band: Float[Array, "2"]) -> Float[Array, ""]:
    middle, half = (band[0] + band[1]) / 2, (band[1] - band[0]) / 2
    return jnp.sum(jnp.maximum(0.0, 1 - ((f - middle) / half) ** 2) ** 2)


def transmitted(response: FrequencyResponse, output: str, name: str) -> Float[Array, ""]:
    """Return the root mean square of a frequency response over the logarithm of frequency, in units
    of output per input.

        sqrt(int |H|^2 d ln f/int d ln f)

    For the largest magnitude instead take peak(response[output, name]). Errors: UNKNOWN_NAME,
    BAD_FREQUENCY if a frequency is 0 Hz.

    >>> model = jb.presets.quarter_car(damping=1500.0)
    >>> inputs, outputs = (
    ...     {"road": jb.BaseMotion("road", "z")},
    ...     {"body": jb.Position("body", axis="z")},
    ... )
    >>> response = jb.frequency_response(
    ...     jb.linearize(model, model.reference), jnp.geomspace(5, 50, 100), inputs, outputs
    ... )
    >>> round(float(jb.objectives.transmitted(response, "body", "road")), 3)
    0.106
    """
    known = concrete(response.frequencies)
    if known is not None and not known.all():
        raise JaxbodyError(
            Problem(
                "BAD_FREQUENCY",
                "transmitted.response",
                "has a frequency of 0 Hz",
                0.0,
                "> 0",
                "The average is over log(f): omit 0 Hz.",
            )
        )
    return _transmitted(response, output, name)


@program
def _transmitted(response: FrequencyResponse, output: str, name: str) -> Float[Array, ""]:
    H, x = response[output, name], jnp.log(response.frequencies)
    return jnp.sqrt(jnp.trapezoid(jnp.real(H) ** 2 + jnp.imag(H) ** 2, x) / (x[-1] - x[0]))


@program
def comfort(ride: RandomResponse, weights: dict[str, str]) -> Float[Array, ""]:
    """Return the vibration total value [m/s2] of the accelerations in a random response; a small
    value means good comfort.

        sqrt(sum of a_w^2),   a_w^2 = int |W|^2 S_a df

    weights: {output: "Wk" for z or "Wd" for x and y}. Errors: those of `weighted_response`. Source:
    ISO 2631-1:1997, 6.5.

    >>> model = jb.presets.quarter_car(damping=1500.0)
    >>> outputs = {"body": jb.Acceleration("body", axis="z")}
    >>> road = {"road": jb.vibration.RoadRoughness.iso("C").at_speed(20.0)}
    >>> ride = jb.random_response(
    ...     jb.linearize(model, model.reference),
    ...     jb.vibration.Band(0.1, 100.0),
    ...     {"road": jb.BaseMotion("road", "z")},
    ...     outputs,
    ...     road,
    ... )
    >>> round(float(jb.objectives.comfort(ride, {"body": "Wk"})), 2)
    1.19
    """
    return _root(jnp.sum(weighted_response(ride, weights).rms ** 2))


def road_holding(ride: RandomResponse, forces: dict[str, Any]) -> Float[Array, ""]:
    """Return the rms variation of tyre forces relative to their static loads; a small value means
    good road holding.

        sqrt(mean of (rms of F/load)^2);   a tyre may lift off if three times this value reaches 1

    forces: {output: static load [N]}. Errors: UNKNOWN_NAME, BAD_UNIT if an output is not a force.

    >>> model = jb.presets.quarter_car(damping=1500.0)
    >>> road = {"road": jb.vibration.RoadRoughness.iso("C").at_speed(20.0)}
    >>> inputs, outputs = (
    ...     {"road": jb.BaseMotion("road", "z")},
    ...     {"tyre": jb.sensors.LoadCell("tyre")},
    ... )
    >>> ride = jb.random_response(
    ...     jb.linearize(model, model.reference),
    ...     jb.vibration.Band(0.1, 100.0),
    ...     inputs,
    ...     outputs,
    ...     road,
    ... )
    >>> round(float(jb.objectives.road_holding(ride, {"tyre": 450 * 9.81})), 2)
    0.23
    """
    for name in forces:
        unit = ride.units[ride.outputs.index(name)] if name in ride.outputs else "N"
        if unit != "N":
            raise JaxbodyError(
                Problem(
                    "BAD_UNIT",
                    f"road_holding[{name!r}]",
                    f"is in {unit}",
                    unit,
                    "N",
                    "Use the LoadCell of a tyre.",
                )
            )
    return _road_holding(
        ride, {name: float_array(load, f"road_holding[{name!r}]") for name, load in forces.items()}
    )


@program
def _road_holding(ride: RandomResponse, forces: dict[str, Array]) -> Float[Array, ""]:
    shares = jnp.stack([ride[name] / load for name, load in forces.items()])
    return _root(jnp.mean(shares**2))


def stroke(ride: RandomResponse, output: str, *, static: Any = 0.0) -> Float[Array, ""]:
    """Return the stroke [m] of an element, |static| + 3 rms, which is exceeded only 0.3 % of the
    time.

    output: name of the element's deformation in the random response `ride`; static: its static
    deformation [m]. Error: UNKNOWN_NAME.

    >>> model = jb.presets.quarter_car(damping=1500.0)
    >>> road = {"road": jb.vibration.RoadRoughness.iso("C").at_speed(20.0)}
    >>> inputs, outputs = (
    ...     {"road": jb.BaseMotion("road", "z")},
    ...     {"travel": jb.Elongation("suspension")},
    ... )
    >>> ride = jb.random_response(
    ...     jb.linearize(model, model.reference),
    ...     jb.vibration.Band(0.1, 100.0),
    ...     inputs,
    ...     outputs,
    ...     road,
    ... )
    >>> round(float(jb.objectives.stroke(ride, "travel")), 3)
    0.037
    """
    return _stroke(ride, output, float_array(static, "stroke.static"))


@program
def _stroke(ride: RandomResponse, output: str, static: Float[Array, ""]) -> Float[Array, ""]:
    return jnp.abs(static) + 3 * ride[output]


def _root(square: Float[Array, ""]) -> Float[Array, ""]:
    return jnp.where(square > 0, jnp.sqrt(jnp.where(square > 0, square, 1.0)), 0.0 * square)


def _numbers(x: Any, where: str, *, allow_complex: bool = False) -> Inexact[Array, "*n"]:
    numbers = (
        (x if isinstance(x, jax.Array) else np.asarray(x))
        if allow_complex and np.iscomplexobj(x)
        else float_array(x, where)
    )
    if not np.size(numbers):
        raise JaxbodyError(Problem("NO_DATA", where, "is empty", x, "one number or more"))
    return numbers


def _width(width: Any, where: str) -> Any:
    if is_concrete(width) and not width > 0:
        raise JaxbodyError(
            Problem(
                "BAD_WIDTH",
                where,
                f"is {width}",
                width,
                "> 0",
                "Give the largest negligible difference, in the unit of x.",
            )
        )
    return float_array(width, where)
