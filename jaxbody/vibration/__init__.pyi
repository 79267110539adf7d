"""What `jaxbody.vibration` offers, written by `python tests/stubs.py`."""

from jaxbody.vibration.backbones import backbone_curves as backbone_curves
from jaxbody.vibration.comfort_weightings import frequency_weighting as frequency_weighting
from jaxbody.vibration.comfort_weightings import weighted_response as weighted_response
from jaxbody.vibration.comfort_weightings import weighted_signal as weighted_signal
from jaxbody.vibration.damped_modes import complex_modes as complex_modes
from jaxbody.vibration.damped_modes import whirl as whirl
from jaxbody.vibration.dynamic_stiffnesses import dynamic_stiffness as dynamic_stiffness
from jaxbody.vibration.frequency_responses import frequency_response as frequency_response
from jaxbody.vibration.linearizations import linearize as linearize
from jaxbody.vibration.modal_energies import mode_energies as mode_energies
from jaxbody.vibration.mode_branches import mac as mac
from jaxbody.vibration.mode_branches import track_modes as track_modes
from jaxbody.vibration.mount_axes import elastic_axes as elastic_axes
from jaxbody.vibration.mount_axes import torque_roll_axis as torque_roll_axis
from jaxbody.vibration.natural_modes import modes as modes
from jaxbody.vibration.random_responses import random_response as random_response
from jaxbody.vibration.road_spectra import RoadRoughness as RoadRoughness
from jaxbody.vibration.road_spectra import road_profile as road_profile
from jaxbody.vibration.spectra import Band as Band
from jaxbody.vibration.spectra import CrossPSD as CrossPSD
from jaxbody.vibration.spectra import PSD as PSD
from jaxbody.vibration.spectra import PowerLaw as PowerLaw
from jaxbody.vibration.spectra import Spectrum as Spectrum
from jaxbody.vibration.spins import linearize_spin as linearize_spin
from jaxbody.vibration.wheel_compliances import wheel_compliance as wheel_compliance
