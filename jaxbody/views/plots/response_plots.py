"""Plots of responses: over frequency, spectral densities, weighted accelerations."""

from typing import Any

import numpy as np

from jaxbody.core.errors import JaxbodyError, Problem, check_all_known
from jaxbody.vibration.comfort_weightings import WeightedSignal
from jaxbody.vibration.dynamic_stiffnesses import DynamicStiffness
from jaxbody.vibration.frequency_responses import FrequencyResponse
from jaxbody.vibration.random_responses import RandomResponse
from jaxbody.vibration.state_spaces import StateSpace
from jaxbody.views.plots.canvases import (
    DASHES,
    axes_below,
    axes_or_new,
    legend,
    of_one,
    panels_of_lines,
    style,
    with_unit,
)
from jaxbody.views.scenes.colors import COLORS, GRAY, LIGHT

STEPS = (1e-3, 0.01, 0.1, 0.5, 1, 2, 5, 10, 15, 30, 45, 90, 180, 360, 720)  # degrees between ticks
MOST_TICKS = 5
MANY = 16  # largest number of lines whose legend fits beside a plot of normal width


@of_one("frequencies", 1)
def plot_frequency_response(response: FrequencyResponse, *, ax: Any = None) -> Any:
    """Draw magnitudes over frequency, both on logarithmic scales, one panel per unit, with the
    phases below; return the top axes. The legend has the inputs.

    >>> model = jb.presets.quarter_car(damping=1500.0)
    >>> inputs, outputs = (
    ...     {"road": jb.BaseMotion("road", "z")},
    ...     {"body": jb.Position("body", axis="z")},
    ... )
    >>> response = jb.frequency_response(
    ...     jb.linearize(model, jb.equilibrium(model)), jnp.geomspace(0.1, 50, 100), inputs, outputs
    ... )
    >>> ax = jb.plots.plot_frequency_response(response)
    >>> ax.get_ylabel()
    'magnitude [-]'
    """
    f, size, phase = _above_0_hz(response)
    phase = phase - 2 * np.pi * np.round(phase[..., :1] / (2 * np.pi))
    pairs = _pairs(response)
    panels: dict[str, Any] = {}
    for i, j, name in pairs:
        unit = response.unit(response.outputs[i], response.inputs[j])
        panels.setdefault(unit, {})[name] = size[i, j], phase[i, j], look(response, i, j)
    ax = axes_or_new(ax, 7.0 if len(pairs) <= MANY else 9.0, 2.2 + 2.2 * len(panels))
    return _over_frequency(ax, f, panels, "magnitude", "phase", _input(response))


@of_one("frequencies", 1)
def plot_element_stiffness(stiffness: DynamicStiffness, *, ax: Any = None) -> Any:
    """Draw the magnitude of the dynamic stiffness of an element over frequency, with its loss angle
    below; return the top axes.

    >>> rubber = jb.laws.Linear(2e4) + jb.laws.Maxwell(stiffness=6e4, relaxation_time=0.01)
    >>> ax = jb.plots.plot_element_stiffness(
    ...     jb.vibration.dynamic_stiffness(rubber, jnp.geomspace(0.5, 200, 100))
    ... )
    >>> ax.get_ylabel()
    'magnitude [N/m]'
    """
    K = np.asarray(stiffness.stiffness)
    panels = {stiffness.unit: {"": (np.abs(K), np.angle(K), None)}}
    f, ax = np.asarray(stiffness.frequencies), axes_or_new(ax, 7.0, 4.4)
    return _over_frequency(ax, f, panels, "magnitude", "loss angle")


