"""The statistical model: errors of measurement and model, lines that count, residuals, priors."""
