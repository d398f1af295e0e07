"""Bodies, skeletons and motions from binary glTF 2.0 (`.glb`), whichever program wrote them."""

from pathlib import Path
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from ..body.body import Body
from ..body.pose import Motion, Pose
from ..body.skeleton import KINDS, Skeleton, make_skeleton
from ..body.skin import LinearSkin
from ..errors import InputError
from .gltf_file import GltfFile
from .gltf_surface import read_surface

_HINGES = ("revolute", "universal")
#: by how much a scale may be off and be no scale
_EVEN = 1e-5


class _Bound(NamedTuple):
    """Joints as they are bound: by their numbers in `skeleton`, whose order may be another than the file's."""

    skeleton: Skeleton
    #: the node of each joint of the skeleton
    nodes: tuple[int, ...]
    #: from the surface of the first skin to the world at rest, and from the world at rest into each joint's node
    placed: Float[np.ndarray, "4 4"]
    inverse: Float[np.ndarray, "J 4 4"]


def read_gltf(path: str | Path, rate: float | None = None) -> tuple[Skeleton, Motion | None]:
    """The joints of a file's first skin, and its first animation as their motion.

    Rest is where the inverse bind matrices have the joints, in metres and as upright as what stands above the roots
    makes it; the joints' frames there are their orientations. Kinds and axes are those that `write_gltf` notes, else
    roots are free and other joints turn freely. Times are sampled at `rate`, the one of the keys where it is not given.
    Scale may change above the roots alone and be the same along all axes.

    **Raises:** `InputError` where the file is not a whole one, has no skin, or has what a
    `Skeleton` and its `Pose` cannot hold: sheared, sparse, compressed or spline-keyed transforms.
    """
    file = GltfFile(path)
    bound = _bind(file)
    return bound.skeleton, _motion(file, bound, rate)


def read_gltf_body(path: str | Path, rate: float | None = None) -> tuple[Body, Motion | None]:
    """The body of a file's first skin, which blends linearly, and its first animation; the skeleton as in `read_gltf`.

    All meshes that this skin moves are the surface, or those of other skins of the same joints; morph targets and meshes that
    hang on a joint without a skin are left out. Vertices that were split along the seams of textures are one again.

    **Raises:** `InputError` as `read_gltf`, and where the surface is no triangles, or a vertex follows no joint.
    """
    file = GltfFile(path)
    bound = _bind(file)
    surface = read_surface(file, bound.nodes)
    vertices = surface.vertices @ bound.placed[:3, :3].T + bound.placed[:3, 3]
    dtype = bound.skeleton.centres.dtype
    skin = LinearSkin(jnp.asarray(surface.weights, dtype))
    body = Body(bound.skeleton, skin, jnp.asarray(vertices, dtype), jnp.asarray(surface.faces))
    return body, _motion(file, bound, rate)


def _bind(file: GltfFile) -> _Bound:
    """The skeleton of the first skin, at rest."""
    skin, nodes = file.document.skins[0], file.document.nodes
    joints = list(skin.joints)
    parents = [_parent(file, joint, joints) for joint in joints]
    inverse = np.tile(np.eye(4), (len(joints), 1, 1))
    if skin.inverseBindMatrices is not None:
        inverse = file.array(skin.inverseBindMatrices).reshape(-1, 4, 4).swapaxes(1, 2)
    placed = _placed(file, joints[parents.index(-1)], inverse[parents.index(-1)])
    inverse = inverse @ np.linalg.inv(placed)
    rest = np.linalg.inv(inverse)
    # joints in centimetres below a scale of a hundredth are as large as any
    rest[:, :3, :3] /= np.cbrt(np.linalg.det(rest[:, :3, :3]))[:, None, None]
    _check_rigid(file.path, rest[:, :3, :3])
    frames = Rotation.from_matrix(rest[:, :3, :3]).as_quat(scalar_first=True)
    notes = [nodes[joint].extras or {} for joint in joints]
    axes = np.tile(np.eye(3)[:2], (len(joints), 1, 1))
    for number, note in enumerate(notes):
        if np.shape(note.get("axes", ())) == (2, 3):
            axes[number] = note["axes"]
    # a hinge without its axes could turn about any
    kinds = [
        note.get("kind") if "axes" in note or note.get("kind") not in _HINGES else None for note in notes
    ]
    plain = ["free" if parent < 0 else "ball" for parent in parents]
    kinds = [kind if kind in KINDS else other for kind, other in zip(kinds, plain, strict=True)]
    names = [nodes[joint].name or f"joint{number}" for number, joint in enumerate(joints)]
    try:
        skeleton = make_skeleton(names, parents, kinds, rest[:, :3, 3], frames, axes)
    except ValueError as error:
        raise InputError(f"{file.path}: {error}") from None
    order = [names.index(name) for name in skeleton.names]
    return _Bound(skeleton, tuple(joints[number] for number in order), placed, inverse[order])


