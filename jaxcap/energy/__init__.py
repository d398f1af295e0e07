"""Energies: additive residuals of posed bodies."""
