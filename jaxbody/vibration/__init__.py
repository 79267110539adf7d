"""Small motions: matrices, state space, modes; responses to harmonic and random excitation."""
