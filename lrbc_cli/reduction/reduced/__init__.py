"""The reduced model: its port FRFs, global factors, modes and time domain, and its solution at many lines."""
