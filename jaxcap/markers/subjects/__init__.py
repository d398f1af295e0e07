"""Several people and rigid props in one recording."""
