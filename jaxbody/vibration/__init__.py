"""Small motions: matrices, state space, modes; responses to harmonic and random excitation."""

from jaxbody.core.compilation.late_imports import late_names

_NAMES = {
    "backbones": ("backbone_curves",),
    "comfort_weightings": ("frequency_weighting", "weighted_response", "weighted_signal"),
    "damped_modes": ("complex_modes", "whirl"),
    "dynamic_stiffnesses": ("dynamic_stiffness",),
    "frequency_responses": ("frequency_response",),
    "linearizations": ("linearize",),
    "modal_energies": ("mode_energies",),
    "mode_branches": ("mac", "track_modes"),
    "mount_axes": ("elastic_axes", "torque_roll_axis"),
    "natural_modes": ("modes",),
    "random_responses": ("random_response",),
    "road_spectra": ("RoadRoughness", "road_profile"),
    "spectra": ("Band", "CrossPSD", "PSD", "PowerLaw", "Spectrum"),
    "spins": ("linearize_spin",),
    "wheel_compliances": ("wheel_compliance",),
}
__getattr__, __dir__, __all__ = late_names("jaxbody.vibration", _NAMES)
