"""All jobs of a campaign: what each rests on, running, judging, writing."""
