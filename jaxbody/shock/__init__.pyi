"""What `jaxbody.shock` offers, written by `python tests/stubs.py`."""

from jaxbody.shock.fatigue_damages import SNCurve as SNCurve
from jaxbody.shock.fatigue_damages import fatigue_damage as fatigue_damage
from jaxbody.shock.floor_spectra import floor_spectrum as floor_spectrum
from jaxbody.shock.matched_records import spectrum_compatible_record as spectrum_compatible_record
from jaxbody.shock.peak_factors import level_crossings as level_crossings
from jaxbody.shock.peak_factors import peak_factor as peak_factor
from jaxbody.shock.response_spectra import ASCE7 as ASCE7
from jaxbody.shock.response_spectra import DesignSpectrum as DesignSpectrum
from jaxbody.shock.response_spectra import Eurocode8 as Eurocode8
from jaxbody.shock.response_spectra import ResponseSpectrum as ResponseSpectrum
from jaxbody.shock.shock_spectra import shock_spectrum as shock_spectrum
from jaxbody.shock.spectrum_responses import spectrum_response as spectrum_response
