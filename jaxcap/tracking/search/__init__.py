"""Searches for a pose: starts, their annealing, a first frame, fast motion, and lost frames."""
