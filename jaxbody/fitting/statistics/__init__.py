"""Statistics of estimates from residuals: noise models, covariance, robust losses. No mechanics."""
