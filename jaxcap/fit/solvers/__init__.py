"""Minimise sums of squares on manifolds."""
