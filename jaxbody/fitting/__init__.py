"""Fits: parameters, experiments, residuals, searches, results; uncertainty, validation."""

from jaxbody.core.compilation.late_imports import late_names

_NAMES = {
    "bands": ("confidence_bands",),
    "coverages": ("interval_coverage",),
    "experiments.diagnoses": ("diagnose",),
    "experiments.experiments": ("Experiment",),
    "experiments.measured_responses": ("MeasuredModes", "MeasuredResponse"),
    "experiments.measured_stiffnesses": ("MeasuredStiffness",),
    "experiments.measured_suspension_curves": ("MeasuredCurves",),
    "experiments.plausibilities": ("plausibility",),
    "fit_results": ("Fit",),
    "fitters": ("fit",),
    "model_comparisons": ("evidence", "leave_one_out"),
    "multistarts": ("Multistart", "multistart"),
    "parameters.priors": ("LogNormal",),
    "planning.choices": ("choose",),
    "planning.criteria": ("criterion",),
    "planning.expected_fits": ("expected_fit", "information"),
    "planning.further_measurements": ("further_measurements",),
    "posteriors": ("Posterior", "posterior"),
    "profiles": ("profile_likelihood",),
    "shootings": ("multiple_shooting",),
    "validations": ("validate",),
}
__getattr__, __dir__, __all__ = late_names("jaxbody.fitting", _NAMES)
