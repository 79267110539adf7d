"""The plots of results: `result.plot()` calls the function of `jaxbody.views.plots` whose first
argument is of the result's class. Each function has a caption for reports."""

from collections.abc import Callable
from typing import Any, NamedTuple, get_type_hints

from jaxbody.views import plots


class Picture(NamedTuple):
    """The function that draws the results of a class, and its caption."""

    draw: Callable[..., Any]
    caption: str


CAPTIONS: dict[Callable[..., Any], str] = {
    plots.draw_model: "The model in its reference pose",
    plots.draw_equilibrium: "The equilibrium",
    plots.plot_equilibria: "Energies of the equilibria",
    plots.plot_load_cases: "Strokes and forces in each load case",
    plots.plot_preload: "Changes of free lengths",
    plots.draw_assembly: "The model with its loops closed",
    plots.plot_suspension_curves: "Curves over travel",
    plots.plot_trajectory: "Motion of the bodies",
    plots.plot_matrix: "The matrices",
    plots.plot_modes: "Shapes of the modes",
    plots.plot_poles: "Poles",
    plots.plot_mode_energies: "Shares of kinetic energy",
    plots.plot_tracked_modes: "Modes over the parameter",
    plots.plot_backbone_curves: "Frequency over amplitude",
    plots.plot_elastic_axes: "Elastic axes",
    plots.plot_torque_roll_axis: "Torque roll axis",
    plots.plot_frequency_response: "Magnitude and phase",
    plots.plot_element_stiffness: "Dynamic stiffness and loss angle",
    plots.plot_psd: "Spectral densities",
    plots.plot_state_space: "Transfer functions",
    plots.plot_shock_spectrum: "Largest responses over frequency",
    plots.plot_response_spectrum: "The spectrum",
    plots.plot_spectrum_compatible_record: "The record, and its spectrum beside the one to meet",
    plots.plot_spectrum_response: "Largest outputs, and the shares of the modes",
    plots.plot_peak_factors: "Largest values to be expected",
    plots.plot_fatigue_damage: "Damage",
    plots.plot_weighted_signal: "Weighted acceleration and dose",
    plots.plot_record: "The record",
    plots.plot_recovered: "Motion of the base, and what was removed",
    plots.plot_measurement: "What was measured",
    plots.plot_estimated_response: "Estimated responses, with 95 % bands and coherence",
    plots.plot_identified_modes: "Stabilization diagram",
    plots.plot_diagnosis: "Gain, delay and residual of each channel",
    plots.plot_fit: "Measured and fitted",
    plots.plot_confidence_bands: "Confidence bands",
    plots.plot_validation: "Measured and predicted",
    plots.plot_multistart: "Cost of the optima",
    plots.plot_profile_likelihood: "Profile of the cost",
    plots.plot_posterior: "Draws of the posterior, with the normal approximation and the priors",
    plots.plot_interval_coverage: "Share of intervals that contain the true value",
    plots.plot_choice: "Shares of candidates in the continuous design",
    plots.plot_tuning: "The objective at each trial",
    plots.plot_front: "The front",
    plots.plot_tornado: "The strongest parameters",
    plots.plot_tolerances: "Distribution under tolerances",
}


# {class of the first argument of a function, which it draws: its picture}
PICTURES = {
    next(iter(get_type_hints(draw).values())): Picture(draw, caption)
    for draw, caption in CAPTIONS.items()
}


def picture_of(kind: type) -> Picture:
    """Return the picture of a class, or of its first base class with a picture."""
    for base in kind.__mro__:
        if base in PICTURES:
            return PICTURES[base]
    raise AttributeError(f"'{kind.__name__}' has no plot: print it")