@of_one("frequencies", 1)
def plot_transmissibility(response: FrequencyResponse, *, ax: Any = None) -> Any:
    """Draw the magnitudes of dimensionless responses, motion over motion or force over force, over
    frequency; the region above 1 is shaded.

    Error: BAD_UNIT if no output has the unit of an input.

    >>> car = jb.presets.quarter_car(damping=1500.0)
    >>> road, body = {"road": jb.BaseMotion("road", "z")}, {"body": jb.Position("body", axis="z")}
    >>> ax = jb.plots.plot_transmissibility(
    ...     jb.frequency_response(
    ...         jb.linearize(car, car.reference), jnp.geomspace(0.1, 50, 100), road, body
    ...     )
    ... )
    >>> (
    ...     ax.get_ylabel(),
    ...     round(float(ax.lines[0].get_ydata()[0]), 2),
    ... )  # slowly the body moves as the road
    ('transmissibility [-]', 1.01)
    """
    ratios = [
        (i, j, name)
        for i, j, name in _pairs(response)
        if not response.unit(response.outputs[i], response.inputs[j])
    ]
    if not ratios:
        raise JaxbodyError(
            Problem(
                "BAD_UNIT",
                "plot_transmissibility.response",
                "has no output in the unit of an input",
                response,
                "a ratio",
                "Use displacements for inputs and outputs, or forces for both.",
            )
        )
    ax = axes_or_new(ax, 7.0 if len(ratios) <= MANY else 9.0, 3.4)
    f, size, _ = _above_0_hz(response)
    for i, j, name in ratios:
        ax.loglog(f, size[i, j], lw=1.5, label=name, **look(response, i, j))
    top = max(size[i, j].max() for i, j, _ in ratios)
    ax.axhspan(1.0, max(2.0, 2 * top), color=LIGHT, alpha=0.4, lw=0, zorder=0)
    ax.axhline(1.0, color=GRAY, lw=0.8)
    ax.set(ylabel="transmissibility [-]", ylim=(None, max(2.0, 2 * top)))
    hertz(ax, f)
    legend(ax, len(ratios), title=_input(response))
    return ax


@of_one("frequencies", 1)
def plot_dynamic_stiffness(
    response: FrequencyResponse, *, pairs: dict[str, tuple[str, str]] | None = None, ax: Any = None
) -> Any:
    """Draw the magnitude [N/mm] and the loss angle [degrees] of dynamic stiffnesses F/x over
    frequency.

    The dynamic stiffness of a spring and damper is k + i w c, with the loss angle atan(w c/k). That
    of a body at the point of a force is the inverse of its receptance and contains its inertia.
    Stiffnesses against rotation are in N m/rad, in a panel of their own.

    Args:
        response: a frequency response with forces and displacements.
        pairs: {label: (force, displacement)}, each an input or output; for two outputs their ratio
            under the first input to which the displacement responds. None takes all pairs of an
            output in m and an input in N, and of an output in N and an input in m; the sign of the
            latter is changed if the force is opposed to the displacement.
        ax: axes to draw into; None makes a new figure.

    Errors: UNKNOWN_NAME; BAD_UNIT if nothing is a force over a displacement, or a moment over an
    angle.

    >>> car = jb.presets.quarter_car(damping=1500.0)
    >>> inputs, outputs = (
    ...     {"road": jb.BaseMotion("road", "z")},
    ...     {"force": jb.sensors.LoadCell("suspension"), "stroke": jb.Elongation("suspension")},
    ... )
    >>> response = jb.frequency_response(
    ...     jb.linearize(car, car.reference), jnp.geomspace(0.1, 50, 100), inputs, outputs
    ... )
    >>> ax = jb.plots.plot_dynamic_stiffness(response, pairs={"suspension": ("force", "stroke")})
    >>> round(float(ax.lines[0].get_ydata()[0]), 1)  # 35000 N/m
    35.0
    """
    f = np.asarray(response.frequencies)
    panels: dict[str, Any] = {}
    for name, (units, values) in (
        _stiffnesses(response) if pairs is None else _ratios(response, pairs)
    ).items():
        (label, size), K = STIFFNESS_UNITS[units], values[f > 0]
        panels.setdefault(label, {})[name] = np.abs(K) / size, np.unwrap(np.angle(K)), None
    if not panels:
        raise JaxbodyError(
            Problem(
                "BAD_UNIT",
                "plot_dynamic_stiffness.response",
                "has no force over a displacement",
                response,
                "N/m or N m/rad",
                "Give outputs in m of inputs in N, or pairs={name: (force, displacement)}.",
            )
        )
    ax = axes_or_new(ax, 7.0, 2.2 + 2.2 * len(panels))
    return _over_frequency(ax, f[f > 0], panels, "dynamic stiffness", "loss angle", plain=True)


