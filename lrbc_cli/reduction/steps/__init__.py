"""The steps of a reduction: lines of the full model that expand the basis, the estimate, compression, the certificate."""
