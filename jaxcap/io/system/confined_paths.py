"""Files that another file names, such as the buffers of a `.gltf`: read from the folder of that file only."""

import base64
import binascii
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NoReturn
from urllib.parse import unquote

from ...errors import InputError


def read_inside(path: str | Path, uri: str) -> bytes:
    """Read the data at a URI that the file `path` contains.

    It is a `data:` URI, or a file in the folder of `path` or below it. A name may be percent-encoded.
    Symbolic links are resolved first, so neither they nor `..` lead out of the folder. If `path` is a link,
    the folder of its target is allowed as well.

    **Raises:** `InputError` if the URI has another scheme, is absolute, or leads out of the folder, or if
    there is no such file.
    """
    path = Path(path)
    if uri.lower().startswith("data:"):
        return _data(path, uri)
    names, leaves = list(dict.fromkeys([uri, unquote(uri)])), False
    for folder in _folders(path):
        for name in names:
            try:
                found = folder / name
                inside = not _leaves_folder(name) and is_inside(path, found)
                if inside and found.is_file():
                    return found.resolve().read_bytes()
            except (OSError, ValueError, RuntimeError):
                # the name is too long or has a null character, a loop of links, no permission
                continue
            leaves |= not inside
    if leaves:
        raise outside_folder_error(path, uri)
    raise InputError(
        f"{path}: it refers to '{_short(uri)}', and there is no such file in its folder; copy that file as well."
    )


def is_inside(path: str | Path, other: str | Path) -> bool:
    """Check that another file is in or below the folder of `path`, or of the target of `path`.

    Links are resolved first.
    """
    found = Path(other).resolve()
    return any(found.is_relative_to(folder.resolve()) for folder in _folders(Path(path)))


def outside_folder_error(path: str | Path, uri: str) -> InputError:
    """Return the error for a file that names another one outside of its folder."""
    return InputError(
        f"{path}: it refers to '{_short(uri)}', which is outside of its folder and is not read; move that file into the "
        "folder and refer to it by its name only."
    )


def _folders(path: Path) -> list[Path]:
    return list(dict.fromkeys([path.absolute().parent, path.resolve().parent]))


def _short(uri: str) -> str:
    return uri if len(uri) <= 60 else f"{uri[:57]}..."


class InsideResolver:
    """A resolver for trimesh of the files that a mesh names, by `read_inside`. Each file is read once."""

    def __init__(self, path: str | Path):
        self.path, self._read = Path(path), dict[str, bytes]()

    def get(self, name: Any) -> bytes:
        name = name.decode("utf-8", "replace") if isinstance(name, bytes) else str(name)
        if name not in self._read:
            self._read[name] = read_inside(self.path, name)
        return self._read[name]

    def __getitem__(self, name: Any) -> bytes:
        return self.get(name)

    def keys(self) -> Iterator[str]:
        return iter(())

    def __contains__(self, name: object) -> bool:
        return False

    def namespaced(self, namespace: str) -> "InsideResolver":
        return self

    def write(self, name: str, data: Any) -> NoReturn:
        raise OSError(f"{self.path}: files cannot be written while a mesh is read.")


def _leaves_folder(name: str) -> bool:
    """Check for a name that is absolute on any system, has a scheme, or contains `..`."""
    return bool(re.match(r"[/\\~]|[A-Za-z][A-Za-z0-9+.-]*:", name)) or ".." in re.split(r"[/\\]", name)


def _data(path: Path, uri: str) -> bytes:
    head, comma, text = uri.partition(",")
    try:
        if not comma or not head.lower().endswith(";base64"):
            raise binascii.Error("not base64")
        return base64.b64decode(unquote(text), validate=True)
    except (binascii.Error, ValueError) as error:
        raise InputError(f"{path}: a 'data:' URI in it cannot be read ({error}); export it again.") from None
