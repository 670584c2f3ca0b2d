"""The steps of a reduction: full-order lines that expand the basis, the error estimate, compression, the certificate."""
