"""Figures, tables and the HTML page, from the result files only: nothing is identified or judged here."""
