"""Computing without physics: batches in lanes, eigenproblems, Dormand-Prince, Gauss collocation."""
