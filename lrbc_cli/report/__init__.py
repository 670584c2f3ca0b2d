"""Figures, tables and the HTML page; reads result files only, never computes physics."""
