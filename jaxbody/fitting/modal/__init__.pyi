"""What `jaxbody.fitting.modal` offers, written by `python tests/stubs.py`."""

from jaxbody.fitting.modal.ambient_spectra import positive_spectra as positive_spectra
from jaxbody.fitting.modal.identified_modes import IdentifiedModes as IdentifiedModes
from jaxbody.fitting.modal.identified_modes import identify_modes as identify_modes
from jaxbody.fitting.modal.response_estimates import EstimatedResponse as EstimatedResponse
from jaxbody.fitting.modal.response_estimates import estimate_responses as estimate_responses
from jaxbody.fitting.modal.response_estimates import random_error as random_error
from jaxbody.fitting.modal.segments import ImpactWindow as ImpactWindow
