"""Joint limits."""
