"""Modal testing: records to frequency responses, and responses to modes, with standard errors;
public as jaxbody.modal."""

from jaxbody.core.compilation.late_imports import late_names

_NAMES = {
    "ambient_spectra": ("positive_spectra",),
    "identified_modes": ("IdentifiedModes", "identify_modes"),
    "response_estimates": ("EstimatedResponse", "estimate_responses", "random_error"),
    "segments": ("ImpactWindow",),
}
__getattr__, __dir__, __all__ = late_names("jaxbody.fitting.modal", _NAMES)
