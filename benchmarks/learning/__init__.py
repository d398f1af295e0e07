"""Learned bodies."""
