"""Figures and sections of the page, each from records."""
