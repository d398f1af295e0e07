"""Marker sets of laboratories, by their labels."""
