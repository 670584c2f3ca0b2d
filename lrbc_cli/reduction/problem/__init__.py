"""The problem that a reduction solves: full model at reference values of its terms, basis, certificate vectors, norms of errors."""
