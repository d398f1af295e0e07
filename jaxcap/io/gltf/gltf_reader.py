"""Bodies, skeletons and motions from glTF 2.0 files (`.glb`, `.gltf`) of any program."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import jax.numpy as jnp
import numpy as np

from ...arguments import checked
from ...body.body import Body
from ...body.body_model import BodyModel
from ...body.pose import Motion
from ...body.shape_modes import ShapeModes
from ...body.skeleton import KINDS, Skeleton
from ...errors import InputError
from ..skinned.bind_pose import (
    BindPose,
    FileJoints,
    make_bind_pose,
    make_skinned_body,
    make_skinned_motion,
    surface_to_world_transform,
)
from ..skinned.left_out import warn_of_unread_content
from ..system.reader_errors import reader_of
from ..text import MAX_NUMBER, shortened
from .gltf_file import GltfFile
from .gltf_parts import Part
from .gltf_surface import (
    find_skins_with_joints,
    find_unread_content,
    inverse_binds,
    read_surface,
    skin_joints,
    skinned_meshes,
)
from .gltf_targets import find_targets

#: the family of a body whose coefficients are shape keys
GLTF_FAMILY = "glTF"
_KINDS_WITH_AXES = ("revolute", "universal")


@checked
@reader_of("a skinned glTF file")
def read_gltf(
    path: str | Path, rate: float | None = None, clip: str | None = None
) -> tuple[Skeleton, Motion | None]:
    """Read the joints of a file's first skin, and an animation as their motion.

    The animation is the one named `clip`, or the first. The rest pose is given by the inverse bind matrices,
    in metres, upright after the transforms above the roots; the joints' frames there are their orientations.
    Kinds and axes are those that `write_gltf` stores; otherwise roots are free and other joints are ball
    joints. Times are sampled at `rate`, from the first key of any node to the last. Without `rate` the
    coarsest rate that contains all keys is used, and 30 frames per second with a warning if there is none.
    Other figures in the file are left out with a warning. Scale may change above the roots only and must be
    uniform.

    **Raises:** `InputError` if the file is incomplete, has no skin or no such clip, or has content that a
    `Skeleton` and its `Pose` cannot represent: sheared, sparse or compressed transforms.
    """
    file = GltfFile(path, clip)
    bound = _read_bind_pose(file)
    warn_of_unread_content(file.path, find_unread_content(file, skin_joints(file, 0), surface=False))
    return bound.skeleton, _motion(file, bound, rate)


@reader_of("a skinned glTF file")
def read_gltf_body(
    path: str | Path, rate: float | None = None, clip: str | None = None
) -> tuple[Body, Motion | None]:
    """Read the body of a file's first skin, with linear blend skinning, and an animation.

    Skeleton and `clip` are as in `read_gltf`. The surface consists of all meshes of this skin and of other
    skins that share joints with it. Vertices that were split along texture seams are merged. Shape keys
    (morph targets), meshes that are attached to a joint without a skin, and those of a second figure, whose
    skin has no joint of the first one, are left out with a warning.

    **Raises:** `InputError` as `read_gltf`, and if the surface is not made of triangles, or a vertex follows
    no joint.
    """
    file = GltfFile(path, clip)
    bound = _read_bind_pose(file)
    surface = read_surface(file, _nodes(file, bound))
    warn_of_unread_content(file.path, find_unread_content(file, skin_joints(file, 0), surface=True))
    return make_skinned_body(file.path, bound, surface), _motion(file, bound, rate)


@checked
@reader_of("a skinned glTF file")
def read_gltf_model(path: str | Path, names: Sequence[str] | None = None) -> BodyModel:
    """Read the body of a file's first skin with its shape keys (morph targets) as coefficients, each a group of its own.

    `shape_body(model, smile=np.array([1.0]))` applies the shape key `smile`. The template has the default weights of the file. Shape
    keys move the surface, and no joints. Skeleton and surface are those of `read_gltf_body`. A fit keeps the coefficients from 0 to
    1, the range of a shape key, or up to a default weight outside it.

    **Arguments:** `names`, the shape keys that are coefficients; the others keep their default weights. Default: all.

    **Raises:** `InputError` as `read_gltf_body`, and if the file has no shape keys, or not those of `names`.
    """
    file = GltfFile(path, None)
    targets = _shape_keys(file)
    if not targets:
        raise InputError(f"{path}: the skinned meshes have no shape keys; read the file as a body.")
    kept = list(targets if names is None else dict.fromkeys(names))
    if unknown := [name for name in kept if name not in targets]:
        there = ", ".join(map(shortened, targets))
        raise InputError(f"{path}: there is no shape key '{shortened(unknown[0])}'; the file has {there}.")
    bound = _read_bind_pose(file)
    surface = read_surface(file, _nodes(file, bound), list(targets))
    assert surface.displacements is not None
    weights = np.array(list(targets.values()))
    vertices = surface.vertices + np.einsum("k,vka->va", weights, surface.displacements)
    body = make_skinned_body(file.path, bound, surface._replace(vertices=vertices))
    columns = [list(targets).index(name) for name in kept]
    moves, weights = surface.displacements[:, columns], weights[columns]
    modes = np.swapaxes(moves @ bound.surface_to_world[:3, :3].T, 0, 1)
    dtype = body.vertices.dtype
    centres = jnp.zeros((len(kept), body.skeleton.num_joints, 3), dtype)
    return BodyModel(
        template=body,
        modes=ShapeModes(centres, jnp.asarray(modes, dtype)),
        template_coefficients=jnp.asarray(weights, dtype),
        groups=tuple((name, 1) for name in kept),
        family=GLTF_FAMILY,
        lowest=jnp.asarray(np.minimum(weights, 0.0), dtype),
        highest=jnp.asarray(np.maximum(weights, 1.0), dtype),
    )


@reader_of("a skinned glTF file")
def read_shape_keys(path: str | Path) -> list[str]:
    """Read the names of the shape keys of the meshes of a file's first skin. Raises `InputError`."""
    return list(_shape_keys(GltfFile(path, None)))


