"""Compares measurements with the model before anything is identified, for ``lrbc check``; begin with ``first_look``."""
