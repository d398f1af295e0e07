"""The structure of a glTF file: its chunks, its node tree, and checks of its announced sizes."""

import struct
from collections.abc import Sequence
from pathlib import Path

from ...errors import InputError
from ..archives.archive import MAX_EXPANSION, MIN_MEMORY_LIMIT
from ..text import parse_json, read_json
from .gltf_parts import Part

#: numbers in an element of each type
TYPE_SIZES = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
#: largest number of mesh instances, which a scene reader joins in seconds
MAX_MESHES = 2000
_JSON_CHUNK, _BINARY_CHUNK = 0x4E4F534A, 0x004E4942


def chunks(path: Path) -> tuple[bytes, bytes]:
    """Read the JSON and the binary chunk of a binary file. Raises `InputError` if it is incomplete."""
    if not path.is_file():
        raise InputError(f"{path}: there is no such file; check the path.")
    data = path.read_bytes()
    found: dict[int, bytes] = {}
    if data[:4] == b"glTF" and len(data) >= 12 and struct.unpack_from("<I", data, 8)[0] == len(data):
        at = 12
        while at + 8 <= len(data):
            length, kind = struct.unpack_from("<II", data, at)
            at += 8 + length
            if at > len(data):
                break
            found.setdefault(kind, data[at - length : at])
    if _JSON_CHUNK not in found:
        raise InputError(f"{path}: this .glb file is incomplete or damaged; copy or export it again.")
    return found[_JSON_CHUNK], found.get(_BINARY_CHUNK, b"")


def node_parents(nodes: Sequence[Part]) -> dict[int, int]:
    """Return the parent of each node that has one. Raises `InputError` if nodes form no tree."""
    above: dict[int, int] = {}
    for number, node in enumerate(nodes):
        for child in node.indices("children", len(nodes)):
            if child in above:
                raise InputError(
                    f"{node.where}: its child {child} is also a child of node {above[child]}; nodes must form a tree."
                )
            above[child] = number
    rooted: set[int] = set()
    for number in range(len(nodes)):
        chain: dict[int, None] = {}
        while number in above and number not in rooted:
            if number in chain:
                raise InputError(f"{nodes[number].where} descends from itself; nodes must form a tree.")
            chain[number] = None
            number = above[number]
        rooted.update(chain)
    return above


def check_scene(path: Path) -> None:
    """Check the assumptions of a general scene reader.

    Nodes must form a tree, counts must fit the file size, and the number of meshes is limited.

    **Raises:** `InputError` with the path in the JSON.
    """
    binary = path.suffix.lower() == ".glb"
    root = Part(parse_json(chunks(path)[0], path) if binary else read_json(path), str(path))
    nodes, meshes = root.parts("nodes"), root.parts("meshes")
    node_parents(nodes)
    beside = [
        path.parent / buffer.text("uri") for buffer in root.parts("buffers") if len(buffer.text("uri")) < 256
    ]
    size = path.stat().st_size + sum(other.stat().st_size for other in beside if _is_file(other))
    room = max(MIN_MEMORY_LIMIT, MAX_EXPANSION * size)
    for accessor in root.parts("accessors"):
        room -= 8 * accessor.integer("count") * TYPE_SIZES.get(accessor.text("type"), 1)
        if room < 0:
            raise InputError(f"{accessor.where} has more numbers than the file can contain; it is damaged.")
    shown = [node.index("mesh", len(meshes)) for node in nodes]
    count = sum(len(meshes[mesh].values("primitives")) for mesh in shown if mesh is not None)
    if count > MAX_MESHES:
        raise InputError(f"{path}: the file has {count} meshes; merge them to at most {MAX_MESHES}.")


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except (OSError, ValueError):
        return False
