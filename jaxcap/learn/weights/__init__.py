"""Optimisation of skinning weights and rest vertices."""
