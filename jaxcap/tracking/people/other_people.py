"""Other people in the clouds of one tracked body."""

import equinox as eqx
import numpy as np
from scipy.spatial import KDTree

from ...body.body import pose_body
from ...body.pose import Pose
from ...geometry.sampling import even_indices
from ...observe.clouds import Cloud
from ..advance import Follower
from .groups import find_groups, real_points

#: number of points of a cloud that are tested
NUM_POINTS = 1500
#: distance from the body from which points may be another person's, metres
DISTANCE = 0.25
#: least share of the explained points, and least height and longest side, as shares of the body's
MIN_POINTS, MIN_HEIGHT, MIN_SIZE = 0.25, 0.5, 0.55
#: least share of the points near the body, and of these on its surface, at most so far from a sample of it, metres
MIN_EXPLAINED, MIN_ON_SURFACE, ON_SURFACE = 0.2, 0.5, 0.06
#: least share of outliers in a frame that shows another person, less than MIN_POINTS / (1 + MIN_POINTS)
MIN_OUTLIERS = 0.15

_pose_body = eqx.filter_jit(pose_body)


def shows_others(follower: Follower, pose: Pose, cloud: Cloud, outlier_share: float = 1.0) -> bool:
    """Test if a cloud has another group of points that is as large as a person.

    **Arguments:** `outlier_share` of the frame. Points of another person are outliers, so that most frames need no test.
    """
    if outlier_share < MIN_OUTLIERS:
        return False
    points, _ = real_points(cloud)
    points = points[even_indices(len(points), NUM_POINTS)]
    samples = np.asarray(_pose_body(follower.surface.body, pose).vertices, float)
    if not np.isfinite(samples).all():
        return False
    distances = KDTree(samples).query(points, distance_upper_bound=DISTANCE)[0]
    far = np.isinf(distances)
    num_explained = len(points) - int(far.sum())
    # a body in noise shows nothing
    if np.sum(distances <= ON_SURFACE) < MIN_ON_SURFACE * num_explained:
        return False
    if far.sum() < MIN_POINTS * num_explained or num_explained < MIN_EXPLAINED * len(points):
        return False
    up = np.asarray(follower.up, float) / np.linalg.norm(follower.up)
    height = float(follower.surface.size)
    return any(
        len(group) >= MIN_POINTS * num_explained and np.ptp(points[far][group] @ up) >= MIN_HEIGHT * height
        for group in find_groups(points[far], height, up, MIN_SIZE)
    )
