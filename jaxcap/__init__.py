"""Fit articulated bodies to sensor data: poses, motions and their energies in JAX."""

from .lazy_imports import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
