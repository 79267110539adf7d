"""Foundations: errors, checks of arguments, printed results, units; JAX, workers. No mechanics."""
