"""Joint angles between anatomical axes, as biomechanics reports them."""

from ..lazy_imports import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
