"""Uncertainty of fits: profiles, bands, coverage, validation."""
