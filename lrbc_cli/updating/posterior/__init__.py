"""The uncertainty after a fit: covariance, sampling of tight or loose, intervals; and what can be predicted beforehand."""
