"""Joint limits learned from motion: samples, voxels, keyframes, and projection of motions."""

from ..lazy_imports import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
