"""The version of jaxcap in this process, for comparison with the workers of a cluster."""

import functools
import hashlib
import importlib.metadata
from pathlib import Path
from typing import NamedTuple

_PACKAGE = Path(__file__).resolve().parents[1]


class Version(NamedTuple):
    """The version of the package, and a digest of its source files, which differs between two checkouts."""

    number: str
    source: str

    def __str__(self) -> str:
        return f"{self.number} ({self.source[:8]})"


@functools.cache
def installed_version() -> Version:
    """Return the version of jaxcap in this process."""
    try:
        number = importlib.metadata.version("jaxcap")
    except importlib.metadata.PackageNotFoundError:
        number = "unknown"
    digest = hashlib.sha256()
    for file in sorted(_PACKAGE.rglob("*.py")):
        digest.update(file.relative_to(_PACKAGE).as_posix().encode())
        digest.update(file.read_bytes())
    return Version(number, digest.hexdigest())
