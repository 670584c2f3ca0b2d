"""Hypotheses on a measurement that the model does not explain: places, coordinates, matrices, damping, springs, supports, loose bolts."""
