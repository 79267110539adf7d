"""Fits: parameters, experiments, residuals, searches, results; uncertainty, validation."""
