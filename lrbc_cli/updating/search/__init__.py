"""The search for the optimum: optimisers, start values by scans and tables, coarse profiles, smoothed spectra, the L-curve.

A *descent* is one run of an optimiser, its *end* the place where it stops, and a *place* a value of theta at which one begins.
"""
