"""Measured data: files, formats, units, sampling, repairs."""
