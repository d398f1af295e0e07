"""Scans registered to the vertices of a body that is adapted to the person in them."""
