"""Joint centres of a solved motion, and markers with their gaps filled."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ...arguments import checked
from ...body.kinematics import forward_kinematics, joint_positions
from ...body.pose import Motion, Pose
from ...body.skeleton import Skeleton
from ...observe.markers import MarkerFrames
from ..calibration.residuals import rest_positions
from ..subject import Subject
from .label_matching import match_markers


@checked
def joint_frames(
    skeleton: Skeleton, motion: Motion, lost: Bool[np.ndarray, "F"] | None = None
) -> MarkerFrames:
    """Compute the joint centres of every frame as markers with the joints' names; none in `lost` frames."""
    positions = np.asarray(_joint_centres(skeleton, motion.poses))
    seen = np.ones(positions.shape[:2], bool)
    if lost is not None:
        seen &= ~np.asarray(lost)[:, None]
    return MarkerFrames(np.where(seen[..., None], positions, 0), seen, skeleton.names, motion.rate)


@checked
def fill_gaps(
    subject: Subject,
    motion: Motion,
    frames: MarkerFrames,
    *,
    weights: Float[np.ndarray, "F M"] | None = None,
    lost: Bool[np.ndarray, "F"] | None = None,
) -> MarkerFrames:
    """Fill the gaps of the subject's markers with predictions from their bones; observed positions stay.

    The offset of a marker from its predicted position is interpolated linearly across a gap, in the frame of
    the bone, so that nothing jumps. Before the first and after the last observation it is constant. A marker
    that is never visible is at its predicted position.

    **Arguments:** `motion` through the frames; `weights` of the markers from the solve, in the subject's
    order: an observation with a weight below 0.5 is an outlier and replaced as in a gap; in `lost` frames,
    and for markers with the subject's weight 0, nothing is filled.
    """
    matched = match_markers(subject, frames)
    positions, seen = np.asarray(matched.positions, float), np.asarray(matched.seen)
    local = np.asarray(rest_frame_positions(subject, motion, matched.positions), float)
    trusted = seen if weights is None else seen & (np.asarray(weights) >= 0.5)
    filled = np.tile(np.asarray(subject.offsets, float), (len(positions), 1, 1))
    at = np.arange(len(positions))
    for marker in np.flatnonzero(trusted.any(0)):
        known = np.flatnonzero(trusted[:, marker])
        for axis in range(3):
            filled[:, marker, axis] = np.interp(at, known, local[known, marker, axis])
    on_bones = np.asarray(subject.weights) > 0
    gap = ~trusted & on_bones
    if lost is not None:
        gap &= ~np.asarray(lost)[:, None]
    carried = np.asarray(
        _to_world(subject, motion.poses, jnp.asarray(filled, matched.positions.dtype)), float
    )
    whole = np.where(gap[..., None], carried, positions)
    dtype = np.asarray(frames.positions).dtype
    return MarkerFrames(whole.astype(dtype), seen | gap, subject.labels, frames.rate)


def predicted_positions(subject: Subject, motion: Motion) -> Float[Array, "F M 3"]:
    """Predict the marker positions of a motion, metres; circle and sphere markers as if rigid."""
    local = jnp.broadcast_to(subject.offsets, (len(motion), *subject.offsets.shape))
    return _to_world(subject, motion.poses, local)


def rest_frame_positions(
    subject: Subject, motion: Motion, positions: Float[Array, "F M 3"]
) -> Float[Array, "F M 3"]:
    """Transform marker positions of a motion to the rest frames of their bones, metres."""
    return _to_rest_frames(subject, motion.poses, positions)


@eqx.filter_jit
def _joint_centres(skeleton: Skeleton, poses: Pose) -> Float[Array, "F J 3"]:
    return jax.lax.map(lambda pose: joint_positions(skeleton, forward_kinematics(skeleton, pose)), poses)


@eqx.filter_jit
def _to_rest_frames(subject: Subject, poses: Pose, positions: Float[Array, "F M 3"]) -> Float[Array, "F M 3"]:
    def of_frame(frame):
        pose, observed = frame
        return rest_positions(subject, pose, forward_kinematics(subject.skeleton, pose), observed)

    return jax.lax.map(of_frame, (poses, positions))


@eqx.filter_jit
def _to_world(subject: Subject, poses: Pose, local: Float[Array, "F M 3"]) -> Float[Array, "F M 3"]:
    def of_frame(frame):
        pose, rest = frame
        transforms = forward_kinematics(subject.skeleton, pose)
        r, t = transforms.rotations[subject.bones], transforms.translations[subject.bones]
        return jnp.einsum("mab,mb->ma", r, rest) + t

    return jax.lax.map(of_frame, (poses, local))
