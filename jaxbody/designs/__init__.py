"""Tuning: tune, pareto, sweep, tolerances, objectives."""
