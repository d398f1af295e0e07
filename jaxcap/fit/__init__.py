"""Fitting of bodies: problems of one or many frames, solvers, correspondences of points and surfaces."""

from ..lazy_imports import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
