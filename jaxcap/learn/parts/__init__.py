"""Rigid parts of a surface that moves."""
