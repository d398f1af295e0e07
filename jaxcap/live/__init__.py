"""Tracking of what arrives: the newest frame is tracked, and older ones are dropped."""

from ..lazy_imports import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
