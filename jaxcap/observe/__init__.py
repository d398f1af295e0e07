"""Observations of sensors: point clouds, depth images, mesh sequences and optical markers."""

from ..lazy_imports import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
