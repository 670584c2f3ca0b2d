"""The steps of a reduction: full-order solves that extend the basis, error estimate, compression, certificate and error bound."""
