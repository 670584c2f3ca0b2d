"""Measurements beside the model before anything is identified, for ``lrbc check``."""
