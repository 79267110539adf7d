"""Design: tune, pareto, sweep, tolerances, objectives."""
