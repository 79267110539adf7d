"""Numerical methods without mechanics: batches in lanes, eigenproblems, blocks of Runge-Kutta
steps, Gauss collocation."""
