"""Skinned, animated bodies as binary glTF 2.0 (`.glb`), which most 3D programs open.

Every joint is a node in its own frame: at rest it stands at the joint's centre, turned by the
joint's orientation, so its x axis is the twist axis. Above the roots is one node that carries
the scale of the poses. glTF skins by linear blending (Khronos, glTF 2.0, section 3.7.3), as
`LinearSkin` does; other skins are made linear first, by `jaxcap.linearise`.
"""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial.transform import Rotation

from ..body.body import Body
from ..body.pose import Motion
from ..body.skeleton import Skeleton
from ..body.skin import LinearSkin, RigidSkin
from ..errors import InputError
from .atomic import replacing
from .glb import INDICES, VERTICES, Blob
from .mesh import vertex_normals

if TYPE_CHECKING:
    import pygltflib

#: joints in one attribute of a vertex
_SET = 4
#: a channel is written where a number leaves its rest by more than single precision shows
_STILL = 1e-7


def write_gltf(path: str | Path, body: Body, motion: Motion | None = None) -> None:
    """Write a body, with a motion as its animation where there is one, in metres, y up.

    Every influence is kept, by fours in `JOINTS_0`, `JOINTS_1`, ...; the strongest come first.
    Some programs read the first four only: `limit_influences` makes a body that needs no more.
    Kinds and axes of joints stand in the nodes' extras, so that `read_gltf` gives the skeleton back.

    **Raises:** `InputError` where the suffix is not `.glb`, the skin does not blend linearly,
    the motion has other joints or no frames, or the file cannot be written.
    """
    import pygltflib

    path = Path(path)
    if path.suffix.lower() != ".glb":
        raise InputError(f"{path}: skinned bodies are not written as '{path.suffix}' files; use .glb.")
    if not isinstance(body.skin, (LinearSkin, RigidSkin)):
        raise InputError(
            f"{path}: glTF blends linearly and this body has a {type(body.skin).__name__}; linearise it first."
        )
    _check_motion(path, body.skeleton, motion)
    document = pygltflib.GLTF2(asset=pygltflib.Asset(version="2.0", generator="jaxcap"))
    blob = Blob(document)
    roots = [joint for joint, parent in enumerate(body.skeleton.parents) if parent < 0]
    top, surface = body.skeleton.num_joints, body.skeleton.num_joints + 1
    document.nodes = _joint_nodes(body.skeleton)
    document.nodes.append(pygltflib.Node(name=_free_name("Armature", body.skeleton), children=roots))
    # beside the armature, because a skinned mesh does not follow its own node
    document.nodes.append(pygltflib.Node(name=_free_name("Body", body.skeleton), mesh=0, skin=0))
    document.meshes = [pygltflib.Mesh(name="Body", primitives=[_surface(blob, body)])]
    # glTF's own default is a mirror of metal
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
        document.animations = _animations(blob, body.skeleton, motion)
    document.scenes, document.scene = [pygltflib.Scene(nodes=[top, surface])], 0
    with replacing(path) as beside:
        beside.write_bytes(blob.file())


def _check_motion(path: Path, skeleton: Skeleton, motion: Motion | None) -> None:
    if motion is None:
        return
    joints = motion.poses.rotations.shape[1]
    if joints != skeleton.num_joints:
        raise InputError(f"{path}: the motion moves {joints} joints and the body has {skeleton.num_joints}.")
    if motion.num_frames == 0:
        raise InputError(f"{path}: the motion has no frames; give one at least.")
    for values in (motion.poses.translations, motion.poses.rotations, motion.poses.scale):
        wrong = ~np.isfinite(np.asarray(values)).reshape(motion.num_frames, -1).all(1)
        if wrong.any():
            raise InputError(
                f"{path}: frame {int(wrong.argmax())} of the motion has numbers that are not finite."
            )


def _free_name(name: str, skeleton: Skeleton) -> str:
    while name in skeleton.names:
        name += "_"
    return name


def _frames(skeleton: Skeleton) -> tuple[Float[np.ndarray, "J 3"], Rotation, Rotation]:
    """Per joint: its centre seen from its parent's, its frame, and its parent's frame, at rest."""
    parents, centres = np.array(skeleton.parents), np.array(skeleton.centres, float)
    frames = np.asarray(skeleton.orientations, float)
    above = np.where(parents[:, None] < 0, [1.0, 0, 0, 0], frames[parents])
    steps = centres - np.where(parents[:, None] < 0, 0.0, centres[parents])
    return steps, Rotation.from_quat(frames, scalar_first=True), Rotation.from_quat(above, scalar_first=True)


def _joint_nodes(skeleton: Skeleton) -> "list[pygltflib.Node]":
    import pygltflib

    steps, frames, above = _frames(skeleton)
    places, turns = above.inv().apply(steps), (above.inv() * frames).as_quat()
    return [
        pygltflib.Node(
            name=name,
            translation=places[joint].tolist(),
            rotation=turns[joint].tolist(),
            children=[child for child, parent in enumerate(skeleton.parents) if parent == joint],
            extras={"kind": skeleton.kinds[joint], "axes": np.asarray(skeleton.axes[joint], float).tolist()},
        )
        for joint, name in enumerate(skeleton.names)
    ]


