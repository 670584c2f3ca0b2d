"""Turns the settings of a campaign into the method of identification: the only place that knows what ``auto`` and a missing key mean."""
