"""Correction of hands whose fingers lie on the neighbours of their own: small steps do not lead from one finger to the next."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial import KDTree

from ...body.body import Body, posed_vertices
from ...body.pose import Pose
from ...body.symmetry import left_right_pairs_by_name
from ...fit.correspondence.nearest_at_vertices import nearest_at_vertices
from ...geometry import rotation
from ...observe.clouds import Cloud
from ...parallel import parallel_map
from ...tracking.limb_flips import limb_ends
from ..task import AdaptState, AdaptTask
from .fit_frame import fit_task_poses

#: rotations about the normal of the palm by about the width of a finger at its length, degrees
SLIPS = (-15.0, 15.0)
#: points of an end are at most so far from its vertices, metres; larger distances from the surface count as the second number
NEAR, FAR = 0.03, 0.01
#: an end is tried again if its points are farther from the surface than in most scans by this factor
SUSPICIOUS = 1.4
#: a rotated end is accepted if it lowers the distance of its points by at least this factor
ACCEPTED = 0.75
#: the least number of points of an end, and the largest of all ends and of a scan, that are compared
MIN_POINTS, MAX_POINTS, MAX_SCAN_POINTS = 20, 4096, 20_000
#: steps of a pose after a rotation
STEPS = 5


class End(NamedTuple):
    """The end of a limb: its joint, its vertices, and the normal of its flattest plane in the axes of the rest pose."""

    joint: int
    vertices: Bool[np.ndarray, "V"]
    normal: Float[np.ndarray, "3"]


def correct_finger_slips(
    task: AdaptTask, state: AdaptState, frames: Sequence[int], poses: Mapping[int, Pose]
) -> dict[int, Pose]:
    """Rotate the ends of limbs by the width of a finger where this brings them much closer to their points.

    The distance of an end from its points is compared with the median over the frames, left and right together. Where it is
    larger, the pose is fitted again, from the end rotated to either side.

    Returns the poses that change.
    """
    body, ends = state.body, limb_end_planes(state.body)
    if not ends:
        return {}
    poses, changed = dict(poses), {}

    def distances_of(frame: int) -> Float[np.ndarray, "E"]:
        return _distances(body, poses[frame], task.cloud(frame), ends)

    distances = np.stack(list(parallel_map(distances_of, frames)))
    usual = _usual_distances(distances, body, ends)
    for column, end in enumerate(ends):
        rows = np.flatnonzero(distances[:, column] > SUSPICIOUS * usual[column])
        tries = [(int(row), angle) for row in rows for angle in SLIPS]
        scans = (task.scan(frames[row]) for row, _ in tries)
        starts = [_rotated(poses[frames[row]], end, angle) for row, angle in tries]
        least = ACCEPTED * distances[:, column]
        fits = fit_task_poses(task, state, scans, starts, steps=STEPS)
        for (row, _), fit in zip(tries, fits, strict=True):
            frame = frames[row]
            reached = _distances(body, fit.pose, task.cloud(frame), ends)[column]
            if reached < least[row]:
                least[row] = reached
                poses[frame] = changed[frame] = fit.pose
    return changed


def limb_end_planes(body: Body) -> list[End]:
    """Find the ends of limbs, and the directions in which they are flattest."""
    parts, rest = np.asarray(body.skin.dominant_bones()), np.asarray(body.vertices, float)
    found = []
    for joint in limb_ends(body):
        own = body.skeleton.descendants[joint][parts]
        found.append(End(joint, own, np.linalg.svd(rest[own] - rest[own].mean(0), full_matrices=False)[2][2]))
    return found


def _usual_distances(
    distances: Float[np.ndarray, "F E"], body: Body, ends: Sequence[End]
) -> Float[np.ndarray, "E"]:
    """Compute the median distance of each end and its counterpart on the other side over all frames; NaN without points."""
    sides = {joint: set(pair) for pair in left_right_pairs_by_name(body.skeleton.names) for joint in pair}
    usual = []
    for end in ends:
        same = [other.joint in sides.get(end.joint, {end.joint}) for other in ends]
        known = distances[:, same][np.isfinite(distances[:, same])]
        usual.append(np.median(known) if len(known) else np.nan)
    return np.array(usual)


def _distances(body: Body, pose: Pose, cloud: Cloud, ends: Sequence[End]) -> Float[np.ndarray, "E"]:
    """Compute the mean distance of the points near each end of a limb from the surface, metres; NaN for few points."""
    vertices = np.asarray(posed_vertices(body, pose), float)
    if not np.isfinite(vertices).all():
        return np.full(len(ends), np.nan)
    points = _some(np.asarray(cloud.points, float)[np.asarray(cloud.weights) > 0], MAX_SCAN_POINTS)
    owners = np.concatenate([np.full(end.vertices.sum(), number) for number, end in enumerate(ends)])
    tree = KDTree(np.concatenate([vertices[end.vertices] for end in ends]))
    found = tree.query(points, distance_upper_bound=NEAR)
    away, nearest = np.asarray(found[0]), np.asarray(found[1])
    near = _some(np.flatnonzero(np.isfinite(away)), MAX_POINTS)
    surface = nearest_at_vertices(points[near], vertices, np.asarray(body.faces), num_points=MAX_POINTS)
    owner = owners[nearest[near]]
    counts = np.bincount(owner, minlength=len(ends))
    sums = np.bincount(owner, np.minimum(surface.distances, FAR), len(ends))
    return np.where(counts >= MIN_POINTS, sums / np.maximum(counts, 1), np.nan)


def _some(rows: np.ndarray, most: int) -> np.ndarray:
    """Take every n-th row, so that at most so many are left."""
    return rows[:: max(1, -(-len(rows) // most))]


def _rotated(pose: Pose, end: End, degrees: float) -> Pose:
    """Rotate the end of a limb about its normal."""
    half = np.radians(degrees) / 2
    step = jnp.asarray(np.append(np.cos(half), np.sin(half) * end.normal), pose.rotations.dtype)
    turned = rotation.multiply(pose.rotations[end.joint], step)
    return eqx.tree_at(lambda p: p.rotations, pose, pose.rotations.at[end.joint].set(turned))
