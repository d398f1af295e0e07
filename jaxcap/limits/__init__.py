"""Joint limits: ranges, cones, boxes and implicit surfaces; learned from motion; motions projected onto them."""

from ..lazy_imports import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
