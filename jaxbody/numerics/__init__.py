"""Computing without physics: batches in lanes, eigenproblems, blocks of Runge-Kutta steps,
Gauss collocation."""
