"""Turns the evidence of an identification into verdicts on bolts, and the verdicts into an outcome (all-clear or not)."""
