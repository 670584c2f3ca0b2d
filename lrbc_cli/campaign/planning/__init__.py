"""What planned responses and hammer points can show of the bolts, for ``lrbc plan``."""
