"""Energies of what is known beforehand: likely poses, limits, symmetry, smooth motion."""
