"""T, V and R, their derivatives, the equations of motion; equilibria, load cases, preload."""
