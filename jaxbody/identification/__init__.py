"""Fits: residuals, searches, results, several starts, multiple shooting."""
