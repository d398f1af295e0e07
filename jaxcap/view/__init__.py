"""Browser windows: view the library's files (`app`), pose a body by hand (`ik`), and view from notebooks
(`show`)."""

from ..lazy_imports import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
