"""A motion by few keys: what is between them is interpolated, and stays within a tolerance of the motion.

Keys are put in where the interpolation is furthest off, as Douglas and Peucker (1973) do for lines, until it is
off nowhere; then each that is not needed is taken out again.
"""

from collections.abc import Callable
from itertools import pairwise
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from ..body.kinematics import joint_paths
from ..body.pose import Motion, Pose
from ..body.skeleton import Skeleton
from ..geometry import rotation
from .interpolation import between


class Keys(NamedTuple):
    """Which frames are keys, and the motion that they give."""

    #: (F, J) frames that are keys of each joint; the same for all joints where whole poses are keys
    keyed: Bool[np.ndarray, "F J"]
    motion: Motion
    #: the largest errors of that motion: degrees of a joint's rotation, and metres of a joint's place
    degrees: float
    metres: float

    @property
    def count(self) -> int:
        """Keys of all joints together."""
        return int(self.keyed.sum())


def find_keys(
    skeleton: Skeleton,
    motion: Motion,
    degrees: float | int = 1.0,
    metres: float | int = 0.005,
    per_joint: bool = False,
) -> Keys:
    """Few keys between which rotations interpolated along the shortest arc, and translations and scale straight, are
    within `degrees` of every joint's own rotation, and joints within `metres` of their places in the world.

    The first and last frames are keys. Whole poses are keys unless `per_joint`, where every joint has keys of its
    own: fewer in all, as a still joint needs two. The tolerances are kept in every frame. Of whole poses no key can be
    left out alone; of single joints none can by that joint's rotation and translation, which may be off by half of
    `metres` of its own, and further keys hold what the errors of several joints add up to.

    **Raises:** `ValueError` for a tolerance that is not above 0, a motion without frames, or of other joints.
    """
    for name, value in (("degrees", degrees), ("metres", metres)):
        if not 0 < value < np.inf:
            raise ValueError(f"The tolerance is {value:g} {name}; it must be above 0.")
    count, joints = motion.poses.rotations.shape[:2]
    if joints != skeleton.num_joints:
        raise ValueError(
            f"The motion moves {joints} joints and the skeleton has {skeleton.num_joints}; retarget it."
        )
    if count == 0:
        raise ValueError("The motion has no frames; there are no keys in it.")
    paths = np.asarray(joint_paths(skeleton, motion.poses), float)
    keyed = np.zeros((count, joints), bool)
    keyed[[0, -1]] = True
    tolerance = np.array([np.radians(degrees), metres])
    if per_joint:
        _keys_of_joints(skeleton, motion.poses, paths, keyed, tolerance)
    else:
        keyed[:] = _keys_of_poses(skeleton, motion.poses, paths, keyed[:, 0], tolerance)[:, None]
    poses = interpolate_keys(motion.poses, keyed)
    turned, moved = _errors(skeleton, motion.poses, paths, poses)
    return Keys(
        keyed, Motion(poses, motion.rate), float(np.degrees(turned.max())), float(moved.max(initial=0.0))
    )


def interpolate_keys(poses: Pose, keyed: Bool[np.ndarray, "F J"]) -> Pose:
    """The poses that keys give: each joint between those of its frames that are `keyed`. Scale goes with the
    first joint. First and last frames have to be keys."""
    before, after = _neighbours(keyed)
    frames = np.arange(len(keyed))[:, None]
    share = (frames - before) / np.maximum(after - before, 1)
    return between(_poses_at(poses, before), _poses_at(poses, after), jnp.asarray(share))


def _poses_at(poses: Pose, frames: Int[np.ndarray, "F J"]) -> Pose:
    """Each joint as in a frame of its own."""
    joints = np.arange(frames.shape[1])
    return Pose(
        poses.translations[frames, joints], poses.rotations[frames, joints], poses.scale[frames[:, 0]]
    )


