"""Identification of one job: its measurement, unknowns, weights, fit and result. Begin with ``identify`` and ``job``."""
