"""Flag frames that the body explains worse than is normal for their sequence, with reasons."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Array, Float

from ...body.body import Body, pose_body
from ...body.pose import Pose
from ...fit.correspondence.nearest_at_vertices import nearest_at_vertices
from ...geometry.camera import Camera
from ...observe import thin_cloud
from ...observe.clouds import Cloud
from ...stacking import stack_trees
from ...tracking.judgement.baseline import median_baseline, sensor_directions
from ...tracking.judgement.evidence import Evidence, gather_evidence
from ...tracking.judgement.region_samples import region_joints, sample_regions
from ...tracking.judgement.verdict import Judgement, judge_evidence
from ..task import AdaptState, AdaptTask

#: number of points of a scan with measured distances
POINTS = 1000
#: a frame is lost if its median distance exceeds the sequence's by this many deviations and by at least this,
#: metres
MAX_DEVIATIONS, MIN_EXCESS = 5.0, 0.003
#: median distance from which on a frame of a finished motion is lost in any case, metres
MAX_DISTANCE = 0.015
NO_SCAN = "no usable scan"


def flag_frames(task: AdaptTask, state: AdaptState, *, final: bool = False) -> AdaptState:
    """Judge the poses of all frames by one rule, and record the `lost` frames and their `reasons`.

    A frame is judged by part (`tracking.judgement`) and by its median distance from the body. Both are compared
    with the baseline of all frames, whatever their order. A `final` motion is also judged by an absolute
    distance.
    """
    reasons = dict.fromkeys(task.missing, NO_SCAN)
    distances = {n: median_distance(state.body, state.motion[n], task.cloud(n)) for n in task.scanned}
    all_distances = np.array(list(distances.values()))
    limit, middle = distance_limit(all_distances), 1000 * float(np.median(all_distances))
    limit = min(limit, MAX_DISTANCE) if final else limit
    for (frame, distance), judgement in zip(distances.items(), judge_parts(task, state), strict=True):
        found = list(judgement.reasons) if judgement.verdict == "lost" else []
        if not distance <= limit:
            found.append(
                f"{1000 * distance:.1f} mm from scan to body, compared with {middle:.1f} mm over all frames"
            )
        if found:
            reasons[frame] = ", ".join(found)
    frames = tuple(sorted(reasons))
    return state._replace(lost=frames, reasons=tuple(reasons[frame] for frame in frames))


def judge_parts(task: AdaptTask, state: AdaptState) -> list[Judgement]:
    """Compare each scanned frame by part with the baseline of all frames."""
    surface = sample_regions(state.body, region_joints(task.template))

    def gather(sensors: Sequence[Camera] | Float[Array, "D"]) -> list[Evidence]:
        return [gather_evidence(surface, state.motion[n], task.cloud(n), sensors) for n in task.scanned]

    evidence = gather(task.cameras)
    if not task.cameras:
        # estimate the sensors from all frames together
        evidence = gather(sensor_directions(median_baseline(stack_trees(evidence))))
    baseline = median_baseline(stack_trees(evidence))
    return [judge_evidence(surface, baseline, one) for one in evidence]


def distance_limit(distances: Float[np.ndarray, "F"]) -> float:
    """Compute the limit of a frame's median distance, metres, from the median and MAD of all frames."""
    middle = float(np.median(distances))
    spread = 1.4826 * float(np.median(np.abs(distances - middle)))
    return middle + max(MAX_DEVIATIONS * spread, MIN_EXCESS, 0.5 * middle)


def median_distance(body: Body, pose: Pose, cloud: Cloud) -> float:
    """Compute the median distance of a cloud's points from the surface of a posed body, metres."""
    few = thin_cloud(cloud, POINTS)
    points = np.asarray(few.points, float)[np.asarray(few.weights) > 0]
    vertices = np.asarray(pose_body(body, pose).vertices, float)
    if not np.isfinite(vertices).all():
        return float("inf")
    return float(
        np.median(nearest_at_vertices(points, vertices, np.asarray(body.faces), num_points=POINTS).distances)
    )
