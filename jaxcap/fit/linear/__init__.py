"""Linear operators with structure, and solvers of their systems."""
