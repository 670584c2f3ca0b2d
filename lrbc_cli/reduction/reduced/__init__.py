"""The reduced model: FRFs for any values of terms and global factors, modes, first-order form, and fast solution at many lines."""
