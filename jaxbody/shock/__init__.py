"""Shock and earthquake: response spectra, maxima, records that meet them; peaks and fatigue."""
