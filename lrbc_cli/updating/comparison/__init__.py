"""Measured FRFs beside computed ones: correlation figures, and constant factors between them."""
