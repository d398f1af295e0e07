"""Cut, join and loop motion clips."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from ..arguments import checked
from ..body.kinematics import joint_paths
from ..body.pose import Motion, Pose, concatenate_poses, take_poses
from ..body.skeleton import Skeleton
from .interpolation import interpolate_poses, smooth_step
from .planar_transform import PlanarTransform, apply_planar_transform, fit_planar_transform, planar_power


class LoopedMotion(NamedTuple):
    """A loop: the last frame equals the first, up to a planar transform if the motion travels."""

    motion: Motion
    #: planar transform from the first frame to the last; the identity if the loop is in place
    travel: PlanarTransform


@checked
def cut(motion: Motion, first: int = 0, last: int | None = None) -> Motion:
    """Cut frames `first` to `last` from a motion, both included; negative numbers count from the end.

    **Raises:** `ValueError` if the motion does not have these frames, or the last comes before the first.
    """
    count = len(motion)
    last = count - 1 if last is None else last
    for name, frame in (("first", first), ("last", last)):
        if not -count <= frame < count:
            raise ValueError(
                f"The {name} frame is {frame}, but the motion has {count} frames; give a frame from 0 to {count - 1}."
            )
    first, last = first % count, last % count
    if last < first:
        raise ValueError(f"The last frame, {last}, comes before the first, {first}; exchange them.")
    return motion.slice(slice(first, last + 1))


@checked
def join(skeleton: Skeleton, a: Motion, b: Motion, frames: int = 0) -> Motion:
    """Join two motions into one.

    `b` is rotated about the vertical and translated along the floor so that it continues where `a` ends. The
    last `frames` of `a` are blended with the first ones of `b` (Kovar et al. 2002, section 5).

    In the blend, rotations follow the shortest arc and translations are linear. The blend weight has zero
    slope at both ends. If `frames` is 0, `b` follows one step after `a`, at the final speed of `a`. A blend
    never changes heights, so both motions need the same floor height.

    **Raises:** `ValueError` if a motion is shorter than the blend, has another number of joints than the
    skeleton, has no frames, or has another rate.
    """
    _check_motions(a, b)
    if not 0 <= frames <= min(len(a), len(b)):
        raise ValueError(
            f"A blend over {frames} frames does not fit motions of {len(a)} and {len(b)} frames; give from 0 to "
            f"{min(len(a), len(b))}."
        )
    window = max(frames, 1)
    end, start = take_poses(a.poses, slice(len(a) - window, None)), take_poses(b.poses, slice(0, window))
    here, there = np.asarray(joint_paths(skeleton, start)), np.asarray(joint_paths(skeleton, end))
    if frames == 0 and len(a) > 1:
        # one more step along the floor, at the final speed
        before = np.asarray(joint_paths(skeleton, take_poses(a.poses, slice(len(a) - 2, len(a) - 1))))
        there = there + np.mean(there - before, axis=1, keepdims=True) * [1.0, 0.0, 1.0]
    moved = apply_planar_transform(
        skeleton, fit_planar_transform(here.reshape(-1, 3), there.reshape(-1, 3)), b.poses
    )
    parts = [take_poses(a.poses, slice(0, len(a) - frames)), take_poses(moved, slice(frames, None))]
    if frames:
        share = smooth_step((np.arange(frames) + 1.0) / (frames + 1.0))
        blend = interpolate_poses(end, take_poses(moved, slice(0, frames)), jnp.asarray(share))
        parts = [parts[0], blend, parts[1]]
    return Motion(concatenate_poses(parts), a.rate)


@checked
def make_loop(
    skeleton: Skeleton, motion: Motion, first: int, last: int, frames: int, in_place: bool = False
) -> LoopedMotion:
    """Make a seamless loop of frames `first` to `last`.

    The `frames` before `last` are blended into those before `first`, after a planar transform. The last two
    frames of the loop are those before and at `first`. Three consecutive frames of `motion` therefore cross
    the seam: the last frame equals the first in pose and in velocity, to machine precision.

    **Arguments:** `in_place` removes the travel, evenly over the loop; the last frame is then at the position
    of the first. `find_loops` finds similar frames.

    **Raises:** `ValueError` if the frames are not in the motion, fewer than `frames` come before the first,
    or `frames` is less than 2 or more than the length of the loop.
    """
    _check_motions(motion, motion)
    if not 0 <= first < last < len(motion):
        raise ValueError(
            f"Frames {first} to {last} of the loop are not in a motion of {len(motion)} frames; give a first and a "
            f"later last frame from 0 to {len(motion) - 1}."
        )
    if not 2 <= frames <= last - first:
        raise ValueError(
            f"A blend over {frames} frames does not fit a loop of {last - first} frames; give from 2 to {last - first}."
        )
    if first < frames:
        raise ValueError(
            f"The loop begins at frame {first}, but its blend takes the {frames} frames before it; begin later or "
            "blend fewer frames."
        )
    early, late = (slice(end - frames, end + 1) for end in (first, last))
    paths = np.asarray(joint_paths(skeleton, motion.poses))
    travel = fit_planar_transform(paths[early].reshape(-1, 3), paths[late].reshape(-1, 3))
    lead = apply_planar_transform(skeleton, travel, take_poses(motion.poses, early))
    # the blend is complete one frame before the end
    share = smooth_step(np.arange(frames + 1) / (frames - 1.0))
    blend = interpolate_poses(take_poses(motion.poses, late), lead, jnp.asarray(share))
    poses = concatenate_poses([take_poses(motion.poses, slice(first, last - frames)), blend])
    if in_place:
        poses = apply_planar_transform(
            skeleton, [planar_power(travel, -t) for t in np.linspace(0.0, 1.0, last - first + 1)], poses
        )
        poses = _close_loop(poses)
        travel = PlanarTransform(0.0, np.zeros(2))
    return LoopedMotion(Motion(poses, motion.rate), travel)


def _close_loop(poses: Pose) -> Pose:
    """Replace the last frame by the first, from which it differs only by rounding."""
    return concatenate_poses([take_poses(poses, slice(0, -1)), take_poses(poses, slice(0, 1))])


def _check_motions(a: Motion, b: Motion) -> None:
    for motion in (a, b):
        if len(motion) == 0:
            raise ValueError("A motion has no frames; give motions with at least one frame.")
    if abs(a.rate - b.rate) > 1e-6 * a.rate:
        raise ValueError(
            f"The motions have {a.rate:g} and {b.rate:g} frames per second; resample one of them to the other."
        )
