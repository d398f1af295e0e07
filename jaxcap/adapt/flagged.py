"""Flag frames that the body explains less well than is normal for their sequence, and say why."""

import equinox as eqx
import numpy as np
from jaxtyping import Float

from ..body.body import Body, pose_body
from ..body.pose import Pose
from ..geometry.closest import nearest_on_surface
from ..observe import Cloud, thin_cloud
from .task import AdaptState, Task

#: points of a scan whose distances are measured
POINTS = 1000
#: a frame is off where its median distance is so many deviations over the sequence's, and at least so much, metres
DEVIATIONS, OFF = 5.0, 0.003
#: of a finished motion a frame is off from this median distance on, whatever the others are, metres
MOST = 0.015
NO_SCAN = "no scan that can be used"

_posed = eqx.filter_jit(pose_body)


def flag_frames(task: Task, state: AdaptState, *, final: bool = False) -> AdaptState:
    """Judge the poses of all frames by one rule, and note which are `lost` and the `reasons`.

    A frame is judged by its median distance from the body, against what is normal for all frames, whatever their order; a
    `final` motion by an absolute distance, too.
    """
    reasons = dict.fromkeys(task.missing, NO_SCAN)
    distances = {n: median_distance(state.body, state.motion[n], task.cloud(n)) for n in task.scanned}
    all_distances = np.array(list(distances.values()))
    limit, middle = distance_limit(all_distances), 1000 * float(np.median(all_distances))
    limit = min(limit, MOST) if final else limit
    for frame, distance in distances.items():
        if not distance <= limit:
            reasons[frame] = f"{1000 * distance:.1f} mm from scan to body, where {middle:.1f} mm is usual"
    frames = tuple(sorted(reasons))
    return state._replace(lost=frames, reasons=tuple(reasons[frame] for frame in frames))


def distance_limit(distances: Float[np.ndarray, "F"]) -> float:
    """The median distance from which on a frame is off, metres, by the median of all frames and the deviation from it."""
    middle = float(np.median(distances))
    spread = 1.4826 * float(np.median(np.abs(distances - middle)))
    return middle + max(DEVIATIONS * spread, OFF, 0.5 * middle)


def median_distance(body: Body, pose: Pose, cloud: Cloud) -> float:
    """The median distance of a cloud's points from the surface of a body, metres."""
    few = thin_cloud(cloud, POINTS)
    points = np.asarray(few.points, float)[np.asarray(few.weights) > 0]
    vertices = np.asarray(_posed(body, pose).vertices, float)
    if not np.isfinite(vertices).all():
        return float("inf")
    return float(np.median(nearest_on_surface(points, vertices, np.asarray(body.faces)).distances))
