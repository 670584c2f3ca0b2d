"""How another measuring chain, or another damping, changes FRFs."""
