"""The updated model of a job in motion: its modes and its deflection shapes."""