def _neighbours(keyed: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The last key at or before each frame, and the first at or after it."""
    frames = np.arange(len(keyed))[:, None]
    before = np.maximum.accumulate(np.where(keyed, frames, 0), axis=0)
    after = np.minimum.accumulate(np.where(keyed, frames, len(keyed) - 1)[::-1], axis=0)[::-1]
    return before, after


def _errors(
    skeleton: Skeleton, poses: Pose, paths: np.ndarray, there: Pose
) -> tuple[Float[np.ndarray, "F J"], Float[np.ndarray, "F J"]]:
    """By how much rotations (radians) and places (metres) are off."""
    turned = np.asarray(rotation.distance(poses.rotations, there.rotations), float)
    moved = np.linalg.norm(np.asarray(joint_paths(skeleton, there), float) - paths, axis=-1)
    return turned, moved


def _keys_of_poses(skeleton, poses: Pose, paths, keyed: np.ndarray, tolerance: np.ndarray) -> np.ndarray:
    def errors(marked: np.ndarray) -> np.ndarray:
        there = interpolate_keys(poses, np.repeat(marked[:, None], skeleton.num_joints, 1))
        turned, moved = _errors(skeleton, poses, paths, there)
        return np.maximum(turned.max(1) / tolerance[0], moved.max(1) / tolerance[1])

    return _prune(_insert(keyed, errors), errors)


def _keys_of_joints(skeleton, poses: Pose, paths, keyed: np.ndarray, tolerance: np.ndarray) -> None:
    """Marks the keys in `keyed`: of each joint by itself, then where joints' errors add up to too much."""

    def errors(marked: np.ndarray) -> np.ndarray:
        there = interpolate_keys(poses, marked)
        turned = np.asarray(rotation.distance(poses.rotations, there.rotations), float)
        slid = np.linalg.norm(np.asarray(there.translations - poses.translations, float), axis=-1)
        scaled = np.abs(np.asarray(there.scale - poses.scale, float))[:, None] * (
            np.arange(slid.shape[1]) == 0
        )
        return np.maximum(turned / tolerance[0], np.maximum(slid, scaled) / (0.5 * tolerance[1]))

    keyed[:] = _prune(_insert(keyed, errors), errors)
    descent = skeleton.descent
    while True:
        there = interpolate_keys(poses, keyed)
        turned, moved = _errors(skeleton, poses, paths, there)
        # a key changes the gaps beside it, so rotations are looked at again
        twisted, beyond = turned > tolerance[0], moved > tolerance[1]
        if not (twisted.any() or beyond.any()):
            return
        for joint in np.flatnonzero(twisted.any(0)):
            keyed[int(np.argmax(turned[:, joint])), joint] = True
        slid = np.linalg.norm(np.asarray(there.translations - poses.translations, float), axis=-1)
        # one key for each joint that is too far off in some frame: where it is furthest, for that of its ancestors
        # whose error moves it most
        for joint in np.flatnonzero(beyond.any(0)):
            frame = int(np.argmax(moved[:, joint]))
            lever = np.linalg.norm(paths[frame, joint] - paths[frame], axis=-1)
            effect = descent[:, joint] * (turned[frame] * lever + slid[frame])
            effect = np.where(keyed[frame], -1.0, effect)
            keyed[frame, int(np.argmax(effect))] = True


def _insert(keyed: np.ndarray, errors: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
    """A key at the worst frame of every gap in which something is off, until nothing is. `keyed` is (F,), or (F, J)
    with a column for each joint's own keys."""
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


def _prune(keyed: np.ndarray, errors: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
    """Keys taken out until none can be. Every other key is tried at once, as their gaps do not touch."""
    flat = keyed.reshape(len(keyed), -1).copy()
    needed = np.zeros_like(flat)
    while True:
        count = flat.sum()
        needed[:] = False
        needed[[0, -1]] = True
        while (flat & ~needed).any():
            tried = flat & ~_alternate(flat, needed)
            off = errors(tried.reshape(keyed.shape)).reshape(flat.shape) > 1.0
            before, after = _neighbours(tried)
            for frame, column in zip(*np.nonzero(flat & ~tried), strict=True):
                gap = slice(before[frame, column], after[frame, column] + 1)
                needed[frame, column] = off[gap, column].any()
                flat[frame, column] = needed[frame, column]
        # what was needed beside a key that has gone since may not be so now
        if flat.sum() == count:
            return flat.reshape(keyed.shape)


def _alternate(keyed: np.ndarray, needed: np.ndarray) -> np.ndarray:
    """Of the keys that may be left out, in every column some of which no two are neighbours."""
    chosen = np.zeros_like(keyed)
    for column in range(keyed.shape[1]):
        last = False
        for frame in np.flatnonzero(keyed[:, column]):
            last = not last and not needed[frame, column]
            chosen[frame, column] = last
    return chosen
