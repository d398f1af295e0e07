"""Priors: likely poses, limits, symmetry, smooth motion."""
