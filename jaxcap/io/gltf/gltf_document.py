"""The JSON and the buffers of a glTF 2.0 file, binary (`.glb`) or text (`.gltf`) with external files."""

import shlex
import struct
from pathlib import Path
from typing import Any

from ...errors import InputError
from ..skinned.clip import clip_names
from ..system.confined_paths import read_inside
from ..text import parse_json, read_json
from .gltf_parts import Part
from .gltf_scene import chunks

#: suffixes of both forms
SUFFIXES = (".glb", ".gltf")
#: largest number of buffers
MAX_BUFFERS = 1000


def read_gltf_json(path: str | Path) -> dict[str, Any]:
    """Read the JSON of a file without its buffers; empty if it is not a readable glTF file."""
    try:
        with Path(path).open("rb") as stream:
            if Path(path).suffix.lower() == ".gltf":
                head = parse_json(stream.read(), path)
            else:
                magic, _, _, length, _ = struct.unpack("<4s4I", stream.read(20))
                # read nothing of other file types, and never more than the file's size
                length = min(length, Path(path).stat().st_size)
                head = parse_json(stream.read(length), path) if magic == b"glTF" else {}
    except (OSError, ValueError, struct.error):
        return {}
    return head if isinstance(head, dict) else {}


def has_skin(path: str | Path) -> bool:
    """Check that a file is a `.glb` or `.gltf` with joints that move a surface."""
    head = read_gltf_json(path)
    nodes = head.get("nodes")
    return bool(head.get("skins")) and any("skin" in node for node in _select_dicts(nodes))


def read_clip_names(path: str | Path) -> tuple[str, ...]:
    """Return the names of the animations in a `.glb` or `.gltf`; empty if it cannot be read."""
    names = [one.get("name") for one in _select_dicts(read_gltf_json(path).get("animations"))]
    return clip_names([name if isinstance(name, str) else None for name in names])


def missing_skin_error(path: str | Path) -> InputError:
    """Return the error for a glTF or USD file without a skin, with advice."""
    rig = f"rig it with `jaxcap rig {shlex.quote(str(path))} -o body.npz`"
    if Path(path).suffix.lower() not in SUFFIXES:
        rig = "export its mesh as .glb and rig that with `jaxcap rig`"
    return InputError(
        f"{path}: there is no skin in it, so its surface does not follow joints; {rig}, or export it again with its armature."
    )


def read_document(path: Path) -> tuple[Part, list[bytes | None]]:
    """Read a complete file: its JSON, and the bytes of each buffer, None for a buffer without data.

    Buffers are in the file itself, in data URIs, or in files in the same folder or below.

    **Raises:** `InputError` if the file is incomplete, or a buffer is missing, cut short or outside the
    folder.
    """
    if path.suffix.lower() == ".gltf":
        root, own = Part(read_json(path), str(path)), None
    else:
        head, own = chunks(path)
        root = Part(parse_json(head, path), str(path))
    parts, found = root.parts("buffers"), dict[str, bytes]()
    if len(parts) > MAX_BUFFERS:
        raise InputError(f"{path}: the file has {len(parts)} buffers; export it with at most {MAX_BUFFERS}.")
    buffers: list[bytes | None] = []
    for number, buffer in enumerate(parts):
        uri = buffer.text("uri") if "uri" in buffer else None
        if uri is not None and uri not in found:
            found[uri] = read_inside(path, uri)
        buffers.append(found[uri] if uri is not None else own if number == 0 else None)
    return root, buffers


def _select_dicts(rows: object) -> list[dict]:
    return [row for row in rows if isinstance(row, dict)] if isinstance(rows, list) else []
