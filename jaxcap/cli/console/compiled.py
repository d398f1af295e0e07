"""Where the command line keeps compiled functions from run to run.

Whoever can write to that folder can run programs as its user, so it is the user's own; and it is bounded. JAX's bound needs
a file beside each entry, and without one, which a run that was killed leaves, keeps nothing more: the bound is ours.
"""

import contextlib
import hashlib
import os
import platform
import stat
import sys
from pathlib import Path

from ...errors import InputError

#: bytes that a folder may hold when a run starts
LARGEST = 1 << 30
#: seconds of compiling from which on a function is kept
WORTH = "0.1"


def prepare_jax(keep: bool) -> None:
    """Choose JAX's folder of compiled functions and silence its compiler; nothing is done where JAX is imported already, and
    what the environment says of either stays as it is.

    **Raises:** `InputError` where the folder that `JAXCAP_CACHE` names cannot be used.
    """
    if "jax" in sys.modules:
        return
    # the compiler writes past Python, as "Very slow compile? If you want to file a bug ..."
    os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")
    if not keep:
        os.environ["JAX_ENABLE_COMPILATION_CACHE"] = "false"
        return
    if "JAX_COMPILATION_CACHE_DIR" in os.environ:
        return
    named = os.environ.get("JAXCAP_CACHE")
    try:
        folder = make_private(Path(named).expanduser() if named else _users()) / _machine()
        folder.mkdir(exist_ok=True)
        trim(folder, LARGEST)
    except OSError as error:
        if named:
            raise InputError(
                f"JAXCAP_CACHE is {named}: this folder cannot be used ({error.strerror}); name one that only you can write "
                "to, or give --no-cache."
            ) from None
        # a home that cannot be written to: compiled anew in each run
        return
    os.environ["JAX_COMPILATION_CACHE_DIR"] = str(folder)
    os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", WORTH)


def make_private(folder: Path) -> Path:
    """A folder that only its user can write to, made where it is not there. Raises `OSError`."""
    folder.mkdir(parents=True, exist_ok=True, mode=0o700)
    found = folder.stat()
    if os.name == "posix" and (found.st_uid != os.geteuid() or found.st_mode & (stat.S_IWGRP | stat.S_IWOTH)):
        raise PermissionError(1, "others can write to it")
    if not os.access(folder, os.W_OK | os.X_OK):
        raise PermissionError(13, "Permission denied")
    return folder


def trim(folder: Path, largest: int) -> None:
    """Remove the files that were not used for the longest time until the others have at most `largest` bytes."""
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
    """The kind of processor: a home may be shared by machines whose compiled functions the others cannot run."""
    features = ""
    with contextlib.suppress(OSError):
        lines = Path("/proc/cpuinfo").read_text("utf-8", "replace").splitlines()
        features = next((line for line in lines if line.startswith(("flags", "Features"))), "")
    digest = hashlib.sha256(f"{platform.processor()} {features}".encode()).hexdigest()
    return f"{platform.machine()}-{digest[:8]}"
