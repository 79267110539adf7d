"""Small motions: matrices, ports, state space, modes of every kind."""
