"""Design optimization, Pareto fronts, sweeps, tolerances, sensitivities, and objectives
for them."""
