"""Which frames to calibrate with: as different as can be, and well seen."""

import numpy as np
from jaxtyping import Bool, Float

from ...body.pose import Pose
from ..subject import Subject
from .rotation_prior import mean_rotations


def choose_frames(
    subject: Subject,
    poses: Pose,
    used: Bool[np.ndarray, "F M"],
    usable: Bool[np.ndarray, "F"],
    count: int,
) -> np.ndarray:
    """At most `count` frames in their order, each as far from those before as possible (Gonzalez
    1985): the distance of two poses is the angle between their joints' rotations, squared and summed,
    over joints that both frames show. Frames that show under half of what the others do come last.

    **Raises:** `ValueError` where no frame is usable.
    """
    usable = np.asarray(usable) & (used.sum(1) >= 3)
    if not usable.any():
        raise ValueError(
            "No frame shows three markers that the template explains; check labels, unit and the template."
        )
    frames = np.flatnonzero(usable)
    if len(frames) <= count:
        return frames
    shown = used[frames].sum(1)
    full = shown >= 0.5 * np.median(shown)
    if full.sum() >= count:
        frames = frames[full]
    features = _features(subject, poses, used, frames)
    # the first is the most usual pose, so that the choice hangs on no order
    middle = np.sum((features - np.median(features, 0)) ** 2, 1)
    chosen = [int(np.argmin(middle))]
    distance = np.sum((features - features[chosen[0]]) ** 2, 1)
    # a pose that is far from all others is likelier wrong than rare
    distance[middle > 30 * max(float(np.median(middle)), 1e-12)] = 0.0
    while len(chosen) < count:
        chosen.append(int(np.argmax(distance)))
        distance = np.minimum(distance, np.sum((features - features[chosen[-1]]) ** 2, 1))
    return np.sort(frames[np.unique(chosen)])


def _features(subject: Subject, poses: Pose, used, frames) -> Float[np.ndarray, "C N"]:
    """Quaternions of the joints but the roots, on one hemisphere, where their bone's markers are seen;
    else their means."""
    skeleton = subject.skeleton
    inner = [j for j, parent in enumerate(skeleton.parents) if parent >= 0 and skeleton.kinds[j] != "fixed"]
    rotations = np.asarray(poses.rotations, float)[frames][:, inner]
    below = skeleton.descent[:, np.asarray(subject.bones)].T.astype(float)[:, inner]
    told = used[frames].astype(float) @ below > 0
    means = mean_rotations(rotations)
    signs = np.sign(np.einsum("fja,ja->fj", rotations, means))[..., None]
    away = (np.where(signs == 0, 1, signs) * rotations - means) * told[..., None]
    return away.reshape(len(frames), -1)
