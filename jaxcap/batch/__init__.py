"""Many independent jobs on the workers of a Dask cluster: of this computer, or of others."""

from ..lazy_imports import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
