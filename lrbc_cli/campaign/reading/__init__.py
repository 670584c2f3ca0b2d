"""Reads the model of a campaign (matrices, terms, loads, outputs, bolts) and checks that its parts fit together; begin with ``inputs``."""
