"""Joint centres of a solved motion, and markers with their gaps filled."""

from typing import NamedTuple

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
from ..subject import Subject
from .gap_offsets import fill_offsets
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


class GapEstimate(NamedTuple):
    """The subject's markers with their gaps filled, and the uncertainty of the filled positions."""

    frames: MarkerFrames
    #: standard deviation of each filled position along its least certain axis, metres; zero where observed, NaN in gaps that
    #: stay
    deviations: Float[np.ndarray, "F M"]


@checked
def fill_gaps(
    subject: Subject,
    motion: Motion,
    frames: MarkerFrames,
    *,
    weights: Float[np.ndarray, "F M"] | None = None,
    lost: Bool[np.ndarray, "F"] | None = None,
) -> MarkerFrames:
    """Fill the gaps of the subject's markers; observed positions stay. Arguments are those of `estimate_gaps`."""
    return estimate_gaps(subject, motion, frames, weights=weights, lost=lost).frames


@checked
def estimate_gaps(
    subject: Subject,
    motion: Motion,
    frames: MarkerFrames,
    *,
    weights: Float[np.ndarray, "F M"] | None = None,
    lost: Bool[np.ndarray, "F"] | None = None,
) -> GapEstimate:
    """Estimate the positions of the subject's markers in gaps by pose, neighbours and time; observed positions stay.

    The poses carry a marker through its gap: those of `motion`, and next to a gap those that the other markers give. Its offset from its bone follows from the offsets of the other
    markers of the bone and from those before and after the gap (`gap_model`). The statistics, and with them the
    deviations, are those of gaps that are made in visible pieces of the same frames and filled in the same way. A marker
    that is never visible is at its predicted position, with the deviation that the subject gives.

    **Arguments:** `motion` through the frames; `weights` of the markers from the solve, in the subject's
    order: an observation with a weight below 0.5 is an outlier and replaced as in a gap; in `lost` frames,
    and for markers with the subject's weight 0, nothing is filled.
    """
    matched = match_markers(subject, frames)
    positions, seen = np.asarray(matched.positions, float), np.asarray(matched.seen)
    trusted = seen if weights is None else seen & (np.asarray(weights) >= 0.5)
    gap = ~trusted & (np.asarray(subject.weights) > 0)
    if lost is not None:
        # the poses of lost frames are those of other frames
        trusted = trusted & ~np.asarray(lost)[:, None]
        gap &= ~np.asarray(lost)[:, None]
    filled = fill_offsets(subject, motion, matched.positions, trusted, gap)
    carried = np.asarray(
        _to_world(subject, filled.poses, jnp.asarray(filled.offsets, matched.positions.dtype)), float
    )
    whole = np.where(gap[..., None], carried, positions)
    dtype = np.asarray(frames.positions).dtype
    deviations = np.where(gap, filled.deviations, np.where(seen, 0.0, np.nan))
    return GapEstimate(MarkerFrames(whole.astype(dtype), seen | gap, subject.labels, frames.rate), deviations)


def predicted_positions(subject: Subject, motion: Motion) -> Float[Array, "F M 3"]:
    """Predict the marker positions of a motion, metres; circle and sphere markers as if rigid."""
    local = jnp.broadcast_to(subject.offsets, (len(motion), *subject.offsets.shape))
    return _to_world(subject, motion.poses, local)


@eqx.filter_jit
def _joint_centres(skeleton: Skeleton, poses: Pose) -> Float[Array, "F J 3"]:
    return jax.lax.map(lambda pose: joint_positions(skeleton, forward_kinematics(skeleton, pose)), poses)


@eqx.filter_jit
def _to_world(subject: Subject, poses: Pose, local: Float[Array, "F M 3"]) -> Float[Array, "F M 3"]:
    def of_frame(frame):
        pose, rest = frame
        transforms = forward_kinematics(subject.skeleton, pose)
        r, t = transforms.rotations[subject.bones], transforms.translations[subject.bones]
        return jnp.einsum("mab,mb->ma", r, rest) + t

    return jax.lax.map(of_frame, (poses, local))
