"""Comparison of measured and computed FRFs: correlation figures, and constant factors between them (units, signs, delays)."""
