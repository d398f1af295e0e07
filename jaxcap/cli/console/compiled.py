"""The cache folder of compiled functions of the command line.

Write access to that folder allows running programs as its user, so it is the user's own; and its size is
limited. JAX's own limit needs a file next to each entry, and caches nothing more if a killed run left one
without it; so the limit is enforced here.
"""

import contextlib
import hashlib
import os
import platform
import stat
import sys
from pathlib import Path

from ...errors import InputError

#: maximum size of the folder when a run starts, bytes
MAX_CACHE_BYTES = 1 << 30
#: minimum compile time of a cached function, seconds
MIN_COMPILE_SECONDS = "0.1"


def prepare_jax(use_cache: bool) -> None:
    """Set JAX's cache folder of compiled functions and silence its compiler; do nothing if JAX is already
    imported. Environment variables of the user take precedence.

    **Raises:** `InputError` if the folder that `JAXCAP_CACHE` names cannot be used.
    """
    if "jax" in sys.modules:
        return
    # the compiler writes to stderr directly, for example "Very slow compile? If you want to file a bug ..."
    os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")
    if not use_cache:
        os.environ["JAX_ENABLE_COMPILATION_CACHE"] = "false"
        return
    if "JAX_COMPILATION_CACHE_DIR" in os.environ:
        return
    named = os.environ.get("JAXCAP_CACHE")
    try:
        folder = make_cache_folder()
        trim(folder, MAX_CACHE_BYTES)
    except OSError as error:
        if named:
            raise InputError(
                f"JAXCAP_CACHE is {named}: this folder cannot be used ({error.strerror}); name one that only you can write "
                "to, or give --no-cache."
            ) from None
        # a home without write access: compile in each run
        return
    os.environ["JAX_COMPILATION_CACHE_DIR"] = str(folder)
    os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", MIN_COMPILE_SECONDS)


def make_cache_folder() -> Path:
    """Make the cache folder for this type of processor, in that of `JAXCAP_CACHE` or of the user. Raises `OSError`."""
    named = os.environ.get("JAXCAP_CACHE")
    folder = make_private(Path(named).expanduser() if named else _users()) / _machine()
    folder.mkdir(exist_ok=True)
    return folder


def count_kept_functions() -> int:
    """Count the compiled functions that are kept for later runs; 0 without a cache."""
    try:
        return len(os.listdir(os.environ["JAX_COMPILATION_CACHE_DIR"]))
    except (KeyError, OSError):
        return 0


def make_private(folder: Path) -> Path:
    """Make a folder, or check an existing one, that only its user can write to. Raises `OSError`."""
    folder.mkdir(parents=True, exist_ok=True, mode=0o700)
    found = folder.stat()
    if os.name == "posix" and (found.st_uid != os.geteuid() or found.st_mode & (stat.S_IWGRP | stat.S_IWOTH)):
        raise PermissionError(1, "others can write to it")
    if not os.access(folder, os.W_OK | os.X_OK):
        raise PermissionError(13, "Permission denied")
    return folder


def trim(folder: Path, largest: int) -> None:
    """Remove the least recently used files until the others have at most `largest` bytes."""
    files = []
    for path in folder.rglob("*"):
        # another run may have removed it
        with contextlib.suppress(OSError):
            found = path.lstat()
            if stat.S_ISREG(found.st_mode):
                files.append((max(found.st_atime, found.st_mtime), found.st_size, path))
    total = sum(size for _, size, _ in files)
    for _, size, path in sorted(files):
        if total <= largest:
            return
        with contextlib.suppress(OSError):
            path.unlink()
        total -= size


def _users() -> Path:
    import platformdirs

    return platformdirs.user_cache_path("jaxcap", appauthor=False)


def _machine() -> str:
    """Return a name for the processor type: machines that share a home may not run each other's compiled
    functions."""
    features = ""
    with contextlib.suppress(OSError):
        lines = Path("/proc/cpuinfo").read_text("utf-8", "replace").splitlines()
        features = next((line for line in lines if line.startswith(("flags", "Features"))), "")
    digest = hashlib.sha256(f"{platform.processor()} {features}".encode()).hexdigest()
    return f"{platform.machine()}-{digest[:8]}"
