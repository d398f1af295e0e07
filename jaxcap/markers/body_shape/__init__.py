"""Body shape from markers."""
