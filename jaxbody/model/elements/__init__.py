"""Springs, bushings, torsion and contact: a deformation e, energy V(e), dissipation R(e, e_dot)."""
