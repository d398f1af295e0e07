"""Landmarks of markers without labels, by their geometry."""
