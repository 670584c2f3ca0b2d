"""The full-order finite-element model: DOFs, units, operators, low-rank terms and their parameters, calibration factors."""
