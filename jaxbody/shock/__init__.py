"""Shock and earthquake: response spectra, maxima, records that meet them; peaks and fatigue."""

from jaxbody.core.compilation.late_imports import late_names

_NAMES = {
    "fatigue_damages": ("SNCurve", "fatigue_damage"),
    "floor_spectra": ("floor_spectrum",),
    "matched_records": ("spectrum_compatible_record",),
    "peak_factors": ("level_crossings", "peak_factor"),
    "response_spectra": ("ASCE7", "DesignSpectrum", "Eurocode8", "ResponseSpectrum"),
    "shock_spectra": ("shock_spectrum",),
    "spectrum_responses": ("spectrum_response",),
}
__getattr__, __dir__, __all__ = late_names("jaxbody.shock", _NAMES)