# {SI units of a force and a displacement: (unit in the plot, its size in SI)}
STIFFNESS_UNITS = {("N", "m"): ("N/mm", 1e3), ("N m", "rad"): ("N m/rad", 1.0)}


def _over_frequency(
    ax: Any,
    f: np.ndarray,
    panels: dict[str, dict[str, tuple[Any, Any, Any]]],
    what: str,
    angle: str,
    title: str | None = None,
    *,
    plain: bool = False,
) -> Any:
    """Draw magnitudes in a panel for each unit and all angles below; return the top axes.

    Args:
        ax: axes whose area the panels share.
        f: frequencies [Hz].
        panels: {unit: {name: (magnitudes, angles [rad], look)}}, where `look` holds matplotlib's
            properties of the line, such as its color; None takes those of the next `style`. A panel
            with a line named "" has no legend.
        what: name of the magnitudes.
        angle: name of the angles.
        title: title of the legends.
        plain: whether ticks of the magnitudes are plain numbers, as in `plain_numbers`.
    """
    *others, below = axes_below(ax, *[1.0] * (len(panels) - 1), 0.55)
    for axes, (unit, lines) in zip((ax, *others), panels.items(), strict=True):
        for name, (size, angles, look) in lines.items():
            look = {"lw": 1.5} | (look or style(len(below.lines)))
            axes.loglog(f, size, label=name, **look)
            below.semilogx(f, np.rad2deg(angles), **look)
        axes.set_ylabel(with_unit(what, unit))
        if plain:
            plain_numbers(axes, np.concatenate([size for size, *_ in lines.values()]))
        legend(axes, len(lines) if all(lines) else 0, title=title)
    hertz(below, f)
    degrees(below, angle)
    return ax


@of_one("times", 1)
def plot_weighted_signal(signal: WeightedSignal, *, ax: Any = None) -> Any:
    """Draw the frequency-weighted acceleration over time with its rms value, and below it the
    vibration dose value accumulated since the start.

    >>> jb.plots.plot_weighted_signal(
    ...     jb.vibration.weighted_signal(jnp.arange(400) / 400, jnp.sin(jnp.arange(400)), "Wk")
    ... ).get_ylabel()
    'weighted by Wk [m/s2]'
    """
    unit = "rad/s2" if signal.name == "We" else "m/s2"
    panels = {
        f"weighted by {signal.name} [{unit}]": {
            f"peak {float(signal.peak):.3g} {unit}": np.asarray(signal.values)
        },
        f"dose [{unit[:-1]}$^{{1.75}}$]": {f"VDV {float(signal.vdv):.3g}": np.asarray(signal.dose)},
    }
    ax = panels_of_lines(axes_or_new(ax, 7.5, 3.8), signal.times, panels, "time [s]", share=0.6)
    for sign in (1, -1):
        label = f"rms {float(signal.rms):.3g} {unit}" if sign > 0 else None
        ax.axhline(sign * float(signal.rms), color=COLORS[1], lw=1.4, ls="--", label=label)
    legend(ax, 2)
    return ax


def _stiffnesses(response: FrequencyResponse) -> dict[str, tuple[tuple[str, str], np.ndarray]]:
    """Return {label: (units, dynamic stiffness)} of each pair of output and input whose ratio is a
    stiffness or a compliance."""
    stiffnesses = {}
    for i, j, name in _pairs(response):
        units, values = (
            (response.output_units[i], response.input_units[j]),
            np.asarray(response.values)[i, j],
        )
        if units in STIFFNESS_UNITS:
            stiffnesses[name] = (
                units,
                values
                * np.sign(values[np.argmax(np.asarray(response.frequencies) > 0)].real or 1.0),
            )
        elif units[::-1] in STIFFNESS_UNITS:
            stiffnesses[name] = units[::-1], 1 / values
    return stiffnesses


