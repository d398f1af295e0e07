"""A body in its markers."""
