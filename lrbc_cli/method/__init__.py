"""Resolves the settings of a campaign: the only place that knows what ``auto`` and an absent key mean."""
