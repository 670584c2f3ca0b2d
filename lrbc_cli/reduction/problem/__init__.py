"""What is reduced: the full model about its reference state, the basis, the values of terms, and what errors are relative to."""
