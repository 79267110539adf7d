"""Plots with matplotlib: each function draws into `ax`, or a new figure, and returns the axes; it
shows no window and changes no settings. `result.plot()` draws a result with the function for its
class, from `jaxbody.views.plots.plots_of_results`."""

from jaxbody.views.plots.design_plots import plot_front, plot_tolerances, plot_tornado, plot_tuning
from jaxbody.views.plots.fit_plots import (
    plot_autocorrelation,
    plot_correlations,
    plot_history,
    plot_interval_coverage,
    plot_multistart,
    plot_profile_likelihood,
)
from jaxbody.views.plots.measured_plots import (
    plot_confidence_bands,
    plot_diagnosis,
    plot_fit,
    plot_measurement,
    plot_record,
    plot_recovered,
    plot_validation,
)
from jaxbody.views.plots.mode_plots import (
    plot_backbone_curves,
    plot_elastic_axes,
    plot_matrix,
    plot_mode_energies,
    plot_modes,
    plot_poles,
    plot_torque_roll_axis,
    plot_tracked_modes,
)
from jaxbody.views.plots.model_plots import draw_mode, draw_model
from jaxbody.views.plots.motion_plots import (
    plot_energies,
    plot_force_strokes,
    plot_forces,
    plot_phases,
    plot_trajectory,
)
from jaxbody.views.plots.response_plots import (
    plot_dynamic_stiffness,
    plot_element_stiffness,
    plot_frequency_response,
    plot_psd,
    plot_state_space,
    plot_transmissibility,
    plot_weighted_signal,
)
from jaxbody.views.plots.shock_plots import (
    plot_fatigue_damage,
    plot_peak_factors,
    plot_response_spectrum,
    plot_shock_spectrum,
    plot_spectrum_compatible_record,
    plot_spectrum_response,
)
from jaxbody.views.plots.statics_plots import (
    draw_assembly,
    draw_equilibrium,
    plot_equilibria,
    plot_load_cases,
    plot_load_path,
    plot_preload,
    plot_suspension_curves,
)

__all__ = [
    "draw_assembly",
    "draw_equilibrium",
    "draw_mode",
    "draw_model",
    "plot_autocorrelation",
    "plot_backbone_curves",
    "plot_confidence_bands",
    "plot_correlations",
    "plot_diagnosis",
    "plot_dynamic_stiffness",
    "plot_elastic_axes",
    "plot_element_stiffness",
    "plot_energies",
    "plot_equilibria",
    "plot_fatigue_damage",
    "plot_fit",
    "plot_force_strokes",
    "plot_forces",
    "plot_frequency_response",
    "plot_front",
    "plot_history",
    "plot_interval_coverage",
    "plot_load_cases",
    "plot_load_path",
    "plot_matrix",
    "plot_measurement",
    "plot_mode_energies",
    "plot_modes",
    "plot_multistart",
    "plot_peak_factors",
    "plot_phases",
    "plot_poles",
    "plot_preload",
    "plot_profile_likelihood",
    "plot_psd",
    "plot_record",
    "plot_recovered",
    "plot_response_spectrum",
    "plot_shock_spectrum",
    "plot_spectrum_compatible_record",
    "plot_spectrum_response",
    "plot_state_space",
    "plot_suspension_curves",
    "plot_tolerances",
    "plot_tornado",
    "plot_torque_roll_axis",
    "plot_tracked_modes",
    "plot_trajectory",
    "plot_transmissibility",
    "plot_tuning",
    "plot_validation",
    "plot_weighted_signal",
]


def __dir__():
    return __all__
