"""The reduced model: its port FRFs, global factors, modes, time domain, and how it is solved at many lines."""
