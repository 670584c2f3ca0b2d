"""Causes of jobs that no state of the bolts explains: other air, another clock, or something left on the structure."""
