"""One identification: the measurement of a job, its unknowns and weights, the fit, and the outcome."""