def _inverse_bind(skeleton: Skeleton) -> Float[np.ndarray, "J 4 4"]:
    """From the world at rest into each joint's frame."""
    _, frames, _ = _frames(skeleton)
    inverse = np.tile(np.eye(4), (skeleton.num_joints, 1, 1))
    inverse[:, :3, :3] = frames.inv().as_matrix()
    inverse[:, :3, 3] = -frames.inv().apply(np.array(skeleton.centres, float))
    return inverse.astype("<f4")


def _surface(blob: Blob, body: Body) -> "pygltflib.Primitive":
    import pygltflib

    vertices, faces = np.asarray(body.vertices, float), np.asarray(body.faces)
    normals = vertex_normals(vertices, faces)
    # a vertex of no face has no normal, and glTF wants one of unit length
    normals[np.linalg.norm(normals, axis=1) < 0.5] = [0.0, 1.0, 0.0]
    attributes = pygltflib.Attributes(
        POSITION=blob.add(vertices.astype("<f4"), VERTICES, bounds=True),
        NORMAL=blob.add(normals.astype("<f4"), VERTICES),
    )
    joints, weights = influences(np.asarray(body.skin.influence(body.skeleton.num_joints), float))
    number = "u1" if body.skeleton.num_joints <= 256 else "<u2"
    for place in range(joints.shape[1] // _SET):
        part = slice(_SET * place, _SET * (place + 1))
        setattr(attributes, f"JOINTS_{place}", blob.add(joints[:, part].astype(number), VERTICES))
        setattr(attributes, f"WEIGHTS_{place}", blob.add(weights[:, part], VERTICES))
    # the largest number of a type ends a strip, so it cannot be a vertex
    number = "<u2" if len(vertices) <= 0xFFFF else "<u4"
    indices = blob.add(faces.reshape(-1).astype(number), INDICES) if len(faces) else None
    return pygltflib.Primitive(
        attributes=attributes, indices=indices, material=0, mode=4 if len(faces) else 0
    )


def influences(
    weights: Float[np.ndarray, "V J"],
) -> tuple[Int[np.ndarray, "V K"], Float[np.ndarray, "V K"]]:
    """The joints of each vertex, the strongest first, and their weights in single precision,
    which sum to one; K is a multiple of four, and what is over is joint 0 with weight 0."""
    weights = weights.astype("<f4")
    most = int((weights > 0).sum(1).max(initial=1))
    count = -(-most // _SET) * _SET
    weights = np.pad(weights, ((0, 0), (0, max(count - weights.shape[1], 0))))
    joints = np.argsort(-weights, axis=1, kind="stable")[:, :count]
    chosen = np.take_along_axis(weights, joints, 1)
    chosen /= chosen.sum(1, keepdims=True)
    # the strongest takes what rounding has left
    chosen[:, 0] += (1.0 - chosen.sum(1, dtype=float)).astype("<f4")
    return np.where(chosen > 0, joints, 0), chosen


def _animations(blob: Blob, skeleton: Skeleton, motion: Motion) -> "list[pygltflib.Animation]":
    """One animation with a channel for every node's property that leaves its rest; none where
    all is at rest."""
    import pygltflib

    animation = pygltflib.Animation(name="Motion")
    times = np.arange(motion.num_frames) / motion.rate
    clock = None

    def channel(node: int, what: str, values: np.ndarray, rest: np.ndarray) -> None:
        nonlocal clock
        if np.abs(values - rest).max() <= _STILL:
            return
        clock = blob.add(times.astype("<f4"), bounds=True) if clock is None else clock
        output = blob.add(values.astype("<f4"))
        animation.samplers.append(
            pygltflib.AnimationSampler(input=clock, output=output, interpolation="LINEAR")
        )
        target = pygltflib.AnimationChannelTarget(node=node, path=what)
        animation.channels.append(
            pygltflib.AnimationChannel(sampler=len(animation.samplers) - 1, target=target)
        )

    steps, frames, above = _frames(skeleton)
    moves = np.asarray(motion.poses.translations, float)
    quaternions = np.asarray(motion.poses.rotations, float)
    for joint in range(skeleton.num_joints):
        back = above[joint].inv()
        places = back.apply(steps[joint] + moves[:, joint])
        turns = back * Rotation.from_quat(quaternions[:, joint], scalar_first=True) * frames[joint]
        rest = (back * frames[joint]).as_quat()
        channel(joint, "translation", places, back.apply(steps[joint]))
        channel(joint, "rotation", _continuous(turns.as_quat(), rest), rest)
    scales = np.repeat(np.asarray(motion.poses.scale, float)[:, None], 3, 1)
    channel(skeleton.num_joints, "scale", scales, np.ones(3))
    return [animation] if animation.channels else []


def _continuous(turns: Float[np.ndarray, "F 4"], rest: Float[np.ndarray, "4"]) -> Float[np.ndarray, "F 4"]:
    """The same rotations with signs that do not jump, for programs that blend numbers."""
    before = np.concatenate([rest[None], turns[:-1]])
    flips = np.where(np.sum(before * turns, 1) < 0, -1.0, 1.0)
    return turns * np.cumprod(flips)[:, None]
