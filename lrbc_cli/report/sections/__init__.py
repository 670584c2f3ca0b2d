"""Sections of the page on all results: its head, the verdicts, the jobs, and the methods to cite."""
