"""The statistical model: errors of measurement and model, the lines that count, residuals, priors."""
