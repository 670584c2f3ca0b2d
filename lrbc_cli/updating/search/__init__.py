"""Where descents begin and how they run: optimisers, levels, tables, wider peaks, the L-curve."""
