"""Reports of learned bodies."""
