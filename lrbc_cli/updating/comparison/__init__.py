"""Compares measured with computed FRFs: correlation figures, and constant factors between them."""
