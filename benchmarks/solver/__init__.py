"""The solver and its derivatives."""
