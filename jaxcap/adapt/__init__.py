"""Adapt a template body to the actor in a sequence of scans."""

from ..lazy_imports import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
