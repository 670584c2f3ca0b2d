"""The reduced model of a campaign: its cache, its memory, its FRFs."""
