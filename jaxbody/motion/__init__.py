"""Trajectories by the equations of motion, and what sensors read along them."""
