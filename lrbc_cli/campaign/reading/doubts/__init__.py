"""Warnings about contradictions within a campaign, one kind per module: springs, places, numbering, materials, settings, names."""
