"""Bodies, skeletons and motions from glTF 2.0 (`.glb`, `.gltf`), whichever program wrote them."""

from pathlib import Path

import numpy as np

from ..arguments import checked
from ..body.body import Body
from ..body.pose import Motion
from ..body.skeleton import KINDS, Skeleton
from .bound import Bound, Joints, bind, body_of, motion_of, placing
from .gltf_file import GltfFile
from .gltf_surface import read_surface

_HINGES = ("revolute", "universal")


@checked
def read_gltf(
    path: str | Path, rate: float | None = None, clip: str | None = None
) -> tuple[Skeleton, Motion | None]:
    """The joints of a file's first skin, and an animation as their motion: the one called `clip`, or the first.

    Rest is where the inverse bind matrices have the joints, in metres and as upright as what stands above the roots
    makes it; the joints' frames there are their orientations. Kinds and axes are those that `write_gltf` notes, else
    roots are free and other joints turn freely. Times are sampled at `rate`, the one of the keys where it is not given.
    Scale may change above the roots alone and be the same along all axes.

    **Raises:** `InputError` where the file is not a whole one, has no skin or no such clip, or has what a
    `Skeleton` and its `Pose` cannot hold: sheared, sparse, compressed or spline-keyed transforms.
    """
    file = GltfFile(path, clip)
    bound = _bind(file)
    return bound.skeleton, _motion(file, bound, rate)


def read_gltf_body(
    path: str | Path, rate: float | None = None, clip: str | None = None
) -> tuple[Body, Motion | None]:
    """The body of a file's first skin, which blends linearly, and an animation; skeleton and `clip` as in `read_gltf`.

    All meshes that this skin moves are the surface, or those of other skins of the same joints; morph targets and meshes that
    hang on a joint without a skin are left out. Vertices that were split along the seams of textures are one again.

    **Raises:** `InputError` as `read_gltf`, and where the surface is no triangles, or a vertex follows no joint.
    """
    file = GltfFile(path, clip)
    bound = _bind(file)
    return body_of(bound, read_surface(file, _nodes(file, bound))), _motion(file, bound, rate)


def _bind(file: GltfFile) -> Bound:
    """The skeleton of the first skin, at rest."""
    skin, nodes = file.document.skins[0], file.document.nodes
    joints = list(skin.joints)
    parents = [_parent(file, joint, joints) for joint in joints]
    inverse = np.tile(np.eye(4), (len(joints), 1, 1))
    if skin.inverseBindMatrices is not None:
        inverse = file.array(skin.inverseBindMatrices).reshape(-1, 4, 4).swapaxes(1, 2)
    notes = [nodes[joint].extras or {} for joint in joints]
    axes = np.tile(np.eye(3)[:2], (len(joints), 1, 1))
    for number, note in enumerate(notes):
        if np.shape(note.get("axes", ())) == (2, 3):
            axes[number] = note["axes"]
    # a hinge without its axes could turn about any
    kinds = [
        note.get("kind") if "axes" in note or note.get("kind") not in _HINGES else None for note in notes
    ]
    kinds = [kind if kind in KINDS else None for kind in kinds]
    names = [nodes[joint].name or f"joint{number}" for number, joint in enumerate(joints)]
    root = parents.index(-1)
    world, over = file.world(file.still()), file.above.get(joints[root])
    above = np.eye(3) if over is None else world[over][0, :3, :3]
    placed = placing(file.path, above, (world[joints[root]][0] @ inverse[root])[:3, :3])
    return bind(file.path, Joints(names, parents, kinds, axes, inverse), placed)


def _parent(file: GltfFile, joint: int, joints: list[int]) -> int:
    """The next joint above, whatever nodes stand between; -1 for a root."""
    node = file.above.get(joint)
    while node is not None and node not in joints:
        node = file.above.get(node)
    return -1 if node is None else joints.index(node)


def _nodes(file: GltfFile, bound: Bound) -> list[int]:
    joints = file.document.skins[0].joints
    return [joints[number] for number in bound.order]


def _motion(file: GltfFile, bound: Bound, rate: float | None) -> Motion | None:
    if not file.document.animations:
        return None
    clock, values = file.animation(rate)
    world = file.world(values)
    frames = np.stack([world[node] for node in _nodes(file, bound)], 1)
    found = (len(clock) - 1) / (clock[-1] - clock[0]) if len(clock) > 1 else 30.0
    return motion_of(file.path, bound, frames, found)
