"""Skeletons, poses, skins and bodies."""

from ..lazy_imports import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
