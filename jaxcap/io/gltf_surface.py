"""The surface that a skin of a glTF file moves, and which joints each vertex follows."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from ..errors import InputError
from .gltf_file import GltfFile
from .surface import Surface, as_shares, joined, sewn

#: triangles, and points where there are no faces
_TRIANGLES, _POINTS = 4, 0


def read_surface(file: GltfFile, joints: Sequence[int]) -> Surface:
    """The meshes of all skins that share joints with the first, whose nodes `joints` are columns of weights.

    **Raises:** `InputError` where there is none, one is not of triangles, or a vertex follows no joint.
    """
    parts: list[Surface] = []
    for node in file.document.nodes:
        if node.mesh is None or node.skin is None or not _shared(file, node.skin, joints):
            continue
        move = _between_skins(file, node.skin, joints)
        for primitive in file.document.meshes[node.mesh].primitives:
            part = _part(file, primitive, file.document.skins[node.skin].joints, joints)
            parts.append(part._replace(vertices=part.vertices @ move[:3, :3].T + move[:3, 3]))
    if not parts:
        raise InputError(f"{file.path}: no mesh of this file follows its joints; read it as a skeleton.")
    return sewn(joined(parts))


def _shared(file: GltfFile, skin: int, joints: Sequence[int]) -> bool:
    return bool(set(file.document.skins[skin].joints) & set(joints))


def _between_skins(file: GltfFile, skin: int, joints: Sequence[int]) -> Float[np.ndarray, "4 4"]:
    """From the space in which a skin was bound to that of the first, by a joint of both."""
    first, other = file.document.skins[0], file.document.skins[skin]
    if skin == 0 or first.inverseBindMatrices is None or other.inverseBindMatrices is None:
        return np.eye(4)
    joint = next(joint for joint in other.joints if joint in joints)
    to_first, to_other = (
        file.array(which.inverseBindMatrices).reshape(-1, 4, 4).swapaxes(1, 2)[which.joints.index(joint)]
        for which in (first, other)
    )
    return np.linalg.inv(to_first) @ to_other


def _part(file: GltfFile, primitive: Any, own: Sequence[int], joints: Sequence[int]) -> Surface:
    if primitive.mode not in (None, _TRIANGLES, _POINTS):
        raise InputError(f"{file.path}: a mesh is lines, or strips of triangles; export it as triangles.")
    names = primitive.attributes
    vertices = file.array(names.POSITION)
    if primitive.mode == _POINTS:
        faces = np.zeros((0, 3), np.int64)
    elif primitive.indices is None:
        faces = np.arange(len(vertices)).reshape(-1, 3)
    else:
        faces = file.array(primitive.indices).astype(np.int64).reshape(-1, 3)
    if faces.max(initial=-1) >= len(vertices):
        raise InputError(f"{file.path}: a face names vertex {faces.max()} of {len(vertices)}.")
    # attributes that pygltflib does not name are there all the same
    column = {node: number for number, node in enumerate(joints)}
    columns = np.array([column.get(node, -1) for node in own])
    weights, rows, place = np.zeros((len(vertices), len(joints))), np.arange(len(vertices)), 0
    while getattr(names, f"JOINTS_{place}", None) is not None:
        chosen = file.array(getattr(names, f"JOINTS_{place}")).astype(int)
        shares = file.array(getattr(names, f"WEIGHTS_{place}"))
        if chosen.max(initial=0) >= len(columns):
            raise InputError(f"{file.path}: a vertex follows joint {chosen.max()} of {len(columns)}.")
        for numbers, share in zip(columns[chosen].T, shares.T, strict=True):
            np.add.at(weights, (rows[numbers >= 0], numbers[numbers >= 0]), share[numbers >= 0])
        place += 1
    return Surface(vertices, faces, as_shares(weights, str(file.path)))
