"""Changes of FRFs that no bolt causes: another measuring chain (window, filter, clock, double hit) or another damping."""
