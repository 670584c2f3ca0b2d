"""What a campaign's settings come to: the one place that knows what ``auto`` and an absent key mean."""
