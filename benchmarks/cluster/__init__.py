"""Many jobs on the workers of a cluster."""
