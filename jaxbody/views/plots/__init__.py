"""Plots with matplotlib: each function draws into `ax`, or a new figure, and returns the axes; it
shows no window and changes no settings. `result.plot()` draws a result with the function for its
class, from `jaxbody.views.plots.plots_of_results`."""

from jaxbody.core.compilation.late_imports import late_names

_NAMES = {
    "design_plots": (
        "plot_front",
        "plot_tolerances",
        "plot_tornado",
        "plot_tuning",
    ),
    "fit_plots": (
        "plot_autocorrelation",
        "plot_choice",
        "plot_correlations",
        "plot_history",
        "plot_interval_coverage",
        "plot_multistart",
        "plot_posterior",
        "plot_profile_likelihood",
    ),
    "measured_plots": (
        "plot_confidence_bands",
        "plot_diagnosis",
        "plot_fit",
        "plot_measurement",
        "plot_record",
        "plot_recovered",
        "plot_validation",
    ),
    "modal_plots": (
        "plot_estimated_response",
        "plot_identified_modes",
    ),
    "mode_plots": (
        "plot_backbone_curves",
        "plot_elastic_axes",
        "plot_matrix",
        "plot_mode_energies",
        "plot_modes",
        "plot_poles",
        "plot_torque_roll_axis",
        "plot_tracked_modes",
    ),
    "model_plots": (
        "draw_mode",
        "draw_model",
    ),
    "motion_plots": (
        "plot_energies",
        "plot_force_strokes",
        "plot_forces",
        "plot_phases",
        "plot_trajectory",
    ),
    "response_plots": (
        "plot_dynamic_stiffness",
        "plot_element_stiffness",
        "plot_frequency_response",
        "plot_psd",
        "plot_state_space",
        "plot_transmissibility",
        "plot_weighted_signal",
    ),
    "shock_plots": (
        "plot_fatigue_damage",
        "plot_peak_factors",
        "plot_response_spectrum",
        "plot_shock_spectrum",
        "plot_spectrum_compatible_record",
        "plot_spectrum_response",
    ),
    "statics_plots": (
        "draw_assembly",
        "draw_equilibrium",
        "plot_equilibria",
        "plot_load_cases",
        "plot_load_path",
        "plot_preload",
        "plot_suspension_curves",
    ),
}
__getattr__, __dir__, __all__ = late_names("jaxbody.views.plots", _NAMES)
