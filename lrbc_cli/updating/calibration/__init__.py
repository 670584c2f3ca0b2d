"""Calibration: global factors of the reference model from one measurement, and which of them it does not identify separately."""
