"""From measured FRFs to verdicts: the statistical model, the search for the most probable state, its posterior, and judging."""
