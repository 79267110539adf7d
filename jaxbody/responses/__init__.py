"""Responses to harmonic and random excitation, spectra, roads and comfort."""
