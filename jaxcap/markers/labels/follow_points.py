"""Labels of successive frames: points are assigned to the markers of the pose that the last frames predict."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ...body.kinematics import forward_kinematics
from ...body.pose import Pose
from ..motion.initial_pose import estimate_initial_poses
from ..motion.inverse_kinematics import INITIAL_SEARCH, MIN_MARKERS
from ..motion.solve_frame import SearchCriteria, solve_frame
from ..subject import Subject, marker_positions
from .first_pose import PointPose
from .grow_pose import regrow_bones
from .match_points import match_points, matched_targets

#: gates around the position at the solved pose, metres: of a track that keeps its label, and of a new track
TRACK_GATE, NEW_GATE = 0.04, 0.025
#: growth of the second for each frame without the marker, where other markers do not determine its bone, and largest gate
GATE_GROWTH, MAX_GATE = 0.004, 0.15
#: gate around the last position if too few tracks continue, metres
LAST_GATE = 0.08
#: number of solves in a frame, each after an assignment
MAX_ROUNDS = 3
#: factors of the squared distance for a track that keeps its label, and for a given label
TRACK_DISCOUNT, GIVEN_DISCOUNT = 0.25, 0.1
#: bones with fewer than this share of their markers are matched anew, every so many frames, with this tolerance in metres
BONE_SHARE, REGROW_EVERY, REGROW_TOLERANCE = 0.5, 5, 0.025
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
) -> dict[int, tuple[Int[np.ndarray, "M"], Pose]]:
    """Label frames in their order, forwards or backwards, from the pose of a frame next to the first.

    Returns the columns of the markers in each frame that the pose explains, and the pose. Ends at the first frame of the
    doubtful ones if these last longer than `MAX_DOUBT`.
    """
    state = _State.begin(subject, points, start)
    found = {}
    doubt = 0
    for frame in frames:
        columns = np.flatnonzero(points.tracks[frame] >= 0)
        matched = _label_frame(subject, points, state, frame, columns)
        expected = min(len(columns), int(state.used.sum()))
        if (matched >= 0).sum() < max(MIN_MARKERS, MIN_SHARE * expected):
            doubt += 1
            if doubt > MAX_DOUBT * points.rate:
                break
            continue
        doubt = 0
        found[frame] = np.where(matched >= 0, columns[matched], -1), state.pose
    return found


@dataclass
class _State:
    """What one frame passes to the next."""

    pose: Pose
    #: markers of this pose
    last: Float[np.ndarray, "M 3"]
    #: the track of each marker in the last frame, or -1; frames since then
    tracks: Int[np.ndarray, "M"]
    missed: Int[np.ndarray, "M"]
    used: Bool[np.ndarray, "M"]

    @staticmethod
    def begin(subject: Subject, points: PointSequence, start: PointPose) -> "_State":
        tracks = np.where(start.columns >= 0, points.tracks[start.frame, start.columns], -1)
        markers = np.asarray(marker_positions(subject, start.pose), float)
        used = np.asarray(subject.weights) > 0
        return _State(start.pose, markers, tracks, np.where(tracks >= 0, 0, 1), used)


def _label_frame(
    subject: Subject, points: PointSequence, state: _State, frame: int, columns: Int[np.ndarray, "P"]
) -> Int[np.ndarray, "M"]:
    """Label the points of a frame, and update the state; returns the point of each marker, or -1."""
    at, tracks = points.positions[frame, columns], points.tracks[frame, columns]
    continued = (state.tracks[:, None] == tracks) & (state.tracks[:, None] >= 0)
    named = points.given[columns] == np.arange(len(state.tracks))[:, None]
    discounts = np.where(named, GIVEN_DISCOUNT, np.where(continued, TRACK_DISCOUNT, 1.0))
    # tracks have no jumps, so those that continue move the pose; new ones are compared with the solved pose
    matched = np.where(continued.any(1), continued.argmax(1), -1)
    if (matched >= 0).sum() < MIN_MARKERS:
        gates = np.where(state.used, np.maximum(LAST_GATE, _new_gates(subject, state, matched)), 1e-6)
        matched = match_points(state.last, at, gates[:, None], discounts)
    moment = None
    for _ in range(MAX_ROUNDS):
        if (matched >= 0).sum() < MIN_MARKERS:
            break
        moment = _advance(subject, state.pose, *matched_targets(subject, at, matched))
        gates = np.where(continued | named, TRACK_GATE, _new_gates(subject, state, matched)[:, None])
        gates = np.where(state.used[:, None], gates, 1e-6)
        again = match_points(np.asarray(moment.markers, float), at, gates, discounts)
        same, matched = np.array_equal(again, matched), again
        if same:
            break
    if moment is not None and frame % REGROW_EVERY == 0:
        moment, matched = _regrow(subject, state.used, moment, at, matched)
    if moment is not None:
        state.pose, state.last = moment.pose, np.asarray(moment.markers, float)
    state.missed = np.where(matched >= 0, 0, state.missed + 1)
    state.tracks = np.where(matched >= 0, tracks[matched], -1)
    return matched


def _new_gates(subject: Subject, state: _State, matched: Int[np.ndarray, "M"]) -> Float[np.ndarray, "M"]:
    """Compute the gates of markers for new tracks: wide only where other markers do not determine the bone."""
    bones = np.asarray(subject.bones)
    seen = np.bincount(bones, weights=matched >= 0, minlength=subject.skeleton.num_joints)
    growth = np.where(seen[bones] >= 2, 0.0, GATE_GROWTH * state.missed)
    return np.minimum(NEW_GATE + growth, MAX_GATE)


def _regrow(subject: Subject, used, moment: "_Moment", at, matched) -> tuple["_Moment", Int[np.ndarray, "M"]]:
    """Match bones that lost their markers anew; keep the result if it explains more points."""
    bones, count = np.asarray(subject.bones), subject.skeleton.num_joints
    total = np.bincount(bones, weights=used, minlength=count)
    shown = np.bincount(bones, weights=matched >= 0, minlength=count)
    lost = (total >= 2) & (shown < BONE_SHARE * total)
    free = len(at) - int((matched >= 0).sum())
    known = (total > 0) & ~lost
    if not lost.any() or free < 2 or not known.any():
        return moment, matched
    places = np.asarray(moment.rotations, float), np.asarray(moment.translations, float)
    grown = regrow_bones(subject, *places, known, matched, at, REGROW_TOLERANCE)
    if (grown >= 0).sum() <= (matched >= 0).sum():
        return moment, matched
    targets = matched_targets(subject, at, grown)
    guess = estimate_initial_poses(subject, targets[0][None], targets[1][None])
    other = _advance(subject, jax.tree.map(lambda leaf: leaf[0], guess), *targets, INITIAL_SEARCH)
    again = match_points(np.asarray(other.markers, float), at, np.where(used, TRACK_GATE, 1e-6)[:, None])
    if (again >= 0).sum() <= (matched >= 0).sum():
        return moment, matched
    return other, again


class _Moment(NamedTuple):
    """A solved frame: its pose, markers and bones."""

    pose: Pose
    markers: Float[Array, "M 3"]
    rotations: Float[Array, "J 3 3"]
    translations: Float[Array, "J 3"]


@eqx.filter_jit
def _advance(
    subject: Subject, start: Pose, positions: Float[Array, "M 3"], seen, search: SearchCriteria = FRAME_SEARCH
) -> _Moment:
    pose = solve_frame(subject, start, positions, seen, search).pose
    bones = forward_kinematics(subject.skeleton, pose)
    return _Moment(pose, marker_positions(subject, pose), bones.rotations, bones.translations)
