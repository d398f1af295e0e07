"""The JSON and the buffers of a glTF 2.0 file, binary (`.glb`) or text (`.gltf`) with files next to it."""

import json
import shlex
import struct
from pathlib import Path
from typing import Any

from ..errors import InputError
from .clip import clip_names
from .inside import read_inside

#: both forms of the format
SUFFIXES = (".glb", ".gltf")


def read_head(path: str | Path) -> dict[str, Any]:
    """Read the JSON of a file without its buffers; empty where it is not a glTF file that can be read."""
    try:
        with Path(path).open("rb") as stream:
            if Path(path).suffix.lower() == ".gltf":
                head = json.loads(stream.read())
            else:
                magic, _, _, length, _ = struct.unpack("<4s4I", stream.read(20))
                # of another kind of file nothing is read
                head = json.loads(stream.read(length)) if magic == b"glTF" else {}
    except (OSError, ValueError, RecursionError, struct.error):
        return {}
    return head if isinstance(head, dict) else {}


def has_skin(path: str | Path) -> bool:
    """Whether this is a `.glb` or `.gltf` with joints that move a surface."""
    head = read_head(path)
    nodes = head.get("nodes")
    return bool(head.get("skins")) and any("skin" in node for node in _dicts(nodes))


def clips_of(path: str | Path) -> tuple[str, ...]:
    """Return the names of the animations in a `.glb` or `.gltf`; none where it cannot be read."""
    names = [one.get("name") for one in _dicts(read_head(path).get("animations"))]
    return clip_names([name if isinstance(name, str) else None for name in names])


def no_skin(path: str | Path) -> InputError:
    """Say that a file, glTF or USD, has no joints that move its surface, and what to do."""
    rig = f"rig it with `jaxcap rig {shlex.quote(str(path))} -o body.npz`"
    if Path(path).suffix.lower() not in SUFFIXES:
        rig = "export its mesh as .glb and rig that with `jaxcap rig`"
    return InputError(
        f"{path}: there is no skin in it, so no joint moves its surface; {rig}, or export it again with its armature."
    )


def read_document(path: Path) -> tuple[Any, list[bytes | None]]:
    """Read a whole file: its content, and the bytes of each buffer, None where the file has none for it.

    Buffers are the file's own, data URIs, or files in the same folder or below.

    **Raises:** `InputError` where the file is not whole, or a buffer is missing, cut short or elsewhere.
    """
    import pygltflib

    if not path.is_file():
        raise InputError(f"{path}: there is no such file; check the path.")
    suffix = path.suffix.lower() if path.suffix.lower() in SUFFIXES else ".glb"
    try:
        if suffix == ".gltf":
            document: Any = pygltflib.GLTF2.gltf_from_json(path.read_text(encoding="utf-8-sig"))
            own = None
        else:
            with path.open("rb") as stream:
                head = stream.read(12)
            if head[:4] != b"glTF" or int.from_bytes(head[8:], "little") != path.stat().st_size:
                raise InputError(f"{path}: this is not a whole .glb file; export it again.")
            document = pygltflib.GLTF2().load_binary(str(path))
            own = document.binary_blob()
    except InputError:
        raise
    except Exception as error:  # whatever a damaged file makes of a reader
        raise InputError(
            f"{path}: this is not a whole {suffix} file ({type(error).__name__}); export it again."
        ) from None
    if document is None:
        raise InputError(f"{path}: this is not a whole {suffix} file; export it again.")
    buffers: list[bytes | None] = []
    for number, buffer in enumerate(document.buffers or []):
        content = own if buffer.uri is None and number == 0 else None
        if buffer.uri is not None:
            if not isinstance(buffer.uri, str):
                raise InputError(f"{path}: the URI of buffer {number} is not text; export the file again.")
            content = read_inside(path, buffer.uri)
        buffers.append(content)
    return document, buffers


def _dicts(rows: object) -> list[dict]:
    return [row for row in rows if isinstance(row, dict)] if isinstance(rows, list) else []
