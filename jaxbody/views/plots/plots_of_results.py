"""What `plot` of each result draws: one function of the plots for each class, with its caption
in reports."""

from collections.abc import Callable
from typing import Any, NamedTuple

from jaxbody.design.fronts import Front
from jaxbody.design.sensitivity_analyses import Sensitivities
from jaxbody.design.tolerance_analyses import Tolerances
from jaxbody.design.tuning_results import Tuning
from jaxbody.fitting.confidence_bands import Bands
from jaxbody.fitting.coverages import Coverage
from jaxbody.fitting.experiments.diagnoses import Diagnosis
from jaxbody.fitting.experiments.measurements import Measurement
from jaxbody.fitting.fit_results import Fit
from jaxbody.fitting.multistarts import Multistart
from jaxbody.fitting.profiles import Profile
from jaxbody.fitting.validations import Validation
from jaxbody.mechanics.equilibria import Equilibrium
from jaxbody.mechanics.preloads import Preload
from jaxbody.mechanics.several_equilibria import Equilibria
from jaxbody.mechanics.static_load_cases import LoadCases
from jaxbody.model.inputs.base_motions import Recovered
from jaxbody.model.models import Model
from jaxbody.motion.trajectories import Trajectory
from jaxbody.records.records import Record
from jaxbody.shock.fatigue_damages import FatigueDamage
from jaxbody.shock.matched_records import MatchedRecord
from jaxbody.shock.peak_factors import PeakFactors
from jaxbody.shock.response_spectra import ResponseSpectrum
from jaxbody.shock.shock_spectra import ShockSpectrum
from jaxbody.shock.spectrum_responses import SpectrumResponse
from jaxbody.suspension.alignment_curves import SuspensionCurves
from jaxbody.suspension.assemblies import Assembly
from jaxbody.vibration.backbone_curves import Backbones
from jaxbody.vibration.comfort_weightings import WeightedSignal
from jaxbody.vibration.damped_modes import ComplexModes
from jaxbody.vibration.dynamic_stiffnesses import DynamicStiffness
from jaxbody.vibration.frequency_responses import FrequencyResponse
from jaxbody.vibration.linearizations import LinearSystem
from jaxbody.vibration.modal_energies import ModeEnergies
from jaxbody.vibration.mode_branches import Branches
from jaxbody.vibration.mount_axes import ElasticAxes, TorqueRollAxis
from jaxbody.vibration.natural_modes import Modes
from jaxbody.vibration.random_responses import RandomResponse
from jaxbody.vibration.state_spaces import StateSpace
from jaxbody.views.plots import (
    design_plots,
    fit_plots,
    measured_plots,
    mode_plots,
    model_plots,
    motion_plots,
    response_plots,
    shock_plots,
    statics_plots,
)


class Picture(NamedTuple):
    """The function that draws the results of a class, and a caption."""

    draw: Callable[..., Any]
    caption: str


PICTURES: dict[type, Picture] = {
    Model: Picture(model_plots.draw_model, "The model in its reference pose"),
    Equilibrium: Picture(statics_plots.draw_equilibrium, "The equilibrium"),
    Equilibria: Picture(statics_plots.plot_equilibria, "Energies of the equilibria"),
    LoadCases: Picture(statics_plots.plot_load_cases, "Strokes and forces in each load case"),
    Preload: Picture(statics_plots.plot_preload, "Changes of free lengths"),
    Assembly: Picture(statics_plots.draw_assembly, "The model with its loops closed"),
    SuspensionCurves: Picture(statics_plots.plot_suspension_curves, "Curves over travel"),
    Trajectory: Picture(motion_plots.plot_trajectory, "Motion of the bodies"),
    LinearSystem: Picture(mode_plots.plot_matrix, "The matrices"),
    Modes: Picture(mode_plots.plot_modes, "Shapes of the modes"),
    ComplexModes: Picture(mode_plots.plot_poles, "Poles"),
    ModeEnergies: Picture(mode_plots.plot_mode_energies, "Shares of kinetic energy"),
    Branches: Picture(mode_plots.plot_branches, "Modes over the parameter"),
    Backbones: Picture(mode_plots.plot_backbones, "Frequency over amplitude"),
    ElasticAxes: Picture(mode_plots.plot_elastic_axes, "Elastic axes"),
    TorqueRollAxis: Picture(mode_plots.plot_torque_roll_axis, "Torque roll axis"),
    FrequencyResponse: Picture(response_plots.plot_frequency_response, "Magnitude and phase"),
    DynamicStiffness: Picture(
        response_plots.plot_element_stiffness, "Dynamic stiffness and loss angle"
    ),
    RandomResponse: Picture(response_plots.plot_psd, "Spectral densities"),
    StateSpace: Picture(response_plots.plot_state_space, "Transfer functions"),
    ShockSpectrum: Picture(shock_plots.plot_shock_spectrum, "Largest responses over frequency"),
    ResponseSpectrum: Picture(shock_plots.plot_response_spectrum, "The spectrum"),
    MatchedRecord: Picture(
        shock_plots.plot_matched_record, "The record, and its spectrum beside the one to meet"
    ),
    SpectrumResponse: Picture(
        shock_plots.plot_spectrum_response, "Largest outputs, and the shares of the modes"
    ),
    PeakFactors: Picture(shock_plots.plot_peak_factors, "Largest values to be expected"),
    FatigueDamage: Picture(shock_plots.plot_fatigue_damage, "Damage"),
    WeightedSignal: Picture(response_plots.plot_weighted_signal, "Weighted acceleration and dose"),
    Record: Picture(measured_plots.plot_record, "The record"),
    Recovered: Picture(measured_plots.plot_recovered, "Motion of the base, and what was removed"),
    Measurement: Picture(measured_plots.plot_measurement, "What was measured"),
    Diagnosis: Picture(measured_plots.plot_diagnosis, "Gain, delay and residual of each channel"),
    Fit: Picture(measured_plots.plot_fit, "Measured and fitted"),
    Bands: Picture(measured_plots.plot_bands, "Confidence bands"),
    Validation: Picture(measured_plots.plot_validation, "Measured and predicted"),
    Multistart: Picture(fit_plots.plot_multistart, "Cost of the optima"),
    Profile: Picture(fit_plots.plot_profile, "Profile of the cost"),
    Coverage: Picture(fit_plots.plot_coverage, "Share of intervals that contain the true value"),
    Tuning: Picture(design_plots.plot_tuning, "The objective at each trial"),
    Front: Picture(design_plots.plot_front, "The front"),
    Sensitivities: Picture(design_plots.plot_tornado, "The strongest parameters"),
    Tolerances: Picture(design_plots.plot_tolerances, "Distribution under tolerances"),
}


def picture_of(kind: type) -> Picture:
    """The picture of a class, or of the first of its base classes that has one."""
    for base in kind.__mro__:
        if base in PICTURES:
            return PICTURES[base]
    raise AttributeError(f"'{kind.__name__}' has no plot: print it")
