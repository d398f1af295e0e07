"""Optical markers in files."""
