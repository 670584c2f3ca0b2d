"""Predicts for ``lrbc plan`` which bolts planned responses and hammer points can detect; begin with ``plan``."""
