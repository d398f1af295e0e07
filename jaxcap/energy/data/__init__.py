"""Energies of what was observed: points, surfaces, landmarks, the floor."""
