"""Selection of calibration frames: as different as possible, with most markers visible."""

import numpy as np
from jaxtyping import Bool, Float

from ...body.pose import Pose
from ...geometry.sampling import farthest_points
from ..subject import Subject
from .rotation_prior import mean_rotations


class NoFrameFits(ValueError):
    """No pose of a template fits the markers of any frame."""


def choose_frames(
    subject: Subject,
    poses: Pose,
    used: Bool[np.ndarray, "F M"],
    usable: Bool[np.ndarray, "F"],
    num_frames: int,
) -> np.ndarray:
    """Choose at most `num_frames` frames, in order, by farthest point sampling.

    The distance of two poses is the sum of the squared differences between their joints' quaternions. A
    joint without visible markers counts as at its mean. Frames with fewer than half of the median number of
    visible markers come last.

    **Raises:** `NoFrameFits` where no frame is usable.
    """
    usable = np.asarray(usable) & (used.sum(1) >= 3)
    if not usable.any():
        raise NoFrameFits(
            "No frame has three visible markers that fit the template; check the labels, the unit and the "
            "template."
        )
    frames = np.flatnonzero(usable)
    if len(frames) <= num_frames:
        return frames
    shown = used[frames].sum(1)
    full = shown >= 0.5 * np.median(shown)
    if full.sum() >= num_frames:
        frames = frames[full]
    features = _pose_features(subject, poses, used, frames)
    # start with the most typical pose, so that the choice does not depend on the order
    middle = np.sum((features - np.median(features, 0)) ** 2, 1)
    # a pose that is far from all others is more probably wrong than rare
    outlier = middle > 30 * max(float(np.median(middle)), 1e-12)
    return frames[farthest_points(features, num_frames, int(np.argmin(middle)), outlier)]


def _pose_features(subject: Subject, poses: Pose, used, frames) -> Float[np.ndarray, "C N"]:
    """Compute quaternions of the joints except roots, on one hemisphere, minus their means.

    They are zero where no marker below the joint is visible.
    """
    skeleton = subject.skeleton
    inner = [j for j, parent in enumerate(skeleton.parents) if parent >= 0 and skeleton.kinds[j] != "fixed"]
    rotations = np.asarray(poses.rotations, float)[frames][:, inner]
    below = skeleton.descendants[:, np.asarray(subject.bones)].T.astype(float)[:, inner]
    determined = used[frames].astype(float) @ below > 0
    means = mean_rotations(rotations)
    signs = np.sign(np.einsum("fja,ja->fj", rotations, means))[..., None]
    away = (np.where(signs == 0, 1, signs) * rotations - means) * determined[..., None]
    return away.reshape(len(frames), -1)
