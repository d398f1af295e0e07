"""Priors of poses: Gaussian mixtures of joints and their parents, as data and learned from motion."""

from ..lazy_imports import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
