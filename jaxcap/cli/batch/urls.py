"""Files at URLs, such as `s3://bucket/take.c3d`, by fsspec: whole files and folders are fetched and uploaded."""

import os
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from ...batch.dask_libraries import import_optional
from ...errors import InputError

_SCHEME = re.compile(r"[A-Za-z][A-Za-z0-9+.-]+://")


def is_url(text: str) -> bool:
    """Test if a text is a URL and not a path of this computer."""
    return _SCHEME.match(text) is not None


def place_of(output: str) -> str:
    """Return the one name of a place that several paths or URLs may name, for comparisons."""
    return output.rstrip("/") if is_url(output) else os.path.abspath(output)


def folders_of(place: str) -> Iterator[str]:
    """Iterate over the folders that a place is in, the nearest first."""
    folder = place.rpartition("/")[0] if is_url(place) else os.path.dirname(place)
    while folder and folder != place and not folder.endswith(":/"):
        yield folder
        place, folder = folder, (folder.rpartition("/")[0] if is_url(folder) else os.path.dirname(folder))


def glob_urls(pattern: str) -> list[str]:
    """List the URLs that match a pattern of a shell. Raises `InputError` if the store cannot be reached."""
    store, path = _open(pattern)
    try:
        return [store.unstrip_protocol(found) for found in store.glob(path)]
    except Exception as error:
        raise _unreachable(pattern, error) from None


def exists(url: str) -> bool:
    """Test if a file or folder is at a URL. Raises `InputError` if the store cannot be reached."""
    store, path = _open(url)
    try:
        return bool(store.exists(path))
    except Exception as error:
        raise _unreachable(url, error) from None


def fetch(url: str, folder: Path) -> Path:
    """Load a file or a folder from a URL into a folder of this computer; return its path there.

    **Raises:** `InputError` if it is not there or cannot be copied.
    """
    store, path = _open(url)
    target = folder / url.rstrip("/").rpartition("/")[2]
    try:
        store.get(path, str(target), recursive=bool(store.isdir(path)))
    except FileNotFoundError:
        raise InputError(f"{url}: there is no such file; check the URL.") from None
    except Exception as error:
        raise _unreachable(url, error) from None
    return target


def upload(path: Path, url: str) -> list[str]:
    """Send a file or a folder of this computer to a URL, each file whole; return the URLs of the files.

    **Raises:** `InputError` if it cannot be copied.
    """
    files = sorted(file for file in path.rglob("*") if file.is_file()) if path.is_dir() else [path]
    written = []
    try:
        for file in files:
            there = url if file == path else f"{url}/{file.relative_to(path).as_posix()}"
            store, place = _open(there)
            store.makedirs(store._parent(place), exist_ok=True)
            store.put_file(str(file), place)
            written.append(there)
    except Exception as error:
        raise _unreachable(url, error) from None
    return written


def stamp(url: str) -> str:
    """Return a text that changes with the file at a URL: its checksum or its time, and its size."""
    store, path = _open(url)
    try:
        found = store.info(path)
    except Exception as error:
        raise _unreachable(url, error) from None
    names = ("ETag", "etag", "md5Hash", "LastModified", "mtime", "created", "size")
    return " ".join(f"{name}={found[name]}" for name in names if found.get(name) is not None)


def _open(url: str) -> tuple[Any, str]:
    fsspec = import_optional("fsspec", f"{url}: URLs are read by fsspec")
    try:
        return fsspec.core.url_to_fs(url)
    except (ImportError, ValueError) as error:
        raise InputError(
            f"{url}: this kind of URL cannot be opened ({error}); install what it needs, or copy the files to a folder."
        ) from None


def _unreachable(url: str, error: Exception) -> InputError:
    reason = " ".join(str(error).split()) or type(error).__name__
    return InputError(f"{url}: cannot be reached ({reason}); check the URL and your access to it.")
