"""What a fit leaves uncertain: covariance, tight or loose by sampling, intervals; and what can be known beforehand."""
