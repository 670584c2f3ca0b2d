"""Sparse factorisations of the full-order dynamic stiffness: fill-reducing orderings, prediction of fill, solvers."""
