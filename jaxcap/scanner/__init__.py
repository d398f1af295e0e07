"""Simulated depth cameras around a moving surface, with noisy and partial clouds and meshes."""

from ..lazy_imports import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
