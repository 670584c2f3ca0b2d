"""From what an identification says of the bolts to verdicts, and what those add up to."""
