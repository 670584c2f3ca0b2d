"""What another measuring chain, or another damping, makes of FRFs."""
