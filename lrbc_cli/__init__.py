"""Find the loose bolts of a structure from measured FRFs by low-rank parametric model order reduction."""

__version__ = "0.1.0"
