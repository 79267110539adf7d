"""What residuals say of estimates: noise models, covariance, robust losses. No mechanics."""
