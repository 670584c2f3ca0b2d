"""From measured FRFs to verdicts: the statistical model, the search for what is most probable, its posterior, and judging."""
