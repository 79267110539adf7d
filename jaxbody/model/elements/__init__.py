"""Springs, bushings, torsion and contact: a deformation e(poses), V(e) and R(e, e_dot)."""
