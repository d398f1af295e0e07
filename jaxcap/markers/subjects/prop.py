"""A rigid prop: its markers in a frame of its own, and its motion."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from ...arguments import checked
from ...body.pose import Motion, Pose
from ...body.skeleton import make_skeleton
from ...errors import InputError
from ...geometry import rotation
from ...geometry.linear import inverse_symmetric
from ...observe.markers import MarkerFrames
from ..motion.inverse_kinematics import describe_solution
from ..robust import OUTLIER_BOUND
from ..segments.rigid_motion import MIN_MARKERS
from ..segments.segment_frames import SegmentFrames, coordinate_variance, fit_segment_frames
from ..segments.segment_sets import make_segments
from ..subject import Subject, make_subject

#: least standard deviation of a marker, metres: that of a good camera system
MIN_DEVIATION = 2e-4
#: median residual above which the markers are on no rigid body, metres
MAX_MEDIAN = 0.015
#: residual up to which a marker is no outlier, however small its deviation is, metres
MIN_OUTLIER = MAX_MEDIAN / 3


class RigidProp(NamedTuple):
    """A prop and its motion. It is a subject of one joint, so that all that solves, labels and writes subjects takes it.

    The prop's frame has its origin at the mean of the markers, the x axis to the farthest marker, and the xy plane through the
    marker farthest from this axis. At rest it is the frame of the world.
    """

    subject: Subject
    motion: Motion
    #: distances between observed and predicted markers, metres, NaN where not visible and in lost frames
    residuals: Float[np.ndarray, "F M"]
    #: covariances of translation, metres, and rotation, radians, in the prop's axes, without outliers; infinite in lost frames
    covariances: Float[np.ndarray, "F 6 6"]
    #: frames with fewer than three markers, or without a pose that fits three; they keep the last pose
    lost: Bool[np.ndarray, "F"]
    #: messages to the user, in sentences
    messages: tuple[str, ...]


@checked
def fit_prop(frames: MarkerFrames, name: str = "prop") -> RigidProp:
    """Fit a rigid body to markers, and its motion through the frames.

    The mean shape is that of generalised Procrustes analysis with gaps (Gower 1975). Outliers, such as swapped labels, have low
    weights. The deviation of each marker follows from its residuals. A frame in which fewer than three markers are near a rigid
    pose is lost.

    **Arguments:** `frames` of the prop's markers alone; `name` of its one joint.

    **Raises:** `InputError` for fewer than three markers that are visible together, markers on a line, and markers whose
    distances change.
    """
    positions, seen = np.asarray(frames.positions, float), np.asarray(frames.visible)
    shown = np.flatnonzero(seen.any(0)).tolist()
    if len(shown) < MIN_MARKERS:
        raise InputError(
            f"The prop '{name}' has {len(shown)} visible markers; at least {MIN_MARKERS} on no line are needed."
        )
    labels = [frames.labels[index] for index in shown]
    positions, seen = positions[:, shown], seen[:, shown]
    segments = make_segments([range(len(shown))], len(shown))
    shape = fit_segment_frames(positions, seen, segments)
    if not shape.known.any():
        raise InputError(
            f"The markers of the prop '{name}' ({', '.join(labels[:8])}) are on a line, or one of them is never visible with "
            "three others; add a marker, or leave this one out."
        )
    residuals = shape.residuals(positions, seen, segments)
    middle = float(np.nanmedian(residuals))
    if not middle < MAX_MEDIAN:
        raise InputError(
            f"The markers of '{name}' ({', '.join(labels[:8])}) are on no rigid body: they are {1e3 * middle:.0f} mm from the "
            "best one (median). Leave out those that move, or use fit_local, which finds segments."
        )
    skeleton = make_skeleton([name], [-1], ["free"], np.zeros((1, 3)))
    subject = make_subject(
        skeleton,
        np.zeros(len(labels), int),
        shape.local_positions,
        labels,
        deviations=_marker_deviations(residuals),
    )
    inliers = find_inliers(subject, residuals)
    lost = inliers.sum(1) < MIN_MARKERS
    if lost.all():
        raise InputError(
            f"The markers of '{name}' ({', '.join(labels[:8])}) are on no rigid body: in no frame are {MIN_MARKERS} of them where "
            "it has them. Leave out those that move, or use fit_local, which finds segments."
        )
    motion = _rigid_motion(subject, shape, lost, frames.rate)
    messages = describe_solution(
        subject, MarkerFrames(positions, seen, tuple(labels), frames.rate), seen, lost
    )
    return RigidProp(
        subject,
        motion,
        np.where(lost[:, None], np.nan, residuals),
        pose_covariances(subject, inliers, lost),
        lost,
        messages,
    )


def find_inliers(prop: Subject, residuals: Float[np.ndarray, "F M"]) -> Bool[np.ndarray, "F M"]:
    """Find the markers that are near their positions on a prop: by their deviations, and in any case within `MIN_OUTLIER`."""
    bound = np.sqrt(OUTLIER_BOUND) * np.asarray(prop.deviations, float)
    # false where NaN
    return residuals <= np.maximum(bound, MIN_OUTLIER)


def _rigid_motion(subject: Subject, shape: SegmentFrames, lost: Bool[np.ndarray, "F"], rate: float) -> Motion:
    """Make the motion of one joint; a lost frame keeps the last pose, and the first ones take the first that is not lost."""
    last = np.maximum.accumulate(np.where(lost, -1, np.arange(len(lost))))
    last = np.where(last < 0, np.argmin(lost), last)
    dtype = subject.offsets.dtype
    rotations = rotation.from_matrix(jnp.asarray(shape.rotations[last], dtype))
    poses = Pose(jnp.asarray(shape.origins[last], dtype), rotations, jnp.ones(len(last), dtype))
    return Motion(poses, rate)


def pose_covariances(
    subject: Subject, inliers: Bool[np.ndarray, "F M"], lost: Bool[np.ndarray, "F"]
) -> Float[np.ndarray, "F 6 6"]:
    """Compute the covariances of the poses of a prop, from its markers that are no outliers and their deviations.

    A marker at `p` moves by `t + w x p` in the prop's axes, for a translation `t` and a small rotation `w` of the prop.
    """
    offsets = np.asarray(subject.offsets, float)
    rows = np.zeros((len(offsets), 3, 6))
    rows[:, :, :3] = np.eye(3)
    x, y, z = offsets.T
    rows[:, 0, 4], rows[:, 0, 5] = z, -y
    rows[:, 1, 3], rows[:, 1, 5] = -z, x
    rows[:, 2, 3], rows[:, 2, 4] = y, -x
    each = np.einsum("mai,maj->mij", rows, rows) / np.asarray(subject.deviations, float)[:, None, None] ** 2
    used = inliers & ~lost[:, None]
    covariances = np.full((len(used), 6, 6), np.inf)
    # frames with the same markers have the same covariance
    patterns, place = np.unique(used, axis=0, return_inverse=True)
    for number, pattern in enumerate(patterns):
        information = each[pattern].sum(0)
        if pattern.sum() >= MIN_MARKERS and np.linalg.matrix_rank(information) == 6:
            covariances[place.ravel() == number] = inverse_symmetric(information)
    return covariances


def _marker_deviations(residuals: Float[np.ndarray, "F M"]) -> Float[np.ndarray, "M"]:
    """Estimate the standard deviation of each marker along an axis."""
    variances = np.array([coordinate_variance(column, residuals.shape[1]) for column in residuals.T])
    # with three or four markers each one pulls the fit to itself
    return np.maximum(np.sqrt(np.maximum(variances, np.median(variances))), MIN_DEVIATION)
