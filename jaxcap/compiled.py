"""Compiled functions that a process keeps, and their number."""

import logging
from pathlib import Path

import jax

_LOG = logging.getLogger(__name__)
#: the pieces of memory that a process has mapped, on Linux
MAPS = Path("/proc/self/maps")
#: number of pieces above which compiled functions are forgotten; Linux allows 65,530 by default
MANY_MAPS = 35_000


def forget_many_compiled(limit: int = MANY_MAPS) -> bool:
    """Forget all compiled functions if the process has mapped more than `limit` pieces of memory; return whether it did.

    XLA maps each compiled function in several pieces, and ends the process if Linux allows no more. Work that compiles for
    ever new shapes calls this between its steps. Functions that are called again compile again.
    """
    if not MAPS.exists() or MAPS.read_bytes().count(b"\n") <= limit:
        return False
    _LOG.info("forgetting compiled functions, as there are too many for one process")
    jax.clear_caches()
    return True
