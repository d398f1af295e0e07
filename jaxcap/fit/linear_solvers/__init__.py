"""Structured linear operators and solvers for their systems."""
