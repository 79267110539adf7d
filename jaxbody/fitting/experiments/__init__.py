"""Measurements, and the predictions of a model for them; checks of records and models before
a fit."""
