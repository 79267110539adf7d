"""Force laws written out for NumPy: F(x) of springs and dampers without memory."""

import numpy as np

import jaxbody as jb


def force(law, x):
    """F(x) of a law."""
    if law is None:
        return 0.0
    if isinstance(law, jb.laws.Sum):
        return sum(force(term, x) for term in law.terms)
    if isinstance(law, jb.laws.Linear):
        return float(law.coefficient) * x
    if isinstance(law, jb.laws.Polynomial):
        return sum(float(c) * x ** (i + 1) for i, c in enumerate(law.coefficients))
    if isinstance(law, jb.laws.TensionOnly):
        return float(law.stiffness) * max(x, 0.0)
    if isinstance(law, jb.laws.BumpStop):
        d, w, k = -x - float(law.gap), float(law.engagement), float(law.stiffness)
        return -k * (0.0 if d < 0 else d * d / (2 * w) if d < w else d - w / 2)
    if isinstance(law, jb.laws.Digressive):
        fast, slow = float(law.fast), float(law.slow)
        return fast * x + (slow - fast) * x / np.hypot(1.0, x / float(law.knee))
    if isinstance(law, jb.laws.Friction):
        return float(law.level) * x / np.hypot(x, float(law.velocity))
    if isinstance(law, jb.laws.TwoSided):
        return force(law.bump if x < 0 else law.rebound, x)
    raise TypeError(type(law).__name__)