def _shape_keys(file: GltfFile) -> dict[str, float]:
    """Find the shape keys of the meshes of the first skin, with their default weights."""
    own = set(find_skins_with_joints(file, skin_joints(file, 0)))
    return find_targets(file, [mesh for _, mesh, skin in skinned_meshes(file) if skin in own])


def _read_bind_pose(file: GltfFile) -> BindPose:
    """Build the skeleton of the first skin, at rest."""
    joints = skin_joints(file, 0)
    place = {joint: number for number, joint in enumerate(joints)}
    parents = _parents(file, place)
    inverse = inverse_binds(file, 0)
    nodes = [file.nodes[joint] for joint in joints]
    for joint in joints:
        # a check: rest is the bind pose, but the node's own transform matters once something moves
        file.rest_transform(joint)
    axes, kinds = np.tile(np.eye(3)[:2], (len(joints), 1, 1)), []
    for number, node in enumerate(nodes):
        kind, noted = _read_extras(node)
        kinds.append(kind)
        if noted is not None:
            axes[number] = noted
    names = [node.text("name") or f"joint{number}" for number, node in enumerate(nodes)]
    root = parents.index(-1)
    over = file.parents.get(joints[root])
    world = file.world_transforms({}, [joints[root]] if over is None else [joints[root], over])
    above = np.eye(3) if over is None else world[over][0, :3, :3]
    placed = surface_to_world_transform(file.path, above, (world[joints[root]][0] @ inverse[root])[:3, :3])
    return make_bind_pose(file.path, FileJoints(names, parents, kinds, axes, inverse), placed)


def _read_extras(node: Part) -> tuple[str | None, np.ndarray | None]:
    """Read the kind and the axes that `write_gltf` stores for a joint.

    None if they are missing or belong to other programs.
    """
    note = node.content.get("extras")
    if not isinstance(note, dict):
        return None, None
    try:
        axes = np.array(note["axes"], float)
        axes = axes if axes.shape == (2, 3) and (np.abs(axes) <= MAX_NUMBER).all() else None
    except (KeyError, TypeError, ValueError, OverflowError):
        axes = None
    kind = note.get("kind")
    # the axis of a hinge is needed
    known = isinstance(kind, str) and kind in KINDS and (axes is not None or kind not in _KINDS_WITH_AXES)
    return (kind if known else None), axes


def _parents(file: GltfFile, joint_indices: Mapping[int, int]) -> list[int]:
    """Return the nearest joint above each joint, past any other nodes; -1 for a root."""
    # for each node: the joint that it is or descends from
    nearest: dict[int, int] = dict(joint_indices)
    parents = []
    for joint in joint_indices:
        chain, node = [], file.parents.get(joint)
        while node is not None and node not in nearest:
            chain.append(node)
            node = file.parents.get(node)
        found = -1 if node is None else nearest[node]
        nearest.update(dict.fromkeys(chain, found))
        parents.append(found)
    return parents


def _motion(file: GltfFile, bound: BindPose, rate: float | None) -> Motion | None:
    if not file.animations:
        return None
    clock, moving = file.sample_animation(rate)
    nodes = _nodes(file, bound)
    world = file.world_transforms(moving, nodes)
    file.reserve_memory(3 * 16 * len(clock) * len(nodes), "the motion of its joints")
    frames = np.stack([np.broadcast_to(world[node], (len(clock), 4, 4)) for node in nodes], 1)
    found = (len(clock) - 1) / (clock[-1] - clock[0]) if len(clock) > 1 else 30.0
    return make_skinned_motion(file.path, bound, frames, found)


def _nodes(file: GltfFile, bound: BindPose) -> list[int]:
    joints = skin_joints(file, 0)
    return [joints[number] for number in bound.order]
