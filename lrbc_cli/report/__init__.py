"""Figures, tables and the HTML page. Reads result files only, and never computes physics."""
