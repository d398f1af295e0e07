"""The libraries of Dask, which are imported only where jobs are sent to a cluster."""

import importlib
from types import ModuleType

from ..errors import InputError

#: the command that installs the libraries
INSTALL = "pip install 'jaxcap[cluster]'"


def import_distributed() -> ModuleType:
    """Import `dask.distributed`. Raises `InputError` if it is not installed."""
    return import_optional("distributed", "Batches run on Dask")


def import_optional(module: str, use: str) -> ModuleType:
    """Import a library that only the extra `cluster` installs; `use` begins the sentence of the error.

    **Raises:** `InputError` if it is not installed.
    """
    try:
        return importlib.import_module(module)
    except ImportError:
        raise InputError(f"{use}, and {module} is not installed; install it with {INSTALL}.") from None
