"""The statistical model: errors of measurement and model, choice of the lines, residuals and their covariance, priors."""
