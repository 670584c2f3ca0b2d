"""FRFs of the model as a function of the unknowns, and the cost of their differences from measured FRFs."""
