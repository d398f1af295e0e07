"""Skinned, animated bodies as binary glTF 2.0 (`.glb`), which most 3D programs open.

Every joint is a node with its own frame: at rest it has the position of the joint's centre and the joint's
orientation, so its x axis is the twist axis. One node above the roots carries the scale of the poses. glTF
uses linear blend skinning (Khronos, glTF 2.0, section 3.7.3), as `LinearSkin` does; convert other skins by
`jaxcap.edit.to_linear_blend` first.
"""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from ...arguments import checked
from ...body.body import Body
from ...body.morph_targets import MorphTargets
from ...body.pose import Motion
from ...body.skeleton import Skeleton
from ...errors import InputError
from ...geometry.mesh import vertex_normals
from ..skinned.skinned import (
    INFLUENCES_PER_SET,
    bind_frames,
    check_linear_skin,
    check_motion,
    influences,
    moving_frames,
    rest_frames,
)
from ..system.atomic import atomic_path
from .glb import ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER, GlbBuilder
from .gltf_target_writer import add_targets, check_targets

if TYPE_CHECKING:
    import pygltflib

#: a channel is written if a number differs from its rest value by more than single precision resolves
_CHANNEL_TOLERANCE = 1e-7


@checked
def write_gltf(
    path: str | Path, body: Body, motion: Motion | None = None, targets: MorphTargets | None = None
) -> None:
    """Write a body, with an optional motion as its animation, in metres, y up.

    All influences are kept, in sets of four in `JOINTS_0`, `JOINTS_1`, ...; the strongest come first. Some
    programs read the first four only: `limit_influences` makes a body with at most four. Kinds and axes of
    joints are in the nodes' extras, so that `read_gltf` restores the skeleton. `targets` become morph targets (shape keys), with
    weights that the motion animates: `jaxcap.edit.linear_targets` makes them of displacements that depend on the pose.

    **Raises:** `InputError` if the suffix is not `.glb`, the skin is not linear, the motion has other joints
    or no frames, the targets have other vertices or frames, or the file cannot be written.
    """
    import pygltflib

    path = Path(path)
    if path.suffix.lower() != ".glb":
        raise InputError(f"{path}: skinned bodies are not written as '{path.suffix}' files; use .glb.")
    check_linear_skin(path, body, "glTF")
    check_motion(path, body.skeleton, motion)
    check_targets(path, body, motion, targets)
    document = pygltflib.GLTF2(asset=pygltflib.Asset(version="2.0", generator="jaxcap"))
    blob = GlbBuilder(document)
    roots = [joint for joint, parent in enumerate(body.skeleton.parents) if parent < 0]
    top, surface = body.skeleton.num_joints, body.skeleton.num_joints + 1
    document.nodes = _joint_nodes(body.skeleton)
    document.nodes.append(pygltflib.Node(name=_unique_name("Armature", body.skeleton), children=roots))
    # outside the armature, because a skinned mesh does not follow its own node
    document.nodes.append(pygltflib.Node(name=_unique_name("Body", body.skeleton), mesh=0, skin=0))
    document.meshes = [pygltflib.Mesh(name="Body", primitives=[_surface(blob, body)])]
    if targets is not None and len(targets.names):
        add_targets(blob, document.meshes[0], targets)
    # the default material of glTF is a metallic mirror
    look = pygltflib.PbrMetallicRoughness(
        baseColorFactor=[0.8, 0.8, 0.8, 1.0], metallicFactor=0.0, roughnessFactor=0.8
    )
    document.materials = [pygltflib.Material(name="Body", pbrMetallicRoughness=look)]
    document.skins = [
        pygltflib.Skin(
            name="Armature",
            joints=list(range(top)),
            skeleton=top,
            inverseBindMatrices=blob.add(_inverse_bind(body.skeleton)),
        )
    ]
    if motion is not None:
        document.animations = _animations(
            blob, body.skeleton, motion, surface, None if targets is None else targets.weights
        )
    document.scenes, document.scene = [pygltflib.Scene(nodes=[top, surface])], 0
    with atomic_path(path) as beside:
        beside.write_bytes(blob.to_bytes())


def _unique_name(name: str, skeleton: Skeleton) -> str:
    while name in skeleton.names:
        name += "_"
    return name


