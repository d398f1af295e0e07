"""The surface that a skin of a glTF file moves, with the skinning weights of its vertices."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from ...errors import InputError
from ..skinned.bind_pose import invert_affine
from ..skinned.left_out import OTHER_FIGURES, SHAPE_KEYS, UNSKINNED_MESHES
from ..skinned.skinned_surface import SkinnedSurface, concatenate_surfaces, merge_seams, normalise_weights
from .gltf_file import GltfFile
from .gltf_parts import Part
from .gltf_targets import read_displacements

#: modes: triangles, and points for meshes without faces
_TRIANGLES, _POINTS = 4, 0


def read_surface(
    file: GltfFile, joints: Sequence[int], targets: Sequence[str] | None = None
) -> SkinnedSurface:
    """Read the meshes of all skins that share joints with the first.

    The nodes `joints` are the columns of the weights. `targets` are the names of the shape keys whose displacements are read.

    **Raises:** `InputError` if there is none, one is not made of triangles, or a vertex follows no joint.
    """
    parts: list[SkinnedSurface] = []
    skins = {skin: skin_joints(file, skin) for skin in find_skins_with_joints(file, joints)}
    for _, mesh, skin in skinned_meshes(file):
        if skin not in skins:
            continue
        move = _skin_to_first_skin(file, skin, joints)
        for primitive in file.meshes[mesh].parts("primitives"):
            part = _read_primitive(file, primitive, skins[skin], joints)
            vertices = part.vertices @ move[:3, :3].T + move[:3, 3]
            moved = None
            if targets is not None:
                moved = read_displacements(file, file.meshes[mesh], primitive, targets) @ move[:3, :3].T
            parts.append(part._replace(vertices=vertices, displacements=moved))
    if not parts:
        raise InputError(
            f"{file.path}: no mesh in this file is skinned to its joints; read it as a skeleton."
        )
    return merge_seams(concatenate_surfaces(parts))


def find_skins_with_joints(file: GltfFile, joints: Sequence[int]) -> tuple[int, ...]:
    """Find the skins in use that have at least one of some joints. Raises `InputError`."""
    wanted = set(joints)
    used = dict.fromkeys(skin for _, _, skin in skinned_meshes(file))
    return tuple(skin for skin in used if not wanted.isdisjoint(skin_joints(file, skin)))


def skinned_meshes(file: GltfFile) -> list[tuple[Part, int, int]]:
    """Return the nodes with a mesh and a skin, and the indices of both. Raises `InputError`."""
    found = [
        (node, node.index("mesh", len(file.meshes)), node.index("skin", len(file.skins)))
        for node in file.nodes
    ]
    return [(node, mesh, skin) for node, mesh, skin in found if mesh is not None and skin is not None]


def find_unread_content(file: GltfFile, joints: Sequence[int], surface: bool) -> dict[str, list[str]]:
    """List the names of contents, by type, that are not read with the figure of `joints`.

    `surface` is true if the surface of the figure is read.
    """

    def name(node: Part, mesh: int) -> str:
        return node.text("name") or file.meshes[mesh].text("name") or f"mesh {mesh}"

    own, with_skin = set(find_skins_with_joints(file, joints)), skinned_meshes(file)
    found = {OTHER_FIGURES: [name(node, mesh) for node, mesh, skin in with_skin if skin not in own]}
    if surface:
        meshes = ((node, node.index("mesh", len(file.meshes))) for node in file.nodes if "skin" not in node)
        found[UNSKINNED_MESHES] = [name(node, mesh) for node, mesh in meshes if mesh is not None]
        found[SHAPE_KEYS] = [
            name(node, mesh)
            for node, mesh, skin in with_skin
            if skin in own and any("targets" in part for part in file.meshes[mesh].parts("primitives"))
        ]
    return found


def skin_joints(file: GltfFile, skin: int) -> list[int]:
    """Return the nodes that are the joints of a skin.

    Raises `InputError` if there are none, or for duplicates.
    """
    joints = file.skins[skin].indices("joints", len(file.nodes))
    if not joints or len(set(joints)) < len(joints):
        raise file.skins[skin].type_error("joints", "a list of nodes without duplicates")
    return joints


def inverse_binds(file: GltfFile, skin: int) -> Float[np.ndarray, "J 4 4"]:
    """Read the transforms from the space of the surface into the frames of a skin's joints.

    Raises `InputError`.
    """
    part, count = file.skins[skin], len(skin_joints(file, skin))
    if "inverseBindMatrices" not in part:
        return np.tile(np.eye(4), (count, 1, 1))
    where = f"{part.where}.inverseBindMatrices"
    found = file.array(part.integer("inverseBindMatrices"), 16, where)
    if len(found) != count:
        raise InputError(
            f"{where} has {len(found)} matrices for {count} joints; expected one for each joint."
        )
    return found.reshape(-1, 4, 4).swapaxes(1, 2)


def _skin_to_first_skin(file: GltfFile, skin: int, joints: Sequence[int]) -> Float[np.ndarray, "4 4"]:
    """Compute the transform from the bind space of a skin to that of the first, by a joint of both."""
    if skin == 0 or any("inverseBindMatrices" not in file.skins[number] for number in (0, skin)):
        return np.eye(4)
    shared = next(joint for joint in skin_joints(file, skin) if joint in joints)
    to_first, to_other = (
        inverse_binds(file, number)[skin_joints(file, number).index(shared)] for number in (0, skin)
    )
    return invert_affine(file.path, to_first) @ to_other


def _read_primitive(
    file: GltfFile, primitive: Part, primitive_joints: Sequence[int], joints: Sequence[int]
) -> SkinnedSurface:
    mode, where = primitive.integer("mode", _TRIANGLES), primitive.where
    if mode not in (_TRIANGLES, _POINTS):
        raise InputError(f"{where}: a mesh consists of lines or triangle strips; export it as triangles.")
    names = primitive.part("attributes")
    vertices = _attribute(file, names, "POSITION", 3)
    if mode == _POINTS:
        faces = np.zeros((0, 3), np.int64)
    elif "indices" not in primitive:
        faces = np.arange(len(vertices))
    else:
        faces = file.array(primitive.integer("indices"), 1, f"{where}.indices")[:, 0].astype(np.int64)
    if faces.size % 3:
        raise InputError(f"{where}: its triangles have {faces.size} corners; expected a multiple of three.")
    faces = faces.reshape(-1, 3)
    if faces.max(initial=-1) >= len(vertices) or faces.min(initial=0) < 0:
        raise InputError(
            f"{where}: a face refers to vertex {faces.max()} of {len(vertices)}; export the mesh again."
        )
    file.reserve_memory(4 * len(vertices) * len(joints), "the weights of its vertices")
    column = {node: number for number, node in enumerate(joints)}
    columns = np.array([column.get(node, -1) for node in primitive_joints])
    weights, rows, place = np.zeros((len(vertices), len(joints))), np.arange(len(vertices)), 0
    while f"JOINTS_{place}" in names:
        chosen = _attribute(file, names, f"JOINTS_{place}", 4).astype(int)
        shares = _attribute(file, names, f"WEIGHTS_{place}", 4)
        if len(chosen) != len(vertices) or len(shares) != len(vertices):
            raise InputError(
                f"{where}: there are {len(vertices)} vertices, but {len(chosen)} rows of joints and {len(shares)} of weights; "
                "export the mesh again."
            )
        if chosen.max(initial=0) >= len(columns) or chosen.min(initial=0) < 0:
            raise InputError(
                f"{where}: a vertex refers to joint {chosen.max()} of {len(columns)}; export the mesh again."
            )
        if shares.min(initial=0) < 0:
            raise InputError(f"{where}: a vertex has a weight below zero; export the mesh again.")
        for numbers, share in zip(columns[chosen].T, shares.T, strict=True):
            np.add.at(weights, (rows[numbers >= 0], numbers[numbers >= 0]), share[numbers >= 0])
        place += 1
    return SkinnedSurface(vertices, faces, normalise_weights(weights, str(file.path)))


def _attribute(file: GltfFile, names: Part, name: str, width: int) -> Float[np.ndarray, "V W"]:
    """Read an attribute of all vertices."""
    return file.array(names.integer(name) if name in names else None, width, f"{names.where}.{name}")
