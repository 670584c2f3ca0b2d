"""The reduced model of a campaign: obtaining it (``stage``), its cache, and the memory it needs."""
