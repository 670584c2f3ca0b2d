"""The updated model of a job as it moves: its modes and its deflection shapes."""
