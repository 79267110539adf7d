"""Free parameters of fit and tune: ties, transforms, bounds, priors, units, spaces."""
