"""Fits: residuals, searches, results, several initial guesses, multiple shooting."""
