"""Modes and operational deflection shapes of the updated model of a job, for its result files."""