def _parent(file: GltfFile, joint: int, joints: list[int]) -> int:
    """The next joint above, whatever nodes stand between; -1 for a root."""
    node = file.above.get(joint)
    while node is not None and node not in joints:
        node = file.above.get(node)
    return -1 if node is None else joints.index(node)


def _placed(file: GltfFile, root: int, inverse: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "4 4"]:
    """How a surface that is bound to a root is turned and scaled in the world, apart from the root's own turn: programs
    keep z up and centimetres below a node that sets both right."""
    world = file.world(file.still())
    scale = np.cbrt(np.linalg.det((world[root][0] @ inverse)[:3, :3]))
    above = world[file.above[root]][0, :3, :3] if root in file.above else np.eye(3)
    turn = above / np.cbrt(np.linalg.det(above))
    if not scale > 0 or not np.isfinite(turn).all():
        raise InputError(
            f"{file.path}: what stands above the joints scales them to nothing, or mirrors them."
        )
    _check_rigid(file.path, turn[None])
    placed = np.eye(4)
    placed[:3, :3] = turn * (1.0 if abs(scale - 1) < _EVEN else scale)
    return placed


def _motion(file: GltfFile, bound: _Bound, rate: float | None) -> Motion | None:
    """Local translations and rotations of bones that move from rest to pose."""
    if not file.document.animations:
        return None
    clock, values = file.animation(rate)
    world = file.world(values)
    # T_j, from rest to pose, is the joint's node after the inverse of where it was bound
    bones = np.stack([world[joint] for joint in bound.nodes], 1) @ bound.inverse
    skeleton = bound.skeleton
    scale = np.cbrt(np.linalg.det(bones[:, 0, :3, :3]))
    bones[:, :, :3] /= scale[:, None, None, None]
    _check_rigid(file.path, bones[:, :, :3, :3])
    centres, count = np.array(skeleton.centres, float), len(clock)
    translations, rotations = np.zeros((count, len(centres), 3)), np.zeros((count, len(centres), 4))
    for joint, parent in enumerate(skeleton.parents):
        local = bones[:, joint] if parent < 0 else np.linalg.inv(bones[:, parent]) @ bones[:, joint]
        turn = Rotation.from_matrix(local[:, :3, :3])
        rotations[:, joint] = turn.as_quat(canonical=True, scalar_first=True)
        translations[:, joint] = local[:, :3, 3] + turn.apply(centres[joint]) - centres[joint]
    dtype = skeleton.centres.dtype
    poses = Pose(*(jnp.asarray(values, dtype) for values in (translations, rotations, scale)))
    return Motion(poses, float((count - 1) / (clock[-1] - clock[0])) if count > 1 else 30.0)


def _check_rigid(path: Path, turns: np.ndarray) -> None:
    apart = np.abs(turns @ np.swapaxes(turns, -1, -2) - np.eye(3)).max()
    if apart > 1e-3 or not (np.linalg.det(turns) > 0).all():
        raise InputError(
            f"{path}: a joint is scaled, sheared or mirrored by itself; a skeleton's joints turn and slide only."
        )
