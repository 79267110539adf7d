"""T, V and R, their derivatives, and the equations of motion."""
