"""Key reduction: few keys whose interpolation stays within a tolerance of the motion.

Keys are inserted at the largest interpolation error, as Douglas and Peucker (1973) do for lines, until the
error is within the tolerance everywhere. Then each key that is not needed is removed again.
"""

from collections.abc import Callable
from itertools import pairwise
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from ..arguments import checked
from ..body.kinematics import joint_paths
from ..body.pose import Motion, Pose
from ..body.skeleton import Skeleton
from ..geometry import rotation
from .interpolation import interpolate_poses


class Keyframes(NamedTuple):
    """The key frames, and the motion that is interpolated from them."""

    #: (F, J) key frames of each joint; the same for all joints if whole poses are keys
    is_key: Bool[np.ndarray, "F J"]
    motion: Motion
    #: largest errors of that motion: joint rotation, degrees, and joint position, metres
    degrees: float
    metres: float

    @property
    def count(self) -> int:
        """The number of keys of all joints together."""
        return int(self.is_key.sum())


@checked
def find_keys(
    skeleton: Skeleton,
    motion: Motion,
    degrees: float | int = 1.0,
    metres: float | int = 0.005,
    per_joint: bool = False,
) -> Keyframes:
    """Find few keys whose interpolation is within `degrees` of every joint rotation and `metres` of every
    joint position.

    Rotations are interpolated along the shortest arc, translations and scale linearly; positions are in the
    world. The first and last frames are keys. Whole poses are keys unless `per_joint`; then every joint has
    its own keys, which are fewer in all, as a joint at rest needs two. The tolerances hold in every frame. No
    single key of whole poses can be removed. With keys per joint, no key can be removed by the error of that
    joint's own rotation and translation; the translation may use half of `metres`. Further keys limit the
    accumulated errors of several joints.

    **Raises:** `ValueError` for a tolerance that is not above 0, a motion without frames, or of other joints.
    """
    for name, value in (("degrees", degrees), ("metres", metres)):
        if not 0 < value < np.inf:
            raise ValueError(f"The tolerance is {value:g} {name}; expected above 0.")
    count, joints = motion.poses.rotations.shape[:2]
    if count == 0:
        raise ValueError("The motion has no frames; give one with at least one frame.")
    paths = np.asarray(joint_paths(skeleton, motion.poses), float)
    keyed = np.zeros((count, joints), bool)
    keyed[[0, -1]] = True
    tolerance = np.array([np.radians(degrees), metres])
    if per_joint:
        _find_joint_keys(skeleton, motion.poses, paths, keyed, tolerance)
    else:
        keyed[:] = _find_pose_keys(skeleton, motion.poses, paths, keyed[:, 0], tolerance)[:, None]
    poses = interpolate_keys(motion.poses, keyed)
    turned, moved = _interpolation_errors(skeleton, motion.poses, paths, poses)
    return Keyframes(
        keyed, Motion(poses, motion.rate), float(np.degrees(turned.max())), float(moved.max(initial=0.0))
    )


@checked
def interpolate_keys(poses: Pose, is_key: Bool[np.ndarray, "F J"]) -> Pose:
    """Interpolate poses between keys, each joint between its own `is_key` frames.

    The scale uses the keys of the first joint. The first and last frames have to be keys.
    """
    before, after = _neighbour_keys(is_key)
    frames = np.arange(len(is_key))[:, None]
    share = (frames - before) / np.maximum(after - before, 1)
    return interpolate_poses(_poses_at(poses, before), _poses_at(poses, after), jnp.asarray(share))


def _poses_at(poses: Pose, frames: Int[np.ndarray, "F J"]) -> Pose:
    """Take each joint from its own frame."""
    joints = np.arange(frames.shape[1])
    return Pose(
        poses.translations[frames, joints], poses.rotations[frames, joints], poses.scale[frames[:, 0]]
    )


