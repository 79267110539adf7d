"""Free parameters of fit and tune: ties, transforms, bounds, design spaces."""
