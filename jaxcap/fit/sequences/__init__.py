"""Many frames and their shared unknowns as one least-squares problem."""
