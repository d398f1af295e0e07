"""Learn how likely poses are: Gaussian mixtures of successive joints."""

from ..lazy_imports import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
