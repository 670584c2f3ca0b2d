"""Whole sections of the page: its head, the verdicts, a part for each job, what to cite."""
