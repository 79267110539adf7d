"""Small motions: matrices, inputs and outputs, state space, modes of every kind."""
