"""The dynamic stiffness of the full model: its orderings, the fill of its factors, its factorisations."""
