"""Linearly blended bodies by all of their unknowns at once."""
