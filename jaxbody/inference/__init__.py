"""Uncertainty of fits: profiles, bands, validation."""
