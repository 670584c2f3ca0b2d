"""All jobs of a campaign: what each result rests on, running, judging and writing."""
