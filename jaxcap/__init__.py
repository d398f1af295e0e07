"""Fit articulated bodies to what sensors saw."""
