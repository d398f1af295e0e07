"""Optical markers."""
