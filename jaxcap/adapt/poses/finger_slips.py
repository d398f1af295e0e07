"""Correction of hands whose fingers lie on the neighbours of their own: small steps do not lead from one finger to the next."""

import logging
from collections.abc import Sequence
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
from ...geometry.mesh import box_diagonal
from ...geometry.sampling import even_indices
from ...observe.clouds import Cloud
from ...parallel import parallel_map
from ...tracking.limb_flips import limb_ends
from ..task import AdaptState, AdaptTask
from .fit_frame import fit_task_poses

#: rotations about the normal of the palm that are tried, by about the width of a finger at its length, degrees
ANGLES = (0.0, -15.0, 15.0)
#: largest diagonal of the box around a hand, as a share of that around the body, and the least number of its vertices
MAX_SIZE, MIN_VERTICES = 0.13, 6
#: points of a hand are at most so far from its vertices, metres; larger distances from the surface count as the second number
NEAR, FAR = 0.03, 0.01
#: a hand is tried again if its points are farther from the surface than in most scans by this factor
SUSPICIOUS = 1.4
#: a rotated hand is accepted if its points are nearer than without the rotation by at least this factor
ACCEPTED = 0.75
#: the least number of points of a hand, and the largest of all hands and of a scan, that are compared
MIN_POINTS, MAX_POINTS, MAX_SCAN_POINTS = 20, 4096, 20_000
#: steps of a pose after a rotation
STEPS = 5

_LOG = logging.getLogger(__name__)


class Hand(NamedTuple):
    """The end of a limb: its joint, its vertices, and the normal of its flattest plane in the axes of the rest pose."""

    joint: int
    vertices: Bool[np.ndarray, "V"]
    normal: Float[np.ndarray, "3"]


def correct_finger_slips(task: AdaptTask, state: AdaptState) -> dict[int, Pose]:
    """Rotate hands by the width of a finger where this brings them much closer to their points; feet likewise.

    The distance of a hand from its points is compared with the median over all scans, left and right together. Where it is
    larger, the pose is fitted again: as it is, and with the hand rotated to either side.

    Returns the poses that change, by their frames.
    """
    body, hands, frames = state.body, find_hands(state.body), task.scanned
    if not hands:
        return {}
    changed: dict[int, Pose] = {}

    def distances_of(frame: int) -> Float[np.ndarray, "E"]:
        return _distances(body, [state.motion[frame]], task.cloud(frame), hands)[0]

    distances = np.stack(list(parallel_map(distances_of, frames)))
    usual = _usual_distances(distances, body, hands)
    suspicious = np.argwhere((distances > SUSPICIOUS * usual).T)
    if len(suspicious):
        _LOG.info("trying %d hands that are far from their points, rotated to either side", len(suspicious))
    for column, row in suspicious.tolist():
        frame, hand = frames[row], hands[column]
        scan, pose = task.scan(frame), changed.get(frame, state.motion[frame])
        starts = [_rotated(pose, hand, angle) for angle in ANGLES]
        fits = list(fit_task_poses(task, state, [scan] * len(starts), starts, steps=STEPS))
        reached = _distances(body, [fit.pose for fit in fits], task.cloud(frame), [hand])[:, 0]
        best = int(np.nanargmin(reached)) if np.isfinite(reached).any() else 0
        if reached[best] < ACCEPTED * reached[0] and fits[best].data <= fits[0].data:
            changed[frame] = fits[best].pose
    return changed


def find_hands(body: Body) -> list[Hand]:
    """Find the small ends of limbs, hands and feet, each from the first joint that rotates all of it."""
    skeleton, parts = body.skeleton, np.asarray(body.skin.dominant_bones())
    rest = np.asarray(body.vertices, float)
    largest = MAX_SIZE * box_diagonal(rest)
    below = skeleton.descendants[:, parts]

    def is_small(joint: int) -> bool:
        return bool(below[joint].any()) and box_diagonal(rest[below[joint]]) <= largest

    joints = set()
    for end in limb_ends(body):
        joint, above = end, skeleton.parents[end]
        while above >= 0 and is_small(above):
            joint = above if skeleton.kinds[above] == "ball" else joint
            above = skeleton.parents[above]
        if is_small(joint) and below[joint].sum() >= MIN_VERTICES:
            joints.add(joint)
    return [Hand(joint, below[joint], _flattest(rest[below[joint]])) for joint in sorted(joints)]


def _flattest(points: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, "3"]:
    """Compute the direction in which points are spread least."""
    return np.linalg.eigh(np.cov(points.T))[1][:, 0]


def _usual_distances(
    distances: Float[np.ndarray, "F E"], body: Body, hands: Sequence[Hand]
) -> Float[np.ndarray, "E"]:
    """Compute the median distance of each hand and its counterpart on the other side over all frames; NaN without points."""
    sides = {joint: set(pair) for pair in left_right_pairs_by_name(body.skeleton.names) for joint in pair}
    usual = []
    for hand in hands:
        same = [other.joint in sides.get(hand.joint, {hand.joint}) for other in hands]
        known = distances[:, same][np.isfinite(distances[:, same])]
        usual.append(np.median(known) if len(known) else np.nan)
    return np.array(usual)


def _distances(
    body: Body, poses: Sequence[Pose], cloud: Cloud, hands: Sequence[Hand]
) -> Float[np.ndarray, "P E"]:
    """Compute the mean distance of the points of each hand from the surface in several poses, metres; NaN for few points.

    They are the points near the hand in any of the poses, the same in all.
    """
    surfaces = [np.asarray(posed_vertices(body, pose), float) for pose in poses]
    if not all(np.isfinite(surface).all() for surface in surfaces):
        return np.full((len(poses), len(hands)), np.nan)
    points = np.asarray(cloud.points, float)[np.asarray(cloud.weights) > 0]
    points = points[even_indices(len(points), MAX_SCAN_POINTS)]
    around = np.concatenate([surface[hand.vertices] for hand in hands for surface in surfaces])
    owners = np.concatenate(
        [np.full(len(poses) * hand.vertices.sum(), number) for number, hand in enumerate(hands)]
    )
    found = KDTree(around).query(points, distance_upper_bound=NEAR)
    near = np.flatnonzero(np.isfinite(found[0]))
    near = near[even_indices(len(near), MAX_POINTS)]
    owner = owners[np.asarray(found[1])[near]]
    counts = np.bincount(owner, minlength=len(hands))
    rows = []
    for surface in surfaces:
        nearest = nearest_at_vertices(points[near], surface, np.asarray(body.faces), num_points=MAX_POINTS)
        sums = np.bincount(owner, np.minimum(nearest.distances, FAR), len(hands))
        rows.append(np.where(counts >= MIN_POINTS, sums / np.maximum(counts, 1), np.nan))
    return np.stack(rows)


def _rotated(pose: Pose, hand: Hand, degrees: float) -> Pose:
    """Rotate a hand about its normal."""
    dtype = pose.rotations.dtype
    step = rotation.about_axis(jnp.asarray(hand.normal, dtype), jnp.asarray(np.radians(degrees), dtype))
    turned = rotation.multiply(pose.rotations[hand.joint], step)
    return eqx.tree_at(lambda p: p.rotations, pose, pose.rotations.at[hand.joint].set(turned))
