"""Global factors of the reference model from one measurement, and which of them it cannot distinguish."""
