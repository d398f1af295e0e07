"""Shared parts of the formats of skinned, animated bodies: local joint frames, and vertex influences.

In all of them a joint has its own frame: at rest it has the position of the joint's centre and the joint's
orientation, so its x axis is the twist axis. A frame is relative to its parent's, a root's to the world.
"""

from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial.transform import Rotation

from ...body.body import Body
from ...body.influences import strongest_bones
from ...body.pose import Motion
from ...body.skeleton import Skeleton
from ...body.skin import LinearSkin, RigidSkin
from ...errors import InputError

#: joints in one vertex attribute
INFLUENCES_PER_SET = 4


class LocalFrames(NamedTuple):
    """Joints in their parents' frames; quaternions are `xyzw`."""

    positions: Float[np.ndarray, "*frames J 3"]
    quaternions: Float[np.ndarray, "*frames J 4"]


def check_linear_skin(path: Path, body: Body, format_name: str) -> None:
    """Check that the skin of a body is linear, as the format `format_name` requires. Raises `InputError`."""
    if not isinstance(body.skin, (LinearSkin, RigidSkin)):
        raise InputError(
            f"{path}: {format_name} supports linear blend skinning only, and this body has a {type(body.skin).__name__}; "
            "convert it by `jaxcap.edit.to_linear_blend` first."
        )


def check_motion(path: Path, skeleton: Skeleton, motion: Motion | None) -> None:
    """Check that a motion, if given, has the skeleton's joints, has frames, and is finite.

    Raises `InputError`.
    """
    if motion is None:
        return
    joints = motion.poses.rotations.shape[1]
    if joints != skeleton.num_joints:
        raise InputError(
            f"{path}: the motion has {joints} joints and the body has {skeleton.num_joints}; retarget it."
        )
    if motion.num_frames == 0:
        raise InputError(f"{path}: the motion has no frames; expected at least one.")
    for values in (motion.poses.translations, motion.poses.rotations, motion.poses.scale):
        wrong = ~np.isfinite(np.asarray(values)).reshape(motion.num_frames, -1).all(1)
        if wrong.any():
            raise InputError(
                f"{path}: frame {int(wrong.argmax())} of the motion has numbers that are not finite; correct it."
            )


def rest_frames(skeleton: Skeleton) -> LocalFrames:
    """Compute the local frame of every joint at rest, `(J, ...)`."""
    steps, frames, above = _frames(skeleton)
    return LocalFrames(above.inv().apply(steps), (above.inv() * frames).as_quat())


def moving_frames(skeleton: Skeleton, motion: Motion) -> LocalFrames:
    """Compute the local frame of every joint in every frame of a motion, `(F, J, ...)`.

    The poses' scale is not included. The signs of quaternions are continuous from the rest pose on, as
    programs interpolate the components of keys.
    """
    steps, frames, above = _frames(skeleton)
    moves = np.asarray(motion.poses.translations, float)
    quaternions = np.asarray(motion.poses.rotations, float)
    translations, turns = np.empty_like(moves), np.empty_like(quaternions)
    for joint in range(skeleton.num_joints):
        back = above[joint].inv()
        translations[:, joint] = back.apply(steps[joint] + moves[:, joint])
        turned = back * Rotation.from_quat(quaternions[:, joint], scalar_first=True) * frames[joint]
        turns[:, joint] = _make_continuous(turned.as_quat(), (back * frames[joint]).as_quat())
    return LocalFrames(translations, turns)


def bind_frames(skeleton: Skeleton) -> Float[np.ndarray, "J 4 4"]:
    """Return the transforms from the joints' frames into the world at rest, for column vectors."""
    frames = np.tile(np.eye(4), (skeleton.num_joints, 1, 1))
    frames[:, :3, :3] = Rotation.from_quat(
        np.asarray(skeleton.orientations, float), scalar_first=True
    ).as_matrix()
    frames[:, :3, 3] = np.asarray(skeleton.centres, float)
    return frames


def influences(
    weights: Float[np.ndarray, "V J"],
) -> tuple[Int[np.ndarray, "V K"], Float[np.ndarray, "V K"]]:
    """Return the joints of each vertex, the strongest first, and their weights in single precision.

    Weights sum to one; K is a multiple of four, padded with joint 0 and weight 0.
    """
    weights = weights.astype("<f4")
    most = int((weights > 0).sum(1).max(initial=1))
    count = -(-most // INFLUENCES_PER_SET) * INFLUENCES_PER_SET
    weights = np.pad(weights, ((0, 0), (0, max(count - weights.shape[1], 0))))
    joints, chosen = strongest_bones(weights, count)
    # the strongest weight absorbs the rounding error
    chosen[:, 0] += (1.0 - chosen.sum(1, dtype=float)).astype("<f4")
    return np.where(chosen > 0, joints, 0), chosen


def _frames(skeleton: Skeleton) -> tuple[Float[np.ndarray, "J 3"], Rotation, Rotation]:
    """Return each joint's offset from its parent, its frame, and its parent's frame, in the world at rest."""
    parents, centres = np.array(skeleton.parents), np.array(skeleton.centres, float)
    frames = np.asarray(skeleton.orientations, float)
    above = np.where(parents[:, None] < 0, [1.0, 0, 0, 0], frames[parents])
    steps = centres - np.where(parents[:, None] < 0, 0.0, centres[parents])
    return steps, Rotation.from_quat(frames, scalar_first=True), Rotation.from_quat(above, scalar_first=True)


def _make_continuous(
    quaternions: Float[np.ndarray, "F 4"], rest: Float[np.ndarray, "4"]
) -> Float[np.ndarray, "F 4"]:
    """Flip the signs of quaternions so that they are continuous."""
    before = np.concatenate([rest[None], quaternions[:-1]])
    flips = np.where(np.sum(before * quaternions, 1) < 0, -1.0, 1.0)
    return quaternions * np.cumprod(flips)[:, None]
