"""From measured FRFs to verdicts: statistical model, search for the most probable state, posterior, and judgement of the bolts."""
