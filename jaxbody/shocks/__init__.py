"""Shock and earthquake: response spectra, maxima by spectra, floor spectra, design spectra and
records that meet them."""
