"""Plots with matplotlib: each function draws into `ax`, or a new figure, and returns the axes; it shows no window and changes no
settings."""

from jaxbody.plots.design_plots import plot_front, plot_tolerances, plot_tornado, plot_tuning
from jaxbody.plots.fit_plots import plot_autocorrelation, plot_correlations, plot_history, plot_profile
from jaxbody.plots.measured_plots import plot_fit
from jaxbody.plots.mode_plots import plot_branches, plot_mode_energies
from jaxbody.plots.model_plots import draw_mode, draw_model
from jaxbody.plots.motion_plots import load_path, plot_forces, plot_trajectory
from jaxbody.plots.response_plots import plot_frequency_response, plot_psd, plot_transmissibility

__all__ = [
    "draw_mode",
    "draw_model",
    "load_path",
    "plot_autocorrelation",
    "plot_branches",
    "plot_correlations",
    "plot_fit",
    "plot_forces",
    "plot_frequency_response",
    "plot_front",
    "plot_history",
    "plot_mode_energies",
    "plot_profile",
    "plot_psd",
    "plot_tolerances",
    "plot_tornado",
    "plot_trajectory",
    "plot_transmissibility",
    "plot_tuning",
]