def _neighbour_keys(keyed: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Find the last key at or before each frame, and the first at or after it."""
    frames = np.arange(len(keyed))[:, None]
    before = np.maximum.accumulate(np.where(keyed, frames, 0), axis=0)
    after = np.minimum.accumulate(np.where(keyed, frames, len(keyed) - 1)[::-1], axis=0)[::-1]
    return before, after


def _interpolation_errors(
    skeleton: Skeleton, poses: Pose, paths: np.ndarray, interpolated: Pose
) -> tuple[Float[np.ndarray, "F J"], Float[np.ndarray, "F J"]]:
    """Compute the errors of rotations (radians) and positions (metres)."""
    turned = np.asarray(rotation.distance(poses.rotations, interpolated.rotations), float)
    moved = np.linalg.norm(np.asarray(joint_paths(skeleton, interpolated), float) - paths, axis=-1)
    return turned, moved


def _find_pose_keys(skeleton, poses: Pose, paths, keyed: np.ndarray, tolerance: np.ndarray) -> np.ndarray:
    def errors(marked: np.ndarray) -> np.ndarray:
        interpolated = interpolate_keys(poses, np.repeat(marked[:, None], skeleton.num_joints, 1))
        turned, moved = _interpolation_errors(skeleton, poses, paths, interpolated)
        return np.maximum(turned.max(1) / tolerance[0], moved.max(1) / tolerance[1])

    return _prune_keys(_insert_keys(keyed, errors), errors)


def _find_joint_keys(skeleton, poses: Pose, paths, keyed: np.ndarray, tolerance: np.ndarray) -> None:
    """Mark the keys in `keyed`: for each joint by itself, then to limit accumulated errors."""

    def errors(marked: np.ndarray) -> np.ndarray:
        interpolated = interpolate_keys(poses, marked)
        turned = np.asarray(rotation.distance(poses.rotations, interpolated.rotations), float)
        slid = np.linalg.norm(np.asarray(interpolated.translations - poses.translations, float), axis=-1)
        scaled = np.abs(np.asarray(interpolated.scale - poses.scale, float))[:, None] * (
            np.arange(slid.shape[1]) == 0
        )
        return np.maximum(turned / tolerance[0], np.maximum(slid, scaled) / (0.5 * tolerance[1]))

    keyed[:] = _prune_keys(_insert_keys(keyed, errors), errors)
    descent = skeleton.descendants
    while True:
        interpolated = interpolate_keys(poses, keyed)
        turned, moved = _interpolation_errors(skeleton, poses, paths, interpolated)
        # a key changes the adjacent gaps, so rotations are checked again
        twisted, beyond = turned > tolerance[0], moved > tolerance[1]
        if not (twisted.any() or beyond.any()):
            return
        for joint in np.flatnonzero(twisted.any(0)):
            keyed[int(np.argmax(turned[:, joint])), joint] = True
        slid = np.linalg.norm(np.asarray(interpolated.translations - poses.translations, float), axis=-1)
        # one key for each joint that exceeds the tolerance in some frame: at its largest error, for the
        # ancestor whose error contributes most
        for joint in np.flatnonzero(beyond.any(0)):
            frame = int(np.argmax(moved[:, joint]))
            lever = np.linalg.norm(paths[frame, joint] - paths[frame], axis=-1)
            effect = descent[:, joint] * (turned[frame] * lever + slid[frame])
            effect = np.where(keyed[frame], -1.0, effect)
            keyed[frame, int(np.argmax(effect))] = True


def _insert_keys(keyed: np.ndarray, errors: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
    """Insert a key at the worst frame of every gap that exceeds the tolerance, until none does.

    `keyed` is (F,), or (F, J) with a column of keys for each joint.
    """
    keyed, shape = keyed.copy(), keyed.shape
    while True:
        off = errors(keyed).reshape(len(keyed), -1)
        if (off <= 1.0).all():
            return keyed
        columns = keyed.reshape(len(keyed), -1).copy()
        for column in np.flatnonzero((off > 1.0).any(0)):
            keys = np.flatnonzero(columns[:, column])
            for start, end in pairwise(keys):
                gap = off[start:end, column]
                if gap.max() > 1.0:
                    columns[start + int(np.argmax(gap)), column] = True
        keyed = columns.reshape(shape)


def _prune_keys(keyed: np.ndarray, errors: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
    """Remove keys until none can be removed. Every second key is tried at once: their gaps do not overlap."""
    flat = keyed.reshape(len(keyed), -1).copy()
    needed = np.zeros_like(flat)
    while True:
        count = flat.sum()
        needed[:] = False
        needed[[0, -1]] = True
        while (flat & ~needed).any():
            tried = flat & ~_alternate_keys(flat, needed)
            off = errors(tried.reshape(keyed.shape)).reshape(flat.shape) > 1.0
            before, after = _neighbour_keys(tried)
            for frame, column in zip(*np.nonzero(flat & ~tried), strict=True):
                gap = slice(before[frame, column], after[frame, column] + 1)
                needed[frame, column] = off[gap, column].any()
                flat[frame, column] = needed[frame, column]
        # a key that was needed may be redundant after its neighbour was removed
        if flat.sum() == count:
            return flat.reshape(keyed.shape)


def _alternate_keys(keyed: np.ndarray, needed: np.ndarray) -> np.ndarray:
    """Choose removable keys in every column so that no two of them are neighbours."""
    chosen = np.zeros_like(keyed)
    for column in range(keyed.shape[1]):
        last = False
        for frame in np.flatnonzero(keyed[:, column]):
            last = not last and not needed[frame, column]
            chosen[frame, column] = last
    return chosen
