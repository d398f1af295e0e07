"""The preparation of a worker before its first job. This module imports no JAX, whose import reads the settings."""

import contextlib
import os
import sys

from ..console.compiled import MIN_COMPILE_SECONDS, make_cache_folder, prepare_jax


def prepare_worker() -> None:
    """Set the cache of compiled functions of a worker; also if something on it, such as a preload script, imported JAX.

    Settings of the user take precedence.
    """
    prepare_jax(use_cache=True)
    jax = sys.modules.get("jax")
    if jax is None or jax.config.jax_compilation_cache_dir is not None:
        return
    # a home without write access: compile on each worker
    with contextlib.suppress(OSError):
        jax.config.update("jax_compilation_cache_dir", str(make_cache_folder()))
        if "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS" not in os.environ:
            jax.config.update("jax_persistent_cache_min_compile_time_secs", float(MIN_COMPILE_SECONDS))
