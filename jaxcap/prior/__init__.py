"""Learn how likely poses are: Gaussian mixtures of successive joints."""

from ..namespace import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