def _ratios(
    response: FrequencyResponse, pairs: dict[str, tuple[str, str]]
) -> dict[str, tuple[tuple[str, str], np.ndarray]]:
    names = [name for pair in pairs.values() for name in pair]
    check_all_known(names, "plot_dynamic_stiffness.pairs", response.outputs + response.inputs)
    values, ratios = np.asarray(response.values), {}
    for label, pair in pairs.items():
        inputs = [response.inputs.index(name) for name in pair if name in response.inputs]
        j = (
            inputs[0]
            if inputs
            else int(np.argmax(np.abs(values[response.outputs.index(pair[1])]).max(-1) > 0))
        )
        force, moved = (
            values[response.outputs.index(name), j]
            if name in response.outputs
            else np.ones(values.shape[-1])
            for name in pair
        )
        units = [
            (response.output_units + response.input_units)[
                (response.outputs + response.inputs).index(name)
            ]
            for name in pair
        ]
        if tuple(units) not in STIFFNESS_UNITS or len(inputs) == 2:
            raise JaxbodyError(
                Problem(
                    "BAD_UNIT",
                    f"plot_dynamic_stiffness.pairs['{label}']",
                    f"is {pair[0]} [{units[0]}] over {pair[1]} [{units[1]}]",
                    pair,
                    "N/m or N m/rad",
                    "Give (force, displacement), one of them an output.",
                )
            )
        ratios[label] = (units[0], units[1]), force / moved
    return ratios


@of_one("A", 2)
def plot_state_space(system: StateSpace, *, frequencies: Any = None, ax: Any = None) -> Any:
    """Draw the frequency response C (i w - A)^-1 B + D, as in `plot_frequency_response`.

    frequencies: [Hz]; None takes 400 from a tenth of the smallest pole to ten times the largest.

    >>> car = jb.presets.quarter_car(damping=1500.0)
    >>> road, body = {"road": jb.BaseMotion("road", "z")}, {"body": jb.Position("body", axis="z")}
    >>> jb.plots.plot_state_space(
    ...     jb.linearize(car, car.reference).state_space(road, body)
    ... ).get_ylabel()
    'magnitude [-]'
    """
    A, B, C, D = (np.asarray(x) for x in (system.A, system.B, system.C, system.D))
    if frequencies is None:
        sizes = np.abs(np.linalg.eigvals(A)) / (2 * np.pi)
        sizes = sizes[sizes > 1e-6 * sizes.max()]
        frequencies = np.geomspace(sizes.min() / 10, sizes.max() * 10, 400)
    f = np.asarray(frequencies, float)
    values = C @ np.linalg.solve(2j * np.pi * f[:, None, None] * np.eye(len(A)) - A, B[None]) + D
    response = FrequencyResponse(
        f,
        np.moveaxis(values, 0, -1),
        system.status,
        system.inputs,
        system.outputs,
        system.input_units,
        system.output_units,
    )
    return plot_frequency_response(response, ax=ax)


@of_one("frequencies", 1)
def plot_psd(
    response: RandomResponse, *, outputs: tuple[str, ...] | None = None, ax: Any = None
) -> Any:
    """Draw power spectral densities of outputs on logarithmic scales, one panel per unit, with
    their rms values.

    outputs: names of outputs; None takes all. Error: UNKNOWN_NAME.

    >>> car = jb.presets.quarter_car(damping=1500.0)
    >>> road, body = {"road": jb.BaseMotion("road", "z")}, {"body": jb.Position("body", axis="z")}
    >>> rough = {"road": jb.vibration.RoadRoughness.iso("C").at_speed(20.0)}
    >>> jb.plots.plot_psd(
    ...     jb.random_response(
    ...         jb.linearize(car, car.reference), jb.vibration.Band(0.5, 20.0), road, body, rough
    ...     )
    ... ).get_ylabel()
    'power spectral density [m$^2$/Hz]'
    """
    names = outputs or response.outputs
    f, psd = np.asarray(response.frequencies), np.asarray(response.psd)
    panels: dict[str, dict[str, float]] = {}
    for name, value in {name: float(response[name]) for name in names}.items():
        panels.setdefault(response.units[response.outputs.index(name)], {})[name] = value
    ax = axes_or_new(ax, 7.5, 1.0 + 2.4 * len(panels))
    every = [ax, *axes_below(ax, *[1.0] * (len(panels) - 1))]
    for axes, (unit, values) in zip(every, panels.items(), strict=True):
        rows = {name: psd[response.outputs.index(name)] for name in values}
        for i, (name, value) in enumerate(values.items()):
            axes.loglog(f, rows[name], lw=1.5, label=f"{name}, rms {value:.3g} {unit}", **style(i))
        shown = unit if unit.isalpha() else f"({unit})"
        axes.set(
            ylabel=f"{'power spectral density' if len(panels) == 1 else 'PSD'} [{shown}$^2$/Hz]",
            ylim=(max(axes.get_ylim()[0], 1e-8 * max(map(np.nanmax, rows.values()))), None),
        )
        legend(axes, len(values))
    hertz(every[-1], f)
    return ax


