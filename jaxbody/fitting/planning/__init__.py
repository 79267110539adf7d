"""Plans of measurements: the fit to expect from them, criteria, the best choice among many."""
