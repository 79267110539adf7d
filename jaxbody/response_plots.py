"""Pictures of responses: frequency response, transmissibility and power spectral density; each draws into `ax` and returns the axes."""
