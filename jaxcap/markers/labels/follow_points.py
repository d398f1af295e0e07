"""Labels of successive frames: points are assigned to the markers of the pose that the last frames predict."""

from collections.abc import Iterable
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ...body.pose import Pose
from ...body.retraction import difference, retract
from ..motion.inverse_kinematics import MIN_MARKERS
from ..motion.solve_frame import SearchCriteria, solve_frame
from ..subject import Subject, marker_positions
from .first_pose import PointPose
from .match_points import match_points

#: gate of a marker around its predicted position, metres; its growth for each frame without the marker, and its largest value
GATE, GATE_GROWTH, MAX_GATE = 0.06, 0.006, 0.2
#: gate around the position at the solved pose, metres
SOLVED_GATE = 0.04
#: factors of the squared distance for a track that keeps its label, and for a given label
TRACK_DISCOUNT, GIVEN_DISCOUNT = 0.25, 0.1
#: a frame is doubtful if fewer than this share of its points, or of the markers, have labels
MIN_SHARE = 0.5
#: seconds of doubtful frames after which the pose is lost
MAX_DOUBT = 0.1
FRAME_SEARCH = SearchCriteria(max_iterations=9)


class PointSequence(NamedTuple):
    """Unlabelled points of all frames."""

    positions: Float[np.ndarray, "F N 3"]
    #: the number of the track of each point, -1 where none is visible
    tracks: Int[np.ndarray, "F N"]
    #: the marker of a column by its given label, or -1
    given: Int[np.ndarray, "N"]
    rate: float


def follow_points(
    subject: Subject, points: PointSequence, start: PointPose, frames: Iterable[int]
) -> dict[int, Int[np.ndarray, "M"]]:
    """Label frames in their order, forwards or backwards, from the pose of a frame next to the first.

    Returns the columns of the markers in each frame that the pose explains. Ends at the first frame of the
    doubtful ones if these last longer than `MAX_DOUBT`.
    """
    used, count = np.asarray(subject.weights) > 0, subject.num_markers
    pose, ahead = start.pose, np.asarray(marker_positions(subject, start.pose), float)
    last, missed, doubt = start.columns, np.zeros(count), 0
    last_tracks = np.where(last >= 0, points.tracks[start.frame, last], -1)
    found: dict[int, Int[np.ndarray, "M"]] = {}
    for frame in frames:
        columns = np.flatnonzero(points.tracks[frame] >= 0)
        at, tracks = points.positions[frame, columns], points.tracks[frame, columns]
        discounts = _discounts(last_tracks, tracks, points.given[columns])
        gates = np.where(used, np.minimum(GATE + GATE_GROWTH * missed, MAX_GATE), 1e-6)
        matched = match_points(ahead, at, gates, discounts)
        before = pose
        for _ in range(2):
            if (matched >= 0).sum() < MIN_MARKERS:
                break
            pose, here, ahead = (
                part if isinstance(part, Pose) else np.asarray(part, float)
                for part in _advance(subject, before, *_targets(at, matched, subject), jnp.asarray(doubt == 0))
            )
            again = match_points(here, at, np.where(used, SOLVED_GATE, 1e-6), discounts)
            same, matched = np.array_equal(again, matched), again
            if same:
                break
        expected = min(len(columns), int(used.sum()))
        if (matched >= 0).sum() < max(MIN_MARKERS, MIN_SHARE * expected):
            doubt += 1
            missed += 1
            if doubt > MAX_DOUBT * points.rate:
                break
            continue
        doubt = 0
        missed = np.where(matched >= 0, 0, missed + 1)
        last_tracks = np.where(matched >= 0, tracks[matched], -1)
        found[frame] = np.where(matched >= 0, columns[matched], -1)
    return found


def _discounts(last_tracks: Int[np.ndarray, "M"], tracks: Int[np.ndarray, "P"], given: Int[np.ndarray, "P"]):
    """Prefer the label that a track had in the last frame, and a given label."""
    continued = (last_tracks[:, None] == tracks) & (last_tracks[:, None] >= 0)
    named = given == np.arange(len(last_tracks))[:, None]
    return np.where(named, GIVEN_DISCOUNT, np.where(continued, TRACK_DISCOUNT, 1.0))


def _targets(at, matched, subject: Subject) -> tuple[Array, Array]:
    shown = matched >= 0
    return jnp.asarray(np.where(shown[:, None], at[matched], 0.0), subject.offsets.dtype), jnp.asarray(shown)


@eqx.filter_jit
def _advance(
    subject: Subject, before: Pose, positions: Float[Array, "M 3"], seen, moving
) -> tuple[Pose, Float[Array, "M 3"], Float[Array, "M 3"]]:
    """Solve a frame, and predict the markers of the next one at constant velocity."""
    pose = solve_frame(subject, before, positions, seen, FRAME_SEARCH).pose
    step = jnp.where(moving, difference(subject.skeleton, before, pose), 0.0)
    ahead = retract(subject.skeleton, pose, step)
    return pose, marker_positions(subject, pose), marker_positions(subject, ahead)
