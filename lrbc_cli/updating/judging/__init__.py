"""From the evidence of an identification to verdicts on bolts, and from the verdicts to an outcome (all-clear or not)."""
