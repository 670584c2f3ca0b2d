"""Model reduction, the first link of the chain: ``build`` makes a certified reduced model, ``predict`` estimates memory and time."""
