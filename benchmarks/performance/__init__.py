"""Profiles of the library."""
