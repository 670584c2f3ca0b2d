"""What is reduced: the full model about its reference state, the basis, the values of terms, and the norms of errors."""
