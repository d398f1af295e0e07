"""Energies: residuals of posed bodies that add up."""
