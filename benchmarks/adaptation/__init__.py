"""Adapted templates."""