def _joint_nodes(skeleton: Skeleton) -> "list[pygltflib.Node]":
    import pygltflib

    translations, turns = rest_frames(skeleton)
    return [
        pygltflib.Node(
            name=name,
            translation=translations[joint].tolist(),
            rotation=turns[joint].tolist(),
            children=[child for child, parent in enumerate(skeleton.parents) if parent == joint],
            extras={"kind": skeleton.kinds[joint], "axes": np.asarray(skeleton.axes[joint], float).tolist()},
        )
        for joint, name in enumerate(skeleton.names)
    ]


def _inverse_bind(skeleton: Skeleton) -> Float[np.ndarray, "J 4 4"]:
    """Return the transforms from the world at rest into the joints' frames."""
    bind = bind_frames(skeleton)
    inverse = np.tile(np.eye(4), (len(bind), 1, 1))
    inverse[:, :3, :3] = bind[:, :3, :3].swapaxes(1, 2)
    inverse[:, :3, 3] = -np.einsum("jba,jb->ja", bind[:, :3, :3], bind[:, :3, 3])
    return inverse.astype("<f4")


def _surface(blob: GlbBuilder, body: Body) -> "pygltflib.Primitive":
    import pygltflib

    vertices, faces = np.asarray(body.vertices, float), np.asarray(body.faces)
    normals = vertex_normals(vertices, faces)
    # a vertex of no face has no normal, and glTF requires unit length
    normals[np.linalg.norm(normals, axis=1) < 0.5] = [0.0, 1.0, 0.0]
    attributes = pygltflib.Attributes(
        POSITION=blob.add(vertices.astype("<f4"), ARRAY_BUFFER, bounds=True),
        NORMAL=blob.add(normals.astype("<f4"), ARRAY_BUFFER),
    )
    joints, weights = influences(np.asarray(body.skin.bone_weights(body.skeleton.num_joints), float))
    number = "u1" if body.skeleton.num_joints <= 256 else "<u2"
    for place in range(joints.shape[1] // INFLUENCES_PER_SET):
        part = slice(INFLUENCES_PER_SET * place, INFLUENCES_PER_SET * (place + 1))
        setattr(attributes, f"JOINTS_{place}", blob.add(joints[:, part].astype(number), ARRAY_BUFFER))
        setattr(attributes, f"WEIGHTS_{place}", blob.add(weights[:, part], ARRAY_BUFFER))
    # the largest number of a type ends a strip, so it cannot be a vertex
    number = "<u2" if len(vertices) <= 0xFFFF else "<u4"
    indices = blob.add(faces.reshape(-1).astype(number), ELEMENT_ARRAY_BUFFER) if len(faces) else None
    return pygltflib.Primitive(
        attributes=attributes, indices=indices, material=0, mode=4 if len(faces) else 0
    )


def _animations(
    blob: GlbBuilder,
    skeleton: Skeleton,
    motion: Motion,
    surface: int,
    weights: Float[np.ndarray, "F K"] | None,
) -> "list[pygltflib.Animation]":
    """Build one animation with a channel for every node property that leaves its rest value.

    `weights` are those of the targets of the node `surface`. Empty if all are at rest.
    """
    import pygltflib

    animation = pygltflib.Animation(name="Motion")
    times = np.arange(motion.num_frames) / motion.rate
    clock = None

    def channel(node: int, what: str, values: np.ndarray, rest: np.ndarray) -> None:
        nonlocal clock
        if np.abs(values - rest).max(initial=0.0) <= _CHANNEL_TOLERANCE:
            return
        clock = blob.add(times.astype("<f4"), bounds=True) if clock is None else clock
        # the weights of all targets of a frame follow each other, as numbers
        rows = values.reshape(-1) if what == "weights" else values
        output = blob.add(rows.astype("<f4"))
        animation.samplers.append(
            pygltflib.AnimationSampler(input=clock, output=output, interpolation="LINEAR")
        )
        target = pygltflib.AnimationChannelTarget(node=node, path=what)
        animation.channels.append(
            pygltflib.AnimationChannel(sampler=len(animation.samplers) - 1, target=target)
        )

    rest, moving = rest_frames(skeleton), moving_frames(skeleton, motion)
    for joint in range(skeleton.num_joints):
        channel(joint, "translation", moving.positions[:, joint], rest.positions[joint])
        channel(joint, "rotation", moving.quaternions[:, joint], rest.quaternions[joint])
    scales = np.repeat(np.asarray(motion.poses.scale, float)[:, None], 3, 1)
    channel(skeleton.num_joints, "scale", scales, np.ones(3))
    if weights is not None:
        channel(surface, "weights", weights, np.zeros(weights.shape[1]))
    return [animation] if animation.channels else []
