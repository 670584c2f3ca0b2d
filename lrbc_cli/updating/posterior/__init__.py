"""The uncertainty after a fit: covariance, sampling of tight or loose, intervals; and its prediction before a measurement."""