def _above_0_hz(response: FrequencyResponse) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the frequencies above 0 Hz [Hz], for logarithmic scales, with magnitudes and unwrapped
    phases [rad]."""
    f = np.asarray(response.frequencies)
    values = np.asarray(response.values)[..., f > 0]
    return f[f > 0], np.abs(values), np.unwrap(np.angle(values))


def _pairs(response: FrequencyResponse) -> list[tuple[int, int, str]]:
    """Return (output index, input index, label) of each pair with a nonzero response."""
    size = np.asarray(response.magnitude).max(-1)
    several = len(response.inputs) > 1
    pairs = [
        (i, j, f"{y} of {u}" if several else y)
        for i, y in enumerate(response.outputs)
        for j, u in enumerate(response.inputs)
    ]
    return [
        (i, j, name) for i, j, name in pairs if not size[i, j] <= 1e-12 * size[i].max()
    ] or pairs


def _input(response: FrequencyResponse) -> str | None:
    """Return the title of a legend that names a single input; of several, each line names its."""
    return f"input: {response.inputs[0]}" if len(response.inputs) == 1 else None


def look(response: FrequencyResponse, i: int, j: int) -> dict[str, Any]:
    """Return color and dash pattern of a line: one color per output and one dash pattern per input
    if there are enough of both, else `style` by number."""
    if len(response.outputs) <= len(COLORS) and len(response.inputs) <= len(DASHES):
        return {"color": COLORS[i], "ls": DASHES[j]}
    return style(i * len(response.inputs) + j)


def lines_over_frequency(
    ax: Any, f: np.ndarray, lines: list[tuple[str, np.ndarray]], label: str
) -> Any:
    """Draw named lines over frequency [Hz] on logarithmic scales with plain numbers, and return the
    axes."""
    ax = axes_or_new(ax, 7.0, 3.6)
    for i, (name, values) in enumerate(lines):
        ax.loglog(f, values, lw=1.5, label=name, **style(i))
    ax.set_ylabel(label)
    plain_numbers(ax, np.concatenate([values for _, values in lines]))
    hertz(ax, f)
    legend(ax, len(lines))
    return ax


def hertz(ax: Any, f: np.ndarray) -> None:
    """Label a logarithmic frequency axis with plain numbers: 1, 2 and 5 of each decade, or only 1
    for more than 3000 between the ends."""
    ax.set(xlabel="frequency [Hz]", xlim=(f[0], f[-1]))
    _plain_ticks(ax.xaxis, (1.0, 2.0, 5.0) if f[-1] / f[0] < 3000 else (1.0,))


def degrees(ax: Any, what: str) -> None:
    """Label an axis of angles in degrees, with ticks at fractions of 360 degrees; call it when all
    lines are drawn."""
    from matplotlib.ticker import MultipleLocator

    ax.set_ylabel(f"{what} [degrees]")
    span = np.ptp(ax.get_ylim())
    ax.yaxis.set_major_locator(
        MultipleLocator(next((step for step in STEPS if span < MOST_TICKS * step), span))
    )


def plain_numbers(ax: Any, values: np.ndarray) -> None:
    """Write plain numbers on a logarithmic ordinate of less than two decades, which has few powers
    of ten."""
    if np.nanmax(values) < 100 * np.nanmin(values):
        _plain_ticks(ax.yaxis, (1.0, 2.0, 5.0))


def _plain_ticks(axis: Any, parts: tuple[float, ...]) -> None:
    """Set ticks of a logarithmic axis at these parts of each decade, written as plain numbers."""
    from matplotlib.ticker import LogLocator, NullFormatter

    axis.set_major_locator(LogLocator(subs=parts))
    axis.set_major_formatter("{x:g}")
    axis.set_minor_formatter(NullFormatter())
