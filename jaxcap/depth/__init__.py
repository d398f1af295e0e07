"""Depth images of people: the person in an image, and clouds with their depth images."""

from ..lazy_imports import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
